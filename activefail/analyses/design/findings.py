"""What a search for a design found, in numbers and words."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from activefail.analyses.design.by_stripes import candidates_of
from activefail.analyses.design.design_task import LOOKS
from activefail.analyses.design.required_chart import RequiredChart, chart_of
from activefail.analyses.design.search import WORTH, Answer, Designed
from activefail.analyses.findings.learned_from import noise_notes
from activefail.analyses.findings.lines import titled
from activefail.analyses.stripes.findings import StripeFindings
from activefail.campaign.assembly import Campaign
from activefail.campaign.hazard import Hazard
from activefail.campaign.question import Outside, Question
from activefail.estimates.estimate import ProbabilityEstimate
from activefail.estimates.probability_estimator import Estimator
from activefail.plugins import brought
from activefail.simulators.interface import Terms, limits_of, terms_of
from activefail.space.shares import bounds_percent, percent, short, values_in_words
from activefail.text.json_text import json_values
from activefail.text.progress import Stage
from activefail.visible import or_worse, visible

_FAR = 0.75
"""Share of its target below which a verified probability leaves room for a smaller design."""

OUT_OF_REACH = 3
"""Exit code if no design was shown to meet its targets."""


@dataclass(frozen=True, eq=False)
class DesignFindings:
    """A design that meets its targets, or the nearest one.

    Attributes:
        designed: the result of the search.
        outside: what of the question lies outside the campaign's design space.
        at_upper: classifier's probability of each target's outcome at the upper property bounds, without interval;
            empty without such bounds.
        at_least: classifier's probability of each target's outcome at the least level of the hazard's curve,
            without interval; empty unless the targets are risks in a number of years.
        chart: values that targets require; None if it was not asked for.
        noise: sentences on a margin whose noise is not normal.
    """

    designed: Designed
    outside: Outside
    at_upper: tuple[float, ...] = ()
    at_least: tuple[float, ...] = ()
    chart: RequiredChart | None = None
    noise: tuple[str, ...] = ()

    @classmethod
    def of(cls, designed: Designed) -> Self:
        """The findings of a search alone."""
        return cls(designed, designed.question.outside(designed.task.asked.campaign.space))

    @classmethod
    def beside(cls, estimator: Estimator, designed: Designed, with_chart: bool, stage: Stage) -> Self:
        """The findings of a search by fresh simulations, with what the classifier says beside the design.

        Args:
            estimator: with which it was made.
            designed: its result.
            with_chart: whether the chart of required values is wanted.
            stage: called with each stage of the work.
        """
        task = designed.task
        chart = chart_of(estimator, task, designed.values, stage) if with_chart else None

        def probabilities(under: Question) -> tuple[float, ...]:
            return tuple(estimator.probability(one.outcome, under) for one in task.requirements)

        hazard = task.asked.hazard
        at_upper, at_least = tuple[float, ...](), tuple[float, ...]()
        if hazard is not None:
            at_design = task.asked.at(designed.values)
            if (upper := hazard.at_bound("upper")).factors:
                at_upper = probabilities(at_design.under(upper))
            if task.rate is not None:
                at_least = probabilities(at_design.under(hazard, task.rate.least))
        outside = designed.question.outside(task.asked.campaign.space)
        noise = tuple(noise_notes(estimator.classifier))
        return cls(designed, outside, at_upper, at_least, chart, noise)

    @property
    def campaign(self) -> Campaign:
        """The campaign."""
        return self.designed.task.asked.campaign

    @property
    def hazard(self) -> Hazard | None:
        """The hazard of the question; None for another question."""
        return self.designed.task.asked.hazard

    @property
    def bearing(self) -> dict[str, Any]:
        """The values of all variables that are certain, by name, in the campaign's order."""
        return self.campaign.space.written(self._certain)

    @property
    def _certain(self) -> dict[str, float]:
        fixed = self.designed.question.fixed
        return {name: fixed[name] for name in self.campaign.space.names if name in fixed}

    @property
    def uncertain(self) -> list[str]:
        """The uncertain variables."""
        return list(self.designed.question.space.names)

    @property
    def formulas(self) -> dict[str, tuple[float, str, str] | None]:
        """By name, what formulas of plug-ins give at the upper property bounds: a number, a title and a text."""
        return {name: formula(self._at_upper, self._upper) for name, formula in brought("formulas").items()}

    @property
    def terms(self) -> Terms | None:
        """The design in the designer's terms, at the upper property bounds; None if a value is uncertain."""
        return terms_of(self.campaign.simulator, self._at_upper)

    @property
    def _upper(self) -> Mapping[str, float]:
        return self.hazard.at_bound("upper").factors if self.hazard else {}

    @property
    def _at_upper(self) -> dict[str, float]:
        known = self.campaign.space.quantities(self.designed.question.fixed)
        return {name: value * self._upper.get(name, 1.0) for name, value in known.items()}

    @property
    def assumptions(self) -> list[str]:
        """What the result assumes, as sentences."""
        task, result = self.designed.task, self.designed.result
        sentences = []
        for name in task.free:
            if name in task.question.fixed:
                given = self.in_words({name: task.question.fixed[name]})
                sentences.append(f"{name} is a free variable, so the given {given} was ignored.")
        of_loads = () if self.hazard is None else self.hazard.variables
        kept = [name for name in self.uncertain if name in self.campaign.space.names and name not in of_loads]
        if kept and not self.designed.by_stripes:
            sentences.append(
                f"No value is given for {', '.join(kept)}. The distribution is that of the question, or else the "
                "campaign's."
            )
        if self.designed.by_stripes:
            stripes = [one for one in result.estimates if isinstance(one, StripeFindings)]
            sentences += dict.fromkeys(sentence for one in stripes for sentence in one.assumptions)
            if task.is_line:
                sentences.append(f"The probability is assumed to fall with {task.free[0]}.")
            return sentences
        sentences = [*self.designed.question.assumptions, *self.noise, *self._of_rate, *sentences, *self._of_looks]
        if self.hazard is None and self.designed.question.is_of_campaign:
            sentences.append(
                "The loads have the distribution of the campaign. This is usually not the hazard of a site; "
                "use --hazard or --question."
            )
        if missable := self.designed.missable:
            sentences.append(
                "The bounds assume that there are no failures where the classifier is sure of survival. Without this "
                f"assumption, up to {percent(missable)} of the designs drawn could fail there without having been seen "
                f"({100.0 * result.of_bound:.3g} % confidence)."
            )
        return [*sentences, *limits_of(self.campaign.simulator)]

    @property
    def _of_rate(self) -> list[str]:
        """What a target in years leaves out."""
        if (rate := self.designed.task.rate) is None or self.hazard is None:
            return []
        at_least = ", ".join(percent(share) for share in self.at_least)
        return [
            f"{self.hazard.loads.capitalize()} below {rate.least:g} {self.hazard.unit}, where the hazard's curve "
            f"begins, are left out. There the classifier's probability is {at_least} (no interval). Above its last "
            "point the curve is extrapolated."
        ]

    @property
    def _of_looks(self) -> list[str]:
        """What the looks share, and why the classifier found no better design."""
        task, candidate, sentences = self.designed.task, self.designed.result.candidate, list[str]()
        if self.outside.share and not self.outside.advice:
            sentences.append(
                f"{percent(self.outside.share)} of the question's distribution lies outside the campaign's design "
                "space, where the classifier extrapolates. Fresh simulations are drawn there too; nothing is clipped."
            )
        sentences.append(
            "Free variables stay within the campaign's ranges. A look is a round of verification. If nothing fails "
            "where the classifier is sure of survival, a result is wrong with a probability of at most "
            f"{100.0 * (1.0 - task.confidence):.3g} %, which the looks share: each one spends four fifths of what is "
            "left."
        )
        least = f"{task.smaller.removesuffix('er')}est"
        if not candidate.is_feasible:
            sentences.append(
                "No design within the ranges brings the classifier's probability down to the search's goal. This "
                "design comes nearest to it."
            )
        elif candidate.compared:
            allowed = " that the constraints allow" if task.constraints else ""
            sentences.append(
                f"All {candidate.compared} designs of the free variables' values{allowed} were compared by the "
                f"classifier. It "
                f"puts those that are {task.smaller} than this one above the search's goal, and this one below it."
            )
        elif len(candidate.ranges) > 1 or (candidate.ranges and candidate.ranges[0][1] < task.high[task.free[0]]):
            ranges = " and ".join(f"{short(low)} to {short(high)}" for low, high in candidate.ranges)
            sentences.append(
                f"The classifier's probability meets the search's goal for {task.free[0]} of {ranges}, and exceeds it "
                f"between and beyond. This design is the {least} of these: a larger one may miss the target."
            )
        else:
            sentences.append(
                f"Beyond this design, the classifier's probability stays below the search's goal. A {task.smaller} "
                "design may also meet the target, because the probability need not fall as the design grows."
            )
        if any(share > one.target for one, share in zip(task.requirements, self.at_upper, strict=False)):
            sentences.append(
                "At the upper property bounds the classifier's probability exceeds the target. The fresh "
                "simulations use the lower property bounds only."
            )
        return sentences

    @property
    def verdict(self) -> str:
        """How the search ended, in one sentence."""
        designed = self.designed
        if designed.by_stripes:
            return self._of_stripes
        match designed.status:
            case "verified":
                return (
                    f"The design meets its target with {100.0 * designed.task.confidence:g} % confidence: the upper "
                    f"bound from fresh simulations lies below it. {self._ending}"
                )
            case "not verified" if designed.result.surprising:
                return (
                    f"Not verified: fresh simulations ({designed.result.surprising} of {designed.simulations}) "
                    "contradict the classifier where it was sure, so its boundary is wrong there. Continue the "
                    "campaign, then search again."
                )
            case "not verified" if designed.is_above and not designed.result.candidate.is_feasible:
                return (
                    "Not verified: according to the classifier, no design within the ranges meets the target. Of the "
                    "safest one looked at, shown here, even a lower bound from fresh simulations exceeds it. The "
                    "classifier may be wrong elsewhere: continue the campaign, then search again."
                )
            case "not verified":
                return (
                    f"Not verified: after {len(designed.looks)} looks, an upper bound still exceeds its target. More "
                    "simulations (--simulations) may lower it."
                )
            case _:
                return (
                    "Out of reach: according to the classifier, no design within the ranges meets the target. Fresh "
                    "simulations confirm this of the nearest one and at all ends of the ranges: even a lower bound "
                    "exceeds it at the safest of them, shown here."
                )

    @property
    def _of_stripes(self) -> str:
        """The verdict of stripes."""
        designed, task, candidates = self.designed, self.designed.task, candidates_of(self.designed.task)
        looks = {candidates.index(dict(look.candidate.values)): look for look in designed.looks}
        place, is_met, name = list(looks)[designed.number - 1], designed.status == "met", task.free[0]
        if not task.is_line:
            before = place if is_met else len(candidates)
            looked = sum(one < before for one in looks)
            missed = f"{looked} miss it by their simulations, and {before - looked} by the classifier"
            if not is_met:
                of = f"None of {len(candidates)} designs meets the target under these values"
                return f"{of}: {missed}. This one is the safest."
            return (
                f"The cheapest of {len(candidates)} designs that meets the target under these values, or the first of "
                f"equally cheap ones. Of the {before} before it, {missed}."
            )
        if not is_met:
            return f"This largest {name} of the campaign's range does not meet the target under these values."
        if place == 0:
            return f"The least {name} of the campaign's range meets the target under these values."
        probabilities = ", ".join(f"{100.0 * one.probability:.3g} %" for one in looks[place - 1].estimates)
        below = f"{name} = {candidates[place - 1][name]:.4g} has {probabilities}"
        return f"The smallest {name} that meets the target under these values; {below}."

    @property
    def widening(self) -> str:
        """Which ranges the campaign lacks, and what that means for the design; empty if it lacks few pulses."""
        if not self.outside.advice or self.designed.by_stripes:
            return ""
        means = (
            "Fresh simulations are drawn there, so a verified design stands; a wider campaign may find a smaller one."
        )
        return f"{self.outside.advice} {means}"

    @property
    def _ending(self) -> str:
        """Why no smaller design was looked at, or what became of it, in one sentence."""
        designed, task = self.designed, self.designed.task
        cost = task.cost(designed.values)
        kind, is_far = task.smaller, bool(designed.result.ratios(task.targets).max() < _FAR)
        more = (
            f" The probability is far below the target: --simulations {2 * task.simulations} may verify a {kind} one."
        )
        # Between steps or choices, the next one that is cheaper may already miss the target.
        more *= is_far and task.free[0] not in task.stepped and designed.at_limit.get(task.free[0]) != "lower"
        for look in designed.looks:
            if task.cost(look.candidate.values) < cost:
                return f"A {kind} one, {self.in_words(look.candidate.values)}, was looked at and not verified.{more}"
        if len(designed.looks) < LOOKS and task.sizes(sum(look.size for look in designed.looks)):
            return f"Another look is not expected to verify one that is {kind} by {100.0 * WORTH:g} %.{more}"
        return f"No look is left for a {kind} one.{more}"

    def in_words(self, values: Mapping[str, float], with_units: bool = False) -> str:
        """Values of variables, as text."""
        return values_in_words(self.campaign.space, values, with_units)

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        designed, task, result, rate = self.designed, self.designed.task, self.designed.result, self.designed.task.rate
        parts = zip(task.requirements, result.estimates, result.candidate.model.tolist(), strict=True)
        requirements = [
            {
                "outcome": one.outcome,
                "target": one.target,
                **estimate.numbers,
                "classifier_probability": model,
                "risk": rate
                and {
                    "years": rate.years,
                    "target": rate.risk(one.target),
                    "risk": rate.risk(estimate.probability),
                    "low": rate.risk(estimate.low),
                    "high": rate.risk(estimate.high),
                    "annual_rate_of_pulses": rate.annual,
                    "least_pgv_m_s": rate.least,
                },
            }
            for one, estimate, model in parts
        ]
        looks = [
            {
                "values": self.campaign.space.written(look.candidate.values),
                "classifier_probability": look.candidate.model,
                "confidence_of_each_bound": look.of_bound,
                "estimates": [estimate.numbers for estimate in look.estimates],
            }
            for look in designed.looks
        ]
        return json_values(
            {
                "version": 2,
                "status": designed.status,
                "bearing": self.bearing,
                "free": task.ranges,
                "cost": {"expression": task.cost_text, "value": task.cost(designed.values)},
                **{key: requirements[0][key] for key in ("outcome", "target", "probability", "low", "high")},
                "confidence": task.confidence,
                "simulations": designed.simulations,
                "requirements": requirements,
                "confidence_of_each_bound": result.of_bound,
                "look": designed.number,
                "looks": looks,
                "contradictions_where_sure": result.surprising,
                "could_fail_unseen": None if designed.by_stripes else designed.missable,
                "at_limit_of_range": designed.at_limit,
                **{name: found and found[0] for name, found in self.formulas.items()},
                "terms": self.terms and self.terms.as_json(),
                "classifier_probability_at_upper_bounds": self.at_upper or None,
                "classifier_probability_at_least_velocity": self.at_least or None,
                "uncertain": self.uncertain,
                "question": designed.question.title,
                "outside_design_space": self.outside.share,
                "ranges_to_widen_to": [
                    {"name": name, "low": low, "high": high} for name, (low, high) in self.outside.ranges.items()
                ],
                "assumptions": self.assumptions,
                "chart": self.chart and self.chart.numbers,
            }
        )

    @property
    def exit_code(self) -> int:
        """`OUT_OF_REACH` if no design was shown to meet its targets."""
        return 0 if self.designed.status in ("verified", "met") else OUT_OF_REACH

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        return titled(self.rows)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts."""
        designed, task, result = self.designed, self.designed.task, self.designed.result
        first, outcomes = task.free[0], self.campaign.simulator.outcomes
        events = [f"P({visible(or_worse(one.outcome, outcomes))})" for one in task.requirements]
        rows = [("widen", self.widening)] if self.widening else []
        rows += [("design", self.in_words(self._certain, with_units=True)), ("result", self.verdict)]
        title = designed.status if designed.status in ("verified", "met") else "estimate"
        parts = zip(events, task.requirements, result.estimates, result.candidate.model, strict=True)
        for event, one, estimate, model in parts:
            text = (
                f"{event} = {percent(estimate.probability, 2)}, {self._sure(estimate)}; target "
                f"{100.0 * one.target:.4g} %; classifier {percent(model, 2)}"
            )
            rows.append((title, text))
            rows += estimate.rows if isinstance(estimate, StripeFindings) else []
            if (rate := task.rate) is not None and self.hazard is not None:
                low, middle, high = (rate.risk(P) for P in (estimate.low, estimate.probability, estimate.high))
                text = (
                    f"{percent(middle, 2)} in {rate.years:g} years, {bounds_percent(low, high)}; target "
                    f"{percent(rate.risk(one.target), 2)}; {rate.annual:g} {self.hazard.loads} of at least "
                    f"{rate.least:g} {self.hazard.unit} a year"
                )
                rows.append(("risk", text))
        rows.append(("from", self._from))
        if task.cost_text != first:
            rows.append(("cost", f"{visible(task.cost_text)} = {task.cost(designed.values):.4g}"))
        rows += [("limit", f"{name} is at the {side} end of its range") for name, side in designed.at_limit.items()]
        if self.terms is not None:
            rows += self.terms.lines(self._upper)
        else:
            rows += [found[1:] for found in self.formulas.values() if found is not None]
        for event, share in zip(events, self.at_upper, strict=False):
            rows.append(
                ("upper", f"{event} at the upper property bounds: {percent(share, 2)} (classifier, no interval)")
            )
        return rows + [("note", sentence) for sentence in self.assumptions]

    def _sure(self, estimate: Answer) -> str:
        """The interval of a probability, and what it is sure of."""
        bounds, result = bounds_percent(estimate.low, estimate.high), self.designed.result
        if self.designed.by_stripes:
            return f"{bounds} of these values"
        return (
            f"{bounds}, each bound with {100.0 * result.of_bound:.3g} % confidence, so that all looks together have "
            f"{100.0 * self.designed.task.confidence:g} %"
        )

    @property
    def _from(self) -> str:
        """The simulations of all looks."""
        designed, estimates = self.designed, [estimate for look in self.designed.looks for estimate in look.estimates]
        if designed.by_stripes:
            of_first = (look.estimates[0] for look in designed.looks)
            count = sum(len(one.stripe.values) for one in of_first if isinstance(one, StripeFindings))
            return (
                f"{designed.simulations} simulations now at {len(designed.looks)} designs; all values would take "
                f"{count}. The target is met by the values themselves, not by the upper end"
            )
        contradicted = sum(one.contradictions for one in estimates)
        failed = sum(one.unanswered for one in estimates if isinstance(one, ProbabilityEstimate))
        failures = f", {failed} are numerical failures" if failed else ""
        return (
            f"{designed.simulations} fresh simulations, contradictions: {contradicted}{failures}; "
            f"{len(designed.looks)} of at most {LOOKS} looks"
        )
