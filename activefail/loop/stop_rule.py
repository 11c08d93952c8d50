"""Whether a campaign's stop rule is met, and how: for the loop, `ask`, `status` and the report."""

from typing import TYPE_CHECKING

from activefail.campaign.sections import ErrorStop, ProbabilityStop
from activefail.loop.history import History
from activefail.record.store import Store

if TYPE_CHECKING:
    from activefail.campaign.assembly import Campaign
    from activefail.loop.probability_rule import Looks


def how_met(campaign: "Campaign", history: History, looks: "Looks", error_is_small: bool = False) -> str:
    """How the stop rule is met, in words; empty if it is not, or without a rule.

    Args:
        campaign: the campaign.
        history: its simulations.
        looks: what is known of the rule's probability.
        error_is_small: whether fresh simulations have shown the error that the rule allows.
    """
    after = f"met after {history.asked_for} simulations: "
    match campaign.settings.stop:
        case ErrorStop(error=error, confidence=confidence) if error_is_small:
            return (
                f"{after}the error at the {campaign.settings.acquisition.main_boundary} boundary is at most "
                f"{100 * error:g} %, with {100 * confidence:g} % confidence over all looks"
            )
        case ProbabilityStop(probability=outcome) if looks.is_known:
            return (
                f"{after}the classifier is sure of the probability of {outcome} and a check far from all other designs "
                "did not contradict it"
            )
    return ""


def note_met(store: Store, how: str) -> None:
    """Keep how the stop rule is met by the record as it is; nothing if it is not."""
    if how and how != noted(store):
        store.remember(_noted_as(store), how)


def noted(store: Store) -> str:
    """How the stop rule is met by the record as it is; empty if it is not, or nothing was learned since it changed."""
    how = store.recall(_noted_as(store))
    return how if isinstance(how, str) else ""


def _noted_as(store: Store) -> tuple[str, ...]:
    return "stop rule", store.digest
