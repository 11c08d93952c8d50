"""Which variables affect a probability: its Sobol' indices by the classifier, and its change with one at a time.

Two functions have indices. Without a hazard, the probability of the outcome given all variables of a question, which is
almost 0 or 1. With a hazard, the probability given the bearing alone: the pulses are integrated out.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import ndtr, ndtri

from activefail.acquisition.population import integration_points
from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import Hazard, hazard_question
from activefail.campaign.question import AMPLITUDE, PERIOD, Question
from activefail.errors import InputError
from activefail.features import FeatureMap
from activefail.progress import Begin, uncounted
from activefail.reliability.integral import Boundaries, BoundariesOf, Standardised
from activefail.risk.fragility.levels import RESOLUTION
from activefail.risk.sensitivity.findings import HIGH, LOW, Move, SensitivityFindings
from activefail.risk.sensitivity.sobol import Decomposition, Index, check_samples, decomposed, require_salib
from activefail.simulators.bearing import limits_of
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Classifier, Latent
from activefail.surrogate.margin import MarginLatent
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
    campaign: Campaign,
    classifier: Classifier,
    outcome: str,
    asked: Hazard | Question,
    fixed: Mapping[str, float],
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """Which variables affect a probability, with the length scales that stand beside the indices.

    Args:
        campaign, outcome, samples, confidence, begin: as for `question_sensitivity`.
        classifier: of the campaign.
        asked: a hazard, or another question.
        fixed: values of variables.
    """
    boundaries = BoundariesOf(classifier, campaign.features)
    if isinstance(asked, Hazard):
        found = hazard_sensitivity(campaign, boundaries, outcome, asked, fixed, samples, confidence, begin)
    else:
        found = question_sensitivity(campaign, boundaries, outcome, asked, samples, confidence, begin)
    return found.with_length_scales(length_scales(classifier.latent(outcome), campaign.features))


def question_sensitivity(
    campaign: Campaign,
    boundaries: Boundaries,
    outcome: str,
    question: Question,
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """The Sobol' indices of the classifier's probability Φ(m/s) given the uncertain variables of a question.

    Args:
        campaign: of the classifier.
        boundaries: of the campaign's designs.
        outcome: of the boundary.
        question: the distribution of the variables.
        samples: points of the sample; a power of two. By default as many as two minutes allow.
        confidence: of the intervals.
        begin: called with the number of evaluations; returns a callback for finished ones.

    Raises:
        InputError: if the question's variables are correlated, or rows of a file; if `samples` is invalid; or if SALib
            is not installed.
    """
    space = question.space
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
    require_salib()
    samples = default_samples(space.dimension) if samples is None else samples
    check_samples(samples)
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
        indices=_by_total(decomposition),
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
    campaign: Campaign,
    boundaries: Boundaries,
    outcome: str,
    hazard: Hazard,
    fixed: Mapping[str, float],
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
) -> SensitivityFindings:
    """Which variables affect the probability of a design under a hazard.

    Args:
        campaign: of the classifier.
        boundaries: of the campaign's designs.
        outcome: of the boundary.
        hazard: whose pulses are integrated out.
        fixed: values of variables of the bearing, which then have no indices. They are moved one at a time like the
            others, which have their medians.
        samples, confidence, begin: as for `question_sensitivity`.

    Raises:
        InputError: if the campaign has no pulse or nothing else, `fixed` names no variable of the bearing, `samples` is
            invalid, or SALib is not installed.
    """
    design = [one for one in campaign.space.parameters if one.name not in (PERIOD, AMPLITUDE)]
    base = {one.name: float(one.quantile(0.5, ndtri)) for one in design} | dict(fixed)
    question = hazard_question(hazard, campaign.settings, campaign.space, base)
    if not design:
        raise InputError("hazard: all variables of the campaign belong to the pulse, so no design can be varied.")
    free = [one for one in design if one.name not in fixed]
    X, weight = _pulses(question.space, PULSES)
    pulses = len(X)
    if free:
        require_salib()
        samples = default_samples(len(free), pulses) if samples is None else samples
        check_samples(samples)
    else:
        samples = 0
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
    moves.sort(key=lambda move: -_effect(move, at_base))
    decomposition = Decomposition(float("nan"), float("nan"), float("nan"), ())
    outside = question.share_outside(campaign.space)
    notes = [*hazard.assumptions]
    if free:
        names = tuple(one.name for one in free)
        # Independent: who chooses a design may choose any combination.
        space = DesignSpace(tuple(free))
        decomposition = decomposed(
            lambda U: _mean_over_pulses(probability, question, names, space.from_unit(U), X, weight),
            names,
            samples,
            confidence,
        )
        outside = _share_outside(campaign.space, question, names, space.sobol(256, np.random.default_rng(0)), X, weight)
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
        indices=_by_total(decomposition),
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


def _by_total(decomposition: Decomposition) -> tuple[Index, ...]:
    return tuple(sorted(decomposition.indices, key=lambda index: -index.total.value))


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


def length_scales(latent: Latent | MarginLatent, features: FeatureMap) -> dict[str, float]:
    """Length scales of a boundary's latent by feature, in standard deviations of the feature over the design space."""
    scales = np.exp(latent.trained.hyperparameters.log_lengthscale)
    return dict(zip(features.names, scales.tolist(), strict=True))


def _effect(move: Move, at_base: float) -> float:
    return max(move.at_low, move.at_high, at_base) - min(move.at_low, move.at_high, at_base)


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


def _designs_under_pulses(question: Question, names: tuple[str, ...], designs: Array, pulses: Array) -> Array:
    """Designs of the campaign, (n p, d): each of n designs, values of `names`, under each of p pulses."""
    rows = np.tile(question.designs(pulses), (len(designs), 1))
    for column, name in enumerate(names):
        values = np.repeat(designs[:, column], len(pulses))
        rows[:, question.variables.index(name)] = values * question.factors.get(name, 1.0)
    return rows


def _mean_over_pulses(
    probability: Callable[[Array], Array],
    question: Question,
    names: tuple[str, ...],
    designs: Array,
    pulses: Array,
    weight: Array,
) -> Array:
    """The probability of each of n designs, values of `names`, under weighted pulses, (n,)."""
    means, at_once = np.empty(len(designs)), max(1, _AT_ONCE // len(pulses))
    for first in range(0, len(designs), at_once):
        part = designs[first : first + at_once]
        values = probability(_designs_under_pulses(question, names, part, pulses))
        means[first : first + len(part)] = values.reshape(len(part), -1) @ weight / weight.sum()
    return means


def _share_outside(
    space: DesignSpace, question: Question, names: tuple[str, ...], designs: Array, pulses: Array, weight: Array
) -> float:
    outside = ~space.contains(_designs_under_pulses(question, names, designs, pulses))
    return float((outside.reshape(len(designs), -1) @ weight).mean() / weight.sum())


def _pulses(space: DesignSpace | WeightedRows, n: int) -> tuple[Array, Array]:
    """At most n fixed pulses, (p, k), with weights, (p,)."""
    return integration_points(space.thinned(n) if isinstance(space, WeightedRows) else space, n)
