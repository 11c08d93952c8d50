"""Reads ground-motion records from text files: PEER's AT2, or columns of acceleration or of time and acceleration."""

import codecs
import math
import os
import re
from pathlib import Path

import numpy as np

from activefail.bearing.accelerogram import EVEN, Accelerogram
from activefail.bearing.design import GRAVITY
from activefail.errors import InputError, naming
from activefail.trust import read_regular

UNITS = {"g": GRAVITY, "m/s2": 1.0, "cm/s2": 0.01}
"""Units of acceleration, in m/s2."""

_LARGEST = 200_000_000
"""Most bytes of a file."""

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")

_USUAL = (0.005, 3.0)
"""Peak accelerations of strong motion [g]; other values may have another unit."""

_USUAL_DT = (1e-4, 0.1)
"""Intervals of strong-motion records [s]."""

_DRIFT = 0.25
"""Largest velocity at the end of a record, over its PGV, that needs no baseline correction."""

_KIND = re.compile(r"\b(ACCELERATION|VELOCITY|DISPLACEMENT) TIME\b.*?UNITS OF\s+(G|CM|M)\b", re.IGNORECASE)
"""The line of PEER's header that says what a file has."""


def read_accelerogram(path: str | os.PathLike[str], unit: str, dt: float | None = None) -> Accelerogram:
    """Read a record.

    A header that states DT and NPTS, as in PEER's AT2 files, is followed by accelerations, any number to a line.
    Without one, each line has an acceleration, for which `dt` is needed, or a time and an acceleration; blanks, commas
    or tabs separate columns. Lines before the first number are a header; so are lines that begin with #.

    Args:
        path: of the file.
        unit: of the accelerations: "g", "m/s2" or "cm/s2". No file format says it reliably; a header that contradicts
            it is refused.
        dt: interval between samples [s], required for a single column; a file that states another one is refused.

    Raises:
        InputError: naming the file, the line, the rule and the value.
    """
    if unit not in UNITS:
        raise InputError(f"unit: must be one of {', '.join(UNITS)}, got {unit!r}.")
    path = Path(path)
    if dt is not None and not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"{path}: dt: must be positive and finite, got {dt} s.")
    try:
        data = read_regular(path, _LARGEST, follow=True)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path} {error}") from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: must be text in UTF-8 or ASCII, got UTF-16.")
    # The mark of UTF-8 before the first number would make its line a header.
    text = data.removeprefix(codecs.BOM_UTF8).decode("latin-1")
    lines = text.splitlines()
    with naming(f"{path}: "):
        is_at2 = re.search(r"\bNPTS\b", text[:2000], re.IGNORECASE)
        values, interval = _of_at2(lines, unit, dt) if is_at2 else _of_columns(lines, dt)
        return Accelerogram(UNITS[unit] * values, interval, path.stem)


def doubts(record: Accelerogram) -> list[str]:
    """What makes a record doubtful, as sentences that begin with its name."""
    named = [f"{record.name} {doubt}" for doubt in _doubts(record)]
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


def _of_at2(lines: list[str], unit: str, dt: float | None) -> tuple[np.ndarray, float]:
    """Accelerations and interval of a file whose header states NPTS and DT."""
    place = next(k for k, line in enumerate(lines) if re.search(r"\bNPTS\b", line, re.IGNORECASE))
    for k, line in enumerate(lines[: place + 1], 1):
        if (match := _KIND.search(line)) is None:
            continue
        if match[1].upper() != "ACCELERATION":
            raise InputError(f"line {k}: must state an acceleration, got {line.strip()!r}.")
        if match[2].lower() != unit.partition("/")[0]:
            raise InputError(f"line {k}: must state the unit {unit} (--unit), got {line.strip()!r}.")
    stated = {}
    for name in ("NPTS", "DT"):
        match = re.search(rf"\b{name}\s*=?\s*({_NUMBER.pattern})", lines[place], re.IGNORECASE)
        if match is None:
            # The oldest files: two numbers, then their names.
            match = re.match(rf"\s*({_NUMBER.pattern})[\s,]+({_NUMBER.pattern})", lines[place])
            if match is None:
                raise InputError(f"line {place + 1}: must state {name}, got {lines[place]!r}.")
            stated = {"NPTS": match[1], "DT": match[2]}
            break
        if re.match(r",\d", lines[place][match.end() :]):
            raise InputError(f"line {place + 1}: {name}: must have a decimal point, got {lines[place]!r}.")
        stated[name] = match[1]
    values = np.array([x for k, line in enumerate(lines[place + 1 :], place + 2) for x in _numbers(line, k)])
    count = _value(stated["NPTS"])
    if len(values) != count:
        raise InputError(f"NPTS: must be the number of accelerations, {len(values)}, got {count:g}.")
    interval = _value(stated["DT"])
    if dt is not None and abs(interval - dt) > EVEN * dt:
        raise InputError(f"dt: the header states an interval of {interval:g} s, got {dt:g} s.")
    return values, interval


