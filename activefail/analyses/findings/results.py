"""Results of a campaign so far: its simulations, its classifier's predictions, and notable designs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.estimates.error import expected_error
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.moments import Predicted, binary_entropy, undecided
from activefail.loop.history import History
from activefail.record.store import Store
from activefail.simulators.interface import noun_of
from activefail.space.space import Array
from activefail.visible import or_worse, words

_POOL = 2**12


CONFIDENCE = 0.95
"""Confidence of the intervals of probabilities in the report and the explorer."""

_Z = 1.959964

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(20)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@dataclass(frozen=True)
class Prediction:
    """Predictions for n designs; NaN for those that do not exist.

    Attributes:
        probabilities: (n, number of outcomes).
        low, high: (n,) interval of `beyond` from the latent's uncertainty.
        beyond: (n,) probability of lying beyond the target boundary.
        mean, sd: (n,) of that boundary's latent.
        undecided: (n,) whether the outcome is unknown (`learning.model.moments.undecided`).
    """

    probabilities: Array
    low: Array
    high: Array
    beyond: Array
    mean: Array
    sd: Array
    undecided: NDArray[np.bool_]


def interval(predicted: Predicted, severity: int) -> tuple[Array, Array]:
    """95 % interval of P(at least as severe) from the uncertainty of its boundary's latent f, (n,) each.

    It is widened to contain the reported probability, the mean over f, which can fall outside near 0 and 1. Where the
    boundary is learned from a margin, the outcome is certain but for the side: the interval is 0, 1 or both.
    """
    low, high = (predicted.beyond(severity, sign * _Z) for sign in (-1.0, 1.0))
    probability = predicted.beyond(severity)
    return np.minimum(low, probability), np.maximum(high, probability)


def information(predicted: Predicted, severity: int) -> Array:
    """What one simulation tells of P(at least as severe), (n,) [bit]: its entropy less that with a known latent."""
    p = np.array([predicted.beyond(severity, float(node)) for node in _NODES])
    return np.asarray(binary_entropy(_WEIGHTS @ p) - _WEIGHTS @ binary_entropy(p))


def predict(
    campaign: Campaign, classifier: Classifier, X: Array, possible: NDArray[np.bool_] | bool = True
) -> Prediction:
    """Predict the outcomes of designs, (n, d).

    Those that break a constraint, are not possible, or probably do not exist by the simulations have NaN.
    """
    exists = campaign.space.meets_constraints(X) & possible
    exists &= classifier.existence(X) >= 0.5
    # Not every model predicts for no design at all.
    X_existing = X[exists] if exists.any() else X[:1]
    predicted = classifier.predicted(X_existing)
    moments = predicted.moments[campaign.severity - 1]
    values = (
        predicted.probabilities,
        *interval(predicted, campaign.severity),
        predicted.beyond(campaign.severity),
        moments.mean,
        moments.sd,
    )
    filled: list[NDArray[Any]] = [np.full((len(X), *one.shape[1:]), np.nan) for one in values]
    for column, one in zip(filled, values, strict=True):
        column[exists] = one
    is_undecided = np.zeros(len(X), dtype=bool)
    is_undecided[exists] = undecided(classifier, X_existing)[: exists.sum()]
    filled.append(is_undecided)
    return Prediction(*filled)


@dataclass(frozen=True)
class Findings:
    """A campaign with its simulations and its classifier.

    Attributes:
        history: the simulations so far.
        expected: the error that the classifier expects of itself.
        pool, pool_prediction: a sample of the design space and its predictions.
    """

    folder: Path
    campaign: Campaign
    classifier: Classifier
    history: History
    expected: float
    pool: Array
    pool_prediction: Prediction

    @property
    def boundary(self) -> str:
        """The outcome of the (main) target boundary."""
        return self.campaign.settings.acquisition.main_boundary

    @property
    def beyond(self) -> str:
        """The outcomes beyond that boundary, in words."""
        return or_worse(self.boundary, self.campaign.simulator.outcomes)

    @property
    def influence(self) -> Array:
        """How much the prediction depends on each variable, (d,): its mean change when the variable is redrawn."""
        pool = self.pool[:1024]
        before = predict(self.campaign, self.classifier, pool).beyond
        changes = []
        for column in range(self.campaign.space.dimension):
            moved = pool.copy()
            # Rolling redraws the variable without a random number; by half the sample, a Sobol' point hardly moves.
            moved[:, column] = np.roll(pool[:, column], len(pool) // 3)
            moved = np.where(self.campaign.space.meets_constraints(moved)[:, None], moved, pool)
            changes.append(float(np.abs(predict(self.campaign, self.classifier, moved).beyond - before).mean()))
        return np.array(changes)


def findings_of(folder: Path, campaign: Campaign, store: Store, classifier: Classifier) -> Findings:
    """The findings of a campaign with at least one simulation."""
    pool = campaign.space.sobol(_POOL, np.random.default_rng(0))
    return Findings(
        folder,
        campaign,
        classifier,
        History.of(store.batches),
        expected_error(campaign, classifier),
        pool,
        predict(campaign, classifier, pool),
    )


def at_the_boundary(findings: Findings) -> list[tuple[int, str]]:
    """Simulated designs worth drawing, as (row, reason): on both sides of the target boundary, and at the first one."""
    campaign = findings.campaign
    severity, outcome = campaign.severity, findings.history.outcome
    F = campaign.features(findings.history.designs)
    at = np.abs(findings.classifier.latents[severity - 1].moments(F).standardised)
    name = words(campaign.simulator.outcomes[severity])
    thing = noun_of(campaign.simulator)
    chosen: list[tuple[int, str]] = []
    beyond = np.flatnonzero(outcome >= severity)
    short = np.flatnonzero((outcome < severity) & findings.history.answered)
    if len(beyond):
        first = int(beyond[np.argmin(at[beyond])])
        chosen.append((first, f"The simulated {thing} nearest to the {name} boundary, beyond it"))
        if len(short):
            # The most similar of the designs near the boundary on its other side.
            near = short[np.argsort(at[short])[: max(10, len(short) // 10)]]
            second = int(near[np.argmin(np.linalg.norm(F[near] - F[first], axis=1))])
            chosen.append((second, f"A simulated {thing} with similar features on the other side of the boundary"))
    elif len(short):
        chosen.append((int(short[np.argmin(at[short])]), f"The simulated {thing} nearest to the {name} boundary"))
    mildest = np.flatnonzero(outcome == 0)
    if severity > 1 and len(mildest):
        touch = np.abs(findings.classifier.latents[0].moments(F[mildest]).standardised)
        third = int(mildest[np.argmin(touch)])
        if third not in [row for row, _ in chosen]:
            chosen.append(
                (
                    third,
                    f'The simulated {thing} with the outcome "{words(campaign.simulator.outcomes[0])}" nearest to a '
                    "more severe outcome",
                )
            )
    return chosen
