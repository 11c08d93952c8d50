"""Numbers in texts, as people and programs write them."""

import re
from collections.abc import Iterable, Sequence

_WITHOUT_E = re.compile(r"\s*([+-]?(?:\d+\.\d*|\.\d+))([+-]\d{3})\s*")
"""A number as Fortran writes it if its exponent has three digits; in a text of people it may be a range, 0.5-100."""


def number_in(text: str) -> float:
    """The number that a text is, also with a D before its exponent, NaN and infinity included.

    Raises:
        ValueError: if it is none, such as 1_000, which only Python reads as a number.

    >>> [number_in(text) for text in ("0.5", "1.0D-3")]
    [0.5, 0.001]
    """
    return float(text.lower().replace("d", "e").replace("_", "?"))


def number_of_program(text: str) -> float:
    """The number that a program wrote, as `number_in`, also as Fortran writes it without a letter.

    Raises:
        ValueError: if it is none.

    >>> [number_of_program(text) for text in ("1.0D-3", "0.123-105")]
    [0.001, 1.23e-106]
    """
    match = _WITHOUT_E.fullmatch(text)
    return number_in(f"{match[1]}e{match[2]}" if match else text)


def counted(number: int, thing: str) -> str:
    """A number of things in words."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def outcomes_in_words(counts: Sequence[int], outcomes: Iterable[str]) -> list[str]:
    """Numbers of simulations by outcome in words, those without one last; counts have one more than outcomes."""
    *seen, lost = counts
    return [*(f"{n} {name}" for n, name in zip(seen, outcomes, strict=True)), counted(lost, "numerical failure")]


def duration(seconds: float) -> str:
    """About how long something takes, in words.

    >>> [duration(seconds) for seconds in (0.2, 40.0, 420.0, 10000.0)]
    ['less than 1 s', 'about 40 s', 'about 7 min', 'about 3 h']
    """
    if seconds < 1.0:
        return "less than 1 s"
    if seconds < 100.0:
        return f"about {seconds:.0f} s"
    return f"about {seconds / 60.0:.0f} min" if seconds < 6000.0 else f"about {seconds / 3600.0:.0f} h"
