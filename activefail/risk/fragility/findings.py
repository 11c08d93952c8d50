"""Fragility: the probability of each outcome against one variable, with what follows from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import Hazard, hazard_question
from activefail.campaign.question import AMPLITUDE, PERIOD, Question
from activefail.errors import InputError
from activefail.reliability.estimate import ProbabilityEstimate
from activefail.risk.fragility.band import (
    LEAST,
    NOT_VERIFIED,
    Interval,
    VerifiedLevel,
    capacity_interval,
    stored,
    verify,
)
from activefail.risk.fragility.curve import Capacity, Curve, Ladder
from activefail.risk.fragility.deaggregation import Deaggregation, deaggregated
from activefail.risk.fragility.levels import (
    Boundaries,
    Intensity,
    answer,
    check_asked,
    curves_on,
    intensity_ladder,
    median_intensity,
    question_at,
    standardised_boundaries,
    variable_ladder,
)
from activefail.risk.fragility.lognormal import Lognormal, fit_lognormal, why_not_fitted
from activefail.risk.fragility.rates import YEARS, Risk, risk_of
from activefail.shares import percent
from activefail.simulators.bearing import DfpSimulator
from activefail.space import Array, DesignSpace
from activefail.verification.probability import Estimator

Bound = Literal["lower", "nominal", "upper"]

CAPACITIES = (0.025, 0.10, 0.50)
"""Probabilities of the reported capacities."""

WITHOUT_INTERVAL = "the classifier's number, without an interval"


@dataclass(frozen=True, eq=False)
class BoundaryFragility:
    """The fragility of one boundary.

    Attributes:
        outcome: its name; the probability is of it or a more severe one.
        curve: with the added uncertainties, if there are any.
        alone: the curve of the pulses alone; None without added uncertainty.
        verified: levels with intervals.
        at_median: by property bound, the probability at the hazard's median; None without a hazard.
        risk: None without annual rates.
        deaggregation: None without a hazard.
    """

    outcome: str
    curve: Curve
    alone: Curve | None = None
    verified: tuple[VerifiedLevel, ...] = ()
    at_median: Mapping[str, float] | None = None
    risk: Risk | None = None
    deaggregation: Deaggregation | None = None

    def capacity(self, p: float) -> tuple[Capacity, Interval]:
        """The level at which the curve first exceeds a probability, with what was verified of it."""
        return self.curve.capacity(p), capacity_interval(self.curve, self.verified, p)

    @property
    def lognormal(self) -> Lognormal | None:
        """The lognormal curve beside the curve."""
        return fit_lognormal(self.curve)


@dataclass(frozen=True, eq=False)
class FragilityFindings:
    """The probability of each outcome, or a more severe one, against one variable.

    Attributes:
        title: of the hazard or the question.
        ladder: the variable's levels.
        boundaries: the least severe outcome first.
        outside: (n,) share of the question outside the campaign's design space at each level.
        fixed: values of variables.
        confidence: of the intervals.
        median: the hazard's median of the intensity; None without a hazard.
        outside_hazard: share of the whole hazard outside the design space; None without a hazard.
        why_no_risk: empty if there is a risk.
        notes: what was assumed, as sentences.
    """

    title: str
    ladder: Ladder
    boundaries: tuple[BoundaryFragility, ...]
    outside: Array
    fixed: Mapping[str, float]
    confidence: float
    median: float | None
    outside_hazard: float | None
    why_no_risk: str
    notes: tuple[str, ...]

    @property
    def has_verification(self) -> bool:
        """Whether any level was verified."""
        return any(one.verified for one in self.boundaries)

    @property
    def assumptions(self) -> list[str]:
        """What was assumed, and what contradicts it, as sentences."""
        sentences = list(self.notes)
        for one in self.boundaries:
            surprising = sum(level.estimate.surprising for level in one.verified)
            if surprising:
                sentences.append(
                    f"{surprising} of the fresh simulations contradict the classifier where it was sure. It has missed "
                    "something: continue the campaign before you use these curves."
                )
        if self.has_verification:
            sentences.append(
                f"The intervals are pointwise: each has {100.0 * self.confidence:g} % confidence by itself, not all "
                "together. They assume a limit state that is smooth between simulations."
            )
        curves = np.array([one.curve.probability for one in self.boundaries])
        outside = self.outside[((curves >= 0.01) & (curves <= 0.9)).any(axis=0)]
        if len(outside) and outside.max() > 0.0:
            sentences.append(
                f"Where the curves are between 1 and 90 %, {percent(float(outside.min()))} to "
                f"{percent(float(outside.max()))} of the distribution lies outside the campaign's design space. The "
                "classifier extrapolates there."
            )
        if self.outside_hazard:
            sentences.append(
                f"{percent(self.outside_hazard)} of the hazard's pulses lie outside the campaign's design space."
            )
        return sentences

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return {
            "question": self.title,
            "fixed": dict(self.fixed),
            "variable": {"name": self.ladder.name, "unit": self.ladder.unit, "levels": self.ladder.levels.tolist()},
            "outside_design_space": self.outside.tolist(),
            "outside_design_space_of_hazard": self.outside_hazard,
            "hazard_median": self.median,
            "outcomes": {one.outcome: self._of_boundary(one) for one in self.boundaries},
            "assumptions": self.assumptions,
        }

    def _of_boundary(self, one: BoundaryFragility) -> dict[str, Any]:
        fall, fit, risk, why = one.curve.fall, one.lognormal, one.risk, self.why_no_risk
        return {
            "curve": {
                "probability": one.curve.probability.tolist(),
                "interval": None,
                "interval_reason": "only the verified levels have intervals" if one.verified else NOT_VERIFIED,
            },
            "curve_of_pulses_alone": None
            if one.alone is None
            else {
                "levels": one.alone.ladder.levels.tolist(),
                "probability": one.alone.probability.tolist(),
                "interval": None,
                "interval_reason": WITHOUT_INTERVAL,
            },
            "resolution": one.curve.resolution,
            "rises": one.curve.rises,
            "falls": None if fall is None else {"by": fall.size, "from": fall.start, "to": fall.end},
            "capacities": [self._of_capacity(one, p) for p in CAPACITIES],
            "lognormal": None
            if fit is None
            else {
                "median": fit.median,
                "dispersion": fit.dispersion,
                "largest_misfit": fit.misfit,
                "largest_misfit_at": fit.misfit_at,
                "interval": None,
                "interval_reason": "it describes the curve, which is the result",
            },
            "lognormal_reason": why_not_fitted(one.curve) or None,
            "verified": [_of_level(level) for level in one.verified],
            "at_hazard_median": None
            if one.at_median is None
            else {"probability": dict(one.at_median), "interval": None, "interval_reason": WITHOUT_INTERVAL},
            "margin": self._of_margin(one),
            "risk": None
            if risk is None
            else {
                "annual_rate": risk.annual_rate,
                "years": YEARS,
                "probability": risk.in_50_years,
                "share_outside_hazard_curve": risk.outside,
                "share_above_fragility_curve": risk.beyond,
                "interval": None,
                "interval_reason": WITHOUT_INTERVAL,
            },
            "risk_reason": why or None,
            "deaggregation": None if one.deaggregation is None else one.deaggregation.as_json(),
        }

    def _of_capacity(self, one: BoundaryFragility, p: float) -> dict[str, Any]:
        capacity, interval = one.capacity(p)
        return {
            "probability": p,
            "level": capacity.level,
            "reason": capacity.reason or None,
            "verified": interval.middle,
            "low": interval.low,
            "high": interval.high,
            "confidence": self.confidence if one.verified else None,
            "interval_reason": interval.reason or None,
        }

    def _of_margin(self, one: BoundaryFragility) -> dict[str, Any] | None:
        if (margin := self.margin(one)) is None or self.median is None:
            return None
        _, interval = one.capacity(0.5)
        return {
            "value": margin,
            "low": None if interval.low is None else interval.low / self.median,
            "high": None if interval.high is None else interval.high / self.median,
            "confidence": self.confidence if one.verified else None,
            "interval_reason": interval.reason or None,
        }

    def margin(self, one: BoundaryFragility) -> float | None:
        """The 50 % capacity over the hazard's median; None if either is unknown."""
        level = one.curve.capacity(0.5).level
        return None if level is None or self.median is None else level / self.median


