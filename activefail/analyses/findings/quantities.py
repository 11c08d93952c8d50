"""Symbols, units and meanings of a campaign's variables and features."""

from collections.abc import Iterable

from activefail.campaign.assembly import Campaign
from activefail.text.quantities import Quantity, custom_quantity, quantity


def of_simulator(campaign: Campaign, name: str, unit: str) -> Quantity:
    """A variable or fixed quantity of a simulator; only those that it brings have a known meaning."""
    known = getattr(campaign.simulator, "quantities", None)
    return custom_quantity(name, unit) if known is None else quantity(name, unit, known)


def _of_space(campaign: Campaign, names: Iterable[str]) -> list[Quantity]:
    units = {one.name: one.unit for one in campaign.space.parameters}
    return [of_simulator(campaign, name, units.get(name, campaign.settings.space[name].unit or "")) for name in names]


def variables(campaign: Campaign) -> list[Quantity]:
    """The variables of a campaign, in order."""
    return _of_space(campaign, campaign.space.names)


def by_name(campaign: Campaign) -> dict[str, Quantity]:
    """The variables of a campaign by their names."""
    return {variable.name: variable for variable in variables(campaign)}


def fixed(campaign: Campaign) -> list[Quantity]:
    """The quantities that are the same for every design of a campaign."""
    return _of_space(campaign, campaign.space.fixed)


def features(campaign: Campaign) -> list[Quantity]:
    """The features of a campaign's classifier, in order; custom features have only a name."""
    known = {**getattr(campaign.simulator, "quantities", {}), **campaign.features.quantities, **by_name(campaign)}
    describe = quantity if isinstance(campaign.settings.classifier.features, str) else custom_quantity
    return [known.get(name) or describe(name) for name in campaign.features.names]
