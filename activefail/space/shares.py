"""Shares as text; a share near 0 or 1 is never rounded to it."""

import math
from collections.abc import Mapping

from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace
from activefail.visible import visible


def percent(share: float, digits: int = 1) -> str:
    """A share in per cent, like "97.3 %", with more digits where it would otherwise round to 0 or 100 %.

    Args:
        share: 0 to 1; NaN gives "–".
        digits: fewest digits after the point.
    """
    if share != share:
        return "–"
    if share in (0.0, 1.0):
        return f"{100.0 * share:.0f} %"
    for places in range(digits, 7):
        text = f"{100.0 * share:.{places}f}"
        if float(text) not in (0.0, 100.0):
            return f"{text} %"
    return "< 0.000001 %" if share < 0.5 else "> 99.999999 %"


RAISED = str.maketrans("-.0123456789", "⁻·⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Digits of a power."""


def alike(value: float, *others: float) -> list[str]:
    """Probabilities with as many digits after the point as three digits of the first, or of the largest if it is 0.

    Below 0.001 all have its power of ten if they differ from it by at most a factor of ten, ["1.22·10⁻⁴", "1.19·10⁻⁴",
    "1.24·10⁻⁴"], or else each has three digits and its own. Above, one that is a hundred times smaller has its own. A
    larger probability is never shown as a smaller number, nor one below 1 as 1.
    """
    every = (value, *others)
    of = value or max(others, default=0.0)
    rest = min(of, 1.0 - of)
    exponent = math.floor(math.log10(rest)) if rest > 0.0 else -2
    if rest == of and exponent < -3:
        if any(p and not 0.1 < p / of < 10.0 for p in every):
            return [significant(p) for p in every]
        raised = f"·10{str(exponent).translate(RAISED)}"
        return [f"{p * 10.0**-exponent:.2f}{raised}" if p else "0" for p in every]
    places = min(2 - exponent, 8)

    def text(p: float) -> str:
        if not p or p < min(1e-3, 1e-2 * of):
            return significant(p)
        shown = f"{p:.{places}f}"
        return shown if p == 1.0 or float(shown) < 1.0 else f"> 0.{'9' * places}"

    return [text(p) for p in every]


def significant(value: float, digits: int = 3) -> str:
    """Format a number for a table: a few significant digits, a power of ten only if very large or small."""
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = max(0, digits - 1 - int(f"{abs(value):e}".split("e")[1]))
        return f"{value:.{places}f}".replace("-", "−")
    return power(value, digits)


def power(value: float, digits: int) -> str:
    """A number to significant digits, as a multiple of a power of ten."""
    return _raised(f"{value:.{digits - 1}e}")


def short(value: float) -> str:
    """A number like "0.694" or "2·10⁹": in full up to six digits, else to four, or all before the point."""
    digits = 6 if float(f"{value:.6g}") == value else min(6, max(4, len(f"{abs(value):.0f}")))
    return _raised(f"{value:.{digits}g}")


def _raised(text: str) -> str:
    mantissa, _, exponent = text.replace("-", "−", 1 if text.startswith("-") else 0).partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(RAISED)}" if exponent else mantissa


def values_in_words(space: DesignSpace, values: Mapping[str, float], with_units: bool = True) -> str:
    """Values of variables, like "T_b = 4 s, k = 2·10⁹ N/m^1.5"."""
    units = {one.name: f" {one.unit}" for one in space.parameters if one.unit and with_units}
    texts = ((name, short(one) if isinstance(one, float) else one) for name, one in space.written(values).items())
    return visible(", ".join(f"{name} = {text}{units.get(name, '')}" for name, text in texts))


def lognormal_interval(mean: float, sd: float, unreached: float = 0.0) -> tuple[float, float]:
    """Central 95 % interval of a probability with a mean and a standard deviation, as if lognormal; at most 1.

    Args:
        mean, sd: of the probability.
        unreached: probability that was not searched; the upper end includes it.
    """
    if not mean > 0.0:
        return 0.0, 1.0
    spread = 1.96 * math.sqrt(math.log1p((sd / mean) ** 2))
    return mean * math.exp(-spread), min(1.0, mean * math.exp(spread) + unreached)


def bounds_percent(low: float, high: float) -> str:
    """An interval with a bound to rely on, like "8.75 to 9.76 %": its upper end is rounded up, never down."""
    for places in range(4, 9):
        raised = math.ceil(10.0**places * high) / 10.0**places
        if raised < 2.0 * high:
            break
    return interval_percent(low, min(1.0, raised), max(2, places - 2))


def interval_percent(low: float, high: float, digits: int = 2) -> str:
    """An interval of a share, like "0.3 to 3.3 %"."""
    return f"{percent(low, digits).removesuffix(' %')} to {percent(high, digits)}"


def choices_with_shares(parameter: Parameter) -> str:
    """The choices of a variable with their probabilities; of records, their number."""
    if parameter.groups is not None:
        return records_in_words(parameter)
    shares = zip(parameter.choices, parameter.probabilities, strict=True)
    return ", ".join(f"{choice} ({percent(share)})" for choice, share in shares)


def records_in_words(parameter: Parameter) -> str:
    """How many records, and of how many events, a variable has with positive probability."""
    assert parameter.groups is not None
    possible = [group for group, share in zip(parameter.groups, parameter.probabilities, strict=True) if share > 0.0]
    return f"{len(possible)} records of {len(set(possible))} events"


def feasible_share(space: DesignSpace) -> str:
    """The share of designs that meet the constraints, with two standard errors."""
    return f"{percent(space.feasible_share)} (± {percent(2.0 * space.feasible_error)})"
