"""One simulator's answers to a few designs, as the record holds them; what fails costs itself alone."""

import numpy as np

from activefail.errors import ActivefailError, description_of, place_of
from activefail.simulators.interface import (
    NUMERICAL_FAILURE,
    OUT_OF_MEMORY,
    RAISED,
    UNUSABLE_ANSWER,
    Results,
    Simulator,
    UnusableAnswerError,
    unanswered,
)
from activefail.space import Array
from activefail.visible import visible

LONGEST_MESSAGE = 2000
"""Characters of a simulator's message that activefail repeats."""


def answer(simulator: Simulator, X: Array) -> tuple[Results, str]:
    """A simulator's answers to designs, (n, d), and why the first one without an answer failed; "" if none failed.

    Raises:
        ActivefailError: if the simulator raised one, on purpose.
    """
    try:
        return _usable(simulator, X, simulator.run(X))
    except ActivefailError:
        raise
    except Exception as error:
        if len(X) == 1:
            return unanswered(simulator, 1, _cause(error)), _description_of(X[0], error)
    # One row at a time: one bad design must not cost those beside it.
    parts = [answer(simulator, X[row : row + 1]) for row in range(len(X))]
    return Results.concatenate([results for results, _ in parts]), next((fault for _, fault in parts if fault), "")


def _usable(simulator: Simulator, X: Array, results: Results) -> tuple[Results, str]:
    """Results as the record holds them; rows without an outcome that has a name are numerical failures."""
    n, k = len(X), len(simulator.margins)
    if not isinstance(results, Results):
        raise UnusableAnswerError(f"the simulator must return Results, got {type(results).__name__}")
    if results.margins.shape != (n, k):
        raise UnusableAnswerError(f"the margins must have shape {(n, k)}, got {results.margins.shape}")
    try:
        outcome, cause, margins, seconds = (
            np.asarray(column, dtype=np.float64)
            for column in (results.outcome, results.cause, results.margins, results.seconds)
        )
    except (TypeError, ValueError) as error:
        raise UnusableAnswerError(f"the answers must be numbers: {error}") from error
    # Comparisons with NaN are false, so that NaN is no outcome either.
    has_outcome = (outcome >= NUMERICAL_FAILURE) & (outcome < len(simulator.outcomes)) & (outcome % 1 == 0)
    has_cause = (cause >= 0) & (cause < len(simulator.causes)) & (cause % 1 == 0)
    timed = (seconds >= 0) & (seconds < np.inf)
    good = has_outcome & has_cause & timed
    fault = ""
    if not good.all():
        row = int(np.argmin(good))
        got = f"outcome {results.outcome[row]}, cause {results.cause[row]}, seconds {results.seconds[row]}"
        rule = (
            f"outcome in -1 to {len(simulator.outcomes) - 1}, cause in 0 to {len(simulator.causes) - 1}, seconds >= 0"
        )
        fault = f"design {X[row].tolist()}: the answer must have {rule}, got {got}"
    usable = Results(
        np.where(good, outcome, NUMERICAL_FAILURE).astype(np.int8),
        np.where(good, cause, UNUSABLE_ANSWER).astype(np.int8),
        # Bit for bit where it is float64 already.
        np.where(good[:, None], margins, np.nan),
        np.where(timed, seconds, 0.0),
    )
    return usable, fault


def shown_fault(fault: str) -> str:
    """A fault as messages show it: a simulator may say anything, at any length."""
    return visible(fault[:LONGEST_MESSAGE])


def _cause(error: Exception) -> int:
    match error:
        case MemoryError():
            return OUT_OF_MEMORY
        case UnusableAnswerError():
            return UNUSABLE_ANSWER
        case _:
            return RAISED


def _description_of(design: Array, error: Exception) -> str:
    if isinstance(error, UnusableAnswerError):
        return f"design {design.tolist()}: {error}"
    return f"design {design.tolist()}: {description_of(error)}{place_of(error)}"
