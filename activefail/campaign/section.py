"""What all tables of a settings file have in common: strict keys, alternatives, and rules that objects state."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator

from activefail.errors import InputError

NAME, NUMBER, RANGE = "a name", "a number", "a range"
WITH = "a table with "
"""Tags of alternative values, which no message shows."""

_SHOWN = 200
"""Longest value shown in a message, in characters."""


def shown(value: object) -> str:
    """A value as shown in messages."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print integers of more than 4300 digits
        return "a number with thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


class Section(BaseModel):
    """A table of the settings; it knows no other keys, takes no infinite numbers and is frozen."""

    # Strict: reject "7" as a seed and 0 as a boolean.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


Built = TypeVar("Built")


def built(build: Callable[[], Built]) -> Built:
    """What a table states, to check it.

    Raises:
        ValueError: the rule that it breaks, without the name of the object.
    """
    try:
        return build()
    except InputError as error:
        raise ValueError(str(error.__cause__ or error)) from None


def name_or(other: str) -> Callable[[Any], str]:
    """Which of two alternatives a value is: a text, or what has the other tag."""
    return lambda value: NAME if isinstance(value, str) else other


def by_key(sections: Mapping[str, type[Section]], otherwise: str = NAME) -> Discriminator:
    """Discriminate tables by the key that only one of them has, and `otherwise`: a name, another table or neither."""

    def kind(value: Any) -> str:
        for key, section in sections.items():
            if isinstance(value, section) or (isinstance(value, dict) and key in value):
                return f"{WITH}{key}"
        return "" if isinstance(value, dict) and otherwise == NAME else otherwise

    keys = " or ".join(f"{WITH}`{key}`" for key in sections)
    return Discriminator(kind, "no_such_table", f"must be {'a name, ' if otherwise == NAME else ''}{keys}")
