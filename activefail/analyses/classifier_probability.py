"""A quick probability under a question by the classifier, for searches and charts.

With `POINTS` points it is the first try of `Question.integral`, and the same number wherever that is accurate.
"""

import numpy as np
from scipy.special import ndtr

from activefail.campaign.question import Question
from activefail.estimates.integral import SEQUENCES, Standardised, existence, sequences
from activefail.space.weighted import WeightedRows

POINTS = 1024
"""Points that integrate a probability of a per cent or more."""


def classifier_probability(standardised: Standardised, question: Question, points: int = POINTS) -> float:
    """The probability beyond a boundary, the mean of Φ(z) over the designs of a question's distribution that exist.

    Args:
        standardised: the boundary as a function of the campaign's designs.
        question: the distribution of the variables.
        points: number of fixed points; a power of two. Of weighted rows at most twice as many, because they fill the
            space less evenly.
    """
    space, weight = question.space, np.ones(1)
    if isinstance(space, WeightedRows):
        rows = space.thinned(2 * points)
        X, weight = question.designs(rows.X), rows.weight
    else:
        X = question.designs(sequences(space, points // SEQUENCES))
    beyond = float((weight * ndtr(standardised(X))).mean())
    exists = existence(standardised)
    return beyond if exists is None else min(1.0, beyond / float((weight * ndtr(exists(X)[:, 0])).mean()))
