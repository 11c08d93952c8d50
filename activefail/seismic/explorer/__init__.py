"""The explorer's page Design: the displacement capacity that a site's hazard requires."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from activefail.seismic.hazard.hazard import CAPACITY, Hazard
from activefail.space.space import DesignSpace

if TYPE_CHECKING:
    from activefail.pages.explorer.campaign import OneDesign
    from activefail.pages.explorer.jobs import Jobs
    from activefail.seismic.explorer.design import DesignPage


def design_page(space: DesignSpace) -> "tuple[str, Callable[[OneDesign, Jobs], DesignPage]] | None":
    """The title and the maker of the page of a campaign with a pulse and a displacement capacity; None for others."""
    has_capacity = any(one.name == CAPACITY and not one.choices for one in space.parameters)
    return ("Design for a target", _made) if has_capacity and Hazard.applies_to(space) else None


def _made(one: "OneDesign", jobs: "Jobs") -> "DesignPage":
    from activefail.seismic.explorer.design import DesignPage  # it loads torch

    return DesignPage(one, jobs)
