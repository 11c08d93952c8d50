"""Reads ground-motion records from text files: PEER's AT2, or columns of acceleration or of time and acceleration."""

import codecs
import math
import os
import re
from collections.abc import Iterator
from operator import eq
from pathlib import Path

import numpy as np

from activefail.errors import InputError, naming
from activefail.seismic.bearing.accelerogram import EVEN, Accelerogram
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.accelerogram_header import (
    NUMBER,
    UNITS,
    Lines,
    agreed,
    check_format,
    check_option,
    check_peak,
    check_unit,
    factors,
    intervals,
    points,
    same_interval,
    seconds_of_time,
    unit_named,
    units,
)
from activefail.text.numerals import number_of_program
from activefail.text.trust import read_regular
from activefail.visible import visible

_LARGEST = 200_000_000
"""Most bytes of a file."""

_NUMBER_OR_NONE = re.compile(rf"{NUMBER}|[+-]?(?:nan|inf)\b", re.IGNORECASE)

_WITH_POINT = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
"""A number that may follow another one without a blank: its sign separates them."""

Rows = list[tuple[int, list[float]]]
"""Numbers of lines, with the lines' numbers in the file."""

_WORD = re.compile(r"(?!nan\b|inf)[a-z]{3}", re.IGNORECASE)

_END = re.compile(r"[-=/&#\s]*$|.*\b(?:end|eof)\b", re.IGNORECASE)
"""A line after the last sample."""

_FAR = 3.0
"""A value that is so many times larger than all others is none: a motion rises and falls over several samples."""

_FEW = 10
"""A tenth of a file, or less than a line, may follow the stated number of points."""

_USUAL = (0.005, 3.0)
"""Peak accelerations of strong motion [g]; other values may have another unit."""

_USUAL_DT = (1e-4, 0.1)
"""Intervals of strong-motion records [s]."""

_LEAST_RATE = 1.0
"""No strong motion is sampled at such intervals [s]."""

_DRIFT = 0.25
"""Largest velocity at the end of a record, over its PGV, that needs no baseline correction."""


def read_accelerogram(path: str | os.PathLike[str], unit: str | None = None, dt: float | None = None) -> Accelerogram:
    """Read a record.

    Each line has an acceleration, or a time and an acceleration; where a header or the first line states the number of
    points, it may have any number of accelerations. Blanks, commas or tabs separate columns. Lines before the first
    numbers are a header; so are lines that begin with #.

    Unit, interval and number of points are what the header or the first lines state. What they state must agree with
    the options.

    Args:
        path: of the file.
        unit: of the accelerations: "g", "m/s2", "cm/s2" or "mm/s2", required if the header does not state it.
        dt: interval between samples [s], required if neither the header nor a column of times states it.

    Raises:
        InputError: naming the file, the line, the rule and the value.
    """
    path = Path(path)
    given = None if unit is None else unit_named(unit)
    if given is not None and given not in UNITS:
        raise InputError(f"unit: must be one of {', '.join(UNITS)}, got {unit!r}.")
    if dt is not None and not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"{path}: dt: must be positive and finite, got {dt} s.")
    text = _text(path)
    with naming(f"{path}: "):
        header, data = _parts(text)
        named = units(header)
        found = agreed("unit", given, named, str, eq)
        if given is not None and not named:
            check_unit(header, given)
        if found is None:
            raise InputError(f"unit: the header states none, so it is required (--unit, one of {', '.join(UNITS)}).")
        stated = intervals(header)
        interval = agreed("dt", dt, stated, lambda x: f"{x:g} s", same_interval)
        if dt is not None and not stated:
            check_option(header, dt)
        count = agreed("points", None, points(header), lambda x: f"{x} points", eq)
        values, interval, notes = _samples(data, count, interval, seconds_of_time(header))
        record = Accelerogram(UNITS[found] * values, interval, visible(path.stem), notes=(*notes, *factors(header)))
        _check_outlier(values)
        check_peak(header, record.peak, found)
        return record


def _check_outlier(values: np.ndarray) -> None:
    """Check that the largest values are accelerations: not a mark of missing data, nor a number about the record."""
    size = np.abs(values)
    others = np.max(size, where=size < size.max(), initial=0.0)
    if size.max() > _FAR * others > 0.0:
        k = int(np.argmax(size))
        raise InputError(
            f"sample {k + 1}: must be an acceleration, got {values[k]:g}, and the others are at most {others:g}. "
            "Remove what is none, such as a mark of missing data."
        )


def doubts(record: Accelerogram) -> list[str]:
    """What makes a record doubtful, as sentences that begin with its name."""
    named = [f"{record.name} {doubt}" for doubt in (*record.notes, *_doubts(record))]
    if record.vertical is not None:
        vertical = Accelerogram(record.vertical, record.dt)
        named += [f"{record.name} (vertical) {doubt}" for doubt in _doubts(vertical)]
    return named


