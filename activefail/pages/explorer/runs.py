"""The page of all campaigns in a folder of run folders, and the way to each of them.

A run folder is read again once its files have changed, and at most for a tenth of the time, so that the page costs
little while campaigns run beside it.
"""

import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from activefail.analyses.findings.status import Status, read_status
from activefail.errors import ActivefailError, description_of
from activefail.estimates.scores import error_in_words
from activefail.pages.explorer.fields import Values
from activefail.pages.explorer.pages import Panel, Site, page
from activefail.record.journal import is_being_written
from activefail.record.layout import CHECKPOINT, JOURNAL, SETTINGS
from activefail.space.shares import alike, interval_percent, percent
from activefail.text.numerals import outcomes_in_words
from activefail.visible import or_worse, visible, words

_MOST_OPEN = 8
"""Campaigns whose pages are kept in memory."""

_SHARE = 0.1
"""Largest share of the time for which one run folder is read."""

_PATIENCE = 5.0
"""Longest wait for a run folder to be read [s]; the page shows it once it has been read."""

_ERRORS = 1e-3, 0.5
"""Range of the errors in a learning curve."""

Stamp = tuple[tuple[int, int, int] | None, ...]


def run_folders(folder: Path) -> list[Path]:
    """The run folders in a folder, sorted by name, damaged and old ones too; none if it is a run folder itself."""
    if not folder.is_dir() or _stamp(folder) is not None:
        return []
    with os.scandir(folder) as entries:
        return sorted(Path(entry) for entry in entries if entry.is_dir() and _stamp(Path(entry)) is not None)


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
        self._sites: dict[Path, tuple[Stamp | None, Future[Site]]] = {}  # the one asked last is the last
        self._reading, self._looking = threading.Lock(), threading.Lock()

    def page(self, path: str) -> str | None:
        """As `Site.page`."""
        title = visible(self.folder.resolve().name)
        return page("runs", title=title, table=self._table({})) if path == "/" else None

    def panel(self, name: str) -> Panel | None:
        """As `Site.panel`."""
        return self._table if name == "runs" else None

    def below(self, name: str, anew: bool) -> Site | None:
        """As `Site.below`; those who ask the same campaign wait while it is opened once."""
        folder = self.folder / name
        if folder not in self._reads and folder not in run_folders(self.folder):
            return None
        with self._looking:
            stamp, site = self._sites.pop(folder, (None, None))
            opens = site is None or (anew and stamp != _stamp(folder))
            if site is None or opens:
                stamp, site = _stamp(folder), Future()
            self._sites[folder] = stamp, site
            for longest_ago in [*self._sites][:-_MOST_OPEN]:
                del self._sites[longest_ago]
        if opens:
            try:
                site.set_result(self.open_site(folder))
            except BaseException as error:
                with self._looking:
                    self._sites.pop(folder, None)
                site.set_exception(error)
        return site.result()

    def _table(self, _: Values) -> str:
        """The table as HTML."""
        with self._reading:
            self._reads = {folder: self._read(folder) for folder in run_folders(self.folder)}
            reads = dict(self._reads)
        sizes = [read.status.curve[-1].simulations for read in reads.values() if read.status and read.status.curve]
        rows = [_row(folder, read, max(sizes, default=0)) for folder, read in reads.items()]
        return page("runs_table", rows=rows, counts=Counter(row["state"] for row in rows), most=max(sizes, default=0))

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
        "has_curve": settings.validation.size or settings.probability_rule is not None,
    }


def _answer(status: Status) -> tuple[str, str]:
    """What the campaign answers, the best that it has: of what, and the value with its interval."""
    for outcome, numbers in reversed([*status.estimates.items()]):
        of = f"P({or_worse(outcome, status.summary.outcomes)}), {100.0 * numbers['confidence']:g} % interval"
        if numbers["extrapolated"]:
            return of, f"at most {alike(numbers['high'])[0]}"
        return of, _between(numbers["probability"], numbers["low"], numbers["high"])
    if (error := status.error) is not None:
        of = f"verified error, {100.0 * error['confidence']:g} % interval"
        return of, error_in_words(error)[0]
    last = status.curve[-1] if status.curve else None
    if last is not None and last.probability is not None:
        if not all(status.summary.counts[:-1]):
            return "probability under the classifier, without an interval", alike(last.probability[0])[0]
        return "probability under the classifier, 95 % interval", _between(*last.probability)
    if last is not None and last.score is not None:
        interval = interval_percent(1.0 - last.score.high, 1.0 - last.score.low, 1)
        of = f"error on {last.score.test_designs} validation designs, 95 % interval"
        return of, f"{percent(1.0 - last.score.accuracy)} ({interval})"
    return "", ""


def _between(value: float, low: float, high: float) -> str:
    value_text, *ends = alike(value, low, high)
    return f"{value_text} ({' to '.join(ends)})"


Point = tuple[int, float, float, float]
"""Simulations, and a value with its interval."""


def _curve(status: Status, most: int) -> dict[str, Any] | None:
    """The probability if the campaign seeks one, else the error on the validation set; None without either.

    As shares of the simulations and of the powers of ten of a drawing.
    """
    sought: list[Point] = [(one.simulations, *one.probability) for one in status.curve if one.probability]
    scores = [(one.simulations, one.score) for one in status.curve if one.score is not None]
    points = sought or [(n, 1.0 - one.accuracy, 1.0 - one.high, 1.0 - one.low) for n, one in scores]
    if not points:
        return None
    text, (low, high) = "Error on the validation set", _ERRORS
    if sought:
        last = sought[-1][1] or 1e-9
        ends = [end for _, *row in sought for end in row if end > 0.0] or [last, 1.0]
        text, (low, high) = "Probability under the classifier", (max(min(ends), last / 1e3), min(max(ends), 1e3 * last))
    span = math.log(high / low) or 1.0

    def up(value: float) -> float:
        return 1.0 - math.log(min(max(value, low), high) / low) / span

    decades = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
    return {
        "text": text,
        "line": [(n / most, up(value)) for n, value, _, _ in points],
        "band": [(n / most, up(end)) for n, _, _, end in points]
        + [(n / most, up(end)) for n, _, end, _ in points[::-1]],
        "grid": [
            (up(10.0**k), f"{100.0 * 10.0**k:g} %" if k > -4 else alike(10.0**k)[0].partition("·")[2]) for k in decades
        ],
    }
