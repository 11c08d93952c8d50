"""What the studies share: options, rows that a repeated command continues, tables, times, and campaigns in memory."""

import argparse
import heapq
import json
import resource
import subprocess
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.classifier import Classifier
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.probability_rule import Looks
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.record.store import Store
from activefail.seismic.bearing import TABLE_1


def asked(doc, words=None, **defaults):
    """The options of a command, whose help is the study's docstring.

    Args:
        words: name of a list of words without an option.
        defaults: by name. False is a switch; a type has no default; a list takes words, or one word with commas.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if words:
        parser.add_argument(words, nargs="+")
    for name, default in defaults.items():
        flag, several = f"--{name.replace('_', '-')}", isinstance(default, list)
        one = default[0] if several else default
        kind, value = (one, [] if several else None) if isinstance(one, type) else (type(one), default)
        if several:
            parser.add_argument(flag, nargs="*", type=partial(_parts, kind), default=[value])
        elif kind is bool:
            parser.add_argument(flag, action="store_true")
        else:
            parser.add_argument(flag, type=kind, default=value)
    options = parser.parse_args()
    for name, default in defaults.items():
        if isinstance(default, list):
            setattr(options, name, [part for parts in getattr(options, name) for part in parts])
    return options


def _parts(kind, text):
    return [kind(part) for part in text.split(",") if part]


class Rows:
    """Finished cases, each a line of JSON in a file if there is one; a repeated command continues with the others.

    Attributes:
        finished: the rows that have all `terms`.
    """

    def __init__(self, path=None, **terms):
        self.path, self.terms = path, terms
        lines = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else []
        self.finished = [row for row in map(json.loads, lines) if terms.items() <= row.items()]

    def lack(self, **case):
        """Whether no row is of a case."""
        return not any(case.items() <= row.items() for row in self.finished)

    def add(self, **row):
        """Keep a row, as its line of the file would give it."""
        self.finished.append(json.loads(json.dumps({**self.terms, **row}, default=lambda value: value.tolist())))
        if self.path:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(self.finished[-1]) + "\n")

    def of(self, **case):
        """The rows of a case."""
        return [row for row in self.finished if case.items() <= row.items()]


def parallel(function, cases, processes=1):
    """The results of a function of cases (tuples), as they finish in fresh processes."""
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for future in as_completed([pool.submit(function, *case) for case in cases]):
            yield future.result()


def line(*cells):
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def head(*titles):
    """Print the head of a Markdown table."""
    line(*titles)
    print("|---" * len(titles) + "|", flush=True)


def markdown(titles, rows):
    """A Markdown table as text."""
    return "\n".join([f"| {' | '.join(titles)} |", "|---" * len(titles) + "|", *(f"| {' | '.join(r)} |" for r in rows)])


def write_between(page, begin, end, text):
    """Replace what a page has between two marks."""
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{rest.partition(end)[2]}", encoding="utf-8")


def spread(values, digits=2):
    """Median and range as text."""
    values = np.asarray(values)
    return f"{np.median(values):.{digits}f} ({values.min():.{digits}f}-{values.max():.{digits}f})"


def percent(flags, digits=2):
    """A share [%] with its standard error, as text; from flags or shares, (n,)."""
    return f"{100.0 * np.mean(flags):.{digits}f} ± {100.0 * np.std(flags) / np.sqrt(len(flags)):.{digits}f}"


def timed(function, *arguments):
    """What a function returns, and the processor time of this process [s]."""
    began = time.process_time()
    return function(*arguments), time.process_time() - began


def time_of_command(words, **options):
    """Wall and processor time [s] of a command, and what it prints."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    text = subprocess.run(words, check=True, capture_output=True, text=True, **options).stdout
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, text


def uniform(n, seed):
    """Independent designs of Table 1, (n, 9)."""
    return TABLE_1.from_unit(np.random.default_rng(seed).random((n, TABLE_1.dimension)))


class Learned(NamedTuple):
    """A finished campaign without a folder."""

    campaign: Campaign
    store: Store
    history: History
    classifier: Classifier
    looks: Looks
    """Of the stop rule."""


def campaign_of(simulator=None, **settings):
    """A campaign by its settings, with `__` in place of a dot."""
    changes: dict[str, Any] = {name.replace("__", "."): value for name, value in settings.items()}
    return Campaign.of(CampaignSettings().changed(changes), simulator=simulator)


def in_memory(campaign, executor=None):
    """Run a campaign to its end."""
    store = MemoryStore(campaign.schema)
    with executor or ThreadExecutor(1) as workers:
        run(campaign, store, workers, campaign.settings.sampling.budget)
    learned = current(campaign, store, write=False)
    return Learned(campaign, store, History.of(store.batches), learned.classifier, learned.looks)


class VirtualTime:
    """Workers whose simulations take an imagined time; results arrive in its order."""

    def __init__(self, workers, duration):
        """`duration`: a function of a design, (d,), and its results."""
        self._now, self._free, self._ends, self._duration = 0.0, [0.0] * workers, [], duration

    def run(self, simulator, X, arrived=None):
        """Simulate at once."""
        return simulator.run(X)

    def start(self, simulator, ticket, x):
        """Start a simulation on the worker that is free first."""
        results = simulator.run(x[None])
        end = max(self._now, heapq.heappop(self._free)) + self._duration(x, results)
        heapq.heappush(self._free, end)
        heapq.heappush(self._ends, (end, ticket, results))

    def answered(self, seconds):
        """The results that end next."""
        if not self._ends:
            return []
        self._now, ticket, results = heapq.heappop(self._ends)
        return [(ticket, results)]

    def __enter__(self):
        return self

    def __exit__(self, *exception): ...
