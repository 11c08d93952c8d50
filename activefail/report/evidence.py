"""Evidence of a classifier's accuracy, read from the run folder for the report. The folder is not changed."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.comparison.static import Recall, Score, default_budgets, score
from activefail.errors import InputError
from activefail.files import read_regular
from activefail.loop.history import History
from activefail.loop.initial import initial_sets
from activefail.loop.learning import learn_from
from activefail.record.layout import COMPARISON, SCORES
from activefail.record.store import Store
from activefail.space import Array
from activefail.surrogate.classifier import Classifier
from activefail.verification.error import ErrorEstimate, verified
from activefail.verification.stored_sets import VALIDATION, name_of_test_set, sizes_of_test_sets, stored_set
from activefail.visible import visible

_LARGEST_TABLE = 10_000_000
_BUDGETS = 5


@dataclass(frozen=True)
class Curve:
    """Accuracy against simulations.

    Attributes:
        scores: of one or two samplings.
        test_size: designs in the test set with an outcome.
        source: "compare" or "validation".
        unanswered: numerical failures in the test set.
    """

    scores: list[Score]
    test_size: int
    source: str
    unanswered: int = 0


@dataclass(frozen=True)
class Reliability:
    """Predicted probabilities and observations of lying beyond the target boundary.

    Attributes:
        probability: (n,) predicted.
        beyond: (n,) whether the outcome was beyond the boundary.
        source: "test", "validation" or "left out".
    """

    probability: Array
    beyond: NDArray[np.bool_]
    source: str


def read_scores(path: Path, outcomes: Sequence[str]) -> tuple[list[Score], int]:
    """Read the table that `activefail compare DIR` wrote.

    Args:
        path: of the table.
        outcomes: of the campaign.

    Returns:
        The scores, and the number of numerical failures in the test set.

    Raises:
        InputError: naming the file, the row and the fault.
    """
    other = {"sampling": str, "simulations": int, "test_designs": int}
    kinds = {name: other.get(name, float) for name in Score.columns()}
    scores, unanswered = [], 0
    try:
        # A run folder from someone else may contain a pipe or an endless table.
        text = read_regular(path, _LARGEST_TABLE).decode()
        with io.StringIO(text, newline="") as file:
            for number, row in enumerate(csv.DictReader(file), start=1):
                try:
                    numbers: dict[str, Any] = {name: kind(row[name]) for name, kind in kinds.items()}
                    # Older versions wrote neither recall nor the columns after it.
                    has_recall = Score.recall_columns(outcomes)[0] in row
                    recall = {
                        name: Recall(int(row[f"recalled_{name}"]), int(row[f"test_{name}"]))
                        for name in (outcomes if has_recall else ())
                    }
                    given, hypercube = (int(row.get(name) or 0) for name in ("given", "hypercube"))
                    scores.append(_plausible(Score(**numbers, recall=recall, given=given, hypercube=hypercube)))
                    unanswered = max(unanswered, int(row.get("test_unanswered") or 0))
                except (KeyError, TypeError, ValueError) as error:
                    raise InputError(
                        f"{path}: row {number}: was not written by `activefail compare`: {error}."
                    ) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from None
    except InputError:
        raise
    except (csv.Error, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}.") from None
    if not scores:
        raise InputError(f"{path}: has no rows.")
    return scores, unanswered


_MOST_DESIGNS = 1_000_000
"""Largest plausible number of designs or simulations in a score."""


def _plausible(score: Score) -> Score:
    """The score, if a comparison could have produced it.

    Raises:
        ValueError: naming the fault.
    """
    shares = (0.0, score.low, score.accuracy, score.high, 1.0)
    if not all(one <= other for one, other in pairwise(shares)):
        raise ValueError(f"`0 <= low <= accuracy <= high <= 1` must hold, got {shares[1:-1]}")
    if not 0.0 <= score.outcome_accuracy <= 1.0 or not score.log_score <= 0.0:
        raise ValueError(
            f"`0 <= outcome_accuracy <= 1` and `log_score <= 0` must hold, got {score.outcome_accuracy} and "
            f"{score.log_score}"
        )
    if score.sampling not in ("active", "static"):
        raise ValueError(f"sampling: must be active or static, got {visible(score.sampling)!r}")
    recalled = [number for one in score.recall.values() for number in (one.recalled, one.total)]
    if not all(
        0 <= n <= _MOST_DESIGNS
        for n in (score.simulations, score.test_designs, score.given, score.hypercube, *recalled)
    ):
        raise ValueError(f"numbers of designs must be between 0 and {_MOST_DESIGNS}")
    if any(one.recalled > one.total for one in score.recall.values()):
        raise ValueError("`recalled <= test` must hold for each outcome")
    return score


def _curve(
    campaign: Campaign, store: Store, folder: Path, stage: Callable[[str], None]
) -> tuple[Curve | None, str | None]:
    """The learning curve, and a note on what it lacks."""
    path = folder / COMPARISON / SCORES
    note = "a comparison with static designs"
    if path.exists():
        try:
            scores, unanswered = read_scores(path, campaign.simulator.outcomes)
            return Curve(scores, max(one.test_designs for one in scores), "compare", unanswered), None
        except InputError as error:
            note = f"a readable comparison with static designs ({error})"
    validation = stored_set(store, VALIDATION)
    history = History.of(store.batches)
    done = len(history)
    if validation is None:
        return None, f"{note}, or a validation set (validation.size)"
    scores = []
    classifier: Classifier | None = None
    initial = campaign.settings.sampling.initial * initial_sets(campaign, history)
    budgets = default_budgets(min(initial, done), done)
    for n in (
        budgets if len(budgets) < _BUDGETS else [budgets[round(i)] for i in np.linspace(0, len(budgets) - 1, _BUDGETS)]
    ):
        known = history[:n]
        if len(known.training) < 2:
            continue
        stage(f"learning from the first {n} simulations")
        classifier = learn_from(campaign, known, classifier)
        scores.append(score("active", classifier, campaign.severity, n, *validation))
    return (Curve(scores, len(validation[0]), "validation") if scores else None), note


def _reliability(campaign: Campaign, store: Store, classifier: Classifier) -> Reliability | None:
    latent = classifier.latents[campaign.severity - 1]
    sets = [(name_of_test_set(size), "test") for size in sizes_of_test_sets(store)]
    for name, source in [*sets, (VALIDATION, "validation")]:
        if (designs_and_outcomes := stored_set(store, name)) is not None:
            X, outcome = designs_and_outcomes
            probability = latent.moments(campaign.features(X)).probability
            return Reliability(probability, outcome >= campaign.severity, source)
    known = History.of(store.batches).training
    initial = known.initial
    if initial.sum() < 2:
        return None
    beyond = known.outcome >= campaign.severity
    return Reliability(latent.left_out().probability[initial], beyond[initial], "left out")


@dataclass(frozen=True)
class Evidence:
    """Evidence of a classifier's accuracy in a run folder.

    Attributes:
        curve, reliability, error: None if the folder has no data for it.
        missing: the missing evidence, by section of the report.
    """

    curve: Curve | None
    reliability: Reliability | None
    error: ErrorEstimate | None
    missing: dict[str, str]


def evidence_of(
    folder: Path,
    campaign: Campaign,
    store: Store,
    classifier: Classifier,
    stage: Callable[[str], None] = lambda _: None,
) -> Evidence:
    """The evidence for a campaign with at least one simulation."""
    stage("reading comparison and verification")
    curve, note = _curve(campaign, store, folder, stage)
    missing = {} if note is None else {"curve": note}
    reliability = _reliability(campaign, store, classifier)
    if reliability is None:
        missing["reliability"] = "a test set, or a complete initial design"
    error = verified(campaign, store, classifier, store.batches[-1].iteration, 0.9)
    if error is None:
        missing["error"] = "a verification of the classifier's error"
    return Evidence(curve, reliability, error, missing)
