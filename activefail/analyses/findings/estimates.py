"""What a campaign knows of the classifier's error and of an outcome's probability, with what is assumed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from activefail.analyses.findings.learned_from import noise_notes, source_in_words
from activefail.analyses.findings.lines import titled
from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Outside, Question
from activefail.estimates.confidence_bounds import BOUND_CONFIDENCE, upper_bound
from activefail.estimates.error import ErrorEstimate
from activefail.estimates.estimate import ModeShare, ProbabilityEstimate
from activefail.estimates.integral import BoundariesOf, OfBoundary, integral_of
from activefail.estimates.surface import SurfaceScore
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.margin_choice import OUTCOMES
from activefail.learning.model.system import ByMargins
from activefail.loop.history import History
from activefail.simulators.interface import limits_of
from activefail.space.shares import alike, interval_percent, percent, significant
from activefail.space.space import REACH
from activefail.visible import or_worse, visible, words

_DEVIATING = 2.0
"""Deviation of margins above which a note reports it: the interval allows for this much in any case."""


def rounded_up(share: float) -> str:
    """A bound with two significant digits, never rounded down."""
    if not 0.0 < share < 1.0:
        return f"{share:g}"
    unit = 10.0 ** (math.floor(math.log10(share)) - 1)
    raised = math.ceil(share / unit - 1e-9) * unit
    return significant(raised, 2) if raised < 1.0 else "1"


class Bound(NamedTuple):
    """An upper bound on a probability, one-sided at 90 %, without a model.

    Attributes:
        high: the bound.
        simulations: that it rests on.
        source: what these are.
    """

    high: float
    simulations: int
    source: str

    @property
    def in_words(self) -> str:
        """The bound and what it rests on."""
        if not self.simulations:
            return (
                "none without a model: no simulation of the campaign is one of an initial design, a sample of the space"
            )
        of = "simulations of the initial design" if self.source == "initial design" else self.source
        high = rounded_up(self.high)
        return f"at most {high} with 90 % confidence, without a model: from the {self.simulations} {of} alone"


def bound_without_model(campaign: Campaign, history: History, outcome: str) -> Bound:
    """The bound on the probability of an outcome or a more severe one, from the initial design alone.

    Only the initial design is a sample of the design measure.
    """
    initial = history.without_leading_failures
    initial = initial[initial.initial]
    # A numerical failure may hide either outcome; the bound counts it as beyond.
    hits = int(((initial.outcome >= campaign.simulator.outcomes.index(outcome)) | ~initial.answered).sum())
    return Bound(upper_bound(hits, len(initial), BOUND_CONFIDENCE), len(initial), "initial design")


def bound_of_fresh(estimate: ProbabilityEstimate) -> Bound:
    """The bound from fresh simulations alone, among the designs that exist."""
    high = min(1.0, estimate.bound / max(estimate.exists, estimate.bound)) if estimate.bound else 0.0
    return Bound(high, estimate.simulations, "fresh simulations")


def modes_in_words(modes: Sequence[ModeShare]) -> list[tuple[str, str]]:
    """The name of each mode of a system, and its shares of the failures."""
    shares = [[f"{percent(one[0])} ({interval_percent(*one[1:])})" for one in of[1:]] for of in modes]
    texts = [f"has failed in {failed} of the failures, decides {decisive}" for failed, decisive in shares]
    return [(visible(mode.name), text) for mode, text in zip(modes, texts, strict=True)]


@dataclass(frozen=True)
class ProbabilityFindings:
    """The probability of an outcome or a more severe one.

    Attributes:
        outcome: its name.
        outcomes: of the simulator, the least severe first.
        estimate: from fresh simulations with the classifier frozen.
        learned_from: the margin, or the system, that the boundary was learned from; empty if from the outcomes alone.
        is_clipped: whether this margin is clipped at a largest value.
        learned: simulations of the campaign, without its fresh simulations.
        seen: how many of these ended beyond the boundary.
        bound: without a model.
        outside: bound on the probability of designs outside the variables' bounds, which no simulation tries.
        question: title of the distribution; empty for the campaign's design measure.
        outside_space: what of the distribution lies outside the campaign's design space; None for the design measure.
        model: the probability by the classifier alone.
        lost: the same if none, and if all, of the runs that are probably lost end beyond; None if none was lost.
        of_question: what the question and the simulator assume, as sentences.
        repeatable: whether equal designs have equal results.
    """

    outcome: str
    outcomes: tuple[str, ...]
    estimate: ProbabilityEstimate
    learned_from: str
    learned: int
    seen: int
    bound: Bound
    outside: float
    question: str
    outside_space: Outside | None
    model: OfBoundary
    of_question: tuple[str, ...] = ()
    is_clipped: bool = False
    lost: tuple[float, float] | None = None
    repeatable: bool = True

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        history: History,
        classifier: Classifier,
        outcome: str,
        estimate: ProbabilityEstimate,
        question: Question,
    ) -> Self:
        """The findings of a campaign with this estimate."""
        severity = campaign.simulator.outcomes.index(outcome)
        beyond = history.training.outcome >= severity
        choice = classifier.choices[severity - 1].margin if classifier.choices else OUTCOMES
        latent = classifier.latent(outcome)
        model = integral_of(question, BoundariesOf(classifier, campaign.features), campaign.space).of(severity - 1)
        lost = estimate.lost
        if lost is not None:
            lost = min(model.probability, lost[0]), max(model.probability, lost[1])
        return cls(
            outcome=outcome,
            outcomes=tuple(campaign.simulator.outcomes),
            estimate=estimate,
            learned_from="" if choice == OUTCOMES else campaign.learnable[choice],
            learned=len(history),
            seen=int(beyond.sum()),
            bound=bound_of_fresh(estimate) if question.digest else bound_without_model(campaign, history, outcome),
            outside=question.space.outside,
            question=question.title if question.digest else "",
            outside_space=question.outside(campaign.space) if question.digest else None,
            model=model,
            of_question=(*question.assumptions, *noise_notes(classifier, outcome), *limits_of(campaign.simulator)),
            lost=lost,
            repeatable=classifier.repeatable,
            is_clipped=isinstance(latent, ByMargins) and latent.is_clipped,
        )

    exit_code = 0

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        estimate, sure = self.estimate, f"with {100 * self.estimate.confidence:g} % confidence"
        name = or_worse(self.outcome, self.outcomes)
        learned = source_in_words(self.learned_from)
        failed = f"; {estimate.unanswered} failed numerically" if estimate.unanswered else ""
        probability, low, high, model = alike(estimate.probability, estimate.low, estimate.high, self.model.probability)
        interval = f"{low} to {high}"
        if self.is_extrapolated:
            interval = f"0 to {rounded_up(self.high)}, without a model; {interval} under the classifier"
        else:
            interval += f", {sure}"
        rows = [("interval", interval)]
        if 0.99 < estimate.probability < 1.0 and not self.is_extrapolated:
            rest, least, most = alike(1.0 - estimate.probability, 1.0 - estimate.high, 1.0 - estimate.low)
            rows.append(("otherwise", f"{rest}, {least} to {most}"))
        rows += [
            (
                "from",
                f"{self.learned} simulations of the campaign ({self.seen} ended in {name}) and "
                f"{estimate.simulations} fresh simulations ({estimate.beyond} ended in {name}{failed})",
            ),
            (
                "classifier",
                f"{model}, learned from {learned}, without an interval; contradictions: {estimate.contradictions} of "
                f"{estimate.simulations} fresh simulations ended on the other side than predicted",
            ),
        ]
        rows += [("mode", " ".join(mode)) for mode in modes_in_words(estimate.modes)]
        if check := estimate.check:
            designs = f"{check.simulations} more designs under the question, far from all others"
            rows.append(("check", f"{designs}; contradictions: {check.contradictions}"))
        rows += [
            (
                "recall",
                f"{percent(estimate.recall)} of the estimated probability lies where {name} is predicted; at least "
                f"{percent(estimate.recall_low)} {sure}",
            ),
            ("bound", self.bound.in_words),
            *(("note", sentence) for sentence in self.assumptions),
        ]
        under = f" under {self.question}" if self.question else ""
        return [f"probability of {name}{under}: {probability}", *titled(rows)]

    @property
    def extrapolated(self) -> float:
        """Share of the distribution outside the campaign's design space."""
        return 0.0 if self.outside_space is None else self.outside_space.share

    @property
    def is_extrapolated(self) -> bool:
        """Whether no simulation ended beyond the boundary, so that the estimate rests on the classifier alone."""
        # Under a question, failures of the campaign may be of another region.
        return not self.estimate.beyond and (not self.seen or bool(self.question))

    @property
    def high(self) -> float:
        """Upper end of the interval; without any simulation beyond the boundary, the bound without a model."""
        return max(self.estimate.high, self.bound.high) if self.is_extrapolated else self.estimate.high

    @property
    def assumptions(self) -> list[str]:
        """What the estimate assumes, and what contradicts it, as sentences."""
        estimate, name, check = self.estimate, words(self.outcome), self.estimate.check
        sentences = []
        if self.outside_space is not None and self.outside_space.advice:
            sentences.append(self.outside_space.advice)
        if self.is_extrapolated:
            kind = "fresh simulation" if self.question else "simulation"
            sentences.append(
                f"No {kind} ended in {name}: the estimate is the classifier's extrapolation. Only the bound "
                "without a model rests on simulations alone."
            )
        if estimate.surprising:
            sentences.append(
                f"Fresh simulations ({estimate.surprising} of {estimate.simulations}) contradict the classifier "
                "where it was sure. It has missed something: continue the campaign before you use this estimate."
            )
        deviation, where = estimate.deviation, "fresh simulations"
        if check is not None:
            if check.contradictions:
                sentences.append(
                    f"The mode check ({check.contradictions} of {check.simulations} designs) contradicts the "
                    f"classifier: far from all other simulations, {name} begins elsewhere than it predicts. Do not "
                    "rely on this estimate. Begin a campaign whose [space] is the question's."
                )
            if not check.is_whole:
                sentences.append(
                    f"{check.unanswered} of the {check.simulations} designs of the mode check gave no outcome, so "
                    f"{name} may be hidden there."
                )
            if check.deviation > deviation:
                deviation, where = check.deviation, "mode check"
        if deviation > _DEVIATING:
            sentences.append(
                f"The margins of the {where} lie {deviation:.2g} times as far from the classifier's as its standard "
                "deviations say (root mean square). This widens the interval. "
                + (
                    "To learn where the question's designs lie, begin a campaign whose [space] is the question's."
                    if self.question
                    else "Continue the campaign for a narrower interval."
                )
            )
        if estimate.modes:
            sentences.append(
                "A mode decides the failures that would not occur without it. Its shares have "
                f"{100 * estimate.confidence:g} % intervals each; runs without a result count as predicted, or as safe."
            )
        if not self.repeatable:
            sentences.append(
                "The simulator does not repeat: the probability includes its noise. Contradictions are results that "
                "the noise does not explain."
            )
        if self.lost is not None:
            sentences.append(
                f"Runs without a result are neither. By the classifier, the probability is {self.lost[0]:.3g} if none "
                f"of them would have ended in {name}, and {self.lost[1]:.3g} if all would. The interval includes both. "
                "simulator.lost of a new campaign says what they mean."
            )
        sentences.append(f"Method of the fresh simulations: {estimate.method}.")
        sentences.append(
            "The interval assumes a limit state that is smooth between simulations: no failure is hidden where neither "
            "the classifier nor the fresh simulations looked, in one region or scattered. In five or more dimensions, "
            "no method finds such a region reliably. Only the bound without a model needs no such assumption."
        )
        if self.is_clipped:
            sentences.append(
                f"The margin {visible(self.learned_from)} is clipped at its largest value. It shows no direction "
                "towards failure there, so the estimate and its interval may miss regions of failure."
            )
        if self.extrapolated > 0.0:
            sentences.append(
                f"{percent(self.extrapolated)} of the question's distribution lies outside the campaign's design "
                f"space, where the classifier extrapolates, and {percent(self.model.outside)} of its probability of "
                f"{name} comes from there. Fresh simulations are drawn there too."
            )
        sentences.append(
            f"The outermost designs, with a total probability of {significant(REACH, 1)}, are never simulated; the "
            "upper end of the interval counts them as failures."
        )
        if self.outside > REACH:
            sentences.append(
                f"Designs outside the variables' bounds, with a probability of up to {self.outside:.1g}, are excluded."
            )
        return [*sentences, *self.of_question]

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return {"outcomes": {self.outcome: self.numbers}}

    @property
    def numbers(self) -> dict[str, Any]:
        """The numbers of the outcome, as JSON values."""
        estimate, check = self.estimate, self.estimate.check
        modes = {mode.name: mode.numbers for mode in estimate.modes}
        return ({"modes": modes} if modes else {}) | {
            "probability": estimate.probability,
            "low": 0.0 if self.is_extrapolated else estimate.low,
            "high": self.high,
            "high_under_classifier": estimate.high,
            "confidence": estimate.confidence,
            "simulations": estimate.simulations,
            "numerical_failures": estimate.unanswered,
            "contradictions": estimate.contradictions,
            "contradictions_where_sure": estimate.surprising,
            "deviation_of_margins": estimate.deviation,
            "check": None
            if check is None
            else {
                "simulations": check.simulations,
                "numerical_failures": check.unanswered,
                "contradictions": check.contradictions,
                "deviation_of_margins": check.deviation,
            },
            "extrapolated": self.is_extrapolated,
            "failures_seen": self.seen + estimate.beyond,
            "question": self.question or None,
            "outside_design_space": self.extrapolated,
            "method": estimate.method,
            "learned_from": self.learned_from or "outcomes",
            "campaign_simulations": self.learned,
            "classifier_probability": self.model.probability,
            "classifier_standard_error": self.model.error,
            "classifier_from_outside": self.model.outside,
            "bound_without_model": {
                "high": self.bound.high,
                "confidence": BOUND_CONFIDENCE,
                "one_sided": True,
                "simulations": self.bound.simulations,
                "from": self.bound.source,
            },
            "recall": None if math.isnan(estimate.recall) else estimate.recall,
            "recall_low": estimate.recall_low,
            "outside_bounds": self.outside,
            "assumptions": self.assumptions,
        }


