"""The program's output streams, through which nothing but letters and line ends comes to the terminal."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

from activefail.visible import visible

OUTPUT = "output"
"""What an error of a stream calls it: the system names a file, not a stream."""


class Screen:
    """A stream that shows control characters as escapes, and says of an error that the output caused it.

    The last defence only: a line break of a stranger's is told from one of our own where the text comes in
    (`activefail.visible`), not here.
    """

    def __init__(self, stream: IO[str]) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text, made visible but for line ends and tabs."""
        with _named():
            self.stream.write(visible(text, keep="\n\t"))
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream."""
        with _named():
            self.stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def _named() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        error.filename = error.filename or OUTPUT
        raise


@contextmanager
def visible_output() -> Iterator[None]:
    """Have standard output and error pass through screens meanwhile."""
    before = sys.stdout, sys.stderr
    # None where it is closed.
    sys.stdout, sys.stderr = (None if stream is None else Screen(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def terminal(stream: Any) -> Any:
    """The stream itself, for a display that steers the terminal; what it shows must be visible text already."""
    return stream.stream if isinstance(stream, Screen) else stream
