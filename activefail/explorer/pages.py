"""What a site of the explorer is: pages, and the questions that they ask."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from activefail import __version__
from activefail.explorer.questions import Reader
from activefail.report.environment import page_environment

Answer = dict[str, Any]
"""JSON values."""


def page(name: str, **values: Any) -> str:
    """Render the template of a page or of a part of one."""
    template = page_environment("activefail.explorer").get_template(f"{name}.html.j2")
    return template.render(version=__version__, **values)


class Question(NamedTuple):
    """A question that the pages ask.

    Attributes:
        answer: gives the answer; its arguments are the question's values.
        readers: of the values, by key.
    """

    answer: Callable[..., Answer]
    readers: Mapping[str, Reader] = {}


class Site(Protocol):
    """Pages and the questions that they ask; thread-safe."""

    def page(self, path: str) -> str | None:
        """The page at a path such as "/"; None if there is none. Raises InputError, StoreError."""

    def question(self, path: str) -> Question | None:
        """The question at a path such as "/api/predict"; None if there is none. Raises InputError, StoreError."""

    def below(self, name: str, anew: bool) -> "Site | None":
        """The site of a campaign in the folder of this one, None if there is none; `anew`, if its record has changed.

        Raises InputError, StoreError.
        """

    @property
    def is_busy(self) -> bool:
        """Whether something runs in the background."""

    def close(self) -> None:
        """Stop what runs in the background."""
