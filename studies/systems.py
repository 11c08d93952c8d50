"""Systems of limit states: simulations until a campaign stops, from the modes' margins and from the system's alone.

    python studies/systems.py                                  all systems, ten seeds
    python studies/systems.py --systems frame --seeds 2        a quick look
    python studies/systems.py --out systems.jsonl              finished campaigns are kept

Each campaign has the defaults of `stop = { probability = "failure" }`. One learns the margin of each mode
(`simulator.system`), one the system's margin alone, the smallest or largest that decides. "four-branch" is from
[Waarts2000] with k = 7; "frame" has the three plastic mechanisms of a portal frame (sway, combined, beam), with
lognormal plastic moments and loads; "parallel" and "nested" are made up. The first table gives, for each,

    P          the true probability, from a weighted sample
    calls      simulations to the stop: median and range over the seeds
    P/P_ref    the classifier's probability at the stop over the true one: median and range
    wrong      seeds in which it is more than 20 % off
    no stop    seeds that reached the budget
    missed     share of the failure probability that the classifier misses at the stop: median, and largest
    coverage   share of 90 % intervals from 50 fresh simulations that contain the true probability, over all seeds and
               --repeats estimates each
    ms         processor time of the loop for each simulation

and the second, for the shares of each mode from these fresh simulations, that it has failed in the failures and that it
decides them,

    truth      the true share, from the weighted sample
    largest    largest difference from it in all estimates, in per cent of it
    coverage   share of 90 % intervals that contain it
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from problems import PART, PARTS, ROOT, Variables, standard, variables
from reliability import is_wrong, wrong_shares
from study import Rows, asked, head, in_memory, line, parallel, spread, timed

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.campaign.settings import CampaignSettings
from activefail.estimates.integral import boundary_of
from activefail.estimates.modes import Events
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.learning.criteria.population import population
from activefail.learning.model.threads import one_thread
from activefail.simulators.interface import Results
from activefail.space.space import Array
from activefail.space.systems import System, parse_system

FRESH = 50

WAYS = ("modes", "system")
"""A campaign learns the margins of the modes, or that of the system alone."""


@dataclass(frozen=True)
class SystemProblem:
    """A system as a simulator.

    Attributes:
        limits: of designs, (n, d) -> (n, k).
        system: of the modes.
        space: its variables as settings.
        alone: whether the simulator reports the system's margin alone.
    """

    limits: Callable[[Array], Array]
    system: System
    space: Variables
    alone: bool = False

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    @property
    def margins(self) -> tuple[str, ...]:
        """Names of the margins."""
        return ("g",) if self.alone else self.system.names

    def limit(self, X: Array) -> Array:
        """The system's margin, (n,), of designs, (n, d)."""
        return self.system(self.limits(X))

    def run(self, X: Array) -> Results:
        """Simulate designs, (n, d)."""
        g, nothing = self.limit(X), np.zeros(len(X))
        margins = g[:, None] if self.alone else self.limits(X)
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margins, nothing)

    def campaign(self, seed: int, budget: int = 200) -> Campaign:
        """A campaign with the default stop rule for a probability."""
        returned = {"elsewhere": True, "margins": list(self.margins), "outcomes": list(self.outcomes)}
        settings = {
            "simulator": returned if self.alone else returned | {"system": self.system.text},
            "space": self.space,
            "correlation": [],
            "classifier.features": "design",
            "acquisition.boundary": "failure",
            "acquisition.criterion": "eavc",
            "sampling.initial": max(12, 2 * len(self.space)),
            "sampling.batch": 1,
            "sampling.budget": budget,
            "stop": {"probability": "failure"},
            "seed": seed,
        }
        return Campaign.of(CampaignSettings().changed(settings), simulator=self)


def _four_branch(X):
    x, y = X.T
    bent = 3.0 + 0.1 * (x - y) ** 2
    return np.column_stack([bent - (x + y) / ROOT, bent + (x + y) / ROOT, x - y + 7 / ROOT, y - x + 7 / ROOT])


def _frame(X):
    m, sway, beam = X[:, :5].T, 5.0 * X[:, 5], 5.0 * X[:, 6]
    return np.column_stack(
        [
            m[0] + m[1] + m[3] + m[4] - sway,
            m[0] + 2.0 * m[2] + 2.0 * m[3] + m[4] - sway - beam,
            m[1] + 2.0 * m[2] + m[3] - beam,
        ]
    )


def _parallel(X):
    x, y, z = X.T
    bent = 1.6 - y - 0.15 * (x - 1.0) ** 2 + 0.1 * z
    return np.column_stack([1.8 - x + 0.1 * y**2, bent, 1.5 - 0.6 * (x + y) - 0.5 * z + 0.2 * np.sin(2.0 * z)])


def _nested(X):
    x, y, z, w = X.T
    return np.column_stack(
        [
            2.1 - x + 0.1 * y**2,
            1.6 - 0.8 * x - 0.5 * y + 0.2 * np.sin(2.0 * z),
            1.7 - 0.8 * w + 0.1 * (x + z) ** 2,
            1.9 - 0.7 * (z + w) - 0.2 * np.sin(y),
        ]
    )


_MOMENTS = [("lognormal", 134.9, 13.49)] * 5

