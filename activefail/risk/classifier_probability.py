"""A quick probability under a question by the classifier, for searches and charts; `Question.integral` is exact."""

from scipy.special import ndtr

from activefail.acquisition.population import integration_points
from activefail.campaign.question import Question
from activefail.reliability.integral import Standardised
from activefail.weighted import WeightedRows

POINTS = 1024
"""Points that integrate a probability of a per cent or more."""


def classifier_probability(standardised: Standardised, question: Question, points: int = POINTS) -> float:
    """The probability beyond a boundary, the mean of Φ(m/s) over a question's distribution.

    The simulator is deterministic. So Φ(m/s) is integrated, the probability of the side under the latent, and not the
    probit probability, which contains label noise.

    Args:
        standardised: mean/sd of the boundary's latent as a function of the campaign's designs.
        question: the distribution of the variables.
        points: number of fixed points; a power of two. Of weighted rows at most twice as many, because they fill the
            space less evenly.
    """
    space = question.space
    X, weight = integration_points(space.thinned(2 * points) if isinstance(space, WeightedRows) else space, points)
    return float((weight * ndtr(standardised(question.designs(X)))).mean())
