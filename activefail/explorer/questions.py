"""How the explorer reads a question: each value by its reader, which checks it and makes an argument of it."""

from collections.abc import Callable, Mapping
from typing import Any

from activefail.errors import InputError

Reader = Callable[[str, Any], Any]
"""Takes the name of a value and the value; raises InputError, naming both and the rule, if the value is invalid."""


def read(question: Any, readers: Mapping[str, Reader], name: str = "question") -> dict[str, Any]:
    """The values of a question as arguments, by key.

    Raises:
        InputError: if it is not an object with these keys alone, or a value is invalid.
    """
    if not isinstance(question, dict) or question.keys() != readers.keys():
        raise InputError(f"{name}: must be a JSON object with the keys {', '.join(readers)}.")
    return {key: reader(f"{name}.{key}", question[key]) for key, reader in readers.items()}


def number(low: float, high: float) -> Reader:
    """A number in a range."""

    def read_number(name: str, value: Any) -> float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        # Compare before converting: this rejects NaN, and an integer may be too large for a float.
        if not (is_number and low <= value <= high):
            raise InputError(f"{name}: must lie between {low:g} and {high:g}, got {value!r}.")
        return float(value)

    return read_number


def one_of(*choices: Any) -> Reader:
    """One of some values."""

    def read_choice(name: str, value: Any) -> Any:
        if value not in choices:
            raise InputError(f"{name}: must be one of {', '.join(map(str, choices))}, got {value!r}.")
        return value

    return read_choice
