"""The share of the design space that a classifier gets wrong, from fresh simulations, and the stop rule for it.

The design space is stratified by the classifier's own probability of being wrong. Each part gets simulations in
proportion to its volume times its standard deviation [Neyman1934], and the results are weighted back to the design
measure (`StratifiedCount`). Only fresh simulations count: training designs reveal too little of what the classifier
has missed, even if each is left out in turn.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.estimates.confidence_bounds import StratifiedCount
from activefail.estimates.scores import error_in_words, error_of, keep_of
from activefail.estimates.stored_sets import looks_before, set_name
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.moments import Moments
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, is_impossible
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.estimates.probability_estimator import Estimator
    from activefail.learning.model.saved import SavedClassifier

EDGES = (0.005, 0.02, 0.08, 0.25)
"""Probabilities of being wrong that divide the design space into five parts."""

POOL = 2**14
"""Random designs that estimate the parts' volumes."""


@dataclass(frozen=True)
class ErrorEstimate:
    """An estimate of the classifier's error with its interval.

    Attributes:
        error: estimated share of the designs that exist that is misclassified.
        low, high: two-sided interval of the error, with equal tails.
        confidence: of the interval.
        count: misclassified designs by part; numerical failures count as misclassified.
        simulations: fresh simulations with an outcome.
        misclassified: how many of these are.
        expected: error that the classifier's own probabilities predict.
        requested: all fresh simulations, including numerical failures and designs that do not exist.
        nonexistent: fresh simulations that say that their design does not exist; they count for nothing.
    """

    error: float
    low: float
    high: float
    confidence: float
    count: StratifiedCount
    simulations: int
    misclassified: int
    expected: float
    requested: int
    nonexistent: int = 0

    @property
    def in_words(self) -> tuple[str, str]:
        """The error with its interval, and what it rests on."""
        return error_in_words(self.as_json())

    def as_json(self) -> dict[str, float | int]:
        """The estimate as JSON values; `docs/reference/json.md` describes the keys."""
        absent = {"nonexistent": self.nonexistent} if self.nonexistent else {}
        return {
            "error": self.error,
            "low": self.low,
            "high": self.high,
            "confidence": self.confidence,
            "simulations": self.simulations,
            "numerical_failures": self.requested - self.simulations - self.nonexistent,
            **absent,
            "misclassified": self.misclassified,
            "expected": self.expected,
        }

    def is_at_most(self, level: float, confidence: float) -> bool:
        """Whether the error is at most `level`, with one-sided confidence."""
        return self.count.upper(confidence) <= level


def confidence_of_look(confidence: float, look: int) -> float:
    """The confidence of look number `look`, from 1 on, that gives all looks together `confidence`.

    Repeated looks would eventually end a campaign by chance. Look j may therefore err with probability
    (1 − confidence)/(j (j + 1)) only, which sums to 1 − confidence over all looks.
    """
    return 1.0 - (1.0 - confidence) / (look * (look + 1))


def probability_wrong(moments: Moments) -> Array:
    """min(p, 1 − p): the classifier's own probability of being wrong, (n,)."""
    return np.asarray(np.minimum(moments.probability, 1.0 - moments.probability))


@dataclass(frozen=True)
class Verification:
    """A plan of fresh simulations for one latent.

    Attributes:
        designs: (n, d), ordered by part.
        part: (n,) part of each design.
        predicted: (n,) bool, whether the classifier puts the design beyond the boundary.
        volumes: (5,) of the parts, as shares of the designs that exist by the classifier.
        expected: (5,) the classifier's mean probability of being wrong in each part.
        pool: number of random designs that estimated the volumes; of those that may not exist, the sum of their
            probabilities.
    """

    designs: Array
    part: NDArray[np.intp]
    predicted: NDArray[np.bool_]
    volumes: Array
    expected: Array
    pool: int = POOL


