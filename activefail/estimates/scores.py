"""How good a classifier is on fresh designs with known outcomes, and the learning curves of a campaign."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.record.store import Store
from activefail.space.shares import interval_percent, percent
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.learning.model.classifier import Classifier


@dataclass(frozen=True)
class Recall:
    """The recall of an outcome on a test set.

    Attributes:
        recalled: designs with the outcome that are predicted to have it.
        total: designs with the outcome.
    """

    recalled: int
    total: int

    @property
    def share(self) -> float:
        """recalled/total; NaN if the test set has no such design."""
        return self.recalled / self.total if self.total else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper and Pearson's exact 95 % interval; 0 to 1 without designs."""
        if not self.total:
            return 0.0, 1.0
        from scipy.stats import binomtest

        interval = binomtest(self.recalled, self.total).proportion_ci(method="exact")
        return float(interval.low), float(interval.high)

    @property
    def in_words(self) -> str:
        """For example "96.0 % (48 of 50; 86.3 to 99.5 %)"."""
        if not self.total:
            return "– (none in the test set)"
        return f"{percent(self.share)} ({self.recalled} of {self.total}; {interval_percent(*self.interval, digits=1)})"


@dataclass(frozen=True)
class Score:
    """Measures on the test set of a classifier trained on `simulations`.

    Attributes:
        sampling: "active" or "static".
        accuracy: share of designs on the right side of the target boundary.
        low, high: Wilson's 95 % interval of the accuracy over test sets of this size; both samplings share one set.
        outcome_accuracy: share of designs whose most probable outcome is the true one.
        log_score: mean log probability of the true side of the boundary [nat]; 0 is perfect.
        test_designs: size of the test set, without numerical failures.
        recall: by outcome.
        given: how many of the simulations the campaign did not ask for.
        hypercube: number of the static design among those of its size, from 0.
    """

    sampling: str
    simulations: int
    accuracy: float
    low: float
    high: float
    outcome_accuracy: float
    log_score: float
    test_designs: int
    recall: Mapping[str, Recall] = field(default_factory=dict)
    given: int = 0
    hypercube: int = 0

    @property
    def counts(self) -> dict[str, int]:
        """The recall of each outcome as columns of a table."""
        return {
            f"{part}_{name}": number
            for name, one in self.recall.items()
            for part, number in (("recalled", one.recalled), ("test", one.total))
        }


def score(
    sampling: str, classifier: "Classifier", severity: int, simulations: int, X: Array, outcome: NDArray[np.int8]
) -> Score:
    """Score a classifier on designs, (n, d), with known outcomes, (n,)."""
    from scipy.stats import binomtest

    probabilities = classifier.probabilities(X)
    latent = classifier.latents[severity - 1].moments(classifier.features(X))
    beyond = outcome >= severity
    right = (latent.mean > 0.0) == beyond
    interval = binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson")
    return Score(
        sampling,
        simulations,
        float(right.mean()),
        float(interval.low),
        float(interval.high),
        float(np.mean(np.argmax(probabilities, axis=1) == outcome)),
        log_score(probability_of_truth(latent.probability, beyond)),
        len(X),
        recalls(classifier.outcomes, np.argmax(probabilities, axis=1), outcome),
    )


def score_of(row: Mapping[str, Any]) -> Score:
    """The score from its `asdict`."""
    numbers = {name: float(row[name]) for name in ("accuracy", "low", "high", "outcome_accuracy", "log_score")}
    recall = {name: Recall(int(one["recalled"]), int(one["total"])) for name, one in row["recall"].items()}
    return Score(**{**row, **numbers, "recall": recall})


def recalls(outcomes: Sequence[str], predicted: NDArray[np.intp], outcome: NDArray[np.int8]) -> dict[str, Recall]:
    """The recall of each outcome, from the predicted and the true outcomes of designs, (n,)."""
    return {
        name: Recall(int(np.sum(predicted[outcome == code] == code)), int(np.sum(outcome == code)))
        for code, name in enumerate(outcomes)
    }


def probability_of_truth(probability: Array, beyond: NDArray[np.bool_]) -> Array:
    """Probability of the true side, (n,), from the probabilities of lying beyond a boundary."""
    return np.where(beyond, probability, 1.0 - probability)


def log_score(probability: Array) -> float:
    """Mean logarithm [nat] of the probabilities, (n,), of what is true; below 1e-12 they count as 1e-12."""
    return float(np.mean(np.log(np.clip(probability, 1e-12, None))))


