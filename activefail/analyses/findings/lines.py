"""Findings as lines of a terminal."""

from collections.abc import Iterable, Sequence


def titled(rows: Iterable[tuple[str, str]], width: int = 10) -> list[str]:
    """Titles with their texts."""
    return [f"{title:<{width}} {text}" for title, text in rows]


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of a table with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
