"""Data as JSON values and as JSON text, with the version of their keys."""

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

VERSION = 1
"""Of the keys that docs/reference/json.md describes."""


def json_text(values: Mapping[str, object]) -> str:
    """The values as a JSON object."""
    return json.dumps(json_values({"version": VERSION, **values}), indent=2, allow_nan=False)


def json_values(data: Mapping[str, object]) -> dict[str, Any]:
    """Data as JSON values.

    A dataclass or a named tuple is an object with its fields, an array is a list, and NaN and infinity are null.
    """
    return {name: _json_value(value) for name, value in data.items()}


def _json_value(value: Any) -> Any:
    if is_dataclass(value):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    elif hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return json_values(value)
    if isinstance(value, list | tuple):
        return [_json_value(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def named(data: object, *names: str) -> dict[str, Any]:
    """These attributes of an object, by their names."""
    return {name: getattr(data, name) for name in names}