def planned(estimator: "Estimator", simulations: int) -> Verification:
    """The plan that verifies a classifier: fresh designs, random within each part.

    None is left out because it probably does not exist: the classifier may be wrong about that, too, and where it never
    saw a result it is wrong most often.
    """
    campaign, (pool, existence) = estimator.campaign, pool_of(estimator, POOL)
    moments = estimator.classifier.latents[campaign.severity - 1].moments(campaign.features(pool))
    doubt = probability_wrong(moments)
    part = np.searchsorted(EDGES, doubt, side="right")
    parts = len(EDGES) + 1
    counts = np.bincount(part, minlength=parts)
    of_parts, doubts = (
        np.asarray(np.bincount(part, weights=weight, minlength=parts), dtype=np.float64)
        for weight in (existence, doubt * existence)
    )
    volumes, expected = of_parts / existence.sum(), doubts / np.where(of_parts > 0.0, of_parts, 1.0)
    numbers = np.minimum(allotted(volumes, expected, simulations), counts)
    rows = np.concatenate([np.nonzero(part == k)[0][: numbers[k]] for k in range(parts)])
    return Verification(pool[rows], part[rows], moments.mean[rows] > 0.0, volumes, expected, math.ceil(existence.sum()))


def pool_of(estimator: "Estimator", n: int) -> tuple[Array, Array]:
    """n random designs, (n, d), and the probability that each exists, (n,)."""
    campaign = estimator.campaign
    X = campaign.space.random(n, stream(campaign.settings.seed, "verification", estimator.iteration))
    return X, estimator.classifier.existence(X)


def existing(campaign: Campaign, results: Results) -> NDArray[np.bool_]:
    """Which of n simulations do not say that their design does not exist, (n,)."""
    return ~is_impossible(campaign.simulator, results.outcome, results.cause)


def allotted(volumes: Array, expected: Array, n: int) -> NDArray[np.intp]:
    """Neyman allocation of n simulations to the parts, (5,): proportional to volume times standard deviation.

    Args:
        volumes: (5,) of the parts.
        expected: (5,) the classifier's mean probability of being wrong in each part.
        n: simulations in all.
    """

    # At least 1 % wrong in every part: the classifier's own certainty must not exempt a part from the test.
    share = np.maximum(expected, 0.01)
    weights = volumes * np.sqrt(share * (1.0 - share))
    return _rounded(n * weights / weights.sum(), np.full(len(weights), n))


def estimate_error(
    plan: Verification,
    beyond: NDArray[np.bool_],
    answered: NDArray[np.bool_],
    confidence: float,
    exists: NDArray[np.bool_] | None = None,
) -> ErrorEstimate:
    """Estimate the error from the outcomes of a plan.

    Numerical failures are not random, and may be misclassified: the upper end of the interval counts all of them as
    misclassified, the lower end none. Designs that do not exist are no part of the space, and those that do are a
    random sample of those of their part.

    Args:
        plan: the fresh simulations.
        beyond: (n,) whether each planned design is beyond the boundary.
        answered: (n,) whether it has an outcome.
        confidence: of the interval.
        exists: (n,) whether it exists; all if None.
    """
    parts = len(EDGES) + 1
    misclassified = (plan.predicted != beyond) & answered

    def counted(designs: NDArray[np.bool_], hits: NDArray[np.bool_]) -> StratifiedCount:
        n, x = (np.bincount(plan.part[rows], minlength=parts).astype(np.float64) for rows in (designs, hits))
        return StratifiedCount(plan.volumes, n, x, plan.pool)

    everything = np.ones(len(answered), dtype=bool) if exists is None else exists
    count = counted(everything, (misclassified | ~answered) & everything)
    one_sided = 0.5 + confidence / 2
    return ErrorEstimate(
        counted(answered, misclassified).estimate(plan.expected),
        counted(everything, misclassified).lower(one_sided),
        count.upper(one_sided),
        confidence,
        count,
        int(answered.sum()),
        int(misclassified.sum()),
        float(plan.volumes @ plan.expected),
        len(answered),
        int((~everything).sum()),
    )


