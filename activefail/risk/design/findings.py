"""What a search for a design found, in numbers and words."""

import math
from dataclasses import dataclass
from typing import Any

from activefail.bearing.design import GRAVITY
from activefail.bearing.terms import Terms
from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import CAPACITY, FRICTION, Hazard
from activefail.campaign.question import Outside
from activefail.findings.lines import titled
from activefail.reliability.estimate import ProbabilityEstimate
from activefail.risk.design.design_task import LOOKS, Rate
from activefail.risk.design.required_chart import RequiredChart
from activefail.risk.design.search import WORTH, Designed
from activefail.shares import bounds_percent, percent
from activefail.simulators.bearing import limits_of, terms_of
from activefail.visible import or_worse, visible

OUT_OF_REACH = 3
"""Exit code if no design was shown to meet its targets."""

BEARING_PERIOD = "T_b"
"""Variable of a bearing that gives the stiffness of its lateral force."""


@dataclass(frozen=True, eq=False)
class DesignFindings:
    """A design that meets its targets, or the nearest one.

    Attributes:
        campaign: the campaign.
        designed: the result of the search.
        hazard: the hazard of the question; None for another question.
        outside: what of the question lies outside the campaign's design space.
        at_upper: classifier's probability of each target's outcome at the upper property bounds, without interval;
            empty without such bounds.
        at_least: classifier's probability of each target's outcome at the least velocity of the hazard's curve,
            without interval; empty unless the targets are risks in a number of years.
        chart: values that targets require; None if it was not asked for.
    """

    campaign: Campaign
    designed: Designed
    hazard: Hazard | None
    outside: Outside
    at_upper: tuple[float, ...] = ()
    at_least: tuple[float, ...] = ()
    chart: RequiredChart | None = None

    @property
    def bearing(self) -> dict[str, float]:
        """The values of all variables that are certain, by name, in the campaign's order."""
        fixed = self.designed.question.fixed
        return {name: fixed[name] for name in self.campaign.space.names if name in fixed}

    @property
    def uncertain(self) -> list[str]:
        """The uncertain variables."""
        return list(self.designed.question.space.names)

    @property
    def lateral_force(self) -> float | None:
        """Lateral force at the displacement capacity over the weight, at the upper bound of friction.

        μ + D_tot (2π/T_b)²/g, the force of two equal dishes before a rim is touched. None if the campaign's design is
        not a bearing.
        """
        known = self._at_upper_friction
        if not {BEARING_PERIOD, FRICTION, CAPACITY} <= known.keys():
            return None
        stiffness = (2.0 * math.pi / known[BEARING_PERIOD]) ** 2 / GRAVITY
        return known[FRICTION] + known[CAPACITY] * stiffness

    @property
    def terms(self) -> Terms | None:
        """The bearing in the designer's terms, at the upper bound of friction; None if a value is uncertain."""
        return terms_of(self.campaign.simulator, self._at_upper_friction)

    @property
    def friction(self) -> str:
        """The friction of `lateral_force` and `terms`, in words."""
        upper = self.hazard is not None and FRICTION in self.hazard.at_bound("upper").factors
        return "at the upper bound of friction" if upper else "at the given friction (the hazard has no upper bound)"

    @property
    def _at_upper_friction(self) -> dict[str, float]:
        known = {**self.campaign.space.fixed, **self.bearing}
        if self.hazard is not None and FRICTION in known:
            known[FRICTION] *= self.hazard.at_bound("upper").factors.get(FRICTION, 1.0)
        return known

    @property
    def assumptions(self) -> list[str]:
        """What the result assumes, as sentences."""
        task = self.designed.task
        sentences = list(self.designed.question.assumptions)
        if (rate := task.rate) is not None:
            at_least = ", ".join(percent(share) for share in self.at_least)
            sentences.append(
                f"Pulses below {rate.velocity:g} m/s, where the hazard's curve begins, are left out. At this velocity "
                f"the classifier's probability is {at_least} (no interval). Above its last point the curve is "
                "extrapolated."
            )
        ignored = {name: task.question.fixed[name] for name in task.free if name in task.question.fixed}
        for name, value in ignored.items():
            sentences.append(f"{name} is a free variable, so its given value {value:g} was ignored.")
        kept = [name for name in self.uncertain if name in self.campaign.space.names]
        if self.hazard is not None:
            kept = [name for name in kept if name not in ("T_p", "A_p")]
        if kept:
            sentences.append(
                f"No value is given for {', '.join(kept)}. The distribution is that of the question, or else the "
                "campaign's."
            )
        sentences.append(
            f"{percent(self.outside.share)} of the question's distribution lies outside the campaign's design space, "
            "where the classifier extrapolates. Fresh simulations are drawn there too; nothing is clipped."
        )
        sentences.append(
            "Free variables stay within the campaign's ranges. A look is a round of verification. A result is wrong "
            f"with a probability of at most {100.0 * (1.0 - task.confidence):.3g} %, which the looks share: "
            + " and ".join(f"{100.0 * (1.0 - task.of_bound(look)):.3g} %" for look in range(len(LOOKS)))
            + "."
        )
        kind = "small" if task.cost_text == task.free[0] else "cheap"
        candidate = self.designed.result.candidate
        if not candidate.is_feasible:
            sentences.append(
                "No design within the ranges brings the classifier's probability down to the search's goal. This "
                "design comes nearest to it."
            )
        elif len(candidate.ranges) > 1 or (candidate.ranges and candidate.ranges[0][1] < task.high[task.free[0]]):
            ranges = " and ".join(f"{low:.4g} to {high:.4g}" for low, high in candidate.ranges)
            sentences.append(
                f"The classifier's probability meets the search's goal for {task.free[0]} of {ranges}, and exceeds it "
                f"between and beyond. This design is the {kind}est of these: a larger one may miss the target."
            )
        else:
            sentences.append(
                f"Beyond this design, the classifier's probability stays below the search's goal. A {kind}er design "
                "may also meet the target, because the probability need not fall as the design grows."
            )
        if any(share > one.target for one, share in zip(task.requirements, self.at_upper, strict=False)):
            sentences.append(
                "At the upper property bounds the classifier's probability exceeds the target. The fresh "
                "simulations use the lower property bounds only."
            )
        if self.hazard is None and self.designed.question.is_of_campaign:
            sentences.append(
                "The pulses or loads have the distribution of the campaign. This is usually not the hazard of a site; "
                "use --hazard or --question."
            )
        if missable := self.designed.missable:
            sentences.append(
                "The bounds assume that there are no failures where the classifier is sure of survival. Without this "
                f"assumption, up to {percent(missable)} of the designs drawn could fail there without having been seen "
                f"({100.0 * self.designed.result.of_bound:.3g} % confidence)."
            )
        return [*sentences, *limits_of(self.campaign.simulator)]

    @property
    def verdict(self) -> str:
        """How the search ended, in one sentence."""
        designed = self.designed
        match designed.status:
            case "verified":
                return (
                    f"The design meets its target: the upper bound from fresh simulations lies below it. {self._ending}"
                )
            case "not verified" if designed.surprising:
                return (
                    f"Not verified: fresh simulations ({designed.surprising} of {designed.simulations}) contradict the "
                    "classifier where it was sure, so its boundary is wrong there. Continue the campaign, then search "
                    "again."
                )
            case "not verified":
                return (
                    f"Not verified: after {len(designed.looks)} looks, an upper bound still exceeds its target. More "
                    "simulations (--simulations) may lower it."
                )
            case _:
                return (
                    "Out of reach: according to the classifier, no design within the ranges meets the target. Fresh "
                    "simulations confirm this for the nearest design, shown here."
                )

    @property
    def _ending(self) -> str:
        """Why no smaller design was looked at, or what became of it, in one sentence."""
        designed, task = self.designed, self.designed.task
        cost = task.cost(designed.values)
        kind = "smaller" if task.cost_text == task.free[0] else "cheaper"
        for look in designed.looks:
            if task.cost(look.candidate.values) < cost:
                values = ", ".join(f"{name} = {value:.4g}" for name, value in look.candidate.values.items())
                return f"A {kind} one, {values}, was not verified."
        if len(designed.looks) < len(LOOKS):
            return f"Another look is not expected to verify one that is {kind} by {100.0 * WORTH:g} %."
        return f"No look is left for a {kind} one."

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        designed = self.designed
        task = designed.task
        requirements = [
            {
                "outcome": one.outcome,
                "target": one.target,
                **_estimate_json(estimate),
                "classifier_probability": model,
                "risk": None if task.rate is None else _risk_json(task.rate, one.target, estimate),
            }
            for one, estimate, model in zip(
                task.requirements, designed.result.estimates, designed.result.candidate.model.tolist(), strict=True
            )
        ]
        return {
            "status": designed.status,
            "bearing": self.bearing,
            "free": {name: [task.low[name], task.high[name]] for name in task.free},
            "cost": {"expression": task.cost_text, "value": task.cost(designed.values)},
            **{key: requirements[0][key] for key in ("outcome", "target", "probability", "low", "high")},
            "confidence": task.confidence,
            "simulations": designed.simulations,
            "requirements": requirements,
            "confidence_of_each_bound": designed.result.of_bound,
            "look": designed.number,
            "looks": [
                {
                    "values": dict(look.candidate.values),
                    "classifier_probability": look.candidate.model.tolist(),
                    "confidence_of_each_bound": look.of_bound,
                    "estimates": [_estimate_json(estimate) for estimate in look.estimates],
                }
                for look in designed.looks
            ],
            "contradictions_where_sure": designed.surprising,
            "could_fail_unseen": designed.missable,
            "at_limit_of_range": designed.at_limit,
            "first_free_variable_by_confidence": {
                f"{confidence:g}": None if math.isnan(value) else value for confidence, value in designed.costs.items()
            },
            "lateral_force_over_weight": self.lateral_force,
            "terms": None if (terms := self.terms) is None else terms.as_json(),
            "classifier_probability_at_upper_bounds": list(self.at_upper) or None,
            "classifier_probability_at_least_velocity": list(self.at_least) or None,
            "uncertain": self.uncertain,
            "question": designed.question.title,
            "outside_design_space": self.outside.share,
            "ranges_to_widen_to": [
                {"name": name, "low": low, "high": high} for name, (low, high) in self.outside.ranges.items()
            ],
            "assumptions": self.assumptions,
            "chart": None if self.chart is None else _chart_json(self.chart),
        }

    @property
    def exit_code(self) -> int:
        """`OUT_OF_REACH` if no design was shown to meet its targets."""
        return 0 if self.designed.status == "verified" else OUT_OF_REACH

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        return titled(self.rows)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts."""
        designed, units = self.designed, {p.name: p.unit for p in self.campaign.space.parameters}
        task, bound = designed.task, f"{100.0 * designed.result.of_bound:.3g} %"
        outcomes = self.campaign.simulator.outcomes
        lines = [("widen", self.outside.advice)] if self.outside.advice else []
        lines.append(
            ("design", ", ".join(_value(name, value, units.get(name, "")) for name, value in self.bearing.items()))
        )
        lines.append(("result", self.verdict))
        for one, estimate, model in zip(
            task.requirements, designed.result.estimates, designed.result.candidate.model, strict=True
        ):
            lines.append(
                (
                    "verified" if designed.status == "verified" else "estimate",
                    f"P({visible(or_worse(one.outcome, outcomes))}) = {percent(estimate.probability, 2)}, "
                    f"{bounds_percent(estimate.low, estimate.high)}, each bound with {bound} confidence; target "
                    f"{100.0 * one.target:.4g} %; classifier {percent(model, 2)}",
                )
            )
            if (rate := task.rate) is not None:
                low, middle, high = (rate.risk(P) for P in (estimate.low, estimate.probability, estimate.high))
                lines.append(
                    (
                        "risk",
                        f"{percent(middle, 2)} in {rate.years:g} years, {bounds_percent(low, high)}; "
                        f"target {percent(rate.risk(one.target), 2)}; {rate.annual:g} pulses of at least "
                        f"{rate.velocity:g} m/s a year",
                    )
                )
        wrong = sum(estimate.wrong for look in designed.looks for estimate in look.estimates)
        failed = sum(estimate.unanswered for look in designed.looks for estimate in look.estimates)
        lines.append(
            (
                "from",
                f"{designed.simulations} fresh simulations, contradictions: {wrong}"
                + (f", {failed} are numerical failures" if failed else "")
                + f"; {len(designed.looks)} of at most {len(LOOKS)} looks; "
                f"{100.0 * task.confidence:g} % confidence for the result",
            )
        )
        if task.cost_text != task.free[0]:
            lines.append(("cost", f"{visible(task.cost_text)} = {task.cost(designed.values):.4g}"))
        for name, side in designed.at_limit.items():
            lines.append(("limit", f"{name} is at the {side} end of its range"))
        if designed.costs:
            first = task.free[0]
            shown = ", ".join(
                f"{100.0 * confidence:g} % {'out of range' if math.isnan(value) else f'{value:.4g}'}"
                for confidence, value in designed.costs.items()
            )
            lines.append(
                ("confidence", f"{first} that one look would need at another confidence (approximate): {shown}")
            )
        if (terms := self.terms) is not None:
            lines += terms.lines(f", {self.friction}")
        elif (force := self.lateral_force) is not None:
            text = f"lateral force at D_tot over weight: {force:.3g}, {self.friction} (formula, no interval)"
            lines.append(("force", text))
        for one, share in zip(task.requirements, self.at_upper, strict=False):
            lines.append(
                (
                    "upper",
                    f"P({visible(or_worse(one.outcome, outcomes))}) at the upper property bounds: {percent(share, 2)} "
                    "(classifier, no interval)",
                )
            )
        return lines + [("note", sentence) for sentence in self.assumptions]


def _value(name: str, value: float, unit: str) -> str:
    return visible(f"{name} = {value:.4g}{' ' + unit if unit else ''}")


def _risk_json(rate: Rate, target: float, estimate: ProbabilityEstimate) -> dict[str, Any]:
    return {
        "years": rate.years,
        "target": rate.risk(target),
        "risk": rate.risk(estimate.probability),
        "low": rate.risk(estimate.low),
        "high": rate.risk(estimate.high),
        "annual_rate_of_pulses": rate.annual,
        "least_pgv_m_s": rate.velocity,
    }


def _estimate_json(estimate: ProbabilityEstimate) -> dict[str, Any]:
    return {
        "probability": estimate.probability,
        "low": estimate.low,
        "high": estimate.high,
        "simulations": estimate.simulations,
        "numerical_failures": estimate.unanswered,
        "contradictions": estimate.wrong,
        "contradictions_where_sure": estimate.surprising,
    }


def _chart_json(chart: RequiredChart) -> dict[str, Any]:
    return {
        "required": chart.name,
        "across": {"name": chart.across, "values": chart.x.tolist()},
        "lines": {"name": chart.lines, "values": chart.values.tolist()},
        "targets": chart.targets.tolist(),
        "outcome": chart.outcome,
        "values": [
            [[None if math.isnan(value) else value for value in line] for line in lines]
            for lines in chart.required.tolist()
        ],
        "interval": None,
        "reason": "the classifier's values, without simulation",
    }