def _of_columns(lines: list[str], dt: float | None) -> tuple[np.ndarray, float]:
    """Accelerations and interval of a file with one or two columns."""
    rows: list[tuple[int, list[float]]] = []
    for k, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if not rows and not _NUMBER.match(line.strip()):
            continue
        rows.append((k, _numbers(line, k)))
        if len(rows[-1][1]) != len(rows[0][1]) or len(rows[0][1]) > 2:
            raise InputError(
                f"line {k}: must have one or two numbers, as many as the first line, got {line!r}.{_about_commas(line)}"
            )
    if not rows:
        raise InputError("must have accelerations, got none.")
    values = np.array([numbers for _, numbers in rows])
    if values.shape[1] == 1:
        if dt is None:
            raise InputError("has no times, so dt (--dt) is required.")
        return values[:, 0], dt
    if len(values) < 2:
        raise InputError(f"must have at least 2 samples, got {len(values)}.")
    steps = np.diff(values[:, 0])
    mean = float((values[-1, 0] - values[0, 0]) / len(steps))
    # Times are rounded to the digits of the file.
    rounding = 2.0 * 10.0 ** -max(_digits(lines[rows[1][0] - 1]), 0)
    bad = np.flatnonzero(~(np.abs(steps - mean) <= np.maximum(EVEN * abs(mean), min(rounding, 0.4 * abs(mean)))))
    if len(bad) or not mean > 0.0:
        # One gap changes the mean of all steps, but not their median.
        median = float(np.median(steps))
        apart = np.abs(steps - median) if mean > 0.0 else -steps
        # The first of those that differ most, but for rounding.
        k = int(np.argmax(apart >= 0.99 * apart.max())) + 1
        raise InputError(
            f"line {rows[k][0]}: times must rise by equal intervals (median: {median:.6g} s), got {steps[k - 1]:.6g} s."
            f"{_about_commas(lines[rows[k][0] - 1])}"
        )
    if dt is not None and abs(mean - dt) > EVEN * dt:
        raise InputError(f"dt: the times have an interval of {mean:.6g} s, got {dt:g} s.")
    return values[:, 1], mean


def _about_commas(line: str) -> str:
    """What to know of a line whose commas may be those of decimals; empty for others."""
    return " Commas separate numbers; decimals need points." if "," in line and "." not in line else ""


def _digits(line: str) -> int:
    """Digits after the point of a line's first number."""
    first = re.split(r"[\s,;]+", line.strip())[0]
    mantissa, _, exponent = first.lower().replace("d", "e").partition("e")
    return len(mantissa.partition(".")[2]) - int(exponent or 0)


def _numbers(line: str, k: int) -> list[float]:
    """The numbers of line k.

    Raises:
        InputError: naming the line and what is no number.
    """
    numbers = []
    for part in re.split(r"[\s,;]+", line.strip()):
        if not part:
            continue
        if not _NUMBER.fullmatch(part):
            raise InputError(f"line {k}: must be numbers, got {part!r}.")
        numbers.append(_value(part))
        if not math.isfinite(numbers[-1]):
            raise InputError(f"line {k}: must be finite, got {part!r}.")
    return numbers


def _value(text: str) -> float:
    """A number, whose exponent may be written as Fortran does."""
    return float(text.lower().replace("d", "e"))
