"""Reports what each boundary of a campaign is learned from, and why."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from activefail.estimates.scores import last_error, verified_in_words
from activefail.learning.model.threads import one_thread_of_blas
from activefail.space.shares import percent
from activefail.text.numerals import counted
from activefail.visible import margin_in_words, visible, words

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.campaign.settings import CampaignSettings
    from activefail.learning.model.classifier import Classifier
    from activefail.learning.model.saved import SavedClassifier
    from activefail.loop.history import History
    from activefail.session.session import Session


_NOT_NORMAL = 0.01
"""P-value below which a margin's noise is not taken to be normal."""


class LearnedFrom(NamedTuple):
    """What a boundary is learned from.

    Attributes:
        outcome: name of the boundary's outcome.
        margin: name of the margin, or text of the system; empty if the boundary is learned from the outcomes.
        margin_score, outcome_score: mean log probabilities of left-out designs' sides [nat]; NaN if not compared.
        is_clipped: whether the margin is clipped at a largest value.
        normality: of the margin's noise (see `surrogate.margin.MarginFit.normality`); NaN without noise.
        support: number of inducing points that predictions use; 0 if they use all simulations.
        unusable: the one margin that it would otherwise be learned from; empty if there are several, or none.
        reason: why that margin cannot be used.
    """

    outcome: str
    margin: str
    margin_score: float
    outcome_score: float
    is_clipped: bool = False
    normality: float = math.nan
    support: int = 0
    unusable: str = ""
    reason: str = ""

    def sentence(self, settings: "CampaignSettings") -> str:
        """What the boundary is learned from, with the evidence if there is any; empty if there was no choice."""
        outcome, is_compared = visible(words(self.outcome)), not np.isnan([self.margin_score, self.outcome_score]).any()
        if self.margin or is_compared:
            text = f"{outcome} from {source_in_words(self.margin)}"
        elif self.unusable:
            text = f"{outcome} from the outcomes; {source_in_words(self.unusable)} is not used: {self.reason}"
        else:
            return ""
        if is_compared:
            text += (
                f" (mean log probability of the true side of a left-out design: {self.margin_score:.3f} from the "
                f"margin, {self.outcome_score:.3f} from outcomes)"
            )
        if self.support:
            text += f"; predictions use {self.support:,} inducing points"
        if self.is_clipped:
            text += (
                "; this margin is clipped at its largest value and does not show a failure behind it, so "
                "stop.probability cannot end the campaign"
            )
        if self.normality < _NOT_NORMAL:
            text += f"; {noise_in_words(self.normality)}"
        rule = settings.probability_rule
        if rule is not None and self.outcome == rule.probability and not self.margin:
            text += "; stop.probability cannot end the campaign"
        return text


def noise_in_words(p_value: float) -> str:
    """What a noise that is not normal means for the classifier's own probabilities."""
    return (
        f"its noise is not normal, as the classifier takes it to be (Shapiro and Wilk's test, p = {p_value:.1g}), so "
        "probabilities by the classifier alone may be several times off; those from fresh simulations are not"
    )


def noise_notes(classifier: "Classifier | SavedClassifier", outcome: str = "") -> list[str]:
    """A sentence on a margin whose noise is not normal, for the number that the classifier gives; none otherwise.

    Args:
        classifier: the classifier.
        outcome: whose boundary gives the number; any if empty.
    """
    latents = zip(classifier.outcomes[1:], classifier.latents, strict=True)
    of = [getattr(latent, "normality", math.nan) for name, latent in latents if outcome in ("", name)]
    return [f"Of the margin, {noise_in_words(p_value)}." for p_value in of if p_value < _NOT_NORMAL][:1]


def source_in_words(name: str) -> str:
    """What a boundary is learned from: a margin, a system by its text, or the outcomes if the name is empty."""
    if not name:
        return "the outcomes"
    return margin_in_words(name) if name.isidentifier() else f"the system {visible(name)}"


