"""A fragility curve under finitely many values, such as records: a stripe at each of a few levels."""

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.fragility.band import VerifiedLevel
from activefail.analyses.fragility.capacities import Fragility, fitted
from activefail.analyses.fragility.curve import Curve, Ladder, why_not_fitted
from activefail.analyses.fragility.findings import BoundaryFragility, FragilityFindings
from activefail.analyses.stripes.findings import StripeFindings
from activefail.analyses.stripes.stripe import Stripe, Stripes
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.space.shares import values_in_words

_LEVELS = 4
"""Levels of a curve by stripes."""

_FIRST, _LAST = 0.05, 0.7
"""Probabilities by the classifier between which the levels lie."""

_COARSE = 3
"""Steps of the ladder between levels at which the classifier is asked where these are."""


def fragility_by_stripes(
    stripes: Stripes, asked: Inquiry, ladder: Ladder, outcome: str, wrong: float, confidence: float
) -> FragilityFindings:
    """The curve of an outcome or a more severe one, from stripes at a few levels; each teaches the next.

    The levels begin and end beside those at which the classifier puts 5 % to 70 % of the values beyond the boundary.
    They are asked for from the middle outwards: the middle teaches most. The classifier, which has then learned from
    all of them, says between which levels of the ladder each value has its capacity.

    Args:
        stripes: asks.
        asked: what is asked.
        ladder: all levels.
        outcome: of the boundary.
        wrong: as for `Stripes.ask`.
        confidence: of the intervals.

    Raises:
        InputError: if the classifier puts no level there.
    """
    campaign, question, all_levels = asked.campaign, asked.question, ladder.levels.astype(np.float64)

    def at(level: float) -> Question:
        return question.at({ladder.name: level})

    coarse = np.unique(np.append(all_levels[::_COARSE], all_levels[-1]))
    shares = np.array([stripes.predicted(at(level), outcome).probability for level in coarse.tolist()])
    inside = np.flatnonzero((shares >= _FIRST) & (shares <= _LAST))
    if not len(inside):
        raise InputError(
            f"wrong: the classifier puts no level of {ladder.name} between {100 * _FIRST:g} and {100 * _LAST:g} %; "
            "choose others with --range."
        )
    ends = coarse[[max(0, inside[0] - 1), min(len(coarse) - 1, inside[-1] + 1)]]
    levels = all_levels[(all_levels >= ends[0]) & (all_levels <= ends[1])]
    levels = levels[np.unique(np.linspace(0, len(levels) - 1, _LEVELS).round().astype(int))]
    found: dict[int, StripeFindings] = {}
    for place in np.argsort(np.abs(np.arange(len(levels)) - len(levels) // 2), kind="stable").tolist():
        stripes.stage(f"{ladder.name} = {levels[place]:.4g}")
        found[place] = StripeFindings(stripes.ask(at(float(levels[place])), outcome, wrong), confidence)
    at_levels = [stripes.predicted(at(level), outcome) for level in all_levels.tolist()]
    curve, weight = Curve(ladder, np.array([one.probability for one in at_levels]), 0.0), at_levels[0].values.weight
    is_outside = np.array([~campaign.space.spans(one.values.X) for one in at_levels])
    beyond = np.array([one.beyond for one in at_levels])
    from_outside = (beyond & is_outside) @ weight / np.maximum(curve.probability, 1e-300)
    # The intervals assume no more at any level than where the largest share is taken to be wrong.
    widest = max(found.values(), key=lambda one: (one.stripe.predicted.any(), one.stripe.sure_wrong.mean))
    places = sorted(found, reverse=not curve.rises)
    verified = tuple(VerifiedLevel(float(levels[place]), found[place]) for place in places)
    fit = _of_capacities(curve, beyond, at_levels[0])
    return FragilityFindings(
        title=question.title,
        ladder=ladder,
        boundaries=(BoundaryFragility(outcome, curve, verified=verified, fit=fit),),
        outside=is_outside @ weight,
        from_outside=from_outside[:, None],
        fixed=campaign.space.written(question.fixed),
        given=values_in_words(campaign.space, question.fixed),
        refused="",
        confidence=confidence,
        notes=tuple(widest.assumptions),
        outcomes=tuple(campaign.simulator.outcomes),
    )


def _of_capacities(curve: Curve, beyond: NDArray[np.bool_], of: Stripe) -> Fragility | None:
    """The lognormal curve of the capacities of values, with intervals over their groups.

    Args:
        curve: the share of the values.
        beyond: (m, n) whether each value is beyond the boundary at each level.
        of: the values. Without equal probabilities they have no such curve.
    """
    levels, weight, group = curve.ladder.levels, of.values.weight, of.values.group
    if why_not_fitted(curve) or not np.allclose(weight, weight[0]):
        return None
    first = np.where(beyond.any(axis=0), beyond.argmax(axis=0), len(levels))
    below, capacity = np.append(0.0, levels)[first], np.append(levels, np.inf)[first]
    return fitted(below, capacity, ["one"] * len(weight) if group is None else list(map(str, group.tolist())))
