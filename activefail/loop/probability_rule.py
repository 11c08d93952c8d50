"""The stop rule for a probability: when a campaign knows it well enough to end.

A surrogate cannot know what it has not seen, so its own certainty ends no campaign. After its posterior of the
probability is narrow at two looks, designs far from all others are simulated, where a failure could still hide and
matter. If one of them contradicts the surrogate, the campaign continues.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import DamagedError
from activefail.estimates.hidden import contradictions, designs_of_check, hidden_places, is_whole
from activefail.estimates.integral import BoundariesOf
from activefail.estimates.mode_check import margin_of
from activefail.estimates.model_probability import model_probability
from activefail.learning.criteria.by_margin import SIZE
from activefail.learning.criteria.population import finite
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.system import ByMargins
from activefail.loop.history import History
from activefail.record.batch import CHECK
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space.shares import lognormal_interval
from activefail.space.space import REACH, Array

_BETWEEN = 4
"""Fewest simulations between the two looks that must agree."""

_SURE = 0.5
"""Largest posterior sd of the probability, in units of the stated one: the posterior is too narrow near kinks."""


def least_known(cov: float) -> float:
    """The least probability that a rule with this coefficient of variation can know."""
    return REACH / (_SURE * cov)


@dataclass(frozen=True)
class Looks:
    """What a campaign with a stop rule for a probability knows of it.

    Attributes:
        table: (k, 4) simulations, probability, its posterior standard deviation, and the standard error of its
            integration, at each look since the last check.
        is_known: whether the last iteration held a check that contradicted nothing.
    """

    table: Array = field(default_factory=lambda: np.empty((0, 4)))
    is_known: bool = False

    @property
    def probability(self) -> float:
        """The probability under the classifier of the last look."""
        return float(self.table[-1, 1])

    @property
    def sd(self) -> float:
        """Standard deviation of the probability at the last look, by the posterior and the integration."""
        return float(np.hypot(*self.table[-1, 2:]))

    @property
    def interval(self) -> tuple[float, float, float]:
        """The probability of the last look with its 95 % interval."""
        return self.probability, *lognormal_interval(self.probability, self.sd, REACH)

    def is_narrow(self, cov: float) -> bool:
        """Whether the last look and one at least four simulations before it found a narrow posterior.

        A probability that is not much larger than `space.REACH` is never known: nothing is searched farther out.
        """
        narrow = np.maximum(self.table[:, 2], REACH) <= _SURE * cov * self.table[:, 1]
        before = np.flatnonzero(self.table[:, 0] <= self.table[-1, 0] - _BETWEEN)
        return bool(narrow[-1] and len(before) and narrow[before[-1]])


def looked(
    campaign: Campaign, known: History, iteration: int, before: Classifier | None, classifier: Classifier, looks: Looks
) -> Looks:
    """The looks after one more batch.

    Args:
        campaign: the campaign, with a stop rule for a probability.
        known: its simulations through this iteration.
        iteration: of the batch.
        before: the classifier before the batch.
        classifier: the classifier after it.
        looks: the looks before it.
    """
    row = look(campaign, known, iteration, classifier)
    if not len(row):
        return Looks()
    table = np.concatenate([looks.table, row])
    batch = known[known.iteration == iteration]
    of_check = batch.origin == CHECK
    if before is None or iteration == 0 or not of_check.any():
        return Looks(table)
    check = batch[of_check]
    # The budget may have cut the check short.
    passed = (
        is_whole(designs_of_check(campaign.space.dimension), int(check.answered.sum()))
        and not contradicted(campaign, before, check).any()
    )
    if not of_check.all() or not check.answered.all():
        # Results beside the check, or lost runs, may have widened the posterior again.
        rule = campaign.settings.probability_rule
        assert rule is not None
        passed = passed and Looks(table).is_narrow(rule.cov)
    return Looks(row, is_known=bool(passed) and not has_clipped_margin(campaign, classifier))


def look(campaign: Campaign, known: History, iteration: int, classifier: Classifier) -> Array:
    """The row of one look, (1, 4), after an iteration; none, (0, 4), if the boundary is learned from outcomes."""
    rule = campaign.settings.probability_rule
    assert rule is not None
    latent = classifier.latent(rule.probability)
    if not isinstance(latent, ByMargins):
        # The looks of a classifier of outcomes are too sure of themselves to end a campaign.
        return np.empty((0, 4))
    rng = stream(campaign.settings.seed, "probability", iteration)
    known_now = model_probability(classifier, campaign.features, campaign.space, rule.probability, SIZE, rng)
    return np.array([[len(known), *known_now]])


def has_clipped_margin(campaign: Campaign, classifier: Classifier) -> bool:
    """Whether the boundary is learned from a margin that is clipped at a largest value.

    Such a margin does not show a failure behind this value, so a passed check knows only its own designs.
    """
    rule = campaign.settings.probability_rule
    assert rule is not None
    latent = classifier.latent(rule.probability)
    return isinstance(latent, ByMargins) and latent.is_clipped


LOOKS, KNOWN = "stop/looks", "stop/known"
"""Keys of the looks in a saved state."""


def looks_state(looks: Looks) -> dict[str, NDArray[Any]]:
    """The arrays of a saved state; none without looks."""
    return {LOOKS: looks.table, KNOWN: np.array(int(looks.is_known))} if len(looks.table) else {}


def looks_from_state(campaign: Campaign, state: Mapping[str, NDArray[Any]]) -> Looks:
    """The looks of a saved state.

    Raises:
        DamagedError: if they are not what a campaign saves.
        KeyError: if the campaign would have saved looks and the state has none.
    """
    rule = campaign.settings.probability_rule
    if LOOKS not in state:
        if rule is not None and any(re.fullmatch(rf"{rule.probability}(/\d+)?/unit", key) for key in state):
            raise KeyError(LOOKS)
        return Looks()
    table, known = state[LOOKS], state[KNOWN]
    if table.dtype != np.float64 or table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
        raise DamagedError("holds looks of the stop rule that are not rows of four finite numbers")
    if known.dtype != np.int64 or known.shape != () or int(known) not in (0, 1):
        raise DamagedError("holds a state of the stop rule that is neither 0 nor 1")
    return Looks(table, bool(known))


def contradicted(campaign: Campaign, classifier: Classifier, batch: History) -> NDArray[np.bool_]:
    """Which simulations, (n,), contradict a classifier that has not seen them; no numerical failure does."""
    rule = campaign.settings.probability_rule
    assert rule is not None
    severity = campaign.simulator.outcomes.index(rule.probability)
    latent = classifier.latent(rule.probability)
    margin = None
    if isinstance(latent, ByMargins):
        margin = margin_of(campaign, classifier, severity, batch.outcome, batch.margins)
    wrong = contradictions(
        latent, campaign.features(batch.designs), batch.outcome >= severity, margin, classifier.repeatable
    )
    return np.asarray(wrong & (batch.outcome != NUMERICAL_FAILURE))


def needs_check(campaign: Campaign, history: History, looks: Looks) -> bool:
    """Whether the next batch is a check: the posterior is narrow, and a failure was seen."""
    rule = campaign.settings.probability_rule
    if rule is None or looks.is_known or not len(looks.table):
        return False
    severity = campaign.simulator.outcomes.index(rule.probability)
    return bool((history.outcome >= severity).any()) and looks.is_narrow(rule.cov)


def check_designs(
    campaign: Campaign, simulated: Array, looks: Looks, classifier: Classifier, rng: np.random.Generator
) -> Array:
    """The designs of a check, (4 + 2 d, d), far from all simulated ones in the features: choices have no order.

    Args:
        campaign: the campaign.
        simulated: (n, d) designs that were simulated or are being simulated.
        looks: of the stop rule.
        classifier: knows where designs exist.
        rng: generator of the places.
    """
    space, features = campaign.space, campaign.features

    def seen(Z: Array) -> Array:
        return finite(features, space.from_normal(Z))

    exists, count = BoundariesOf(classifier, features).exists, designs_of_check(space.dimension)
    return hidden_places(space, finite(features, simulated), looks.probability, count, rng, seen, exists)
