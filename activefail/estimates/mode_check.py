"""The mode check of a question: simulations far from all others, where an outcome could hide and still matter.

The stop rule for a probability has such a check under the campaign's own distributions (`loop.probability_rule`). Fresh
simulations go where the classifier doubts, or are drawn by probability. They may all miss a region that it is sure of.
"""

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.estimates.estimate import deviation_of_margins
from activefail.estimates.hidden import ModeCheck, contradictions, designs_of_check, hidden_places
from activefail.estimates.integral import Boundaries
from activefail.learning.criteria.population import finite
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.margin_choice import taken
from activefail.learning.model.system import AnyLatent, ByMargins
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, is_impossible
from activefail.space.space import REACH, Array, DesignSpace


def is_checked(question: Question, latent: AnyLatent) -> bool:
    """Whether an estimate has a mode check: under a question, of a boundary that was learned from a margin.

    Far from all simulations a classifier of outcomes doubts, and the fresh simulations know that
    (docs/decisions/0017). The rows of a table leave no place where an outcome could hide.
    """
    return not question.is_own and isinstance(question.space, DesignSpace) and isinstance(latent, ByMargins)


def places_of_check(
    campaign: Campaign,
    question: Question,
    simulated: Array,
    probability: float,
    rng: np.random.Generator,
    exists: Boundaries | None = None,
) -> Array:
    """Designs of a check, (4 + 2 k, d) for k uncertain variables, far from all simulated ones in the features.

    Args:
        campaign: the campaign.
        question: that has a check.
        simulated: (n, d) designs.
        probability: the estimate under the question.
        rng: generator of the places.
        exists: where designs exist; None if all do.
    """
    space, features = question.space, campaign.features
    assert isinstance(space, DesignSpace)

    def seen(Z: Array) -> Array:
        return finite(features, question.designs(space.from_normal(Z)))

    known, count = finite(features, simulated), designs_of_check(space.dimension)
    existing = None if exists is None else lambda X: exists(question.designs(X))
    return question.designs(hidden_places(space, known, max(REACH, probability), count, rng, seen, existing))


def check_of(campaign: Campaign, classifier: Classifier, outcome: str, designs: Array, results: Results) -> ModeCheck:
    """What the simulations of a check show.

    Args:
        campaign: the campaign.
        classifier: that has not seen them, and learned the boundary from a margin.
        outcome: of the boundary.
        designs: (n, d).
        results: of the n designs.
    """
    severity, latent = campaign.simulator.outcomes.index(outcome), classifier.latent(outcome)
    assert isinstance(latent, ByMargins)
    # A design that does not exist hides nothing.
    answered = (results.outcome != NUMERICAL_FAILURE) | is_impossible(
        campaign.simulator, results.outcome, results.cause
    )
    margin = margin_of(campaign, classifier, severity, results.outcome, results.margins)
    deviation = deviation_of_margins(latent, campaign.features, designs, margin)
    beyond, F = results.outcome >= severity, finite(campaign.features, designs)
    wrong = contradictions(latent, F, beyond, None, classifier.repeatable)
    return ModeCheck(len(answered), int((~answered).sum()), int((wrong & answered).sum()), deviation)


def margin_of(
    campaign: Campaign, classifier: Classifier, severity: int, outcome: NDArray[np.int8], margins: Array
) -> Array:
    """The margin, (n,), or those of a system, (n, k), that a boundary was learned from, in relation to it.

    Args:
        campaign: the campaign.
        classifier: whose boundary was learned from a margin.
        severity: number of the boundary's outcome.
        outcome: (n,) of the simulations.
        margins: (n, k) as the simulator reported them.
    """
    related = campaign.margins_at(severity, outcome, margins)
    return taken(related, classifier.choices[severity - 1].margin, campaign.system)
