"""The page of all campaigns in a folder of run folders, and the way to each of them.

A run folder is read again once its files have changed, and at most for a tenth of the time, so that the page costs
little while campaigns run beside it.
"""

import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from activefail.errors import ActivefailError, description_of
from activefail.explorer.pages import Answer, Question, Site, page
from activefail.findings.status import Status, read_status
from activefail.numerals import outcomes_in_words
from activefail.record.journal import is_being_written
from activefail.record.layout import CHECKPOINT, JOURNAL, SETTINGS
from activefail.shares import alike, interval_percent, percent
from activefail.verification.scores import error_in_words
from activefail.visible import or_worse, visible, words

_MOST_OPEN = 8
"""Campaigns whose pages are kept in memory."""

_SHARE = 0.1
"""Largest share of the time for which one run folder is read."""

_PATIENCE = 5.0
"""Longest wait for a run folder to be read [s]; the page shows it once it has been read."""

_SIZE = 220.0, 56.0
"""Width and height of a learning curve."""

_ERRORS = 1e-3, 0.5
"""Range of the errors in a learning curve."""


def run_folders(folder: Path) -> list[Path]:
    """The run folders in a folder, sorted by name, damaged and old ones too; none if it is a run folder itself."""
    if not folder.is_dir() or _stamp(folder) is not None:
        return []
    with os.scandir(folder) as entries:
        return sorted(Path(entry) for entry in entries if entry.is_dir() and _stamp(Path(entry)) is not None)


Stamp = tuple[tuple[int, int, int] | None, ...]


def _stamp(folder: Path) -> Stamp | None:
    """What changes when a run folder does; None if it is none: a user's file may be named as one of its files."""
    found: list[tuple[int, int, int] | None] = []
    for name in (SETTINGS, JOURNAL, CHECKPOINT, "segments"):
        try:
            of = os.stat(folder / name)
            found.append((of.st_mtime_ns, of.st_size, of.st_ino))
        except OSError:
            found.append(None)
    return tuple(found) if len(found) - found.count(None) > 1 else None


class Curve(NamedTuple):
    """A learning curve as a drawing.

    Attributes:
        text: what it shows, for screen readers.
        line, band: points of the values and of their 95 % intervals.
        grid: heights and texts of the lines across.
    """

    text: str
    line: str
    band: str
    grid: Sequence[tuple[float, str]]


class _Read(NamedTuple):
    """A run folder as it was read: its stamp then, its status or why it has none, and when and how long it took [s]."""

    stamp: Stamp
    status: Status | None
    fault: str
    at: float
    seconds: float


class _Reading(threading.Thread):
    """Reads a run folder.

    Attributes:
        begun: when it began.
        read: the run folder; None until the end.
    """

    def __init__(self, folder: Path, stamp: Stamp) -> None:
        super().__init__(daemon=True)
        self._folder, self._stamp, self.begun = folder, stamp, time.monotonic()
        self.read: _Read | None = None

    def run(self) -> None:
        """Read it. Nothing that is wrong with it reaches the page but in words."""
        status, fault = None, ""
        try:
            status = read_status(self._folder)
        except (ActivefailError, OSError) as error:
            fault = str(error)
        except Exception as error:
            fault = f"cannot be read: {visible(description_of(error))}"
        self.read = _Read(self._stamp, status, fault, self.begun, time.monotonic() - self.begun)


