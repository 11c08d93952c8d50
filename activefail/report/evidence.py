"""What judges a campaign's classifier, read from its run folder for the report; nothing in the folder is changed."""

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
from activefail.campaign.history import History
from activefail.campaign.proposing import initial_sets
from activefail.campaign.stored_sets import VALIDATION, name_of_test_set, sizes_of_test_sets, stored_set
from activefail.campaign.verification import ErrorEstimate, leave_one_out, verified
from activefail.comparison.static import Recall, Score, default_budgets, score
from activefail.errors import InputError
from activefail.files import read_regular
from activefail.record.store import Store
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, train
from activefail.visible import visible

_LARGEST_TABLE = 10_000_000
_BUDGETS = 5


@dataclass(frozen=True)
class Curve:
    """Accuracy against simulations.

    Attributes:
        scores: of one or two samplings.
        test_size: designs that they are judged on.
        source: "compare" or "validation".
        unanswered: designs of the test set besides, which gave no answer.
    """

    scores: list[Score]
    test_size: int
    source: str
    unanswered: int = 0


@dataclass(frozen=True)
class Reliability:
    """Predicted probabilities of the sought boundary, (n,), and whether the outcome was beyond it, (n,).

    Attributes:
        source: "test", "validation" or "left out".
    """

    probability: Array
    beyond: NDArray[np.bool_]
    source: str


def read_scores(path: Path, outcomes: Sequence[str]) -> tuple[list[Score], int]:
    """The table that `activefail compare DIR` wrote: its scores and how many test designs gave no answer.

    Args:
        path: of the table.
        outcomes: of the campaign.

    Raises:
        InputError: naming the file, the row and what is wrong with it.
    """
    other = {"sampling": str, "simulations": int, "test_designs": int}
    kinds = {name: other.get(name, float) for name in Score.columns()}
    scores, unanswered = [], 0
    try:
        # A run folder may come from someone else, with a pipe or a table without end.
        text = read_regular(path, _LARGEST_TABLE).decode()
        with io.StringIO(text, newline="") as file:
            for number, row in enumerate(csv.DictReader(file), start=1):
                try:
                    numbers: dict[str, Any] = {name: kind(row[name]) for name, kind in kinds.items()}
                    # An older program wrote none.
                    known = Score.recall_columns(outcomes)[0] in row
                    recall = {
                        name: Recall(int(row[f"recalled_{name}"]), int(row[f"test_{name}"]))
                        for name in (outcomes if known else ())
                    }
                    scores.append(_plausible(Score(**numbers, recall=recall)))
                    # An older program wrote how many were asked for, and not this.
                    unanswered = max(unanswered, int(row.get("test_unanswered") or 0))
                except (KeyError, TypeError, ValueError) as bad:
                    raise InputError(
                        f"{path}: row {number}: is not one that `activefail compare` writes: {bad}."
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
"""Designs and simulations that a score may be of."""


def _plausible(score: Score) -> Score:
    """A score that a comparison could have had.

    Raises:
        ValueError: saying what is wrong with it.
    """
    shares = (0.0, score.low, score.accuracy, score.high, 1.0)
    if not all(one <= other for one, other in pairwise(shares)):
        raise ValueError(f"`0 <= low <= accuracy <= high <= 1` must hold, got {shares[1:-1]}")
    if not 0.0 <= score.outcome_accuracy <= 1.0 or not score.log_score <= 0.0:
        raise ValueError(f"outcome_accuracy {score.outcome_accuracy} and log_score {score.log_score}")
    if score.sampling not in ("active", "static"):
        raise ValueError(f"sampling: must be active or static, got {visible(score.sampling)!r}")
    recalled = [number for one in score.recall.values() for number in (one.found, one.of)]
    if not all(0 <= n <= _MOST_DESIGNS for n in (score.simulations, score.test_designs, *recalled)):
        raise ValueError(f"numbers of designs must lie in 0 to {_MOST_DESIGNS}")
    if any(one.found > one.of for one in score.recall.values()):
        raise ValueError("more designs were recalled than there are")
    return score


def _curve(
    campaign: Campaign, store: Store, folder: Path, stage: Callable[[str], None]
) -> tuple[Curve | None, str | None]:
    """The curve, and what to say of what is missing of it."""
    path = folder / "compare" / "scores.csv"
    note = "no comparison with a static design was made"
    if path.exists():
        try:
            scores, unanswered = read_scores(path, campaign.simulator.outcomes)
            return Curve(scores, max(one.test_designs for one in scores), "compare", unanswered), None
        except InputError as bad:
            note = f"the comparison cannot be read ({bad})"
    validation = stored_set(store, VALIDATION)
    history = History.of(store.batches)
    done = len(history)
    if validation is None:
        return None, f"{note}, and the campaign has no validation set (validation.size)"
    scores = []
    classifier: Classifier | None = None
    initial = campaign.settings.sampling.initial * initial_sets(campaign, history)
    budgets = default_budgets(min(initial, done), done)
    for n in (
        budgets if len(budgets) < _BUDGETS else [budgets[round(i)] for i in np.linspace(0, len(budgets) - 1, _BUDGETS)]
    ):
        known = history[:n].training
        if len(known) < 2:
            continue
        stage(f"learning from the first {n} simulations")
        kernel, outcomes = campaign.settings.classifier.kernel, campaign.simulator.outcomes
        classifier = train(known.designs, known.outcome, outcomes, campaign.features, kernel, classifier)
        scores.append(score("active", classifier, campaign.severity, n, *validation))
    return (Curve(scores, len(validation[0]), "validation") if scores else None), note


def _reliability(campaign: Campaign, store: Store, classifier: Classifier) -> Reliability | None:
    latent = classifier.latents[campaign.severity - 1]
    sets = [(name_of_test_set(size), "test") for size in sizes_of_test_sets(store)]
    for name, source in [*sets, (VALIDATION, "validation")]:
        if (found := stored_set(store, name)) is not None:
            probability = latent.moments(campaign.features(found[0])).probability
            return Reliability(probability, found[1] >= campaign.severity, source)
    initial = History.of(store.batches).training.initial
    if initial.sum() < 2:
        return None
    moments = leave_one_out(latent.trained)
    beyond = latent.trained.labels.numpy() > 0.0
    return Reliability(moments.probability[initial], beyond[initial], "left out")


@dataclass(frozen=True)
class Evidence:
    """What a run folder holds that judges its campaign's classifier.

    Attributes:
        curve, reliability, error: None where nothing in the folder tells; `missing` says how to get it.
        missing: by section, which command adds it.
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
    """What judges the classifier of a campaign with at least one simulation."""
    stage("reading what was compared and verified")
    curve, note = _curve(campaign, store, folder, stage)
    missing = {} if note is None else {"curve": note}
    reliability = _reliability(campaign, store, classifier)
    if reliability is None:
        missing["reliability"] = "there is neither a test set nor an initial design to judge by"
    error = verified(campaign, store, classifier, store.batches[-1].iteration, 0.9)
    if error is None:
        missing["error"] = "the error of the classifier was not verified"
    return Evidence(curve, reliability, error, missing)
