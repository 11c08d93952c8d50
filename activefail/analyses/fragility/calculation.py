"""The fragility of a design under a hazard, or against one variable under a question."""

from dataclasses import replace

from activefail.analyses.findings.learned_from import noise_notes
from activefail.analyses.fragility.band import VerifiedLevel, stored, verify
from activefail.analyses.fragility.curve import Curve, Ladder, Rate, risk_of
from activefail.analyses.fragility.findings import NO_RATES, BoundaryFragility, FragilityFindings
from activefail.analyses.fragility.levels import RESOLUTION, curves_on
from activefail.campaign.hazard import Hazard
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.estimates.integral import integral_of
from activefail.estimates.probability_estimator import Estimator
from activefail.simulators.interface import limits_of, terms_of
from activefail.space.shares import percent, values_in_words
from activefail.text.progress import Stage, silent


def fragility(
    estimator: Estimator,
    asked: Inquiry,
    ladder: Ladder,
    outcome: str,
    simulations: int | None,
    confidence: float,
    stage: Stage = silent,
) -> FragilityFindings:
    """The fragility against the intensity of a hazard's loads, or against a variable of another question.

    The other uncertain variables are integrated out.

    Args:
        estimator: simulates.
        asked: what is asked.
        ladder: levels of the intensity or the variable (see `levels.ladder_of`).
        outcome: whose curve is verified.
        simulations: fresh ones that verify it; 0 for none. None shows what earlier verifications stored, of every
            outcome, and simulates nothing.
        confidence: of the intervals.
        stage: called with each stage of the work.
    """
    campaign, question, hazard = asked.campaign, asked.question, asked.hazard

    def at_level(level: float) -> Question:
        if hazard is None:
            return question.at({ladder.name: level})
        return asked.under(hazard, level)

    def verified(of: str, curve: Curve) -> tuple[VerifiedLevel, ...]:
        if simulations is None:
            return stored(curve, at_level, lambda at: estimator.stored(of, at, confidence))
        if of != outcome or not simulations:
            return ()
        stage(f"verifying the curve of {of} with {simulations} fresh simulations")
        return verify(curve, simulations, at_level, lambda at, n: estimator.sample(of, n, at).estimate(confidence))

    stage(f"evaluating the curves at {len(ladder.levels)} levels of {ladder.name}")
    curves, outside, from_outside = curves_on(estimator.boundaries, at_level, ladder, campaign.space)
    outcomes = tuple(campaign.simulator.outcomes)
    fixed = question.fixed if hazard is None else asked.fixed
    findings = FragilityFindings(
        title=question.title,
        ladder=curves[0].ladder,
        boundaries=tuple(
            BoundaryFragility(of, curve, verified=verified(of, curve))
            for of, curve in zip(outcomes[1:], curves, strict=True)
        ),
        outside=outside,
        from_outside=from_outside,
        fixed=campaign.space.written(fixed),
        given=values_in_words(campaign.space, fixed),
        refused=campaign.settings.refused.get("verify", ""),
        confidence=confidence,
        notes=(
            *question.assumptions,
            *_notes(asked, ladder.name),
            *noise_notes(estimator.classifier),
            *limits_of(campaign.simulator),
        ),
        outcomes=outcomes,
        terms=terms_of(campaign.simulator, campaign.space.quantities(fixed)),
    )
    return findings if hazard is None else _under_hazard(findings, estimator, asked, hazard, ladder, stage)


def _under_hazard(
    findings: FragilityFindings, estimator: Estimator, asked: Inquiry, hazard: Hazard, ladder: Ladder, stage: Stage
) -> FragilityFindings:
    """The findings with what a hazard adds: its median, property bounds, loads and risk."""
    space, boundaries, median = asked.campaign.space, estimator.boundaries, hazard.median
    without, alone = hazard.alone, None
    if without is not None:
        stage(f"evaluating the curves of the {hazard.loads} alone")
        alone, _, _ = curves_on(boundaries, lambda level: asked.under(without, level), ladder, space)
    at_bounds = {
        bound: integral_of(
            asked.under(hazard.at_bound(bound), median), boundaries, space, RESOLUTION
        ).probability.tolist()
        for bound in hazard.bounds
    }
    stage(f"finding the {hazard.loads} that contribute")
    whole = integral_of(asked.question, boundaries, space).probability
    parts = hazard.deaggregated(boundaries, space, asked.fixed, whole)
    rate = None if hazard.rates is None else Rate(*hazard.rates)
    outside = asked.question.outside(space)
    few = f"{percent(outside.share)} of the hazard's {hazard.loads} lie outside the campaign's design space."
    return replace(
        findings,
        boundaries=tuple(
            replace(
                one,
                alone=alone[column] if alone else None,
                at_median={bound: values[column] for bound, values in at_bounds.items()},
                risk=risk_of(one.curve, rate) if rate else None,
                deaggregation=parts[column],
            )
            for column, one in enumerate(findings.boundaries)
        ),
        median=median,
        loads=hazard.loads,
        outside_hazard=outside.share,
        why_no_risk="" if rate else NO_RATES,
        notes=(*filter(None, [outside.advice or (few if outside.share else "")]), *findings.notes),
    )


def _notes(asked: Inquiry, name: str) -> list[str]:
    """What the curves are integrated over, as sentences."""
    space, hazard, notes = asked.question.space, asked.hazard, list[str]()
    if hazard is None:
        notes.append(f"The curve is integrated over {', '.join(one for one in space.names if one != name)}.")
        pairs = getattr(space, "correlation", ())
        if tied := sorted({one for pair in pairs if name in pair[:2] for one in pair[:2]} - {name}):
            notes.append(
                f"{', '.join(tied)} {'is' if len(tied) == 1 else 'are'} correlated with {name}. The curve ignores this "
                f"correlation: the distribution is the same at each {name}."
            )
        return notes
    if others := [one for one in asked.campaign.space.names if one not in {*hazard.variables, *asked.fixed}]:
        notes.append(f"Variables without a value keep the campaign's distributions: {', '.join(others)}.")
    return [*notes, *hazard.assumptions_at_levels]
