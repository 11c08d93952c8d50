"""Output streams that escape control characters before they reach the terminal."""

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

from activefail.visible import visible

OUTPUT = "output"
"""The name of a stream in error messages: the system names files only."""


class Screen:
    """A stream that escapes control characters and names the output in its errors.

    It is the last defence only: it cannot distinguish foreign line breaks from the program's. Foreign text is escaped
    where it enters (`activefail.visible`).
    """

    def __init__(self, stream: IO[str], escapes: bool = True) -> None:
        self.stream, self.escapes = stream, escapes

    def write(self, text: str) -> int:
        """Write a text, with control characters escaped except line ends and tabs, unless the screen escapes none."""
        with _naming_output():
            self.stream.write(visible(text, keep="\n\t") if self.escapes else text)
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream."""
        with _naming_output():
            self.stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def _naming_output() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        error.filename = error.filename or OUTPUT
        raise


@contextmanager
def visible_output() -> Iterator[None]:
    """Pass standard output and error through screens in this context."""
    before = sys.stdout, sys.stderr
    # A closed stream is None.
    sys.stdout, sys.stderr = (None if stream is None else Screen(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def table_stream(stream: Any) -> Screen:
    """A stream for a table: a terminal gets control characters as escapes, a file or pipe the text itself in UTF-8."""
    plain = terminal(stream)
    if plain.isatty():
        return Screen(plain)
    if isinstance(plain, io.TextIOWrapper):
        plain.reconfigure(encoding="utf-8")
    return Screen(plain, escapes=False)


def terminal(stream: Any) -> Any:
    """The underlying stream, for a display that controls the terminal; its text must already be escaped."""
    return stream.stream if isinstance(stream, Screen) else stream