def known_in_words(run: "Session", after: int | None = None) -> str:
    """How many results the classifier that predicts has learned from, and what is known of its error.

    Args:
        run: the run folder.
        after: number of simulations to learn from, the first ones (see `Session.classifier_after`); all if None.
    """
    from activefail.estimates.error import expected_error
    from activefail.session.session import predicting

    campaign, history = run.campaign, run.history[:after]
    counts = history.counts(len(campaign.simulator.outcomes)).tolist()
    seen = ", ".join(f"{n} {name}" for n, name in zip(counts, campaign.simulator.outcomes, strict=True))
    text = f"learned from {counted(sum(counts), 'result')} ({visible(seen)})"
    settings = campaign.settings
    if not settings.is_repeatable:
        return ". ".join([text, *noise_notes(predicting(run, after))]).removesuffix(".")
    error = last_error(run.store, campaign.learner_code) if len(history) == len(run.history) else None
    if error is not None:
        return f"{text}; verified error {verified_in_words(error)}"
    if settings.probability_rule is not None or not all(counts):
        return text  # The classifier's own error is tiny where an outcome is rare, and misses what was never seen.
    with one_thread_of_blas():
        expected = percent(expected_error(campaign, predicting(run, after)), 2)
    return f"{text}; expected error {expected} of the design space by its own probabilities, without an interval"


def candidate_of(learnable: Sequence[str], learns: str) -> str:
    """The one margin, or the system, that a boundary would be learned from; empty if there are several, or none.

    Args:
        learnable: names of the simulator's margins, or the text of their system.
        learns: `classifier.learns`.
    """
    if len(learnable) == 1:
        return "" if learns == "outcomes" else learnable[0]
    return learns if learns in learnable else ""


def saved_choices(
    state: Mapping[str, Any], outcomes: Sequence[str], learnable: Sequence[str], learns: str
) -> list[LearnedFrom]:
    """What the boundaries are learned from, by a saved state; empty if it says nothing.

    Args:
        state: arrays by name.
        outcomes: names of the simulator's.
        learnable: names of its margins, or the text of their system.
        learns: `classifier.learns`.
    """
    reason = "it does not show on which side of the boundary a design lies"
    rows = []
    for outcome in outcomes[1:]:
        if f"{outcome}/choice" not in state:
            return []
        margin, _, from_margin, from_outcomes, _ = state[f"{outcome}/choice"].tolist()
        name = "" if margin < 0 else learnable[int(margin)]
        of_outcome = {key.rpartition("/")[2]: state[key] for key in state if key.startswith(f"{outcome}/")}
        clipped, support = "clipped" in of_outcome, len(of_outcome.get("inducing", ())) if name else 0
        unusable = candidate_of(learnable, learns)
        noise = float(of_outcome.get("normality", math.nan))
        rows.append(LearnedFrom(outcome, name, from_margin, from_outcomes, clipped, noise, support, unusable, reason))
    return rows


def choices_in_words(campaign: "Campaign", history: "History", classifier: "Classifier") -> list[str]:
    """A sentence for each boundary that is learned from a margin, or not although there is one.

    A boundary has no sentence if the simulator has several margins and none of them gives its side.
    """
    from activefail.learning.model.margin_choice import OUTCOMES, taken, usable
    from activefail.learning.model.system import ByMargins

    known, (_, *outcomes), names = history.training, campaign.simulator.outcomes, campaign.learnable
    candidate, sentences = candidate_of(names, campaign.settings.classifier.learns), []
    for severity, (outcome, choice) in enumerate(zip(outcomes, classifier.choices, strict=False), start=1):
        latent, reason = classifier.latent(outcome), ""
        if candidate:
            margins = campaign.margins_at(severity, known.outcome, known.margins)
            margin = taken(margins, names.index(candidate), campaign.system)
            reason = usable(margin, known.outcome >= severity, campaign.system)
        row = LearnedFrom(
            outcome,
            "" if choice.margin == OUTCOMES else names[choice.margin],
            choice.margin_score,
            choice.outcome_score,
            isinstance(latent, ByMargins) and latent.is_clipped,
            latent.normality if isinstance(latent, ByMargins) else math.nan,
            latent.size_of_support if isinstance(latent, ByMargins) else 0,
            candidate if reason else "",
            reason,
        )
        sentences.append(row.sentence(campaign.settings))
    return list(filter(None, sentences))
