"""Data as JSON values."""

import json
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from activefail.text.json_text import json_text, json_values


class Ends(NamedTuple):
    low: float
    high: float


@dataclass
class Found:
    title: str
    ends: Ends
    levels: Any


def test_data_become_json_values_and_what_is_not_finite_is_null() -> None:
    found = Found("made", Ends(0.5, float("inf")), np.array([[1.0, np.nan], [2.0, 3.0]]))
    values = json_values({"found": found, "count": np.int64(3), "pairs": (1, None)})
    expected = {"title": "made", "ends": {"low": 0.5, "high": None}, "levels": [[1.0, None], [2.0, 3.0]]}
    assert values == {"found": expected, "count": 3, "pairs": [1, None]}
    assert json.loads(json_text({"found": found})) == {"version": 1, "found": expected}