def error_of(digest: str) -> tuple[str, ...]:
    """What the last verified error is of, in a record with this digest."""
    return "error", digest


def error_in_words(error: Mapping[str, Any]) -> tuple[str, str]:
    """A verified error with its interval, and what it rests on, from its numbers in JSON."""
    simulations, lost, absent = error["simulations"], error["numerical_failures"], error.get("nonexistent", 0)
    requested = f" of {simulations + lost + absent}" if lost or absent else ""
    way_out = "simulator.lost of a new campaign says what that means"
    widened = f" ({lost} gave no result, which widens it; {way_out})" if lost else ""
    left_out = f" ({absent} designs that do not exist left out)" if absent else ""
    text = f"{percent(error['error'], 2)} ({interval_percent(error['low'], error['high'])})"
    return text, f"{simulations}{requested} fresh simulations{left_out}{widened}"


def verified_in_words(error: Mapping[str, Any]) -> str:
    """A verified error with its interval, its confidence and what it rests on, from its numbers in JSON."""
    text, basis = error_in_words(error)
    return f"{text} of the design space with {100.0 * error['confidence']:g} % confidence, {basis}"


def last_error(store: Store, code: str | None = None) -> Mapping[str, Any] | None:
    """The numbers of the error that was verified last, by a user or the stop rule; None unless it is of this record.

    Args:
        store: the record.
        code: as for `kept_of`.
    """
    numbers = dict.fromkeys(("error", "low", "high", "confidence"), Real)
    value = kept_of(store, error_of(store.digest), code)
    return value if fits(value, numbers | {"simulations": int, "numerical_failures": int}) else None


def fits(value: Any, shape: Any) -> bool:
    """Whether a kept value is of a type, or a dict with values of these shapes, by key; other versions' may not be.

    A number must be below `_LARGEST` in size.
    """
    if isinstance(shape, dict):
        return isinstance(value, dict) and all(key in value and fits(value[key], one) for key, one in shape.items())
    return isinstance(value, shape) and not (isinstance(value, int | float) and abs(value) >= _LARGEST)


def keep(store: Store, of: tuple[str, ...], value: Any) -> None:
    """Keep a computed result, unless just this is kept already."""
    if store.recall(of) != value:
        store.remember(of, value)


def keep_of(store: Store, of: tuple[str, ...], value: Mapping[str, Any], code: str) -> None:
    """Keep what was found about a classifier, with the digest of the custom code that learned it, "" without any."""
    keep(store, of, {**value, **({"code": code} if code else {})})


def kept_of(store: Store, of: tuple[str, ...], code: str | None) -> Any:
    """What `keep_of` kept; None if it was about a classifier of other custom code than `code`, if that is given."""
    value = store.recall(of)
    if not isinstance(value, dict):
        return value
    learned_with = value.pop("code", "")
    return value if code in (None, learned_with) else None


class CurvePoint(NamedTuple):
    """What a campaign knew after an iteration: a point of its learning curves.

    Attributes:
        simulations: that it had learned from.
        score: on the validation set; None without one.
        probability: of the stop rule's outcome under the classifier, with its 95 % interval; None without such a rule.
    """

    simulations: int
    score: Score | None
    probability: tuple[float, float, float] | None


def remember_point(store: Store, iteration: int, point: CurvePoint) -> None:
    """Keep what a campaign knew after an iteration, if it knew something."""
    if point.score or point.probability:
        score = point.score and asdict(point.score)
        keep(store, (_POINT, str(iteration)), [point.simulations, score, point.probability and [*point.probability]])


def learning_curve(store: Store) -> list[CurvePoint]:
    """The kept points in order; none once a result was corrected, because they belong to the former results.

    None either if one was not written by `remember_point`.
    """
    if not store.batches or len(store.corrections.place):
        return []
    rows = (store.recall((_POINT, str(k))) for k in range(store.batches[-1].iteration + 1))
    try:
        points = [_point(*row) for row in filter(None, rows)]
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return []
    known = sum(map(len, store.batches))
    return points if all(0 < point.simulations <= known for point in points) else []


def _point(simulations: Any, score: Any, probability: Any) -> CurvePoint:
    of = None if probability is None else (float(probability[0]), float(probability[1]), float(probability[2]))
    return CurvePoint(int(simulations), None if score is None else score_of(score), of)


_POINT = "learning curve"

_LARGEST = 2.0**63
"""Above it a kept number is none of activefail's."""