def _doubts(record: Accelerogram) -> list[str]:
    """What makes a component doubtful, as ends of a sentence."""
    if record.peak == 0.0:
        return ["does not move the ground."]
    texts, peak = [], record.peak / GRAVITY
    if not _USUAL[0] <= peak <= _USUAL[1]:
        texts.append(f"has a PGA of {peak:.3g} g, which is unusual. Check its unit.")
    if not _USUAL_DT[0] <= record.dt <= _USUAL_DT[1]:
        texts.append(f"has an interval of {record.dt:.3g} s between samples, which is unusual.")
    a = record.acceleration
    end = abs(float(np.sum(0.5 * record.dt * (a[1:] + a[:-1]))))
    if end > _DRIFT * record.peak_velocity:
        share = end / record.peak_velocity
        texts.append(
            f"ends at {share:.2f} of its PGV. Its baseline may need a correction, which activefail does not make."
        )
    return texts


def _text(path: Path) -> str:
    """The text of a file up to an end mark of old systems."""
    try:
        data = read_regular(path, _LARGEST, follow=True)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path} {error}") from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: must be text in UTF-8 or ASCII, got UTF-16.")
    if b"\0" in data:
        raise InputError(f"{path}: must be text, got a binary file.")
    # The mark of UTF-8 before the first number would make its line a header.
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode()
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text = text.replace('"', " ")  # of quoted cells
    with naming(f"{path} "):
        check_format(text[:5000])
    return text.partition("\x1a")[0]


def _parts(text: str) -> tuple[Lines, Lines]:
    """The lines of the header with all comments, and those of the data, without what follows the data."""
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    while lines and _END.match(lines[-1][1]):
        lines.pop()
    begin = next((k for k, (_, line) in enumerate(lines) if _is_data(line)), len(lines))
    header = lines[:begin] + [part for part in lines[begin:] if _is_comment(part[1])]
    return header, [part for part in lines[begin:] if not _is_comment(part[1])]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _is_data(line: str) -> bool:
    """Whether a line begins with a number and has no words."""
    return bool(_NUMBER_OR_NONE.match(line.strip())) and not _WORD.search(line)


