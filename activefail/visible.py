"""Foreign text made safe to show: what a terminal or a reader would not see as a letter is written as an escape.

A description, a file's name or a simulator's message may hold escape sequences that rewrite a terminal, or line breaks
that forge a message of the program's own.
"""

import os
import shlex
import unicodedata


def visible(text: str, keep: str = "") -> str:
    r"""A text with every control character, line break, direction mark and surrogate as a backslash escape.

    >>> visible("mu\nresults  good \x1b[2J")
    'mu\\nresults  good \\x1b[2J'

    Args:
        text: from a file, a file's name or a simulator.
        keep: characters that stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(
        # Spaces of any width are harmless, and units have them.
        one if one.isprintable() or one in keep or unicodedata.category(one) == "Zs" else _escape(one)
        for one in text
    )


def _escape(character: str) -> str:
    code = ord(character)
    short = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}.get(character)
    return short or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}")


def quoted(word: str | os.PathLike[str]) -> str:
    r"""A word for a shell to paste, on one line and in visible letters: `$'run\xff'` where quotes alone do not do."""
    text = os.fspath(word)
    if visible(text) == text:
        return shlex.quote(text)
    parts = (
        chr(byte) if 0x20 <= byte < 0x7F and byte not in b"\\'" else f"\\x{byte:02x}" for byte in os.fsencode(text)
    )
    return f"$'{''.join(parts)}'"
