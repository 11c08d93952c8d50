"""Shares as text: none that is only near 0 or 1 is rounded to it."""


def percent(share: float, digits: int = 1) -> str:
    """A share as per cent, like "97.3 %"; with more digits where fewer would round it to 0 or 100 %.

    Args:
        share: 0 to 1; NaN gives "–".
        digits: after the point, at least.
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


def interval_percent(low: float, high: float, digits: int = 2) -> str:
    """An interval of a share, like "0.3 to 3.3 %"."""
    return f"{percent(low, digits).removesuffix(' %')} to {percent(high, digits)}"
