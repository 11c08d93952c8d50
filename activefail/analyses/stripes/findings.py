"""What a question over finitely many values has found: a probability with two intervals, as text and JSON."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from activefail.analyses.findings.lines import titled
from activefail.analyses.stripes.intervals import Interval
from activefail.analyses.stripes.stripe import OF_BOUND, Stripe
from activefail.simulators.interface import limits_of
from activefail.space.shares import interval_percent, percent
from activefail.text.json_text import named
from activefail.visible import or_worse


@dataclass(frozen=True, eq=False)
class StripeFindings:
    """The probability of an outcome or a more severe one over finitely many values, with two intervals.

    Attributes:
        stripe: what is known of the values.
        confidence: of the intervals.
    """

    stripe: Stripe
    confidence: float

    exit_code = surprising = 0

    @property
    def probability(self) -> float:
        """Of the values."""
        return self.stripe.probability

    @cached_property
    def these(self) -> Interval:
        """The interval of these values."""
        return self.stripe.of_these(self.confidence)

    @cached_property
    def others(self) -> Interval | None:
        """The interval of other values of their kind."""
        return self.stripe.of_others(self.confidence)

    @property
    def low(self) -> float:
        """Lower end of the interval of these values."""
        return self.these.low

    @property
    def high(self) -> float:
        """Upper end of it."""
        return self.these.high

    @property
    def simulations(self) -> int:
        """Of this call."""
        return self.stripe.new

    @property
    def contradictions(self) -> int:
        """Random predictions that were wrong."""
        return self.stripe.checked.contradicted

    @property
    def basis(self) -> str:
        """What the probability rests on, beside other probabilities."""
        others = "" if self.others is None else f"; others {_ends(self.others)}"
        known, count = int(self.stripe.known.sum()), len(self.stripe.values)
        return f"{known} of {count} values simulated, {self.simulations} now{others}"

    @property
    def fixed(self) -> dict[str, Any]:
        """Values of the other variables, as people see them."""
        return self.stripe.campaign.space.written(self.stripe.question.fixed)

    @property
    def _names(self) -> str:
        return ", ".join(self.stripe.values.names)

    @property
    def _groups(self) -> int:
        group = self.stripe.values.group
        return 0 if group is None else len(set(group[self.stripe.values.weight > 0.0].tolist()))

    @property
    def why_no_others(self) -> str:
        """Why there is no interval of other values; empty if there is one."""
        if self.others is not None:
            return ""
        if self.stripe.values.group is None:
            return f"the values of {self._names} are no sample of others"
        return f"the values of {self._names} are of {self._groups} groups, and three are needed"

    @property
    def lines(self) -> list[str]:
        """The findings as lines of a terminal."""
        at = ", ".join(f"{name} = {value}" for name, value in self.fixed.items())
        event = or_worse(self.stripe.outcome, self.stripe.campaign.simulator.outcomes)
        head = f"probability of {event}{f' at {at}' if at else ''}: {self.probability:.3g}"
        return [head, *titled([*self.rows, *(("note", sentence) for sentence in self.assumptions)])]

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Titles and texts, without those of notes."""
        stripe, sure = self.stripe, f"with {100.0 * self.confidence:g} % confidence"
        count, simulated = len(stripe.values), int(stripe.known.sum())
        predicted, checked = int(stripe.predicted.sum()), stripe.checked
        lost = f"; {int(stripe.lost.sum())} gave no outcome and count both ways" if stripe.lost.any() else ""
        these = f"the {count} values of {self._names}"
        rows = [("these", f"{_ends(self.these)}, {sure}: {these}; what is left is that predictions may be wrong")]
        if self.others is not None:
            single = "" if self._groups < count else ", one for each value"
            kind = f"other values of the kind, if these are a sample; over {self._groups} groups{single}"
            rows.append(("others", f"{_ends(self.others)}, {sure}: {kind}"))
        else:
            rows.append(("others", f"no interval: {self.why_no_others}"))
        return [
            *rows,
            ("from", f"{simulated} simulated ({stripe.new} runs now) and {predicted} predicted{lost}"),
            (
                "wrong",
                f"{percent(stripe.expected_wrong, 2)} expected to be predicted wrongly, by the classifier's own doubt"
                f"{' and the share that its check contradicted' if checked.contradicted else ''}; asked for: "
                f"{percent(stripe.wrong, 2)}",
            ),
            (
                "check",
                f"{checked.simulated} random predictions were simulated too, {checked.contradicted} wrong; this alone "
                f"shows that at most {percent(stripe.most_wrong)} is predicted wrongly ({100 * OF_BOUND:g} %)",
            ),
            ("campaign", f"{stripe.learned} simulations, these among them"),
        ]

    @property
    def assumptions(self) -> list[str]:
        """What the numbers assume, and what contradicts them, as sentences."""
        stripe, campaign, sentences = self.stripe, self.stripe.campaign, []
        if stripe.expected_wrong > stripe.wrong:
            sentences.append(
                "More is expected wrong than was asked for: the doubtful values are in flight elsewhere. Record their "
                "results with `activefail tell`, or drop them; then ask again."
            )
        if stripe.checked.contradicted:
            sentences.append("The check contradicted the classifier.")
        if stripe.predicted.any():
            sentences.append(self._of_sure)
        if outside := int((~campaign.space.spans(stripe.values.X)).sum()):
            text = f"{outside} of the {len(stripe.values)} values are outside the design space, where the classifier "
            sentences.append(f"{text}extrapolates.")
        return [*sentences, *stripe.question.stated_of(of_values=True), *limits_of(campaign.simulator)]

    @property
    def _of_sure(self) -> str:
        """What the interval assumes of predictions of which the classifier is sure."""
        wrong, earlier = self.stripe.sure_wrong, self.stripe.earlier
        of_others = ""
        if earlier.simulated:
            of_others = f" and those of this campaign's other questions ({earlier.contradicted} of {earlier.simulated})"
        return (
            f"Where the classifier is sure, the interval takes a share of {percent(wrong.mean)} to be wrong, with "
            f"{100 * OF_BOUND:g} % confidence at most {percent(wrong.most(OF_BOUND))}. It follows from a prior with a "
            f"mean of 10 %, this check{of_others}."
        )

    @property
    def numbers(self) -> dict[str, Any]:
        """The numbers of the outcome, as JSON values."""
        stripe = self.stripe
        return {
            **named(self, "probability", "low", "high", "confidence"),
            "others": None if self.others is None else self.others._asdict(),
            "others_reason": self.why_no_others or None,
            "values": len(stripe.values),
            "groups": self._groups or None,
            "simulations": stripe.new,
            "simulated": int(stripe.known.sum()),
            "numerical_failures": int(stripe.lost.sum()),
            "predicted": int(stripe.predicted.sum()),
            **named(stripe, "wrong", "expected_wrong", "doubted"),
            "check": {
                "simulations": stripe.checked.simulated,
                "contradicted": stripe.checked.contradicted,
                "probability_wrong_high": stripe.most_wrong,
                "confidence": OF_BOUND,
            },
            "sure_wrong": {
                "mean": stripe.sure_wrong.mean,
                "high": stripe.sure_wrong.most(OF_BOUND),
                "confidence": OF_BOUND,
                "earlier_simulations": stripe.earlier.simulated,
                "earlier_contradicted": stripe.earlier.contradicted,
            },
            "campaign_simulations": stripe.learned,
            "fixed": self.fixed,
            "assumptions": self.assumptions,
        }

    def as_json(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return {"outcomes": {self.stripe.outcome: self.numbers}}


def _ends(interval: Interval) -> str:
    return interval_percent(interval.low, interval.high, 1)
