"""Which variables affect a probability: its Sobol' indices by the classifier, and its change with one at a time.

Two functions have indices. Without a hazard, the probability of the outcome given all variables of a question, which is
almost 0 or 1. With a hazard, the probability given the bearing alone: the pulses are integrated out.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import ndtr, ndtri

from activefail.acquisition.population import integration_points
from activefail.campaign.hazard import hazard_question
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import AMPLITUDE, PERIOD
from activefail.errors import InputError
from activefail.progress import Begin, uncounted
from activefail.reliability.integral import Boundaries, BoundariesOf, Standardised
from activefail.risk.fragility.levels import RESOLUTION
from activefail.risk.sensitivity.findings import HIGH, LOW, Move, SensitivityFindings
from activefail.risk.sensitivity.sobol import Decomposition, checked_samples, decomposed
from activefail.simulators.bearing import limits_of
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier
from activefail.weighted import WeightedRows

PULSES = 128
"""Pulses that integrate the probability of each design; a power of two."""

WIDE = 0.2
"""Width of an interval from which more samples are advised."""

_FEW = 50.0
"""Points on the rarer side of ½ below which the indices and their intervals mean little."""

_EVALUATIONS = 600_000
"""Evaluations of the classifier by default: two minutes at 0.2 ms, of features and prediction for a bearing."""

_LEAST, _MOST = 64, 8192
"""Least and largest number of samples by default."""

_AT_ONCE = 4096
"""Most rows of a prediction at once, which limits its memory."""


def default_samples(variables: int, points: int = 1) -> int:
    """The number of samples that keeps the evaluations of the classifier within two minutes for a bearing.

    Args:
        variables: number of variables d.
        points: evaluations for each of the (d + 2) values that a sample takes.
    """
    affordable = max(1, _EVALUATIONS // ((variables + 2) * points))
    return int(np.clip(2 ** (affordable.bit_length() - 1), _LEAST, _MOST))


def sensitivity(
    asked: Inquiry,
    classifier: Classifier,
    outcome: str,
    p_values: Mapping[str, float],
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """Which variables affect a probability, with the length scales and p-values that stand beside the indices.

    Args:
        asked: what is asked.
        classifier: of the campaign.
        outcome: of the boundary.
        p_values: of the variables.
        samples: points of the sample; a power of two. By default as many as two minutes allow.
        confidence: of the intervals.
        begin: called with the number of evaluations; returns a callback for finished ones.

    Raises:
        InputError: as `question_sensitivity` and `hazard_sensitivity` do.
    """
    features = asked.campaign.features
    of = question_sensitivity if asked.hazard is None else hazard_sensitivity
    found = of(asked, BoundariesOf(classifier, features), outcome, samples, confidence, begin)
    scales = np.exp(classifier.latent(outcome).trained.hyperparameters.log_lengthscale)
    return found.beside(dict(zip(features.names, scales.tolist(), strict=True)), p_values)


def question_sensitivity(
    asked: Inquiry,
    boundaries: Boundaries,
    outcome: str,
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """The Sobol' indices of the classifier's probability Φ(m/s) given the uncertain variables of a question.

    Args:
        asked, outcome, samples, confidence, begin: as for `sensitivity`.
        boundaries: of the campaign's designs.

    Raises:
        InputError: if the question's variables are correlated, or rows of a file; if `samples` is invalid; or if SALib
            is not installed.
    """
    campaign, question, space = asked.campaign, asked.question, asked.question.space
    if isinstance(space, WeightedRows):
        raise InputError(
            "question: must have independent variables, got a table of pulses. Use `--hazard`, which averages over the "
            "pulses."
        )
    if correlated := [pair for pair in space.correlation if pair[2] != 0.0]:
        one, other, rho = correlated[0]
        raise InputError(
            f"question: {one} and {other} have the correlation {rho:g}, and the variance cannot be divided among "
            "correlated variables. Set `correlation = []` in the question file, or give one of the two a value with "
            "`--fixed`."
        )
    samples = checked_samples(samples or default_samples(space.dimension))
    evaluations = samples * (space.dimension + 2)
    column = campaign.simulator.outcomes.index(outcome) - 1
    probability = _probability(lambda X: boundaries(X)[:, column], begin(evaluations))
    decomposition = decomposed(
        lambda U: probability(question.designs(space.from_unit(U))), space.names, samples, confidence
    )
    return SensitivityFindings(
        outcome=outcome,
        outcomes=tuple(campaign.simulator.outcomes),
        title=question.title,
        mean=decomposition.mean,
        sd=decomposition.sd,
        indices=decomposition.by_total,
        confidence=confidence,
        samples=samples,
        evaluations=evaluations,
        units={one.name: one.unit for one in space.parameters},
        outside=question.share_outside(campaign.space),
        notes=(
            *question.assumptions,
            f"The indices divide the variance of the classifier's probability of {outcome} given all variables.",
            *_notes_on_indices(decomposition, samples),
            *_notes_on_rareness(decomposition, samples),
            *limits_of(campaign.simulator),
        ),
    )


def hazard_sensitivity(
    asked: Inquiry,
    boundaries: Boundaries,
    outcome: str,
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """Which variables affect the probability of a design under a hazard, whose pulses are integrated out.

    Variables with values have no indices. They are moved one at a time like the others, which have their medians.

    Args:
        asked, boundaries, outcome, samples, confidence, begin: as for `question_sensitivity`.

    Raises:
        InputError: if the campaign has nothing but a pulse, `samples` is invalid, or SALib is not installed.
    """
    campaign, hazard, fixed = asked.campaign, asked.hazard, asked.fixed
    assert hazard is not None
    design = [one for one in campaign.space.parameters if one.name not in (PERIOD, AMPLITUDE)]
    if not design:
        raise InputError("hazard: all variables of the campaign belong to the pulse, so no design can be varied.")
    base = {one.name: float(one.quantile(0.5, ndtri)) for one in design} | fixed
    question = hazard_question(hazard, campaign.space, base)
    free = [one for one in design if one.name not in fixed]
    rows = question.space.thinned(PULSES) if isinstance(question.space, WeightedRows) else question.space
    X, weight = integration_points(rows, PULSES)
    pulses = len(X)
    samples = checked_samples(samples or default_samples(len(free), pulses)) if free else 0
    evaluations = samples * (len(free) + 2) * pulses
    column = campaign.simulator.outcomes.index(outcome) - 1
    probability = _probability(lambda X: boundaries(X)[:, column], begin(evaluations))

    def moved(name: str, value: float) -> float:
        integral = question.at({name: value}).integral(boundaries, campaign.space, RESOLUTION)
        return float(integral.probability[column])

    at_base = moved(design[0].name, base[design[0].name])
    moves = []
    for one in design:
        low, high = (float(one.quantile(share, ndtri)) for share in (LOW, HIGH))
        moves.append(Move(one.name, base[one.name], low, high, moved(one.name, low), moved(one.name, high)))
    moves.sort(key=lambda move: min(move.at_low, move.at_high, at_base) - max(move.at_low, move.at_high, at_base))
    decomposition = Decomposition(float("nan"), float("nan"), float("nan"), ())
    outside, notes = question.share_outside(campaign.space), [*hazard.assumptions]
    if free:
        # Independent: who chooses a design may choose any combination.
        space = DesignSpace(tuple(free))

        def under_pulses(designs: Array) -> Array:
            """Designs of the campaign, (n p, d): each of n values of the free variables under each of p pulses."""
            rows = np.tile(question.designs(X), (len(designs), 1))
            for k, one in enumerate(free):
                values = np.repeat(designs[:, k], pulses) * question.factors.get(one.name, 1.0)
                rows[:, question.variables.index(one.name)] = values
            return rows

        def mean_over_pulses(U: Array) -> Array:
            """The probability of each of n designs in the unit cube, (n,), some of them at a time."""
            designs, at_once = space.from_unit(U), max(1, _AT_ONCE // pulses)
            parts = [designs[first : first + at_once] for first in range(0, len(designs), at_once)]
            means = [probability(under_pulses(part)).reshape(len(part), -1) @ weight / weight.sum() for part in parts]
            return np.concatenate(means)

        decomposition = decomposed(mean_over_pulses, space.names, samples, confidence)
        designs = space.sobol(256, np.random.default_rng(0))
        is_outside = ~campaign.space.contains(under_pulses(designs))
        outside = float((is_outside.reshape(len(designs), -1) @ weight).mean() / weight.sum())
        notes.append(
            f"The indices divide the variance of the classifier's probability of {outcome} given the design, "
            f"averaged over {pulses} fixed pulses. The variables of the design are independent and have "
            "the campaign's distributions."
        )
    else:
        notes.append("All variables of the design have values, so there are no Sobol' indices.")
    notes.append(
        f"One variable at a time moves to its {100 * LOW:g} % and {100 * HIGH:g} % quantiles in the campaign. The "
        "other variables have the given values, or else their medians. These probabilities are the classifier's and "
        "have no interval; `activefail probability` estimates a probability with an interval."
    )
    return SensitivityFindings(
        outcome=outcome,
        outcomes=tuple(campaign.simulator.outcomes),
        title=hazard.title,
        mean=decomposition.mean,
        sd=decomposition.sd,
        indices=decomposition.by_total,
        confidence=confidence,
        samples=samples,
        evaluations=evaluations,
        units={one.name: one.unit for one in design},
        outside=outside,
        notes=(*notes, *(_notes_on_indices(decomposition, samples) if samples else ()), *limits_of(campaign.simulator)),
        pulses=pulses,
        probability=at_base,
        moves=tuple(moves),
    )


def _notes_on_indices(decomposition: Decomposition, samples: int) -> list[str]:
    """What the indices and their intervals mean."""
    if not decomposition.indices:
        return ["The classifier's probability does not change with these variables, so there are no Sobol' indices."]
    notes = [
        "The indices are those of the classifier's function. Their intervals cover the sampling of the indices alone, "
        "not the classifier's error. The first indices add up to at most 1; a total index includes all interactions "
        "of its variable."
    ]
    estimates = [estimate for index in decomposition.indices for estimate in (index.first, index.total)]
    widest = max(estimate.high - estimate.low for estimate in estimates)
    if widest > WIDE:
        notes.append(
            f"The widest interval is {widest:.2f} wide, so {samples} samples are too few. `--samples {4 * samples}` "
            "would halve the width, roughly."
        )
    if any(not 0.0 <= estimate.value <= 1.0 for estimate in estimates):
        notes.append("Estimates below 0 or above 1 are sampling errors. They are not clipped.")
    return notes


def _notes_on_rareness(decomposition: Decomposition, samples: int) -> list[str]:
    """A warning if the sample holds few designs of either side; the bootstrap cannot know of those that it lacks."""
    if not decomposition.indices or decomposition.rarer >= _FEW:
        return []
    return [
        f"Only about {decomposition.rarer:.1f} of {2 * samples} sampled designs lie on the rarer side of the boundary. "
        "The indices and their intervals are unreliable: take more samples, or a question under which the outcome is "
        "less rare."
    ]


def _probability(standardised: Standardised, advance: Callable[[int], None]) -> Callable[[Array], Array]:
    """The probability Φ(m/s) of designs, (n, d) -> (n,), a part of them at a time."""

    def probability(X: Array) -> Array:
        parts = [np.empty(0)]
        for first in range(0, len(X), _AT_ONCE):
            part = X[first : first + _AT_ONCE]
            parts.append(ndtr(standardised(part)))
            advance(len(part))
        return np.concatenate(parts)

    return probability
