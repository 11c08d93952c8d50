"""What the header of a record file states, and whether an option contradicts it: unit, interval, number of points."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import eq
from typing import Any

from activefail.errors import InputError
from activefail.seismic.bearing.accelerogram import EVEN
from activefail.seismic.bearing.design import GRAVITY
from activefail.text.numerals import number_in

UNITS = {"g": GRAVITY, "m/s2": 1.0, "cm/s2": 0.01, "mm/s2": 0.001}
"""Units of acceleration, in m/s2."""

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
"""A number, whose exponent may be written as Fortran does."""

Lines = list[tuple[int, str]]
"""Lines with their numbers in the file."""

_GAP = r"(?:[ _]?[\[(][^\])]*[\])])?\s*(?:[:=,]|\bis\b|\bof\b)?\s*"
"""What is between a key and its value: a unit in brackets, and a sign or word."""

_NOT_G = (
    r"(?:(?:[cm]?m|in|ft)\s*/\s*s(?:ec)?\s*(?:(?:\^|\*\*)?\s*[2²]|/\s*s(?:ec)?)|[cm]?m[ _.·]?s(?:ec)?\^?-?[2²]|gals?"
    r"|(?:%|milli|micro)[ -]*g|[mµμ]g|g\s*/\s*\d+)(?![\w/^*²])"
)
_ACCELERATION = rf"(?:{_NOT_G}|g(?![\w/^*²]))"
_SYMBOLS = {
    r"\bcentimet(?:er|re)s?\b": "cm",
    r"\bmillimet(?:er|re)s?\b": "mm",
    r"\bmet(?:er|re)s?\b": "m",
    r"\binch(?:es)?\b": "in",
    r"\bf(?:ee|oo)t\b": "ft",
    r"\bper ?cent(?: of)?\b": "%",
    r"\s*\bper\s+": "/",
    r"\bsec(?:ond)?s?[ -]+squared?\b": "s2",
    r"\bsec(?:ond)?s?\b": "s",
}
"""Words of units, as symbols."""
_BARE_UNIT = re.compile(
    rf"(?<![\w/^*.])(?:{_NOT_G}|[cm]?m\s*/\s*s(?:ec)?(?:\^?3)?(?![\w/^*²])|\bcounts?\b(?!\s*[:=]?\s*\d+\W*$))"
    rf"(?![\])]?\s*[:=]\s*{NUMBER})",
    re.IGNORECASE,
)
"""A unit, whatever the words around it are, also of velocities and raw data; g alone may be a name."""
_OTHER_WORDS = re.compile(r"convert|multipl|vs_?30|number of|sample", re.IGNORECASE)
"""Before such a unit, say that it is not that of the samples."""
_UNIT = re.compile(
    r"units?\s*(?:\b(?:of|in|are|is)\b|[:=,])\s*[\[(]?\s*([^\s,;()\[\]]+(?:\s*/\s*[^\s,;()\[\]]+)*)"
    r"|\bacc\w*\.?\s*[\[(]([^\])]+)[\])]"
    rf"|[\[(]\s*({_ACCELERATION})\s*[\])]"
    rf"|\b(?:in|acc[a-z]*)[\s._,-]+({_ACCELERATION})",
    re.IGNORECASE,
)
_NO_UNIT_OF_SAMPLES = re.compile(
    r"\b(?:peak|max\w*|pga|scal(?:e|ed|ing)|range|sensitiv\w*|trigger\w*|threshold)\b", re.IGNORECASE
)
"""Before a unit, says that it is not that of the samples."""

_OF_SAMPLES = re.compile(r"acc|unit|data|value|sample|record", re.IGNORECASE)
"""Before "in g", says that it is the unit of the samples."""
_POINTS = re.compile(
    r"(?:\bNPTS?|\bN_?POINTS|\bNDATA|\bn(?:umber|um|o\.?)[ _](?:of[ _])?(?:\w+[ _])?(?:points|data|samples|values))\b"
    rf"{_GAP}(\d+)"
    r"|(?<![\d.])(\d+)\s+(?:(?:data|accel\w*)\s+)?(?:points|samples|pts)\b(?!\s+(?:across|per|a)\b)"
    rf"|^\W*(?:points|samples)\b{_GAP}(\d+)"
    r"|^\s*(\d+)[\s,]+\S+[\s,]+NPTS\b",
    re.IGNORECASE,
)
_INTERVAL = re.compile(
    rf"(?:\bDT(?:_s)?\b|\bdelta(?:[ _-]?t)?\b|Δ\s?t\b|(?:time|sampl\w*)[ _-]*(?:step|interval|increment|period|spacing)"
    rf"(?:_m?s)?\b){_GAP}({NUMBER})\s*[a-z]*"
    rf"|\bspac(?:ed|ing)\s+(?:\w+\s+)?(?:at|of|by)\s+({NUMBER})\s*[a-z]*"
    rf"|\bintervals\s+of\s+({NUMBER})\s*[a-z]*"
    rf"|({NUMBER})\s*m?s(?:ec)?\w*\s+intervals?\b"
    rf"|^\s*\d+[\s,]+({NUMBER})[\s,]+NPTS\b",
    re.IGNORECASE,
)
_RATE = re.compile(
    rf"(?:\bsampl\w*[ _-]*(?:rate|freq\w*)(?:_hz)?|\bfs){_GAP}({NUMBER})\s*[a-z]*"
    rf"|\bsampled\s+at\s+({NUMBER})\s*Hz"
    rf"|({NUMBER})\s*(?:samples\s*(?:/|per)\s*s|sps\b)",
    re.IGNORECASE,
)
_BARE_INTERVAL = re.compile(rf"(?<![\w.])({NUMBER})\s*(hz|m?s|m?sec|(?:milli)?seconds?)\b(?!\s*/)", re.IGNORECASE)
"""A number that may be an interval or a rate, whatever the words around it are."""

_NO_INTERVAL = re.compile(
    r"filter|pass|cut|corner|band|nyquist|natural|taper|instrument|sensor|transducer|duration|period|\bat\b|time of"
    r"|high|low|\b[hl]p\b|\bfc\b",
    re.IGNORECASE,
)
"""Says that such a number is neither."""

_PEAK = re.compile(
    rf"(?:\bPGA|\bpeak\s+(?:ground\s+)?acc\w*|\bmax\w*\.?\s+acc\w*)\.?(?:[ _]*[\[(]?({_ACCELERATION})[\])]?)?"
    rf"\s*(?:[:=]|\bis\b|\bof\b)?\s*({NUMBER})(?![\d.]*\s*%)\s*[\[(]?({_ACCELERATION})?",
    re.IGNORECASE,
)
_FACTOR = re.compile(rf"\b(?:scal\w*[ _-]*factor|multipli\w+(?:\s+by)?){_GAP}({NUMBER})", re.IGNORECASE)
_AGREE = 2.0
"""Ratio of a stated PGA to that of the samples, either way: it may be that of the raw record, but in no other unit."""

_MILLISECONDS = re.compile(r"(?<![a-z])m(?:illi)?s(?:ec\w*)?\b", re.IGNORECASE)
_TIME_IN_MS = re.compile(r"(?<![a-z])t(?:imes?)?\s*[\[(,_]\s*m(?:illi)?s(?:ec\w*)?\b", re.IGNORECASE)
_TIME_IN_OTHERS = re.compile(r"(?<![a-z])t(?:imes?)?\s*[\[(]\s*(?:us|[µμ]s|micro\w*|min\w*|h|hours?)\b", re.IGNORECASE)
_KIND = re.compile(r"\b(?:(\w+)\s+TIME\s+(?:SERIES|HISTORY)|DATA[_ ]?TYPE\s*[:=]\s*(\w+))", re.IGNORECASE)
_OTHER_KINDS = ("VEL", "DIS", "SA", "SD")
_OTHER_TITLE = re.compile(
    r"\b(?:veloc|vel\b|displ|disp\b|spectr|fourier)|^\W*(?:T|periods?)\b.*\bp?s[adv]\b", re.IGNORECASE
)
_OTHER_KIND = re.compile(r"\W*(?:velocity|displacement)\b", re.IGNORECASE)

FORMATS = {
    "K-NET": r"^Scale Factor\s+[\d.]+\(gal\)/",
    "SMC": r"\A\s*\d (?:UN)?CORRECTED ACCELEROGRAM|\A\s*\d (?:VELOCITY|DISPLACEMENT)",
    "COSMOS": r"\(Format v\d",
    "GeoNet": r"\A(?:un)?corrected accelerogram.*GNS",
    "CSMIP": r"\A(?:un)?corrected accelerogram|points of accel data equally",
}
"""Formats of agencies that are not read, and what shows them: their headers are numbers whose place has a meaning."""


@dataclass(frozen=True)
class Stated:
    """A fact that a line of a header states.

    Attributes:
        value: of the fact.
        line: number of the line in the file.
        text: the line.
    """

    value: Any
    line: int
    text: str


def unit_named(text: str) -> str:
    """The name in UNITS of a unit that may be spelled as gal, cm/sec^2, CM/S/S or m s-2; the text itself if none."""
    plain = re.sub(r"sec(?:ond)?s?", "s", text.strip().lower().replace("²", "2"))
    plain = re.sub(r"[\s^*·._]|'s$", "", plain).replace("/s/s", "/s2").replace("s-2", "/s2").replace("//", "/")
    plain = {
        "gravity": "g",
        "mps2": "m/s2",
        "gal": "cm/s2",
        "gals": "cm/s2",
        "ms2": "m/s2",
        "cms2": "cm/s2",
        "mms2": "mm/s2",
    }.get(plain, plain)
    return plain if plain in UNITS else text


_ANGLE = re.compile(r"\s*(?:deg|°|km)", re.IGNORECASE)
_OTHER_TIME = re.compile(r"\s*(?:/\s*\d|kHz|MHz|[uµμ]s\b|micro|min\b)", re.IGNORECASE)
"""After a number, units that are not read."""


def check_format(text: str) -> None:
    """Refuse a file of a format that is not read."""
    for name, pattern in FORMATS.items():
        if re.search(pattern, text, re.IGNORECASE | re.MULTILINE):
            raise InputError(f"is a file in {name}'s format, which activefail does not read (see docs/records.md).")


def units(header: Lines) -> list[Stated]:
    """The units of acceleration that a header states.

    Raises:
        InputError: if it states velocities, displacements or a unit that is not read.
    """
    found = []
    for place, (line, text) in enumerate(header, 1):
        kind = _KIND.search(text)
        is_other = kind is not None and (kind[1] or kind[2]).upper().startswith(_OTHER_KINDS)
        # The last line has the title of the columns; a line before may begin with the kind.
        titles = _OTHER_TITLE.search(text) if place == len(header) else _OTHER_KIND.match(text)
        if is_other or (titles and "acc" not in text.lower()):
            raise InputError(f"line {line}: must state an acceleration, got {text.strip()!r}.")
        plain = _in_symbols(text)
        for match in _UNIT.finditer(plain):
            before = plain[: match.start()]
            if match[1] is None and match[2] is None and re.search(rf"{NUMBER}\s*$", before):
                continue  # of that number
            if match[1] is None and _NO_UNIT_OF_SAMPLES.search(plain[: match.end()]):
                continue
            if match[0].lower().startswith("in") and not _OF_SAMPLES.search(before):
                continue
            said = next(filter(None, match.groups())).strip(" .:")
            unit = unit_named(said)
            if unit in UNITS:
                found.append(Stated(unit, line, text))
            elif re.search(r"[/%^²]|^[\d.]|^(?:[cm]?m|counts?|in|ft|mg|milli.*)$", said, re.IGNORECASE):
                raise InputError(
                    f"line {line}: must state a unit of acceleration, {', '.join(UNITS)}, got {text.strip()!r}."
                )
    return found


def intervals(header: Lines) -> list[Stated]:
    """The intervals between samples that a header states [s].

    Raises:
        InputError: if one has a decimal comma.
    """
    found = []
    for line, text in header:
        for pattern in (_INTERVAL, _RATE):
            for match in pattern.finditer(text):
                if re.match(r",\d", text[match.end() :]):
                    raise InputError(f"line {line}: DT: must have a decimal point, got {text!r}.")
                end = match.end(next(place for place, group in enumerate(match.groups(), 1) if group))
                if _ANGLE.match(text, end):
                    continue  # a distance
                if _OTHER_TIME.match(text, end):
                    raise InputError(f"line {line}: must state an interval in s or ms, or a rate in Hz, got {text!r}.")
                number = number_in(next(filter(None, match.groups())))
                in_ms = _MILLISECONDS.search(match[0])
                # No strong motion is sampled less than once a second: such a rate is an interval.
                is_rate = pattern is _RATE and number > 1.0 and not in_ms
                found.append(Stated(1.0 / number if is_rate else 1e-3 * number if in_ms else number, line, text))
    return found


def check_unit(header: Lines, unit: str) -> None:
    """Check a unit that only an option states against units in the header."""
    found = []
    for line, text in header:
        plain = _in_symbols(text)
        for match in _BARE_UNIT.finditer(plain):
            before = plain[: match.start()]
            is_of_number = re.search(rf"{NUMBER}\s*[\[(]?\s*$", before)
            if not (is_of_number or _NO_UNIT_OF_SAMPLES.search(before) or _OTHER_WORDS.search(before)):
                found.append(Stated(unit_named(match[0]), line, text))
    if not any(fact.value == unit for fact in found):
        agreed("unit", unit, found, str, eq)


def _in_symbols(text: str) -> str:
    """A line with the symbols of units in place of their words."""
    for word, symbol in _SYMBOLS.items():
        text = re.sub(word, symbol, text, flags=re.IGNORECASE)
    return text


def check_option(header: Lines, dt: float) -> None:
    """Check an interval [s] that only an option states against numbers of the header that may be one."""
    found = []
    for line, text in header:
        for match in () if _NO_INTERVAL.search(text) else _BARE_INTERVAL.finditer(text):
            number = number_in(match[1])
            step = 1.0 / number if match[2].lower() == "hz" and number > 0.0 else number
            step *= 1e-3 if _MILLISECONDS.search(match[2]) else 1.0
            if 1e-4 <= step <= 0.1:
                found.append(Stated(step, line, text))
    if found and not any(same_interval(fact.value, dt) for fact in found):
        agreed("dt", dt, found, lambda x: f"{x:g} s", same_interval)


def check_peak(header: Lines, peak: float, unit: str) -> None:
    """Check the largest acceleration of the samples [m/s2] against that of the header, in this unit if it has none."""
    for line, text in header:
        for match in _PEAK.finditer(text):
            stated = abs(number_in(match[2])) * UNITS.get(unit_named(match[1] or match[3] or unit), 0.0)
            if peak > 0.0 and stated > 0.0 and not 1.0 / _AGREE <= stated / peak <= _AGREE:
                raise InputError(
                    f"line {line}: must agree with the largest of the samples, {peak / UNITS[unit]:.4g} {unit}, got "
                    f"{text.strip()!r}. Check unit and scale, or remove the line."
                )


def factors(header: Lines) -> list[str]:
    """Notes on factors that a header states: the samples of real files have been multiplied by them, or not."""
    return [
        f"has a factor in its header, which is not applied: {text.strip()!r}."
        for _, text in header
        if (match := _FACTOR.search(text)) and number_in(match[1]) != 1.0
    ]


def seconds_of_time(header: Lines) -> float:
    """The unit of a column of times [s]: milliseconds if a column's title states them.

    Raises:
        InputError: if it states another unit than seconds or milliseconds.
    """
    for line, text in header:
        if _TIME_IN_OTHERS.search(text):
            raise InputError(f"line {line}: must state times in s or ms, got {text.strip()!r}.")
    return 1e-3 if any(_TIME_IN_MS.search(text) for _, text in header) else 1.0


def points(header: Lines) -> list[Stated]:
    """The numbers of points that a header states."""
    return [
        Stated(int(next(filter(None, match.groups()))), line, text)
        for line, text in header
        for match in _POINTS.finditer(text)
    ]


def same_interval(one: float, other: float) -> bool:
    """Whether two intervals differ only by rounding."""
    return abs(one - other) <= EVEN * abs(other)


def agreed(
    key: str, given: Any, stated: Iterable[Stated], shown: Callable[[Any], str], same: Callable[[Any, Any], bool]
) -> Any:
    """The value that an option gives or a header states; None if there is none.

    Args:
        key: name of the fact.
        given: value of the option; None if it is left out.
        stated: what the header states.
        shown: a value in words.
        same: whether two values are the same.
    """
    value = given
    for fact in stated:
        if value is None:
            value = fact.value
        elif not same(fact.value, value):
            place = f"line {fact.line}: {fact.text.strip()!r}"
            raise InputError(f"{key}: the header states {shown(fact.value)}, got {shown(value)} ({place}).")
    return value
