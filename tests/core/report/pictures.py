"""Pages without the pictures that take most of their time."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from matplotlib.figure import Figure

from activefail.pages.report import page

_SLOW = ((page, "plot_pairs"), (page, "plot_outcome_planes"))


@contextmanager
def slow_pictures_empty() -> Iterator[None]:
    """Leave those pictures of a campaign empty that take most of a page's time, for a claim about other parts of it."""
    empty = Figure()
    empty.subplots()
    with pytest.MonkeyPatch.context() as patch:
        for module, name in _SLOW:
            patch.setattr(module, name, lambda *_, name=name: [empty] if name == "plot_outcome_planes" else empty)
        yield
