"""Whether a simulator repeats: two results of one design, and the question to the user if they differ."""

import numpy as np

from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator, cause_name
from activefail.space.space import Array

IF_DIFFERENT = (
    "Is the simulator random? Then `simulator.repeatable = false` in the campaign file makes its noise part of the "
    "model; otherwise make it repeat, for example with a fixed random seed, or state `simulator.repeatable = true` if "
    "the difference does not matter."
)


def in_words(simulator: Simulator, results: Results) -> dict[str, str]:
    """The result of one design, by title."""
    code = int(results.outcome[0])
    outcome = "numerical_failure" if code == NUMERICAL_FAILURE else simulator.outcomes[code]
    cause = cause_name(simulator.causes, int(results.cause[0]))
    margins = zip(simulator.margins, results.margins[0].tolist(), strict=True)
    words = {"outcome": f"{outcome} ({cause})" if cause else outcome}
    return words | {name: "undefined" if value != value else repr(value) for name, value in margins}


def differences(simulator: Simulator, one: Results, other: Results, tolerance: Array | float = 0.0) -> str:
    """How two results of one design differ; empty if they do not.

    Args:
        simulator: gave them.
        one, other: the results.
        tolerance: (k,) by which margins may differ.
    """
    near = np.abs(one.margins[0] - other.margins[0]) <= tolerance
    first, second = in_words(simulator, one), in_words(simulator, other)
    same = {name for name, is_near in zip(simulator.margins, near.tolist(), strict=True) if is_near}
    return "; ".join(
        f"{name} {first[name]}, then {second[name]}"
        for name in first
        if first[name] != second[name] and name not in same
    )
