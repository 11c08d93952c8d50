"""Outcomes without a simulation, and the bound on their probability."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activefail.shares import percent
from activefail.verification.confidence_bounds import largest_unseen_share

CONFIDENCE = 0.9
"""One-sided confidence of the bound on an unseen outcome's probability."""


def unseen_outcomes(outcomes: Sequence[str], counts: NDArray[np.int64]) -> tuple[str, ...]:
    """The outcomes without a simulation, in order of severity.

    Args:
        outcomes: names of all outcomes.
        counts: (number of outcomes,) simulations by outcome; further entries are ignored.
    """
    return tuple(name for name, count in zip(outcomes, counts, strict=False) if not count)


def unseen_warning(unseen: Sequence[str], simulations: int, initial: int, unanswered: int = 0) -> str:
    """The warning about outcomes without a simulation; empty if there are none.

    Args:
        unseen: names of the outcomes.
        simulations: number of simulations with an outcome.
        initial: how many of these belong to the initial design, a sample of the design space.
        unanswered: numerical failures in the initial design; each may hide an unseen outcome.
    """
    if not unseen:
        return ""
    names = " or ".join(unseen)
    bound = percent(largest_unseen_share(initial, CONFIDENCE, unanswered))
    hidden = f" and {unanswered} numerical failure{'' if unanswered == 1 else 's'}" if unanswered else ""
    subject = "Its probability" if len(unseen) == 1 else "The probability of each"
    return (
        f"None of the campaign's {simulations} simulations ended in {names}. {subject} over the design space may be "
        f"as large as {bound} ({100 * CONFIDENCE:g} % confidence, from {initial} initial designs without "
        f"{'it' if len(unseen) == 1 else 'them'}{hidden}). Until one of them does, no classifier can know where "
        f"{names} begins."
    )
