"""Trains a classifier: each boundary from its outcomes or a margin, chosen by evidence."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from activefail.errors import InputError
from activefail.learning.features import FeatureMap
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.latent import CustomLatent, CustomModel, Latent, Learner
from activefail.learning.model.margin import MarginFit, MarginLatent, fit_margin
from activefail.learning.model.margin_choice import (
    OUTCOMES,
    Choice,
    LearnableMargins,
    defined,
    is_due,
    learned_with,
    level_of,
    taken,
    usable,
)
from activefail.learning.model.margin_data import is_truncated
from activefail.learning.model.system import AnyLatent, SystemLatent
from activefail.space.space import Array
from activefail.space.systems import System

_COMPARED = 200
"""Most simulations on which the models are compared."""


def train(
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    learner: Learner,
    warm: Classifier | None = None,
    margins: LearnableMargins | None = None,
) -> Classifier:
    """Train a classifier on designs, (n, d), and their outcomes, (n,), without numerical failures.

    Args:
        X, outcome: the designs, and indices into the outcomes.
        outcomes: names, least severe first.
        features: map from designs to the latents' inputs.
        learner: of latents that are learned from outcomes.
        warm: a classifier trained on the first of these points, as the starting point.
        margins: the margins of these designs; without them, boundaries are learned from outcomes alone.

    Raises:
        InputError: if there are no designs, or their features are not finite or too far from those of the space.
    """
    if len(X) == 0:
        raise InputError("None of the simulations gave an outcome, so there is nothing to learn from.")
    F = features.to_learn(X)

    severities = range(1, len(outcomes))

    def chosen(severity: int) -> Choice:
        assert margins is not None
        previous = warm.choices[severity - 1] if warm is not None and warm.choices else None
        return _choice(F, outcome, severity, margins, learner, previous)

    def learned(severity: int) -> Latent | CustomLatent | MarginFit | SystemLatent:
        own = warm is not None and learned_with(warm.choices, severity) == severity
        before = warm.latents[severity - 1] if warm is not None and own else None
        if margins is None or choices[severity - 1].margin == OUTCOMES:
            return learner.learned(F, outcome >= severity, before)
        margin = margins.of(severity, choices[severity - 1].margin)
        if margins.system is not None:
            return fit_system(F, margin, margins.system, before)
        return fit_defined(F, margin, before.trained if isinstance(before, MarginLatent) else None, learner.repeatable)

    # torch and LAPACK release the interpreter's lock, so boundaries train in parallel; a user's model may not.
    with ThreadPoolExecutor(len(severities)) as pool:
        over = map if len(severities) == 1 or isinstance(learner, CustomModel) else pool.map
        choices = () if margins is None else tuple(over(chosen, severities))
        own = [severity for severity in severities if learned_with(choices, severity) == severity]
        trained = dict(zip(own, over(learned, own), strict=True))
    latents = []
    for severity in severities:
        of_boundary = trained[learned_with(choices, severity)]
        latents.append(
            MarginLatent(of_boundary, level_of(margins, choices, severity))
            if isinstance(of_boundary, MarginFit)
            else of_boundary
        )
    return Classifier(tuple(outcomes), features, tuple(latents), choices, repeatable=learner.repeatable)


def _choice(
    F: Array,
    outcome: NDArray[np.int8],
    severity: int,
    margins: LearnableMargins,
    learner: Learner,
    previous: Choice | None,
) -> Choice:
    """What a boundary is learned from: as before, unless the models must be compared again."""
    n, beyond = len(F), outcome >= severity

    def holds(column: int) -> bool:
        return column == OUTCOMES or not usable(margins.of(severity, column), beyond, margins.system)

    if margins.required:
        column = margins.columns[0]
        return Choice(column if holds(column) else OUTCOMES, n)
    if previous is not None and holds(previous.margin) and not is_due(previous, n, beyond):
        return previous
    return choose(F, beyond, margins.values[severity - 1], margins.columns, learner, margins.system)


def fit_defined(F: Array, margin: Array, warm: MarginFit | None = None, repeatable: bool = True) -> MarginFit:
    """The regression of a usable margin, (n,), at scaled features, (n, m)."""
    values, has_undefined, level = defined(margin)
    fitted = fit_margin(F, values, has_undefined or is_truncated(values), warm, repeatable)
    return replace(fitted, data=replace(fitted.data, level=level))


def fit_system(F: Array, margins: Array, system: System, warm: object = None) -> SystemLatent:
    """The latent of usable margins, (n, k), of a system at scaled features, (n, m): a mode learns from what it has."""
    known = ~np.isnan(margins)
    before = [mode.trained for mode in warm.modes] if isinstance(warm, SystemLatent) else [None] * len(system.names)
    fits = [fit_defined(F[rows], of[rows], one) for of, rows, one in zip(margins.T, known.T, before, strict=True)]
    return SystemLatent(tuple(map(MarginLatent, fits)), known, F, system)


def choose(
    F: Array,
    beyond: NDArray[np.bool_],
    margins: Array,
    columns: Sequence[int],
    learner: Learner,
    system: System | None = None,
) -> Choice:
    """Choose by the evidence of the first 200 simulations or fewer.

    With all designs on one side a classifier knows nothing, so a usable margin is chosen without a comparison.

    Args:
        F: (n, m) scaled features.
        beyond: (n,) whether each outcome is beyond the boundary.
        margins: (n, k) margins of the simulator.
        columns: the margins that may be chosen.
        learner: of latents that are learned from outcomes.
        system: of the margins, which column 0 then stands for.
    """
    n, one_sided = len(F), bool(beyond.all() or not beyond.any())
    candidates = [column for column in columns if not usable(taken(margins, column, system), beyond, system)]
    if not candidates:
        return Choice(OUTCOMES, n, one_sided=one_sided)
    # Evenly spread over the rows, so that both the initial design and the active designs count.
    rows = np.unique(np.linspace(0, n - 1, min(n, _COMPARED)).round().astype(int))
    scores = {}
    for column in candidates:
        margin = taken(margins[rows], column, system)
        if usable(margin, beyond[rows], system):
            continue
        if system is not None:
            latent: AnyLatent = fit_system(F[rows], margin, system)
        else:
            latent = MarginLatent(fit_defined(F[rows], margin, repeatable=learner.repeatable))
        scores[column] = outcome_score(latent, beyond[rows])
    if not scores:
        return Choice(OUTCOMES, n, one_sided=one_sided)
    best = max(scores, key=scores.__getitem__)
    if one_sided:
        return Choice(best, n, scores[best], one_sided=True)
    score = outcome_score(learner.learned(F[rows], beyond[rows]), beyond[rows])
    return Choice(best if scores[best] >= score else OUTCOMES, n, scores[best], score)


def outcome_score(latent: AnyLatent, beyond: NDArray[np.bool_]) -> float:
    """Mean log probability of left-out designs' sides, (n,), under a latent [nat]."""
    return float(log_ndtr(np.where(beyond, 1.0, -1.0) * latent.left_out().standardised).mean())