class Runs:
    """The campaigns in a folder; implements `Site`.

    Attributes:
        folder: of the run folders.
        open_site: opens the site of a run folder.
    """

    def __init__(self, folder: Path, open_site: Callable[[Path], Site]) -> None:
        self.folder, self.open_site = folder, open_site
        self._reads: dict[Path, _Read] = {}
        self._readings: dict[Path, _Reading] = {}
        self._sites: dict[Path, tuple[Stamp | None, Site]] = {}  # the one asked last is the last
        self._reading, self._looking = threading.Lock(), threading.Lock()
        self._opening: dict[Path, threading.Lock] = {}

    def page(self, path: str) -> str | None:
        """As `Site.page`."""
        return page("runs", title=visible(self.folder.resolve().name), **self._shown()) if path == "/" else None

    def question(self, path: str) -> Question | None:
        """As `Site.question`: what the page shows, unless it shows that already."""
        return Question(self._news, {"known": lambda _, value: value}) if path == "/api/runs" else None

    def below(self, name: str, anew: bool) -> Site | None:
        """As `Site.below`."""
        folder = self.folder / name
        if folder not in self._reads and folder not in run_folders(self.folder):
            return None
        if (site := self._opened(folder, anew)) is not None:
            return site
        # Those who ask the same campaign wait, so that it is opened once.
        with self._opening.setdefault(folder, threading.Lock()):
            if (site := self._opened(folder, anew)) is None:
                stamp, site = _stamp(folder), self.open_site(folder)
                with self._looking:
                    self._sites[folder] = stamp, site
                    idle = [one for one, (_, of) in self._sites.items() if one != folder and not of.is_busy]
                    for one in idle[: max(0, len(self._sites) - _MOST_OPEN)]:
                        self._sites.pop(one)[1].close()
            return site

    def _opened(self, folder: Path, anew: bool) -> Site | None:
        """The open site of a run folder; None if there is none, or if it is idle, asked anew and its record changed."""
        with self._looking:
            stamp, site = self._sites.pop(folder, (None, None))
            if site is None:
                return None
            if anew and stamp != _stamp(folder) and not site.is_busy:
                site.close()
                return None
            self._sites[folder] = stamp, site
            return site

    @property
    def is_busy(self) -> bool:
        """As `Site.is_busy`."""
        return any(site.is_busy for _, site in self._sites.values())

    def close(self) -> None:
        """Stop what runs in the background."""
        for _, site in self._sites.values():
            site.close()

    def _news(self, known: Any) -> Answer:
        shown = self._shown()
        return {"digest": shown["digest"], "html": None if known == shown["digest"] else shown["table"]}

    def _shown(self) -> dict[str, str]:
        """The table as HTML, and its digest."""
        with self._reading:
            self._reads = {folder: self._read(folder) for folder in run_folders(self.folder)}
            reads = dict(self._reads)
        sizes = [read.status.curve[-1].simulations for read in reads.values() if read.status and read.status.curve]
        most = max(sizes, default=0)
        rows = [_row(folder, read, most) for folder, read in reads.items()]
        counts = Counter(row["state"] for row in rows)
        table = page("runs_table", rows=rows, counts=counts, most=most, width=_SIZE[0], height=_SIZE[1])
        return {"table": table, "digest": sha256(table.encode()).hexdigest()[:16]}

    def _read(self, folder: Path) -> _Read:
        """The run folder as it is; as it was if it has not changed, was read a moment ago or takes long to read."""
        before, stamp, now = self._reads.get(folder), _stamp(folder), time.monotonic()
        if before is not None and (before.stamp == stamp or now < before.at + before.seconds / _SHARE):
            if before.status is None or before.status.is_running == (running := is_being_written(folder)):
                return before
            return before._replace(status=replace(before.status, is_running=running))
        if (reading := self._readings.get(folder)) is None:
            reading = self._readings[folder] = _Reading(folder, stamp or ())
            reading.start()
        reading.join(max(0.0, reading.begun + _PATIENCE - now))
        if reading.read is None:
            return before or _Read((), None, f"not read yet: this takes more than {_PATIENCE:g} s", now, 0.0)
        del self._readings[folder]
        return reading.read


def _row(folder: Path, read: _Read, most: int) -> dict[str, Any]:
    """What the table shows of a run folder; `most` is where the learning curves end."""
    row, fault = {"name": folder.name, "address": f"run/{quote(os.fsencode(folder.name), safe='')}/"}, read.fault
    try:
        if read.status is not None:
            return row | _cells(read.status, most)
    except Exception as error:  # what a stranger's record may hold
        fault = f"cannot be shown: {visible(description_of(error))}"
    return row | {"state": "unreadable", "can_open": False, "title": "", "fault": fault}


