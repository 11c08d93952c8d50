"""What each boundary of a campaign is learned from, and why."""

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.findings.quantities import words
from activefail.loop.history import History
from activefail.surrogate.choice import OUTCOMES, usable
from activefail.surrogate.classifier import Classifier


def choices_in_words(campaign: Campaign, history: History, classifier: Classifier) -> list[str]:
    """A sentence for each boundary that is learned from a margin, or not although there is one.

    A simulator with several margins, of which none tells the side of a boundary, needs no sentence.
    """
    known, names = history.training, campaign.simulator.margins
    learns = campaign.settings.classifier.learns
    sentences = []
    for severity, choice in enumerate(classifier.choices, start=1):
        outcome = words(campaign.simulator.outcomes[severity])
        compared = (
            ""
            if np.isnan(choice.outcome_score) or np.isnan(choice.margin_score)
            else f" (log probability of a left-out side: {choice.margin_score:.3f} from the margin, "
            f"{choice.outcome_score:.3f} from outcomes)"
        )
        if choice.margin != OUTCOMES:
            sentences.append(f"{outcome} from the margin {names[choice.margin]}{compared}")
            continue
        if learns == "auto" and compared:
            sentences.append(f"{outcome} from the outcomes{compared}")
            continue
        tried = [learns] if learns != "auto" else names[:1] if len(names) == 1 else []
        reasons = [(name, usable(known.margins[:, names.index(name)], known.outcome >= severity)) for name in tried]
        because = "".join(f"; the margin {name} is not used: {reason}" for name, reason in reasons if reason)
        if because:
            sentences.append(f"{outcome} from the outcomes{because}")
    return sentences
