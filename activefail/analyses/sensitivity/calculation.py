"""Which probability is decomposed over which variables, by the classifier; and its change with one at a time.

Two functions have indices. Without a hazard, the probability of the outcome given all variables of a question, which is
almost 0 or 1. With a hazard, the probability given the bearing alone: the pulses are integrated out.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.analyses.findings.learned_from import noise_notes
from activefail.analyses.fragility.levels import RESOLUTION
from activefail.analyses.sensitivity.findings import HIGH, LOW, Move, SensitivityFindings
from activefail.analyses.sensitivity.sobol import NOTHING, Decomposition, checked_samples, decomposed
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.estimates.integral import Boundaries, existence, integral_of
from activefail.learning.criteria.population import integration_points
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.system import ByMargins
from activefail.simulators.interface import limits_of
from activefail.space.parameter import Parameter
from activefail.space.shares import power
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows
from activefail.text.progress import Begin, uncounted
from activefail.visible import or_worse

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


class Varied(NamedTuple):
    """What is varied, and the designs whose probability has indices."""

    question: Question  # with the base values of the variables that have one
    parameters: tuple[Parameter, ...]  # all that are varied, for their units
    space: DesignSpace | None  # of the d variables with indices, which are independent; None without any
    designs: Callable[[Array], Array]  # (n, d) values -> (n p, D) designs of the campaign, p of each
    weight: Array  # (p,) of the designs of each
    of_indices: str  # what the indices divide, or why there are none
    notes: tuple[str, ...] = ()


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
    boundaries: Boundaries,
    outcome: str,
    samples: int | None = None,
    confidence: float = 0.95,
    begin: Begin = uncounted,
    classifier: Classifier | None = None,
    p_values: Mapping[str, float] | None = None,
    ended_beyond: NDArray[np.bool_] | None = None,
) -> SensitivityFindings:
    """Which variables affect the classifier's probability Φ(m/s) of an outcome.

    Args:
        asked: what is asked.
        boundaries: of the campaign's designs.
        outcome: of the boundary.
        samples: points of the sample; a power of two. By default as many as two minutes allow.
        confidence: of the intervals.
        begin: called with the number of evaluations; returns a callback for finished ones.
        classifier: whose length scales stand beside the indices.
        p_values: of the variables by name, beside the indices too.
        ended_beyond: (n,) whether each simulation of the campaign did. If all are on one side, the probability of a
            classifier that learned from outcomes has the shape of its prior, and nothing is decomposed.

    Raises:
        InputError: if a question's variables are correlated, or rows of a file; if some designs do not exist; if the
            campaign of a hazard has nothing but a pulse; if `samples` is invalid; or if SALib is not installed.
    """
    if existence(boundaries) is not None:
        raise InputError(
            "simulator.lost: designs that do not exist make the variables dependent, and the variance cannot be "
            "divided among dependent variables."
        )
    campaign, hazard = asked.campaign, asked.hazard
    column = campaign.simulator.outcomes.index(outcome) - 1
    varied = _of_question(asked.question, outcome) if hazard is None else _under_hazard(asked, outcome)
    if why := _why_nothing(ended_beyond, classifier, outcome):
        varied, classifier = varied._replace(space=None, of_indices=why), None
    free, points = varied.space.dimension if varied.space else 0, len(varied.weight)
    samples = checked_samples(samples or default_samples(free, points)) if free else 0
    evaluations = samples * (free + 2) * points
    advance = begin(evaluations)

    def moved(name: str, value: float) -> float:
        integral = integral_of(varied.question.at({name: value}), boundaries, campaign.space, RESOLUTION)
        return float(integral.probability[column])

    probability, moves = (math.nan, ()) if hazard is None else _moves(varied, moved)
    decomposition, outside = NOTHING, varied.question.share_outside(campaign.space)
    if (space := varied.space) is not None:

        def of_unit(U: Array) -> Array:
            """The probability at each of n points of the unit cube, (n,), some of them at a time."""
            values, at_once, parts = space.from_unit(U), max(1, _AT_ONCE // points), []
            for first in range(0, len(values), at_once):
                designs = varied.designs(values[first : first + at_once])
                beyond = ndtr(boundaries(designs)[:, column])
                parts.append(beyond.reshape(-1, points) @ varied.weight / varied.weight.sum())
                advance(len(designs))
            return np.concatenate(parts)

        decomposition = decomposed(of_unit, space.names, samples, confidence)
        if hazard is not None:
            is_outside = ~campaign.space.spans(varied.designs(space.sobol(256, np.random.default_rng(0))))
            outside = float((is_outside.reshape(256, -1) @ varied.weight).mean() / varied.weight.sum())
    scales: dict[str, float] = {}
    of_features = None if classifier is None else classifier.latent(outcome).length_scales
    if of_features is not None:
        scales = dict(zip(campaign.features.names, of_features.tolist(), strict=True))
    return SensitivityFindings(
        outcome=outcome,
        outcomes=tuple(campaign.simulator.outcomes),
        title=varied.question.title,
        mean=decomposition.mean,
        sd=decomposition.sd,
        indices=decomposition.by_total,
        confidence=confidence,
        samples=samples,
        evaluations=evaluations,
        units={one.name: one.unit for one in varied.parameters},
        outside=outside,
        notes=(
            *varied.notes,
            varied.of_indices,
            *(_notes(decomposition, samples, is_rareness_known=hazard is None) if samples else ()),
            *([] if classifier is None else noise_notes(classifier, outcome)),
            *limits_of(campaign.simulator),
            *(_notes_beside(scales, p_values or {}) if decomposition.indices else ()),
        ),
        pulses=0 if hazard is None else points,
        probability=probability,
        moves=moves,
        length_scales=scales,
        p_values=p_values or {},
    )


def _why_nothing(ended_beyond: NDArray[np.bool_] | None, classifier: Classifier | None, outcome: str) -> str:
    """Why there is nothing to decompose, from where the campaign's simulations ended; empty if there is something.

    Margins say how far a boundary is that no simulation crossed.
    """
    if ended_beyond is None or classifier is None or isinstance(classifier.latent(outcome), ByMargins):
        return ""
    if ended_beyond.any() and not ended_beyond.all():
        return ""
    ended, name = "Every" if ended_beyond.any() else "No", or_worse(outcome, classifier.outcomes)
    return f"{ended} simulation of the campaign ended in {name}, so there is nothing to explain: no Sobol' indices."


def _of_question(question: Question, outcome: str) -> Varied:
    """The uncertain variables of a question, whose probability is almost 0 or 1."""
    space = question.space
    if isinstance(space, WeightedRows):
        raise InputError(
            "question: must have independent variables, got rows of a table. Use `--hazard`, which averages over them."
        )
    if space.constraints:
        raise InputError(
            f"question: the constraint {space.constraints[0].text!r} makes the variables dependent, and the variance "
            "cannot be divided among dependent variables."
        )
    if correlated := [pair for pair in space.correlation if pair[2] != 0.0]:
        one, other, rho = correlated[0]
        raise InputError(
            f"question: {one} and {other} have the correlation {rho:g}, and the variance cannot be divided among "
            "correlated variables. Set `correlation = []` in the question file, or give one of the two a value with "
            "`--fixed`."
        )
    note = f"The indices divide the variance of the classifier's probability of {outcome} given all variables."
    return Varied(question, space.parameters, space, question.designs, np.ones(1), note, question.assumptions)


def _under_hazard(asked: Inquiry, outcome: str) -> Varied:
    """The variables of a design, whose probability is that under the pulses of a hazard.

    Variables with values have no indices. They are moved one at a time like the others, which have their medians, or
    of choices the most probable one.
    """
    campaign, hazard = asked.campaign, asked.hazard
    assert hazard is not None
    design = tuple(one for one in campaign.space.parameters if one.name not in hazard.variables)
    if not design:
        raise InputError(
            f"hazard: all variables of the campaign belong to the {hazard.loads}, so no design can be varied."
        )
    base = {
        one.name: float(np.argmax(one.probabilities) if one.choices else one.quantile(0.5)) for one in design
    } | asked.fixed
    question = hazard.question(campaign.space, base)
    free = tuple(one for one in design if one.name not in asked.fixed)
    choices = ", ".join(f"{one.name} = {one.written(base[one.name])}" for one in free if one.choices)
    held = f"medians or most probable choices ({choices})" if choices else "medians"
    rows = question.space.thinned(PULSES) if isinstance(question.space, WeightedRows) else question.space
    X, weight = integration_points(rows, PULSES)

    def under_pulses(values: Array) -> Array:
        designs = np.tile(question.designs(X), (len(values), 1))
        for k, one in enumerate(free):
            factor = question.factors.get(one.name, 1.0)
            designs[:, question.variables.index(one.name)] = np.repeat(values[:, k], len(X)) * factor
        return designs

    of_indices = (
        f"The indices divide the variance of the classifier's probability of {outcome} given the design, "
        f"averaged over {len(X)} fixed {hazard.loads}. The variables of the design are independent and have the "
        "campaign's distributions."
        if free
        else "All variables of the design have values, so there are no Sobol' indices."
    )
    of_moves = (
        f"One variable at a time moves to its {100 * LOW:g} % and {100 * HIGH:g} % quantiles in the campaign. The "
        f"other variables have the given values, or else their {held}. These probabilities are the classifier's and "
        "have no interval; `activefail probability` estimates a probability with an interval."
    )
    # Independent: who chooses a design may choose any combination.
    space = DesignSpace(free) if free else None
    return Varied(question, design, space, under_pulses, weight, of_indices, (*hazard.assumptions, of_moves))


def _moves(varied: Varied, probability: Callable[[str, float], float]) -> tuple[float, tuple[Move, ...]]:
    """The probability at the base values, and at two values of one variable at a time, by decreasing effect."""
    moves, base = [], varied.question.fixed
    at_base = probability(varied.parameters[0].name, base[varied.parameters[0].name])
    for one in (one for one in varied.parameters if not one.choices):
        low, high = (float(one.quantile(share)) for share in (LOW, HIGH))
        at_ends = probability(one.name, low), probability(one.name, high)
        moves.append(Move(one.name, base[one.name], low, high, *at_ends))
    moves.sort(key=lambda move: min(move.at_low, move.at_high, at_base) - max(move.at_low, move.at_high, at_base))
    return at_base, tuple(moves)


def _notes(decomposition: Decomposition, samples: int, is_rareness_known: bool) -> list[str]:
    """What the indices and their intervals mean.

    The bootstrap cannot know of designs that the sample lacks; without a hazard, their number is known.
    """
    if not decomposition.indices:
        return [
            "The classifier's probability hardly changes with these variables: its standard deviation is "
            f"{power(decomposition.sd, 2)}. There are no Sobol' indices."
        ]
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
    if is_rareness_known and decomposition.rarer < _FEW:
        notes.append(
            f"Only about {decomposition.rarer:.1f} of {2 * samples} sampled designs lie on the rarer side of the "
            "boundary. The indices and their intervals are unreliable: take more samples, or a question under which "
            "the outcome is less rare."
        )
    return notes


def _notes_beside(length_scales: Mapping[str, float], p_values: Mapping[str, float]) -> list[str]:
    """What the numbers beside the indices mean."""
    notes = []
    if length_scales:
        notes.append(
            "A length scale is in standard deviations of the feature over the campaign's space: short where the "
            "classifier changes quickly. It has no interval."
        )
    if p_values:
        notes.append(
            "A p-value is that of Wald's test in a logistic regression of the initial design on the variables. It "
            "detects monotone effects only. A large p-value does not show that a variable has no effect."
        )
    return notes
