"""What a custom simulator is given and what it returns: names and numbers of one design."""

from collections.abc import Mapping

import numpy as np

from activefail.simulators.interface import Results, UnusableAnswerError
from activefail.space import Array, DesignSpace


def designs_by_name(space: DesignSpace, X: Array) -> list[dict[str, float]]:
    """Designs, (n, d), as a dictionary each: variables and fixed quantities."""
    return [{**dict(zip(space.names, row, strict=True)), **space.fixed} for row in np.asarray(X).tolist()]


def read_answer(said: object, outcomes: tuple[str, ...], margins: tuple[str, ...], seconds: float) -> Results:
    """What a simulator of one's own said of one design, as a record holds it."""
    if isinstance(said, str):
        said = {"outcome": said}
    if not isinstance(said, Mapping):
        raise UnusableAnswerError(f"the answer must be an outcome or a table with one, got {said!r}")
    unknown = set(said) - {"outcome", "margins"}
    if unknown:
        raise UnusableAnswerError(f"the answer may hold outcome and margins, got {sorted(map(str, unknown))[0]!r} too")
    outcome, told = said.get("outcome"), said.get("margins", {})
    # A text, of its own characters: not what says that it equals one.
    text = str.__str__(outcome) if isinstance(outcome, str) else None
    if text not in outcomes:
        raise UnusableAnswerError(f"outcome: must be one of {', '.join(outcomes)}, got {outcome!r}")
    if not isinstance(told, Mapping):
        raise UnusableAnswerError(f"margins: must be a table of {', '.join(margins) or 'nothing'}, got {told!r}")
    for name in told:
        if name not in margins:
            raise UnusableAnswerError(
                f"margins: {name!r} is not declared in simulator.margins, which names {', '.join(margins) or 'none'}"
            )
    values = [told.get(name, np.nan) for name in margins]
    for name, value in zip(margins, values, strict=True):
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise UnusableAnswerError(f"margins.{name}: must be a number, got {value!r}")
    return Results(
        np.array([outcomes.index(text)], dtype=np.int8),
        np.zeros(1, dtype=np.int8),
        np.array([values], dtype=np.float64).reshape(1, len(margins)),
        np.array([seconds]),
    )
