"""Evidence of a classifier's accuracy, read from the record for the report. The record is not changed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.comparison.static import default_budgets, remembered_scores
from activefail.campaign.assembly import Campaign
from activefail.estimates.scores import Score, last_error, learning_curve, score
from activefail.estimates.stored_sets import VALIDATION, set_name, sizes_of_test_sets, stored_set
from activefail.estimates.surface import SurfaceScore, last_surface
from activefail.learning.model.classifier import Classifier
from activefail.loop.history import History
from activefail.loop.initial import initial_size
from activefail.loop.learning import learn_from
from activefail.record.store import Store
from activefail.space.space import Array

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


def curve_of(
    campaign: Campaign, store: Store, stage: Callable[[str], None] = lambda _: None
) -> tuple[Curve | None, str | None]:
    """The learning curve, and a note on what it lacks."""
    if (remembered := remembered_scores(store)) is not None:
        scores, unanswered = remembered
        return Curve(scores, max(one.test_designs for one in scores), "compare", unanswered), None
    if (validation := stored_set(store, VALIDATION)) is None:
        return None, "a comparison with static designs, or a validation set (validation.size)"
    none_of_static = "a comparison with static designs"
    if kept := [point.score for point in learning_curve(store) if point.score is not None]:
        shown = np.unique(np.linspace(0, len(kept) - 1, _BUDGETS).round().astype(int))
        return Curve([kept[k] for k in shown], len(validation[0]), "validation"), none_of_static
    history, scores, classifier = History.of(store.batches), [], None
    done, initial = len(history), initial_size(campaign, history)
    budgets = np.array(default_budgets(min(initial, done), done))
    shown = np.linspace(0, len(budgets) - 1, min(_BUDGETS, len(budgets))).round().astype(int)
    for n in budgets[shown].tolist():
        known = history[:n]
        if len(known.training) < 2:
            continue
        stage(f"learning from the first {n} simulations")
        classifier = learn_from(campaign, known, classifier)
        scores.append(score("active", classifier, campaign.severity, n, *validation))
    return (Curve(scores, len(validation[0]), "validation") if scores else None), none_of_static


def _reliability(campaign: Campaign, store: Store, classifier: Classifier) -> Reliability | None:
    latent = classifier.latents[campaign.severity - 1]
    sets = [(set_name("test", size), "test") for size in sizes_of_test_sets(store)]
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
    """Evidence of a classifier's accuracy in a record.

    Attributes:
        curve, reliability, error: None if the record has no data for it; `error` as its numbers in JSON.
        surface: in place of the error, if the simulator does not repeat.
        missing: the missing evidence that the campaign can give, by section of the report.
    """

    curve: Curve | None
    reliability: Reliability | None
    error: Mapping[str, Any] | None
    surface: SurfaceScore | None
    missing: dict[str, str]


@dataclass(frozen=True)
class ReportFindings:
    """A report that was written.

    Attributes:
        evidence: of the classifier's accuracy.
        page: the file.
    """

    evidence: Evidence
    page: Path
    exit_code: ClassVar[int] = 0

    @property
    def lines(self) -> list[str]:
        """What the report lacks, and its file, as lines of a terminal."""
        missing = (f"missing    {reason}" for reason in self.evidence.missing.values())
        return [*missing, f"report     {self.page}"]

    def as_json(self) -> dict[str, Any]:
        """The same as JSON values."""
        return {"page": str(self.page), "missing": self.evidence.missing}


def evidence_of(
    campaign: Campaign,
    store: Store,
    classifier: Classifier,
    stage: Callable[[str], None] = lambda _: None,
) -> Evidence:
    """The evidence for a campaign with at least one simulation."""
    stage("reading comparison and verification")
    curve, note = curve_of(campaign, store, stage)
    refused = campaign.settings.refused
    missing = {} if note is None or "compare" in refused else {"curve": note}
    reliability = _reliability(campaign, store, classifier)
    if reliability is None:
        missing["reliability"] = "a test set, or a complete initial design"
    error, surface = last_error(store, campaign.learner_code), last_surface(store, campaign.learner_code)
    # Sets that other code simulated are not read, and then what they verified is not of this simulator.
    sets = [name for name in store.set_names() if name.startswith(("look-", "verification-", "surface-"))]
    if not any(store.read_set(name) is not None for name in sets):
        error = surface = None
    if error is None and surface is None and "verify" not in refused:
        missing["error"] = "a verification of the classifier; `activefail verify` also reads what it once simulated"
    return Evidence(curve, reliability, error, surface, missing)
