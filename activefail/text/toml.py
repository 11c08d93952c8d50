"""TOML from files that may come from someone else."""

import tomllib
from pathlib import Path
from typing import Any

from activefail.errors import InputError
from activefail.text.trust import read_regular

_MOST_DOTS = 200
"""Most dots in a line of TOML: the time to parse a dotted key grows with the square of their number."""


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """The values of TOML."""
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MOST_DOTS:
            raise InputError(f"{source}: line {number}: must have at most {_MOST_DOTS} dots, has {line.count('.')}")
    try:
        values = tomllib.loads(text)
        _check_texts(values, source)
        return values
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{source}: not valid TOML: tables or lists are nested hundreds of levels deep.") from None
    except ValueError as error:  # a TOMLDecodeError, or an integer of thousands of digits
        raise InputError(f"{source}: not valid TOML: {error}") from None


def _check_texts(values: object, source: str) -> None:
    """Check that no text has a NUL, which no name of a file may contain."""
    if isinstance(values, dict):
        values = [*values, *values.values()]
    for value in values if isinstance(values, list) else [values]:
        if isinstance(value, dict | list):
            _check_texts(value, source)
        elif isinstance(value, str) and "\0" in value:
            raise InputError(f"{source}: a text must not contain the character U+0000, got {value!r}.")


_LARGEST_FILE = 10_000_000
"""Most bytes of a TOML file."""


def read_toml(path: Path) -> dict[str, Any]:
    """The values of a TOML file.

    Raises:
        InputError: if the file cannot be read, is too large, or is not UTF-8 or TOML.
    """
    try:
        text = read_regular(path, _LARGEST_FILE, follow=True).decode("utf-8-sig")
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    except ValueError as error:
        raise InputError(f"{path}: cannot be read: it {error}.") from None
    return parse_toml(text, str(path))