SYSTEMS = {
    "four-branch": SystemProblem(_four_branch, parse_system("min(a, b, c, d)", list("abcd")), standard(2)),
    "frame": SystemProblem(
        _frame,
        parse_system("min(sway, combined, beam)", ["sway", "combined", "beam"]),
        variables(*_MOMENTS, ("lognormal", 50.0, 15.0), ("lognormal", 40.0, 12.0)),
    ),
    "parallel": SystemProblem(_parallel, parse_system("max(a, b, c)", list("abc")), standard(3)),
    "nested": SystemProblem(_nested, parse_system("min(max(a, b), max(c, d))", list("abcd")), standard(4)),
}


@cache
def truth(name: str) -> tuple[float, Array, Array]:
    """The probability of a system's failure, and the shares of the modes that have failed, and decide, (k,) each."""
    problem, rng = SYSTEMS[name], np.random.default_rng(0)
    space, parts = problem.campaign(0).space, []
    for _ in range(PARTS):
        drawn = population(space, PART, None, rng)
        events = Events.of(problem.system, problem.limits(drawn.X))
        parts.append(np.concatenate([np.atleast_1d(drawn.weight @ one / PART) for one in events]))
    assert np.std([part[0] for part in parts]) < 0.02 * PARTS**0.5 * np.mean(parts, axis=0)[0], (
        "the sample is too small"
    )
    probability, *shares = np.mean(parts, axis=0)
    failed, decisive = np.split(np.array(shares) / probability, 2)
    return float(probability), failed, decisive


def score(name, way, seed, terms):
    """The row of a campaign."""
    problem = replace(SYSTEMS[name], alone=way == "system")
    campaign = problem.campaign(seed, terms["budget"])
    learned, seconds = timed(in_memory, campaign)
    n, rng = len(learned.history), np.random.default_rng([seed, 1])
    row = {
        "problem": name,
        "way": way,
        "seed": seed,
        "calls": n,
        "stopped": bool(len(learned.looks.table)) and learned.looks.is_known,
        "probability": learned.looks.probability if len(learned.looks.table) else np.nan,
        "ms": 1e3 * seconds / max(1, n - campaign.settings.sampling.initial),
    }
    with one_thread(), ThreadExecutor(1) as executor:
        boundary = boundary_of(learned.classifier, campaign.features, "failure")
        row["missed"] = wrong_shares(problem, campaign.space, boundary, rng)[0]
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, learned.history.last_iteration)
        asked_for = Question.of_space(campaign.space)
        estimates = [
            estimator.sample("failure", FRESH, asked_for.drawn(draw)).estimate(0.9) for draw in range(terms["repeats"])
        ]
    row["intervals"] = [(one.low, one.high) for one in estimates]
    row["modes"] = [[[mode.failed, mode.decisive] for mode in one.modes] for one in estimates]
    return row


def probabilities(rows, names):
    """Print the table of calls and probabilities."""
    head("system", "learned", "P", "calls", "P/P_ref", "wrong", "no stop", "missed", "coverage", "ms")
    for name in names:
        for way in WAYS:
            own, (true, *_) = rows.of(problem=name, way=way), truth(name)
            column = {key: np.array([row[key] for row in own]) for key in own[0] if key not in ("modes", "problem")}
            low, high = np.moveaxis(column["intervals"], -1, 0)
            ratio, missed = column["probability"] / true, column["missed"]
            line(
                name,
                way,
                f"{true:.3g}",
                spread(column["calls"], 0),
                spread(ratio),
                f"{is_wrong(ratio).sum()}/{len(own)}",
                (~column["stopped"]).sum(),
                f"{np.median(missed):.3f} ({missed.max():.3f})",
                f"{np.mean((low <= true) & (true <= high)):.3f}",
                f"{np.median(column['ms']):.0f}",
            )


def shares(rows, names):
    """Print the table of the modes' shares."""
    print()
    head("system", "mode", "failed: truth", "largest", "coverage", "decides: truth", "largest", "coverage")
    for name in names:
        # (seeds, repeats, modes, 2, 3)
        found = np.array([row["modes"] for row in rows.of(problem=name, way="modes")])
        for position, mode in enumerate(SYSTEMS[name].system.names):
            cells = []
            for event, true in enumerate(truth(name)[1:]):
                middle, low, high = np.moveaxis(found[:, :, position, event], -1, 0)
                off = f"{100.0 * np.abs(middle / true[position] - 1.0).max():.1f} %"
                covered = np.mean((low <= true[position] + 1e-9) & (true[position] - 1e-9 <= high))
                cells += [f"{true[position]:.4f}", off, f"{covered:.3f}"]
            line(name, mode, *cells)


def main():
    options = asked(__doc__, systems=list(SYSTEMS), seeds=10, repeats=3, budget=200, processes=1, out=Path)
    terms = {key: getattr(options, key) for key in ("repeats", "budget")}
    rows = Rows(options.out, **terms)
    cases = [(name, way, seed) for seed in range(options.seeds) for name in options.systems for way in WAYS]
    cases = [case for case in cases if rows.lack(**dict(zip(("problem", "way", "seed"), case, strict=True)))]
    for row in parallel(score, [(*case, terms) for case in cases], options.processes):
        rows.add(**row)
    probabilities(rows, options.systems)
    shares(rows, options.systems)


if __name__ == "__main__":
    main()
