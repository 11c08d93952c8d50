"""How a simulated design is shown, where a plug-in brings that for its simulator."""

from typing import NamedTuple, Protocol

from markupsafe import Markup

from activefail.plugins import brought
from activefail.space.space import Array


class Picture(NamedTuple):
    """A simulated design in the report's gallery.

    Attributes:
        drawn: the picture.
        result: how the simulation ended.
        terms: the design in other terms, with `_` before a subscript; may be empty.
    """

    drawn: Markup
    result: str
    terms: str


class View(Protocol):
    """Shows simulated designs in the report and in the explorer; thread-safe.

    A plug-in's `views` are functions of a simulator, which names one of them by its optional attribute `view`.
    """

    @property
    def legend(self) -> str:
        """What pictures show, as a sentence."""

    def prepare(self, X: Array) -> None:
        """Compile and load what simulates, for a design, (d,)."""

    def picture(self, X: Array, name: str, of: str) -> Picture | None:
        """A simulated design, (d,); None if it has no motion to draw.

        Args:
            X: the design.
            name: prefix of the picture's ids.
            of: which simulation it is, in words.
        """

    def panel(self, X: Array, width: float) -> Markup:
        """The explorer's panel of a simulated design, (d,), with figures of a width [in]."""


def view_of(simulator: object) -> View | None:
    """The view of a simulator; None if it names none."""
    name = getattr(simulator, "view", None)
    if name is None:
        return None
    view: View = brought("views")[name](simulator)
    return view
