"""Symbols, units and meanings of a campaign's variables and features, for axes and tables."""

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

from activefail.campaign.assembly import Campaign
from activefail.seismic.simulator import DfpSimulator
from activefail.space.shares import RAISED
from activefail.visible import visible
from activefail.visible import words as words


@dataclass(frozen=True)
class Quantity:
    """A variable or feature as shown to a reader.

    Attributes:
        name: name in campaign files and tables.
        symbol: mathtext, for figures.
        text: plain text with `_` before a subscript, for pages.
        unit: empty for a dimensionless number.
        meaning: a few words; empty if unknown.
    """

    name: str
    symbol: str
    text: str
    unit: str = ""
    meaning: str = ""

    @property
    def axis(self) -> str:
        """Axis label: the symbol with its unit, or with a dash."""
        return f"{self.symbol} [{plain(self.unit)}]" if self.unit else f"{self.symbol} [–]"


def plain(text: str) -> str:
    """Escape a user's text so that matplotlib does not read it as mathtext."""
    return text.replace("$", r"\$")


def _typeset(unit: str) -> str:
    """A unit with superscripts: m/s^2 as m/s², N/m^1.5 as N/m¹·⁵."""
    return re.sub(r"\^(-?\d+(?:\.\d+)?)", lambda power: power[1].translate(RAISED), visible(unit))


_KNOWN = {
    known.name: known
    for known in (
        Quantity("T_b", "$T_b$", "T_b", "s", "period of the bearing"),
        Quantity("mu", r"$\mu$", "μ", "", "friction coefficient"),
        Quantity("D_tot", "$D_{tot}$", "D_tot", "m", "displacement capacity"),
        Quantity("h_sl_ratio", "$h_{sl}/D_{sl}$", "h_sl/D_sl", "", "slider height over slider diameter"),
        Quantity("h_rim_ratio", "$h_{rim}/D_{sl}$", "h_rim/D_sl", "", "rim height over slider diameter"),
        Quantity("p", "$p$", "p", "MPa", "pressure on the slider"),
        Quantity("k", "$k$", "k", "N/m¹·⁵", "stiffness of the contacts"),
        Quantity("T_p", "$T_p$", "T_p", "s", "period of the pulse"),
        Quantity("A_p", "$A_p$", "A_p", "g", "amplitude of the pulse"),
        Quantity("D_ratio", "$D_{ratio}$", "D_ratio", "", "displacement of the pulse over the capacity"),
        Quantity("T_b/T_p", "$T_b/T_p$", "T_b/T_p", "", "period of the bearing over that of the pulse"),
        Quantity("mu/A_p", r"$\mu/A_p$", "μ/A_p", "", "friction over the amplitude of the pulse"),
        Quantity("h_sl/D_sl", "$h_{sl}/D_{sl}$", "h_sl/D_sl", "", "slider height over slider diameter"),
        Quantity("h_rim/D_sl", "$h_{rim}/D_{sl}$", "h_rim/D_sl", "", "rim height over slider diameter"),
        Quantity("k_norm", "$k_{norm}$", "k_norm", "", "contact stiffness over pressure and pulse displacement"),
        Quantity("v*", "$v*$", "v*", "", "sliding block: speed at the rim over the speed needed to cross it"),
        Quantity("a*", "$a*$", "a*", "", "sliding block: outward ground acceleration at the stop, over g"),
        Quantity("m*", "$m*$", "m*", "", "reduced collision: severity, 0 at failure"),
    )
}


def quantity(name: str, unit: str | None = None) -> Quantity:
    """The quantity of a bearing's variable or feature; another name is shown as it is, with its unit."""
    known, unit = _KNOWN.get(name), _typeset(unit or "")
    if known is None:
        return Quantity(name, plain(visible(name)), visible(name), unit)
    if unit not in ("", known.unit):
        return Quantity(name, known.symbol, known.text, unit, known.meaning)
    return known


_GREEK = {
    name: unicodedata.lookup(f"GREEK SMALL LETTER {name.upper()}")
    for names in ("alpha beta gamma delta epsilon zeta eta theta kappa", "mu nu xi rho sigma tau phi psi omega")
    for name in names.split()
}
_SYMBOL = re.compile(rf"(?P<stem>[A-Za-z]|{'|'.join(_GREEK)})(_(?P<below>[A-Za-z0-9]+))?")


def custom_quantity(name: str, unit: str = "") -> Quantity:
    """A custom variable or feature, of which only the name is known: `p` need not be the bearing's pressure.

    A Latin or Greek letter, with or without a subscript, becomes a symbol.
    """
    match, unit = _SYMBOL.fullmatch(name), _typeset(unit)
    if match is None:
        # `storey_height` has no subscript.
        return Quantity(name, plain(visible(name)), visible(name).replace("_", " "), unit)
    stem, below = match["stem"], match["below"]
    symbol = f"\\{stem}" if stem in _GREEK else stem
    text = _GREEK.get(stem, stem)
    if below is not None:
        symbol, text = f"{symbol}_{{{below}}}", f"{text}_{below}"
    return Quantity(name, f"${symbol}$", text, unit)


def _of_simulator(campaign: Campaign, names: Iterable[str]) -> list[Quantity]:
    """Variables or fixed quantities of a simulator; only those of the bearing have a known meaning."""
    describe = quantity if isinstance(campaign.simulator, DfpSimulator) else custom_quantity
    units = {one.name: one.unit for one in campaign.space.parameters}
    return [describe(name, units.get(name, campaign.settings.space[name].unit or "")) for name in names]


def variables(campaign: Campaign) -> list[Quantity]:
    """The variables of a campaign, in order."""
    return _of_simulator(campaign, campaign.space.names)


def by_name(campaign: Campaign) -> dict[str, Quantity]:
    """The variables of a campaign by their names."""
    return {variable.name: variable for variable in variables(campaign)}


def fixed(campaign: Campaign) -> list[Quantity]:
    """The quantities that are the same for every design of a campaign."""
    return _of_simulator(campaign, campaign.space.fixed)


def features(campaign: Campaign) -> list[Quantity]:
    """The features of a campaign's classifier, in order; custom features have only a name."""
    known = by_name(campaign)
    describe = quantity if isinstance(campaign.settings.classifier.features, str) else custom_quantity
    return [known.get(name) or describe(name) for name in campaign.features.names]
