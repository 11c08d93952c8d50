"""Makes foreign text safe to show, with escapes for characters that are not printable.

A description, a file's name or a simulator's message may contain escape sequences that control a terminal, or line
breaks that forge a message of the program.
"""

import os
import shlex
import unicodedata
from collections.abc import Sequence


def visible(text: str, keep: str = "") -> str:
    r"""The text with control characters, line breaks, direction marks and surrogates as backslash escapes.

    >>> visible("mu\nresults  good \x1b[2J")
    'mu\\nresults  good \\x1b[2J'

    Args:
        text: foreign text.
        keep: characters that are not escaped.
    """
    if text.isprintable():
        return text
    return "".join(
        # Spaces of any width are harmless and occur in units.
        char if char.isprintable() or char in keep or unicodedata.category(char) == "Zs" else _escape(char)
        for char in text
    )


def words(name: str) -> str:
    """An outcome's or cause's name as words."""
    return name.replace("_", " ")


def margin_in_words(name: str) -> str:
    """A margin by its name: "the margin slack", but not "the margin margin"."""
    return "the margin" if name == "margin" else f"the margin {visible(name)}"


def or_worse(outcome: str, outcomes: Sequence[str]) -> str:
    """An outcome and the more severe ones in words."""
    return words(outcome) if outcome == outcomes[-1] else f"{words(outcome)} or worse"


def _escape(character: str) -> str:
    code = ord(character)
    short = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}.get(character)
    return short or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}")


def quoted(word: str | os.PathLike[str]) -> str:
    r"""A word quoted for a shell, on one line and in visible characters: `$'run\xff'` if quotes do not suffice."""
    text = os.fspath(word)
    if visible(text) == text:
        return shlex.quote(text)
    parts = (
        chr(byte) if 0x20 <= byte < 0x7F and byte not in b"\\'" else f"\\x{byte:02x}" for byte in os.fsencode(text)
    )
    return f"$'{''.join(parts)}'"