def _samples(
    data: Lines, count: int | None, dt: float | None, second: float
) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Accelerations, interval and notes.

    Args:
        data: lines of numbers.
        count: number of points that the header states.
        dt: interval that the header or the option states.
        second: unit of a column of times [s].
    """
    _check_commas(data)
    rows = [(k, list(_numbers(line, k))) for k, line in data]
    if not rows:
        raise InputError("must have accelerations, got none.")
    notes: tuple[str, ...] = ()
    if sum(len(numbers) for _, numbers in rows) != count:
        rows, count, dt, notes = _without_first(rows, count, dt)
    values = np.array([number for _, numbers in rows for number in numbers])
    widths = {len(numbers) for _, numbers in rows}
    if widths == {2} and count in (None, len(rows)):
        is_count = second == 1.0 and [numbers[0] - rows[0][1][0] for _, numbers in rows] == [*range(len(rows))]
        if is_count and dt is not None and not same_interval(1.0, dt):
            notes += ("has a first column that counts the samples; it is left out.",)
            return np.array([number for _, (_, number) in rows]), dt, notes
        return *_of_times(rows, dict(data), dt, second), notes
    beyond = 0 if count is None else len(values) - count
    if count is None and widths != {1}:
        if not _is_wrapped(rows):
            k = next((k for k, numbers in rows if len(numbers) != len(rows[0][1])), rows[0][0])
            line = dict(data)[k]
            raise InputError(
                f"line {k}: must have one or two numbers, as many as the first line, got {line!r}."
                f"{_about_commas(line)} More need a header with NPTS and DT."
            )
        notes += (f"has {len(rows[0][1])} accelerations to a line, which are read one after the other.",)
    if not 0 <= beyond <= max(1, len(rows[0][1]) - 1, len(values) // _FEW):
        raise InputError(f"points: {count} are stated, but {len(values)} accelerations follow.")
    if dt is None:
        raise InputError("has no times, so dt (--dt) is required.")
    if beyond:
        notes += (f"has {beyond} more values than its {count} points; they are left out.",)
    return values[:count], dt, notes


def _is_wrapped(rows: Rows) -> bool:
    """Whether lines can only have a number of successive samples: up to four columns may be components or times."""
    widths = [len(numbers) for _, numbers in rows]
    is_even = set(widths[:-1]) == {widths[0]} and widths[-1] <= widths[0] > 2
    steps = np.diff([numbers[0] for _, numbers in rows])
    return is_even and (widths[-1] < widths[0] or (widths[0] > 4 and not np.allclose(steps, steps[0], rtol=0.1)))


def _without_first(
    rows: Rows, count: int | None, dt: float | None
) -> tuple[Rows, int | None, float | None, tuple[str, ...]]:
    """The rows without first lines that state the number of points or the interval; with both, and notes.

    Such lines have one number each, or one line has both numbers.
    """
    widths = [len(numbers) for _, numbers in rows[:2]]
    for lines in [
        k for k, of in ((2, [1, 1]), (1, [2, 1]), (1, [1, 1]), (1, [1, 2])) if widths == of and len(rows) > k
    ]:
        first = [number for _, numbers in rows[:lines] for number in numbers]
        left = rows[lines:]
        sizes = (sum(len(numbers) for _, numbers in left), len(left))
        found = next((int(number) for number in first if number in sizes), None)
        steps = [number for number in first if number not in sizes]
        known = [dt is not None and same_interval(step, dt) for step in steps]
        if all(known) or (dt is None and found and len(steps) == 1 and 0.0 < steps[0] <= _USUAL_DT[1]):
            said = " and ".join(f"{number:g}" for number in first)
            note = f"begins with {said}, which is no acceleration: the number of points or the interval."
            return left, found or count, steps[0] if steps else dt, (note,)
    return rows, count, dt, ()


def _of_times(rows: Rows, lines: dict[int, str], dt: float | None, second: float) -> tuple[np.ndarray, float]:
    """Accelerations and interval of lines with a time and an acceleration."""
    values = np.array([numbers for _, numbers in rows]) * (second, 1.0)
    if len(values) < 2:
        raise InputError(f"must have at least 2 samples, got {len(values)}.")
    steps = np.diff(values[:, 0])
    mean = float((values[-1, 0] - values[0, 0]) / len(steps))
    # Times are rounded to the digits of the file.
    rounding = second * 2.0 * 10.0 ** -max(_digits(lines[rows[1][0]]), 0)
    bad = np.flatnonzero(~(np.abs(steps - mean) <= np.maximum(EVEN * abs(mean), min(rounding, 0.4 * abs(mean)))))
    if len(bad) or not mean > 0.0:
        # One gap changes the mean of all steps, but not their median.
        median = float(np.median(steps))
        apart = np.abs(steps - median) if mean > 0.0 else -steps
        # The first of those that differ most, but for rounding.
        k = int(np.argmax(apart >= 0.99 * apart.max())) + 1
        line = rows[k][0]
        raise InputError(
            f"line {line}: times must rise by equal intervals (median: {median:.6g} s), got {steps[k - 1]:.6g} s."
            f"{_about_commas(lines[line])}"
        )
    if dt is None and second == 1.0 and mean >= _LEAST_RATE:
        raise InputError(
            f"line {rows[1][0]}: times must rise by less than {_LEAST_RATE:g} s, got {mean:g} s. If the first column "
            "counts samples, dt (--dt) is required; if it has milliseconds, a title `time [ms]`."
        )
    if dt is not None and not same_interval(mean, dt):
        raise InputError(f"dt: the times have an interval of {mean:.6g} s, got {dt:g} s.")
    return values[:, 1], mean


def _check_commas(data: Lines) -> None:
    """Check that commas separate numbers, not their decimals.

    Raises:
        InputError: if all commas are inside numbers that something else separates, and no number has a point.
    """
    text = "\n".join(line for _, line in data)
    if "," in text and "." not in text and not re.search(r",(?!\d)|(?<!\d),", text) and re.search(r"\d[ \t;]+\S", text):
        k, line = next((k, line) for k, line in data if "," in line)
        raise InputError(f"line {k}: must have decimal points, got {line!r}; commas separate numbers.")


def _about_commas(line: str) -> str:
    """What to know of a line whose commas may be those of decimals; empty for others."""
    return " Commas separate numbers; decimals need points." if "," in line and "." not in line else ""


def _digits(line: str) -> int:
    """Digits after the point of a line's first number."""
    first = re.split(r"[\s,;]+", line.strip())[0]
    mantissa, _, exponent = first.lower().replace("d", "e").partition("e")
    return len(mantissa.partition(".")[2]) - int(exponent or 0)


def _numbers(line: str, k: int) -> Iterator[float]:
    """The numbers of line k."""
    for part in filter(None, re.split(r"[\s,;]+", line.strip())):
        numbers = _WITH_POINT.findall(part)
        if "".join(numbers) != part or not all(number[0] in "+-" for number in numbers[1:]):
            numbers = [part]
        for text in numbers:
            try:
                number = number_of_program(text)
            except ValueError:
                raise InputError(f"line {k}: must be numbers, got {part!r}.") from None
            if not math.isfinite(number):
                raise InputError(f"line {k}: must be finite, got {part!r}.")
            yield number
