"""The fragility of a bearing under a hazard, or against one variable under a question."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import Hazard, hazard_question
from activefail.campaign.question import AMPLITUDE, PERIOD, Question
from activefail.errors import InputError
from activefail.reliability.estimate import ProbabilityEstimate
from activefail.reliability.integral import Boundaries
from activefail.risk.fragility.band import (
    LEAST,
    VerifiedLevel,
    stored,
    verify,
)
from activefail.risk.fragility.curve import Curve, Ladder
from activefail.risk.fragility.deaggregation import deaggregated
from activefail.risk.fragility.findings import Bound, BoundaryFragility, FragilityFindings
from activefail.risk.fragility.levels import (
    RESOLUTION,
    Intensity,
    check_asked,
    curves_on,
    intensity_ladder,
    median_intensity,
    question_at,
    variable_ladder,
)
from activefail.risk.fragility.rates import risk_of
from activefail.simulators.bearing import limits_of, terms_of
from activefail.space import DesignSpace
from activefail.verification.probability_estimator import Estimator


@dataclass(frozen=True)
class Verification:
    """How a curve is verified.

    Attributes:
        outcome: whose curve.
        simulations: number of fresh simulations; 0 for none.
        confidence: of the intervals.
        estimate: estimates a question from so many fresh simulations.
        stored: estimates an outcome under a question from stored simulations, if there are any: what earlier
            verifications stored is then shown for every outcome, and nothing is simulated. None to simulate.
    """

    outcome: str
    simulations: int
    confidence: float
    estimate: Callable[[Question, int], ProbabilityEstimate]
    stored: Callable[[str, Question], ProbabilityEstimate | None] | None = None


def checked_ladder(
    hazard: Hazard | None,
    question: Question,
    space: DesignSpace,
    intensity: Intensity,
    against: str | None,
    bounds: tuple[float, float] | None,
    simulations: int,
) -> Ladder | None:
    """The levels of a variable; None with a hazard, whose intensity has levels of its own.

    Args:
        hazard: None for the question alone.
        question: the hazard's, or another one.
        space: of the campaign.
        intensity: "pgv" or "a_p", with a hazard.
        against: the variable, without a hazard.
        bounds: of the variable's levels; those of the campaign if None.
        simulations: fresh ones that verify the curve; 0 for none.

    Raises:
        InputError: naming the argument, the rule and the value.
    """
    check_asked(hazard, against, bounds, intensity)
    if 0 < simulations < LEAST:
        raise InputError(f"verify: must be at least {LEAST}, got {simulations}.")
    if against is None:
        return None
    if isinstance(against, str) and against in question.fixed:
        raise InputError(f"against: {against} has the value {question.fixed[against]:g}; leave it out of --fixed.")
    return variable_ladder(question, space, against, bounds)


def fragility(
    estimator: Estimator,
    hazard: Hazard | None,
    question: Question,
    intensity: Intensity,
    ladder: Ladder | None,
    outcome: str,
    simulations: int | None,
    confidence: float,
    stage: Callable[[str], None] = lambda _: None,
) -> FragilityFindings:
    """The fragility under a hazard, against its intensity, or under a question, against a variable.

    Args:
        estimator: simulates.
        hazard: at one of its property bounds; None for the question alone.
        question: the hazard's, or another one.
        intensity: "pgv" or "a_p", with a hazard.
        ladder: levels of the variable, without a hazard (see `checked_ladder`).
        outcome: whose curve is verified.
        simulations: fresh ones that verify it; 0 for none. None shows what earlier verifications stored, of every
            outcome, and simulates nothing.
        confidence: of the intervals.
        stage: called with each stage of the work.
    """
    campaign = estimator.campaign

    def estimate(at_level: Question, fresh: int) -> ProbabilityEstimate:
        return estimator.sample(outcome, fresh, at_level).estimate(confidence)

    def read(outcome: str, at_level: Question) -> ProbabilityEstimate | None:
        return estimator.stored(outcome, at_level, confidence)

    verification = Verification(outcome, simulations or 0, confidence, estimate, read if simulations is None else None)
    boundaries = estimator.boundaries
    if hazard is not None:
        values = {name: value for name, value in question.fixed.items() if name in campaign.space.names}
        return bearing_fragility(campaign, boundaries, hazard, values, intensity, verification, stage)
    assert ladder is not None
    return general_fragility(campaign, boundaries, question, ladder, verification, stage)


def bearing_fragility(
    campaign: Campaign,
    boundaries: Boundaries,
    hazard: Hazard,
    fixed: Mapping[str, float],
    intensity: Intensity,
    verification: Verification,
    stage: Callable[[str], None] = lambda _: None,
) -> FragilityFindings:
    """The fragility of a bearing under a hazard, against the intensity of its pulses.

    Args:
        campaign: the campaign.
        boundaries: of the campaign's designs.
        hazard: at one of its property bounds.
        fixed: values of the bearing's variables.
        intensity: "pgv" or "a_p".
        verification: how the curve is verified.
        stage: called with each stage of the work.

    Raises:
        InputError: if the campaign has no pulse, or `fixed` gives one.
    """
    settings, space = campaign.settings, campaign.space

    def question_of(hazard: Hazard, level: float) -> Question:
        return question_at(hazard, settings, space, fixed, intensity, level)

    whole = hazard_question(hazard, settings, space, fixed)
    ladder, median = intensity_ladder(intensity, hazard), median_intensity(hazard, intensity)
    stage(f"evaluating the curves at {len(ladder.levels)} levels of {ladder.name}")
    curves = curves_on(boundaries, lambda level: question_of(hazard, level), ladder, space)
    is_uncertain = hazard.added_dispersion > 0.0 or hazard.bias != 0.0
    alone = None
    if is_uncertain:
        stage("evaluating the curves of the pulses alone")
        alone = curves_on(boundaries, lambda level: question_of(hazard.without_uncertainty(), level), ladder, space)
    has_bounds = hazard.settings.properties is not None
    names: tuple[Bound, ...] = ("lower", "nominal", "upper") if has_bounds else ("nominal",)
    at_bounds = {
        name: question_of(hazard.at_bound(name), median).integral(boundaries, space, RESOLUTION).probability
        for name in names
    }
    stage("finding the pulses that contribute")
    parts = deaggregated(
        boundaries,
        lambda of: hazard_question(of, settings, space, fixed),
        hazard,
        whole.integral(boundaries, space).probability,
    )
    rates, why = hazard.settings.curve, ""
    if rates is None:
        why = "the hazard has no curve of annual rates"
    elif intensity != "pgv":
        why, rates = "the hazard's annual rates are those of PGV, not of A_p", None
    of_boundaries = []
    for column, outcome in enumerate(campaign.simulator.outcomes[1:]):
        curve = curves.curves[column]
        of_boundaries.append(
            BoundaryFragility(
                outcome,
                curve,
                alone.curves[column] if alone else None,
                _verified(outcome, curve, lambda level: question_of(hazard, level), verification, stage),
                {name: float(value[column]) for name, value in at_bounds.items()},
                None if rates is None else risk_of(curve, np.array(rates.pgv_m_s), np.array(rates.annual_rate)),
                parts[column],
            )
        )
    outside = whole.outside(space)
    notes = [
        *filter(None, [outside.advice]),
        *whole.assumptions,
        *_notes_of_bearing(campaign, hazard, fixed, intensity),
    ]
    return FragilityFindings(
        whole.title,
        curves.curves[0].ladder,
        tuple(of_boundaries),
        curves.outside,
        curves.from_outside,
        fixed,
        verification.confidence,
        median,
        outside.share,
        why,
        tuple(notes),
        tuple(campaign.simulator.outcomes),
        terms_of(campaign.simulator, fixed),
    )


def general_fragility(
    campaign: Campaign,
    boundaries: Boundaries,
    question: Question,
    ladder: Ladder,
    verification: Verification,
    stage: Callable[[str], None] = lambda _: None,
) -> FragilityFindings:
    """The fragility of any simulator against one variable, the question's other uncertain variables integrated out.

    Args:
        campaign, boundaries, verification, stage: as for `bearing_fragility`.
        question: the distribution of the variables.
        ladder: of the variable (see `variable_ladder`).
    """
    against = ladder.name

    def question_at_level(level: float) -> Question:
        return question.at({against: level})

    stage(f"evaluating the curves at {len(ladder.levels)} levels of {ladder.name}")
    curves = curves_on(boundaries, question_at_level, ladder, campaign.space)
    of_boundaries = tuple(
        BoundaryFragility(outcome, curve, verified=_verified(outcome, curve, question_at_level, verification, stage))
        for outcome, curve in zip(campaign.simulator.outcomes[1:], curves.curves, strict=True)
    )
    others = [name for name in question.space.names if name != against]
    notes = [
        *question.assumptions,
        f"The curve is integrated over {', '.join(others)}.",
        *limits_of(campaign.simulator),
    ]
    pairs = getattr(question.space, "correlation", ())
    tied = sorted({name for pair in pairs if against in pair[:2] for name in pair[:2]} - {against})
    if tied:
        notes.append(
            f"{', '.join(tied)} {'is' if len(tied) == 1 else 'are'} correlated with {against}. The curve ignores this "
            f"correlation: the distribution is the same at each {against}."
        )
    why = "a risk requires a hazard with annual rates"
    return FragilityFindings(
        question.title,
        curves.curves[0].ladder,
        of_boundaries,
        curves.outside,
        curves.from_outside,
        question.fixed,
        verification.confidence,
        None,
        None,
        why,
        tuple(notes),
        tuple(campaign.simulator.outcomes),
        terms_of(campaign.simulator, question.fixed),
    )


def _verified(
    outcome: str,
    curve: Curve,
    question_at_level: Callable[[float], Question],
    verification: Verification,
    stage: Callable[[str], None],
) -> tuple[VerifiedLevel, ...]:
    if (read := verification.stored) is not None:
        return stored(curve, question_at_level, lambda question: read(outcome, question))
    if outcome != verification.outcome or not verification.simulations:
        return ()
    stage(f"verifying the curve of {outcome} with {verification.simulations} fresh simulations")
    return verify(curve, verification.simulations, question_at_level, verification.estimate)


def _notes_of_bearing(
    campaign: Campaign, hazard: Hazard, fixed: Mapping[str, float], intensity: Intensity
) -> list[str]:
    sentences = []
    others = [name for name in campaign.space.names if name not in {PERIOD, AMPLITUDE, *fixed}]
    if others:
        sentences.append(f"Variables without a value keep the campaign's distributions: {', '.join(others)}.")
    if intensity == "a_p":
        sentences.append(
            "At each amplitude the pulse periods have the same distribution, because the pulses are scaled."
        )
    elif hazard.rows is not None:
        sentences.append("At each PGV the periods have the distribution of all the hazard's pulses.")
    return [*sentences, *limits_of(campaign.simulator)]
