"""Reports what each boundary of a campaign is learned from, and why."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from activefail.visible import visible, words

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.loop.history import History
    from activefail.surrogate.classifier import Classifier


def sentence(
    outcome: str,
    margin: str,
    margin_score: float,
    outcome_score: float,
    is_clipped: bool = False,
    support: int = 0,
) -> str:
    """What a boundary is learned from, with the evidence if there is any; empty if there was no choice.

    Args:
        outcome: name of the boundary's outcome.
        margin: name of the margin; empty if the boundary is learned from the outcomes.
        margin_score, outcome_score: mean log probabilities of left-out designs' sides [nat]; NaN if not compared.
        is_clipped: whether the margin is clipped at a largest value.
        support: number of simulations that predictions rest on; 0 if they rest on all.
    """
    compared = not (math.isnan(margin_score) or math.isnan(outcome_score))
    if not margin and not compared:
        return ""
    evidence = (
        f" (mean log probability of the true side of a left-out design: {margin_score:.3f} from the margin, "
        f"{outcome_score:.3f} from outcomes)"
    )
    source = f"the margin {visible(margin)}" if margin else "the outcomes"
    clipped = (
        "; this margin is clipped at its largest value and does not show a failure behind it, so stop.probability "
        "cannot end the campaign"
    )
    text = f"{visible(words(outcome))} from {source}{evidence if compared else ''}"
    if support:
        text += f"; predictions rest on {support:,} simulations, half of them those with the smallest margins"
    return text + clipped if is_clipped else text


def sentence_without(outcome: str, margin: str, reason: str) -> str:
    """That a boundary is learned from the outcomes because a margin cannot be used.

    Args:
        outcome: name of the boundary's outcome.
        margin: name of the margin.
        reason: why it cannot be used.
    """
    return f"{visible(words(outcome))} from the outcomes; the margin {visible(margin)} is not used: {reason}"


def of_rule(outcome: str, margin: str, stop: str) -> str:
    """That the stop rule cannot end a campaign, for the end of its boundary's sentence; empty if it can.

    Args:
        outcome: name of the boundary's outcome.
        margin: name of the margin; empty if the boundary is learned from the outcomes.
        stop: outcome of `stop.probability`; empty without this rule.
    """
    return "; stop.probability cannot end the campaign" if outcome == stop and not margin else ""


def candidate_of(margins: Sequence[str], learns: str) -> str:
    """The one margin that a boundary would be learned from; empty if there are several, or none.

    Args:
        margins: names of the simulator's margins.
        learns: `classifier.learns`.
    """
    if learns == "auto":
        return margins[0] if len(margins) == 1 else ""
    return learns if learns in margins else ""


def choices_in_words(campaign: "Campaign", history: "History", classifier: "Classifier") -> list[str]:
    """A sentence for each boundary that is learned from a margin, or not although there is one.

    A boundary has no sentence if the simulator has several margins and none of them gives its side.
    """
    from activefail.surrogate.margin import MarginLatent
    from activefail.surrogate.margin_choice import OUTCOMES, usable

    known, names = history.training, campaign.simulator.margins
    learns = campaign.settings.classifier.learns
    sentences = []
    for severity, (choice, latent) in enumerate(zip(classifier.choices, classifier.latents, strict=False), start=1):
        outcome = campaign.simulator.outcomes[severity]
        margin = "" if choice.margin == OUTCOMES else names[choice.margin]
        trained = latent.trained if isinstance(latent, MarginLatent) else None
        clipped, support = (trained.is_clipped, trained.size_of_support) if trained else (False, 0)
        text = sentence(outcome, margin, choice.margin_score, choice.outcome_score, clipped, support)
        candidate = candidate_of(names, learns)
        if not text and candidate:
            margins = campaign.margins_at(severity, known.outcome, known.margins)
            reason = usable(margins[:, names.index(candidate)], known.outcome >= severity)
            if reason:
                text = sentence_without(outcome, candidate, reason)
        if text:
            rule = campaign.settings.probability_rule
            sentences.append(text + of_rule(outcome, margin, rule.probability if rule else ""))
    return sentences
