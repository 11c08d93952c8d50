"""A simulator's results for a few designs, checked for the record; a failure affects its own design only."""

import signal
import threading
from dataclasses import replace

import numpy as np

from activefail.errors import ActivefailError, description_of, place_of
from activefail.simulators.interface import (
    NOT_FINITE,
    NUMERICAL_FAILURE,
    OUT_OF_MEMORY,
    RAISED,
    UNUSABLE_ANSWER,
    NotFiniteError,
    Results,
    Simulator,
    UnusableAnswerError,
    design_in_words,
    settled,
    unanswered,
)
from activefail.space.space import Array
from activefail.visible import visible

LONGEST_MESSAGE = 2000
"""Characters of a simulator's message that activefail quotes."""


def answer(simulator: Simulator, X: Array) -> Results:
    """A simulator's results for designs, (n, d), with their faults.

    Raises:
        ActivefailError: if the simulator raised one.
    """
    try:
        return _usable(simulator, X, simulator.run(X))
    except (ActivefailError, SystemExit):
        # A simulator that calls sys.exit ends its process.
        raise
    except BaseException as error:
        # Some libraries raise errors that are no Exception: a cancelled task, a panic of Rust code.
        if _is_ctrl_c(error):
            raise
        if len(X) == 1:
            return unanswered(simulator, 1, _cause(error), _description_of(design_in_words(simulator, X[0]), error))
    # One row at a time: a bad design must not fail the others.
    return Results.concatenate([answer(simulator, X[row : row + 1]) for row in range(len(X))])


def _is_ctrl_c(error: BaseException) -> bool:
    """Whether an error may come from Ctrl-C: Python handles it in the main thread only, and workers ignore it."""
    return (
        isinstance(error, KeyboardInterrupt)
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    )


def _usable(simulator: Simulator, X: Array, results: Results) -> Results:
    """Results in the record's types; rows with an invalid outcome, cause or time become numerical failures."""
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
        raise UnusableAnswerError(f"the results must be numbers: {error}") from error
    # Comparisons with NaN are false, so NaN is rejected too.
    has_outcome = (outcome >= NUMERICAL_FAILURE) & (outcome < len(simulator.outcomes)) & (outcome % 1 == 0)
    has_cause = (cause >= 0) & (cause < len(simulator.causes)) & (cause % 1 == 0)
    timed = (seconds >= 0) & (seconds < np.inf)
    good = has_outcome & has_cause & timed
    rule = f"outcome in -1 to {len(simulator.outcomes) - 1}, cause in 0 to {len(simulator.causes) - 1}, seconds >= 0"
    faults = {}
    for row in np.flatnonzero(~good).tolist():
        got = f"outcome {results.outcome[row]}, cause {results.cause[row]}, seconds {results.seconds[row]}"
        faults[row] = f"{design_in_words(simulator, X[row])}: the answer must have {rule}, got {got}"
    return Results(
        np.where(good, outcome, NUMERICAL_FAILURE).astype(np.int8),
        np.where(good, cause, UNUSABLE_ANSWER).astype(np.int8),
        # float64 margins keep their bits.
        np.where(good[:, None], margins, np.nan),
        np.where(timed, seconds, 0.0),
        faults,
    )


def finished(simulator: Simulator, results: Results) -> Results:
    """Results as they leave an executor: lost runs settled, faults visible and cut, whatever a simulator's text is."""
    results = settled(simulator, results)
    return replace(results, faults={row: visible(fault[:LONGEST_MESSAGE]) for row, fault in results.faults.items()})


def _cause(error: BaseException) -> int:
    match error:
        case MemoryError():
            return OUT_OF_MEMORY
        case NotFiniteError():
            return NOT_FINITE
        case UnusableAnswerError():
            return UNUSABLE_ANSWER
        case _:
            return RAISED


def _description_of(design: str, error: BaseException) -> str:
    if isinstance(error, UnusableAnswerError):
        return f"{design}: {error}"
    try:
        description = description_of(error)
    except KeyboardInterrupt as message_error:
        if _is_ctrl_c(message_error):
            raise
        description = f"{type(error).__name__}, whose message cannot be read (KeyboardInterrupt)"
    return f"{design}: {description}{place_of(error, users=True)}"
