"""Outcomes that no simulation of a campaign ended in: which ones, and what may be said of them all the same."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.stratified import largest_unseen_share
from activefail.shares import percent

CONFIDENCE = 0.9
"""Of the bound on an unseen outcome's probability, one-sided."""


def unseen_outcomes(outcomes: Sequence[str], counts: NDArray[np.int64]) -> tuple[str, ...]:
    """The outcomes, in order of severity, that were never counted.

    Args:
        outcomes: their names.
        counts: (number of outcomes,) simulations that ended in each; more numbers are ignored.
    """
    return tuple(name for name, count in zip(outcomes, counts, strict=False) if not count)


def unseen_warning(unseen: Sequence[str], simulations: int, initial: int, unanswered: int = 0) -> str:
    """What a user must know of a campaign that never saw some outcomes; empty where it saw all.

    Args:
        unseen: the names of the outcomes.
        simulations: how many gave an answer.
        initial: how many of these are of the initial design, which is a sample of the design space.
        unanswered: how many more of the initial design gave no answer; each may hide an unseen outcome.
    """
    if not unseen:
        return ""
    names = " or ".join(unseen)
    bound = percent(largest_unseen_share(initial, CONFIDENCE, unanswered))
    hidden = f" and {unanswered} without an answer" if unanswered else ""
    what = "Its probability" if len(unseen) == 1 else "The probability of each"
    return (
        f"None of the campaign's {simulations} simulations ended in {names}. {what} over the design space may be as "
        f"large as {bound}: {initial} initial designs without it{hidden} show no more, with {100 * CONFIDENCE:g} % "
        f"confidence. The classifier cannot know where {names} begins."
    )