def _of_level(verified: VerifiedLevel) -> dict[str, Any]:
    estimate = verified.estimate
    return {
        "level": verified.level,
        "probability": estimate.probability,
        "low": estimate.low,
        "high": estimate.high,
        "confidence": estimate.confidence,
        "simulations": estimate.simulations,
        "numerical_failures": estimate.unanswered,
        "contradictions": estimate.wrong,
        "contradictions_where_sure": estimate.surprising,
        "classifier_probability": estimate.model,
    }


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
    boundaries = standardised_boundaries(estimator.classifier, campaign.features)
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
        boundaries: mean/sd of each boundary's latent as a function of designs.
        hazard: at one of its property bounds.
        fixed: values of the bearing's variables.
        intensity: "pgv" or "a_p".
        verification: how the curve is verified.
        stage: called with each stage of the work.

    Raises:
        InputError: if the campaign has no pulse, or `fixed` gives one.
    """
    settings, space = campaign.settings, campaign.space

    def asked(hazard: Hazard, level: float) -> Question:
        return question_at(hazard, settings, space, fixed, intensity, level)

    whole = hazard_question(hazard, settings, space, fixed)
    ladder, median = intensity_ladder(intensity, hazard), median_intensity(hazard, intensity)
    stage(f"evaluating the curves at {len(ladder.levels)} levels of {ladder.name}")
    curves = curves_on(boundaries, lambda level: asked(hazard, level), ladder, space)
    is_uncertain = hazard.added_dispersion > 0.0 or hazard.bias != 0.0
    alone = None
    if is_uncertain:
        stage("evaluating the curves of the pulses alone")
        alone = curves_on(boundaries, lambda level: asked(hazard.without_uncertainty(), level), ladder, space)
    has_bounds = hazard.settings.properties is not None
    names: tuple[Bound, ...] = ("lower", "nominal", "upper") if has_bounds else ("nominal",)
    at_bounds = {name: answer(boundaries, asked(hazard.at_bound(name), median), space).probability for name in names}
    stage("finding the pulses that contribute")
    parts = deaggregated(boundaries, lambda of: hazard_question(of, settings, space, fixed), hazard)
    rates, why = hazard.settings.curve, ""
    if rates is None:
        why = "the hazard has no curve of annual rates"
    elif intensity != "pgv":
        why, rates = "the hazard's annual rates are those of PGV, not of A_p", None
    found = []
    for column, outcome in enumerate(campaign.simulator.outcomes[1:]):
        curve = curves.curves[column]
        found.append(
            BoundaryFragility(
                outcome,
                curve,
                alone.curves[column] if alone else None,
                _verified(outcome, curve, lambda level: asked(hazard, level), verification, stage),
                {name: float(value[column]) for name, value in at_bounds.items()},
                None if rates is None else risk_of(curve, np.array(rates.pgv_m_s), np.array(rates.annual_rate)),
                parts[column],
            )
        )
    notes = [*whole.assumptions, *_notes_of_bearing(campaign, hazard, fixed, intensity)]
    outside = whole.share_outside(space)
    return FragilityFindings(
        whole.title,
        curves.curves[0].ladder,
        tuple(found),
        curves.outside,
        fixed,
        verification.confidence,
        median,
        outside,
        why,
        tuple(notes),
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

    def asked(level: float) -> Question:
        return question.at({against: level})

    stage(f"evaluating the curves at {len(ladder.levels)} levels of {ladder.name}")
    curves = curves_on(boundaries, asked, ladder, campaign.space)
    found = tuple(
        BoundaryFragility(outcome, curve, verified=_verified(outcome, curve, asked, verification, stage))
        for outcome, curve in zip(campaign.simulator.outcomes[1:], curves.curves, strict=True)
    )
    others = [name for name in question.space.names if name != against]
    notes = [*question.assumptions, f"Integrated over {', '.join(others)}."]
    pairs = getattr(question.space, "correlation", ())
    tied = sorted({name for pair in pairs if against in pair[:2] for name in pair[:2]} - {against})
    if tied:
        notes.append(
            f"{', '.join(tied)}: correlated with {against}. At a given {against} its distribution is the one without "
            "this correlation."
        )
    why = "a risk needs a hazard with annual rates"
    return FragilityFindings(
        question.title,
        curves.curves[0].ladder,
        found,
        curves.outside,
        question.fixed,
        verification.confidence,
        None,
        None,
        why,
        tuple(notes),
    )


def _verified(
    outcome: str,
    curve: Curve,
    asked: Callable[[float], Question],
    verification: Verification,
    stage: Callable[[str], None],
) -> tuple[VerifiedLevel, ...]:
    if (read := verification.stored) is not None:
        return stored(curve, asked, lambda question: read(outcome, question))
    if outcome != verification.outcome or not verification.simulations:
        return ()
    stage(f"verifying the curve of {outcome} with {verification.simulations} fresh simulations")
    return verify(curve, verification.simulations, asked, verification.estimate)


def _notes_of_bearing(
    campaign: Campaign, hazard: Hazard, fixed: Mapping[str, float], intensity: Intensity
) -> list[str]:
    sentences = []
    others = [name for name in campaign.space.names if name not in {PERIOD, AMPLITUDE, *fixed}]
    if others:
        sentences.append(f"Variables without a value keep the campaign's distributions: {', '.join(others)}.")
    if intensity == "a_p":
        sentences.append("At each amplitude the pulse periods keep their distribution: the same pulses are scaled.")
    elif hazard.rows is not None:
        sentences.append("At each PGV the periods have the distribution of all the hazard's pulses.")
    if isinstance(campaign.simulator, DfpSimulator):
        sentences.append(
            "The bearing is loaded by one horizontal pulse: its motion is planar, there is no vertical component, and "
            "its rims do not yield."
        )
    return sentences
