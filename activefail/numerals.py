"""Numbers in texts, as people and programs write them."""

import re

_WITHOUT_E = re.compile(r"([+-]?(?:\d+\.\d*|\.\d+))([+-]\d{3})")
"""A number as Fortran writes it if its exponent has three digits."""


def number_in(text: str) -> float:
    """The number that a text is, also as Fortran writes it, NaN and infinity included.

    Raises:
        ValueError: if it is none, such as 1_000, which only Python reads as a number.

    >>> [number_in(text) for text in ("0.5", "1.0D-3", "0.123-105")]
    [0.5, 0.001, 1.23e-106]
    """
    plain = text.strip().lower()
    if match := _WITHOUT_E.fullmatch(plain):
        plain = f"{match[1]}e{match[2]}"
    return float(plain.replace("d", "e").replace("_", "?"))
