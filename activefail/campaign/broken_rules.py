"""Messages for settings that break a rule: key, rule and value; for an unknown key, the nearest known one."""

import json
import re
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel

from activefail.campaign.section import NAME, NUMBER, RANGE, WITH, shown
from activefail.campaign.sections import KINDS
from activefail.campaign.variables import VARIABLES, Variable


def _key(name: str) -> str:
    """A key as TOML writes it: quoted unless it consists of letters, digits, `_` and `-`."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _keys(settings: type[BaseModel], path: Sequence[str]) -> list[str]:
    """The keys of the section at a path; the path is a validation error's `loc`."""
    match path:
        case []:
            section: Any = settings
        case [*_, "space", _, kind]:
            section = VARIABLES.get(kind.removeprefix(WITH), Variable)
        case [*_, "simulator" | "features" | "stop" as name, kind]:
            section = KINDS[name][kind.removeprefix(WITH)]
        case [name, *_]:
            section = settings.model_fields[name].annotation
    # An optional section's type includes None.
    return [key for one in get_args(section) or (section,) if hasattr(one, "model_fields") for key in _names(one)]


def _names(section: type[BaseModel]) -> list[str]:
    """The keys of a section, as a file has them."""
    return [field.alias or name for name, field in section.model_fields.items()]


def _unknown_key(settings: type[BaseModel], path: Sequence[str], key: str) -> str:
    """The message for a key that the section at a path does not have."""
    match path:
        case [*_, "space", _, _] if key in {
            *Variable.model_fields,
            *(key for one in VARIABLES.values() for key in one.model_fields),
        }:
            return "a variable has `low` and `high`, `choices`, `set` or `value`"
        case [*_, "simulator" | "features" | "stop" as name, kind]:
            present = kind.removeprefix(WITH)
            for other, section in KINDS[name].items():
                if key == other:
                    return f"cannot be combined with `{present}`"
                if key in _names(section):
                    return f"belongs to `{other}`; cannot be combined with `{present}`"
    near = get_close_matches(key, _keys(settings, path), 1)
    return f"unknown key; did you mean {near[0]!r}?" if near else "unknown key"


def broken_rule(settings: type[BaseModel], error: Any) -> str:
    """One line of a validation error of the settings: key path, rule and value.

    Args:
        settings: the model of all settings.
        error: an entry of pydantic's `ValidationError.errors()`.
    """
    # The last part of an unknown key's place is the user's, even if it reads like one of our tags.
    whole = error["loc"]
    places, last = (whole[:-1], whole[-1:]) if error["type"] == "extra_forbidden" else (whole, ())
    parts = [part for part in places if part not in (NAME, NUMBER, RANGE, "[key]") and not str(part).startswith(WITH)]
    parts += last
    path = ".".join(_key(str(part)) for part in parts) or "the file"
    message = error["msg"].removeprefix("Value error, ")
    match error["type"]:
        case "extra_forbidden":
            *section, key = error["loc"]
            return f"{path}: {_unknown_key(settings, section, key)}"
        case "missing":
            return f"{path}: required, but missing"
        case "value_error":
            return f"{path}: {message}"
        case "string_pattern_mismatch":
            return f'{path}: must be "module:function", got {shown(error["input"])}'
        case "model_type" | "dict_type":
            return f"{path}: must be a table of keys and values, got {shown(error['input'])}"
        case "too_short" | "too_long" if "actual_length" in error["ctx"]:
            least, most = error["ctx"].get("min_length"), error["ctx"].get("max_length")
            number = least if most is None else most
            rule = f"at {'least' if most is None else 'most'} {number} {'entry' if number == 1 else 'entries'}"
            return f"{path}: must have {rule}, got {shown(error['input'])}"
        case _:
            message = message.replace("Input should be", "must be")
            return f"{path}: {message}, got {shown(error['input'])}"