@dataclass(frozen=True)
class _Verified:
    """What fresh simulations say of a classifier.

    Attributes:
        estimate: what they estimate.
        boundary: outcome of the target boundary.
        learned: simulations of the campaign, without fresh ones.
        iteration: of the classifier.
    """

    estimate: Any
    boundary: str
    learned: int
    iteration: int

    exit_code = 0

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        of_campaign = {"campaign_simulations": self.learned, "iteration": self.iteration}
        return {"boundary": self.boundary, **self.estimate.as_json(), **of_campaign}


@dataclass(frozen=True)
class ErrorFindings(_Verified):
    """The share of the design space that the classifier gets wrong, with its interval."""

    estimate: ErrorEstimate

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        one, (text, basis) = self.estimate, self.estimate.in_words
        rows = [
            ("campaign", f"{self.learned} simulations, iteration {self.iteration}"),
            ("error", f"{text} of the design space on the wrong side of the boundary of {self.boundary}"),
            (
                "",
                f"{100 * one.confidence:g} % interval from {basis}, {one.misclassified} of them misclassified; each "
                "stands for a part of the space, and a part without any counts as expected",
            ),
            ("expected", f"{percent(one.expected, 2)} by the classifier's own probabilities, without an interval"),
        ]
        return titled(rows)


@dataclass(frozen=True)
class SurfaceFindings(_Verified):
    """How well the probabilities hold of a classifier whose simulator does not repeat."""

    estimate: SurfaceScore

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        row = ("campaign", f"{self.learned} simulations, iteration {self.iteration}")
        return titled([row, *self.estimate.rows(self.boundary)])
