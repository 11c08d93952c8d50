"""How a campaign ends on request, and why its stop rule cannot be met, in words."""

from typing import NamedTuple

from activefail.campaign.settings import CampaignSettings
from activefail.estimates.confidence_bounds import upper_bound
from activefail.estimates.error import confidence_of_look, least_simulations
from activefail.loop.probability_rule import least_known
from activefail.space.shares import percent


class StopMessages(NamedTuple):
    """What becomes of running simulations when a campaign stops: on request, after an orderly and an immediate stop."""

    requested: str
    orderly: str
    immediate: str


_IN_BATCHES = StopMessages("stopping after this batch", "after a complete batch", "recorded batches are safe")
_ASYNCHRONOUS = StopMessages(
    "stopping: waiting for the simulations in flight",
    "with nothing in flight",
    "recorded simulations are safe, those in flight will be simulated again",
)


def stop_messages(settings: CampaignSettings) -> StopMessages:
    """The messages about a stop of a campaign."""
    return _ASYNCHRONOUS if settings.sampling.asynchronous else _IN_BATCHES


def stop_rule_warning(settings: CampaignSettings, learns_from_margins: bool) -> str:
    """Why the stop rule cannot be met, or not at its first look; empty if it can."""
    if settings.probability_rule is not None and not learns_from_margins:
        return (
            "stop.probability: a boundary that is learned from outcomes alone never meets this rule; the campaign "
            "ends at its budget. Let the simulator report a margin (docs/probability.md)"
        )
    rule = settings.error_rule
    if rule is None or (least := least_simulations(rule.error, rule.confidence)) <= rule.simulations:
        return ""
    bound = upper_bound(0, rule.simulations, confidence_of_look(rule.confidence, 1))
    return (
        f"stop.simulations: with {rule.simulations} simulations the first look cannot show an error below "
        f"{percent(bound)}, even if none is misclassified; an error of {100 * rule.error:g} % requires at least {least}"
    )


def too_small_for_rule(settings: CampaignSettings, probability: float) -> str:
    """Why a probability under the classifier is too small for the stop rule; empty if it is not.

    Designs beyond a probability of `REACH` are not searched, so nothing much smaller is ever known.
    """
    rule = settings.probability_rule
    if rule is None or not probability < (least := least_known(rule.cov)):
        return ""
    return (
        f"cannot be met: the probability of {rule.probability}, {probability:.2g} under the classifier, is below "
        f"{least:.2g}, the least that the rule can know with stop.cov = {rule.cov:g}. `activefail probability` bounds "
        "it"
    )
