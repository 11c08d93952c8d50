"""Symbols, units and meanings of quantities, for axes and tables."""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from activefail.space.shares import RAISED
from activefail.visible import visible


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


def quantity(name: str, unit: str = "", known: Mapping[str, Quantity] = MappingProxyType({})) -> Quantity:
    """A known quantity; another name is shown as it is, with its unit."""
    one, unit = known.get(name), _typeset(unit)
    if one is None:
        return Quantity(name, plain(visible(name)), visible(name), unit)
    return replace(one, unit=unit or one.unit)


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