def _cells(status: Status, most: int) -> dict[str, Any]:
    """The cells of the row of a run folder."""
    summary, settings = status.summary, status.summary.settings
    has_curve = settings.validation.size or settings.probability_rule is not None
    counts = summary.counts.tolist()
    return {
        "state": status.state,
        "title": settings.description,
        "done": summary.done,
        "budget": settings.sampling.budget,
        "counts": outcomes_in_words(counts, map(words, summary.outcomes))[: None if counts[-1] else -1],
        "can_open": bool(summary.counts[:-1].any()),
        "answer": _answer(status),
        "refused": settings.refused.get("verify", ""),
        "curve": _curve(status, most),
        "no_curve": "none yet" if has_curve else "none: needs validation.size or stop.probability",
    }


def _answer(status: Status) -> tuple[str, str]:
    """What the campaign answers, the best that it has: of what, and the value with its interval."""
    for outcome, numbers in reversed([*status.estimates.items()]):
        of = f"P({or_worse(outcome, status.summary.outcomes)}), {100.0 * numbers['confidence']:g} % interval"
        if numbers["extrapolated"]:
            return of, f"at most {alike(numbers['high'])[0]}"
        probability, low, high = alike(numbers["probability"], numbers["low"], numbers["high"])
        return of, f"{probability} ({low} to {high})"
    if (error := status.error) is not None:
        of = f"verified error, {100.0 * error['confidence']:g} % interval"
        return of, error_in_words(error)[0]
    last = status.curve[-1] if status.curve else None
    if last is not None and last.probability is not None:
        probability, low, high = alike(*last.probability)
        if not all(status.summary.counts[:-1]):
            return "probability under the classifier, without an interval", probability
        return "probability under the classifier, 95 % interval", f"{probability} ({low} to {high})"
    if last is not None and last.score is not None:
        interval = interval_percent(1.0 - last.score.high, 1.0 - last.score.low, 1)
        of = f"error on {last.score.test_designs} validation designs, 95 % interval"
        return of, f"{percent(1.0 - last.score.accuracy)} ({interval})"
    return "", ""


def _curve(status: Status, most: int) -> Curve | None:
    """The probability if the campaign seeks one, else the error on the validation set; None without either."""
    if sought := [(one.simulations, *one.probability) for one in status.curve if one.probability]:
        values, text = sought, "Probability under the classifier"
        ends = [end for _, *row in sought for end in row if end > 0.0]
        last = sought[-1][1] or 1e-9
        low, high = max(min(ends, default=last), last / 1e3), min(max(ends, default=1.0), 1e3 * last)
        grid = [10.0**k for k in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)]
    else:
        scores = [(one.simulations, one.score) for one in status.curve if one.score is not None]
        values = [(n, 1.0 - one.accuracy, 1.0 - one.high, 1.0 - one.low) for n, one in scores]
        text, (low, high), grid = "Error on the validation set", _ERRORS, [0.01, 0.1]
    if not values:
        return None
    width, height = _SIZE
    span = math.log(high / low) or 1.0

    def place(n: int, value: float) -> str:
        return f"{width * n / most:.1f},{up(value):.1f}"

    def up(value: float) -> float:
        return height * (1.0 - math.log(min(max(value, low), high) / low) / span)

    band = [place(n, high) for n, _, _, high in values] + [place(n, low) for n, _, low, _ in reversed(values)]
    labels = [f"{100.0 * value:g} %" if value >= 1e-3 else alike(value)[0].partition("·")[2] for value in grid]
    line = " ".join(place(n, value) for n, value, _, _ in values)
    return Curve(text, line, " ".join(band), list(zip(map(up, grid), labels, strict=True)))
