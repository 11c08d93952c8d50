"""How well a classifier's probabilities hold where the simulator does not repeat: log score and calibration.

Fresh simulations of random designs judge P(at least as severe | design). No design is wrong: its outcome is random.
"""

from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy
from scipy.stats import t

from activefail.errors import SimulationError
from activefail.estimates.confidence_bounds import upper_bound
from activefail.estimates.error import POOL, existing, pool_of
from activefail.estimates.probability_estimator import Estimator
from activefail.estimates.scores import fits, keep_of, kept_of
from activefail.estimates.stored_sets import set_name
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space.shares import interval_percent, percent
from activefail.space.space import Array
from activefail.text.numerals import counted

EDGES = (0.0, 0.1, 0.3, 0.7, 0.9, 1.0)
"""Probabilities that divide the designs for the calibration."""


@dataclass(frozen=True)
class CalibrationClass:
    """The fresh simulations whose probability lies in one class.

    Attributes:
        low_edge, high_edge: of the probability.
        simulations: number of them.
        predicted: their mean probability.
        observed: the share that ended beyond the boundary.
        low, high: its interval [ClopperPearson1934].
    """

    low_edge: float
    high_edge: float
    simulations: int
    predicted: float
    observed: float
    low: float
    high: float


@dataclass(frozen=True)
class SurfaceScore:
    """How well the probabilities hold.

    Attributes:
        log_score: mean logarithm of the probability of the side of the boundary on which each simulation ended [nat].
        low, high: its interval.
        expected_log_score: that the classifier's own probabilities predict.
        confidence: of the intervals.
        simulations: fresh simulations with an outcome.
        numerical_failures: other fresh simulations of designs that exist, which are not scored.
        calibration: of the probabilities, by classes that have simulations.
        nonexistent: fresh simulations that say that their design does not exist; they count for nothing.
    """

    log_score: float
    low: float
    high: float
    expected_log_score: float
    confidence: float
    simulations: int
    numerical_failures: int
    calibration: tuple[CalibrationClass, ...]
    nonexistent: int = 0

    def as_json(self) -> dict[str, Any]:
        """The score as JSON values; `docs/reference/json.md` describes the keys."""
        values = asdict(self) | {"calibration": [asdict(one) for one in self.calibration]}
        return {key: value for key, value in values.items() if key != "nonexistent" or value}

    def rows(self, boundary: str) -> list[tuple[str, str]]:
        """Titles and texts of the score and the calibration, for the outcome of the boundary."""
        failed = f"; {self.numerical_failures} failed numerically" if self.numerical_failures else ""
        failed += f"; {self.nonexistent} designs that do not exist left out" if self.nonexistent else ""
        classes = [
            (
                f"P {part.low_edge:g} to {part.high_edge:g}",
                f"{percent(part.observed)} observed ({interval_percent(part.low, part.high)}), "
                f"{percent(part.predicted)} predicted, {counted(part.simulations, 'simulation')}",
            )
            for part in self.calibration
        ]
        return [
            (
                "log score",
                f"{self.log_score:.3f} ({self.low:.3f} to {self.high:.3f}) nat: mean log P of the side of the boundary "
                f"of {boundary} on which {self.simulations} fresh simulations ended{failed}",
            ),
            ("expected", f"{self.expected_log_score:.3f} by the classifier's own probabilities, without an interval"),
            *classes,
            ("", f"intervals with {100 * self.confidence:g} % confidence each"),
        ]


def score(
    probability: Array, beyond: NDArray[np.bool_], lost: int, confidence: float, nonexistent: int = 0
) -> SurfaceScore:
    """The score of probabilities, (n,), by whether simulations ended beyond the boundary, (n,); others were lost."""
    p, n = np.clip(probability, 1e-12, 1.0 - 1e-12), len(probability)
    scores = np.log(np.where(beyond, p, 1.0 - p))
    half = float(t.ppf(0.5 + 0.5 * confidence, n - 1)) * float(scores.std(ddof=1)) / np.sqrt(n)
    middle, expected = float(scores.mean()), float((xlogy(p, p) + xlogy(1.0 - p, 1.0 - p)).mean())
    place, classes, sure = np.searchsorted(EDGES[1:-1], p, side="right"), [], 0.5 + 0.5 * confidence
    for number in np.unique(place):
        rows = place == number
        k, hits = int(rows.sum()), int(beyond[rows].sum())
        ends = 1.0 - upper_bound(k - hits, k, sure), upper_bound(hits, k, sure)
        edges = EDGES[number], EDGES[number + 1]
        classes.append(CalibrationClass(*edges, k, float(p[rows].mean()), hits / k, *ends))
    ends = middle - half, middle + half
    return SurfaceScore(middle, *ends, expected, confidence, n, lost, tuple(classes), nonexistent)


def verify_surface(estimator: Estimator, simulations: int, confidence: float) -> SurfaceScore:
    """Score the target boundary's probabilities by fresh simulations, which are kept in the run folder."""
    campaign, (pool, existence) = estimator.campaign, pool_of(estimator, max(POOL, simulations))
    # Of those that probably do not exist, `predict` gives no probabilities.
    X = pool[np.argsort(existence < 0.5, kind="stable")][:simulations]
    results = estimator.results(set_name("surface", estimator.iteration, simulations), "", X)
    assert results is not None  # no stop was requested
    answered, exists = results.outcome != NUMERICAL_FAILURE, existing(campaign, results)
    if answered.sum() < 2:
        raise SimulationError(f"simulations: two must give an outcome, got {answered.sum()} of {simulations}.")
    probability = estimator.classifier.predicted(X[answered]).beyond(campaign.severity)
    beyond, lost = results.outcome[answered] >= campaign.severity, int((exists & ~answered).sum())
    found = score(probability, beyond, lost, confidence, int((~exists).sum()))
    keep_of(estimator.store, _surface_of(estimator.store), found.as_json(), campaign.learner_code)
    return found


def _surface_of(store: Store) -> tuple[str, ...]:
    return "surface", store.digest


def last_surface(store: Store, code: str) -> SurfaceScore | None:
    """The score that was found last; None unless it is of this record and a classifier of this custom code."""
    value = kept_of(store, _surface_of(store), code)
    if not fits(value, {one.name: object for one in fields(SurfaceScore) if one.default is MISSING}):
        return None
    return SurfaceScore(**value | {"calibration": tuple(CalibrationClass(**one) for one in value["calibration"])})
