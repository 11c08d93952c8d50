"""Numbers as JSON text, with the version of their keys and null for NaN and infinity."""

import json
import math
from collections.abc import Mapping

VERSION = 1
"""Of the keys that docs/reference/json.md and docs/records.md describe."""


def json_text(values: Mapping[str, object]) -> str:
    """The values as a JSON object."""
    return json.dumps(_without_nan({"version": VERSION, **values}), indent=2, allow_nan=False)


def _without_nan(values: object) -> object:
    if isinstance(values, dict):
        return {name: _without_nan(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [_without_nan(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values
