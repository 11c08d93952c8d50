"""The intensities of pulses: their levels, and questions about an amplitude in place of a velocity."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from activefail.campaign.question import Question
from activefail.seismic.hazard.velocity import AMPLITUDE, PGV
from activefail.space.space import Array
from activefail.space.weighted import WeightedRows

_UNITS = {"pgv": (PGV, "m/s"), "a_p": (AMPLITUDE, "g")}
"""Name and unit of each intensity."""

_PER_DECADE = 24
"""Levels of an intensity in a factor of ten."""

_RANGES = {"pgv": (0.1, 4.0), "a_p": (0.02, 2.0)}
"""Range of the levels of each intensity."""


def levels_of(intensity: str, velocities: Sequence[float]) -> tuple[str, str, Array]:
    """Name, unit and levels of an intensity: 24 fixed ones in a factor of ten.

    Args:
        intensity: "pgv" or "a_p".
        velocities: that those of "pgv" include [m/s].
    """
    low, high = _RANGES[intensity]
    if intensity == "pgv":
        low, high = min(low, *velocities), max(high, *velocities)
    first, last = (_PER_DECADE * np.log10(end) for end in (low, high))
    steps = np.arange(int(np.floor(first + 1e-9)), int(np.ceil(last - 1e-9)) + 1)
    return *_UNITS[intensity], np.asarray(10.0 ** (steps / _PER_DECADE))


def with_amplitude(question: Question) -> Question:
    """A question about a velocity as one about an amplitude with the same numbers."""

    def renamed(name: str) -> str:
        return AMPLITUDE if name == PGV else name

    space = question.space
    if isinstance(space, WeightedRows):
        space = replace(space, names=tuple(map(renamed, space.names)))
    else:
        parameters = (replace(one, name=AMPLITUDE, unit="g") if one.name == PGV else one for one in space.parameters)
        space = replace(space, parameters=tuple(parameters))
    return replace(question, space=space, fixed={renamed(name): value for name, value in question.fixed.items()})
