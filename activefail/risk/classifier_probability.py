"""A quick probability under a question by the classifier, for searches and charts.

With `POINTS` points it is the first try of `Question.integral`, and the same number wherever that is accurate.
"""

from scipy.special import ndtr

from activefail.campaign.question import Question
from activefail.reliability.integral import SEQUENCES, Standardised, sequences
from activefail.weighted import WeightedRows

POINTS = 1024
"""Points that integrate a probability of a per cent or more."""


def classifier_probability(standardised: Standardised, question: Question, points: int = POINTS) -> float:
    """The probability beyond a boundary, the mean of Φ(z) over a question's distribution.

    Args:
        standardised: the boundary as a function of the campaign's designs.
        question: the distribution of the variables.
        points: number of fixed points; a power of two. Of weighted rows at most twice as many, because they fill the
            space less evenly.
    """
    space = question.space
    if isinstance(space, WeightedRows):
        rows = space.thinned(2 * points)
        return float((rows.weight * ndtr(standardised(question.designs(rows.X)))).mean())
    return float(ndtr(standardised(question.designs(sequences(space, points // SEQUENCES)))).mean())