def expected_error(campaign: Campaign, classifier: "Classifier | SavedClassifier") -> float:
    """The error that the classifier expects: its mean probability of being wrong about the target boundary."""
    pool = campaign.space.sobol(POOL // 4, np.random.default_rng(0))
    doubt = probability_wrong(classifier.latents[campaign.severity - 1].moments(campaign.features(pool)))
    existence = classifier.existence(pool)
    return float(doubt @ existence / existence.sum())


def could_show(plan: Verification, error: float, confidence: float) -> bool:
    """Whether a plan would show an error of at most `error` if half as many are wrong as the classifier expects."""
    counted = np.bincount(plan.part, minlength=len(EDGES) + 1).astype(np.float64)
    return StratifiedCount(plan.volumes, counted, 0.5 * counted * plan.expected, plan.pool).upper(confidence) <= error


def least_simulations(error: float, confidence: float) -> int:
    """Fewest simulations, all classified correctly, that show an error of at most `error` at the first look."""
    return int(np.ceil(np.log1p(-confidence_of_look(confidence, 1)) / np.log1p(-error)))


def verify_by_rule(
    estimator: "Estimator", stop: Callable[[], bool] = lambda: False
) -> tuple[ErrorEstimate | None, bool]:
    """The verified error if the stop rule looks now, otherwise None, and whether the rule is met.

    Simulates nothing if the classifier itself expects a larger error than the rule allows, or if the rule has too few
    simulations to show so small an error.
    """
    rule = estimator.campaign.settings.error_rule
    if rule is None or expected_error(estimator.campaign, estimator.classifier) > rule.error:
        return None, False
    confidence = confidence_of_look(rule.confidence, 1 + looks_before(estimator.store, estimator.iteration))
    plan = planned(estimator, rule.simulations)
    if not could_show(plan, rule.error, confidence):
        return None, False
    results = estimator.results(*_names(estimator, rule.simulations), plan.designs, stop)
    if results is None:
        return None, False
    error = _judged(estimator.campaign, plan, results, rule.confidence)
    keep_of(estimator.store, error_of(estimator.store.digest), error.as_json(), estimator.campaign.learner_code)
    return error, error.is_at_most(rule.error, confidence)


def verify(estimator: "Estimator", simulations: int, confidence: float) -> ErrorEstimate:
    """Estimate the error of the classifier from fresh simulations, which are kept in the run folder."""
    plan, (of_look, name) = planned(estimator, simulations), _names(estimator, simulations)
    results = estimator.results(name, of_look, plan.designs)
    assert results is not None  # no stop was requested
    error = _judged(estimator.campaign, plan, results, confidence)
    keep_of(estimator.store, error_of(estimator.store.digest), error.as_json(), estimator.campaign.learner_code)
    return error


def _names(estimator: "Estimator", simulations: int) -> tuple[str, str]:
    """Names of a look's fresh simulations, and of a user's; their designs are the same."""
    of = estimator.iteration, simulations
    return set_name("look", *of), set_name("verification", *of)


def _judged(campaign: Campaign, plan: Verification, results: Results, confidence: float) -> ErrorEstimate:
    answered = results.outcome != NUMERICAL_FAILURE
    beyond = results.outcome >= campaign.severity
    return estimate_error(plan, beyond, answered, confidence, existing(campaign, results))


def _rounded(shares: Array, most: NDArray[np.int_]) -> NDArray[np.int_]:
    """Whole numbers near the shares, (s,), with the same sum, none above its greatest number, (s,)."""
    total = round(float(shares.sum()))
    counts = np.minimum(np.floor(shares).astype(np.int_), most)
    while counts.sum() < total:
        counts[np.argmax(np.where(counts < most, shares - counts, -np.inf))] += 1
    return counts
