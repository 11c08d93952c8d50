"""Solvers that give up before failure: calls, intervals and coverage against a twin whose margin is whole.

    python studies/giving_up.py                              seven limit states, ten seeds
    python studies/giving_up.py --problems plane --seeds 2   a quick look
    python studies/giving_up.py --unknown                    nothing says what lost runs mean: both probabilities

A run is lost where the margin g is below a level, so that no margin at most this level is ever seen. Lost runs mean
failure. The twin's margin is g less the level, everywhere. Campaigns have `stop = { probability = "failure" }` and a
budget of 150. Each gives --repeats estimates from 50 fresh simulations. With --unknown lost runs mean nothing, and the
level is the one below which a run is lost: P is 0 if none of them fails.

    plane      3.2 - x1 - 0.15 x2; level 0.1
    branch     3 + 0.1 (x1 - x2)^2 - (x1 + x2) / sqrt 2; level 0.2
    buckling   resistance less load of a column by Perry and Robertson, four variables; 5 % of the load is left
    frame      five variables of a portal frame, 1 less its utilisation; level 0.08
    spring     1.4 - 0.3 exp(0.4 x1 + 0.3 x2) - 0.1 x3 + 0.05 x3^2, three variables; level 0.1
    ragged     as plane; the level is 0.1 + 0.05 sin(3 x2), so that no margin separates
    late       as plane; lost below -0.3: margins reach 0 first, and the twin's level is 0
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from problems import PARTS, Problem, standard
from reliability import estimated, is_wrong, stopping_campaign
from study import Rows, asked, head, in_memory, line, parallel, spread

from activefail.estimates.probability_estimator import Estimator
from activefail.learning.criteria.population import population
from activefail.learning.model.threads import one_thread
from activefail.simulators.interface import NUMERICAL_FAILURE


@dataclass(frozen=True)
class GivesUp(Problem):
    """A limit state whose solver gives up below a level.

    Attributes:
        level: of the margin, from designs, (n, d) -> (n,), below which a run is lost.
        reached: whether margins reach 0 first.
        means: what a lost run is recorded as.
    """

    level: object = None
    means: int = 1

    def run(self, X):
        """Simulate designs, (n, d)."""
        results, g = super().run(X), self.limit(X)
        lost = g < self.level(X)
        outcome = np.where(lost, self.means, g <= 0.0).astype(np.int8)
        return replace(results, outcome=outcome, margins=np.where(lost, np.nan, g)[:, None])


def _constant(level):
    return lambda X: np.full(len(X), level)


def _plane(X):
    return 3.2 - X[:, 0] - 0.15 * X[:, 1]


def _branch(X):
    return 3.0 + 0.1 * (X[:, 0] - X[:, 1]) ** 2 - (X[:, 0] + X[:, 1]) / 2.0**0.5


def _column(X):
    length, load, strength, bow = X.T
    slender = length * 100.0 / 4.98 / (np.pi * np.sqrt(210e3 / strength))
    phi = 0.5 * (1.0 + bow * np.maximum(slender - 0.2, 0.0) + slender**2)
    reduction = 1.0 / (phi + np.sqrt(phi**2 - slender**2))
    return reduction * 53.8 * strength * 0.1 / load - 1.0


def _frame(X):
    wind, snow, height, span, strength = X.T
    bending = 0.25 * wind * height**2 + 0.06 * snow * span**2
    return 1.0 - bending / (0.9 * strength) - (0.5 * snow * span + 0.3 * wind * height) / (8.0 * strength)


def _spring(X):
    return 1.4 - 0.3 * np.exp(0.4 * X[:, 0] + 0.3 * X[:, 1]) - 0.1 * X[:, 2] + 0.05 * X[:, 2] ** 2


SPACES = {
    "column": {
        "length": {"distribution": "normal", "mean": 4.0, "sd": 0.2},
        "load": {"distribution": "gumbel_max", "mean": 350.0, "sd": 70.0},
        "strength": {"distribution": "lognormal", "mean": 280.0, "cov": 0.08},
        "bow": {"distribution": "lognormal", "mean": 0.34, "cov": 0.3},
    },
    "frame": {
        "wind": {"distribution": "gumbel_max", "mean": 6.0, "sd": 1.5},
        "snow": {"distribution": "gumbel_max", "mean": 8.0, "sd": 2.0},
        "height": {"distribution": "normal", "mean": 6.0, "sd": 0.3},
        "span": {"distribution": "normal", "mean": 12.0, "sd": 0.4},
        "strength": {"distribution": "lognormal", "mean": 275.0, "cov": 0.07},
    },
}

PROBLEMS = {
    "plane": (_plane, standard(2), _constant(0.1)),
    "branch": (_branch, standard(2), _constant(0.2)),
    "buckling": (_column, SPACES["column"], _constant(0.05)),
    "frame": (_frame, SPACES["frame"], _constant(0.08)),
    "spring": (_spring, standard(3), _constant(0.1)),
    "ragged": (_plane, standard(2), lambda X: 0.1 + 0.05 * np.sin(3.0 * X[:, 1])),
    "late": (_plane, standard(2), _constant(-0.3)),
}


def twin_of(name):
    """The limit state whose margin is whole: failure is where it is at most the level, or 0 if that is below."""
    limit, space, level = PROBLEMS[name]
    return Problem(lambda X: limit(X) - np.maximum(level(X), 0.0), space)


def probability_of(name):
    """P(failure) from a weighted sample."""
    problem, rng = twin_of(name), np.random.default_rng(0)
    space, parts = problem.campaign().space, []
    for _ in range(PARTS):
        drawn = population(space, 500_000, None, rng)
        parts.append((drawn.weight * (problem.limit(drawn.X) <= 0.0)).mean())
    return float(np.mean(parts))


def score(name, seed, twin, unknown, repeats):
    """A campaign and its estimates."""
    limit, space, level = PROBLEMS[name]
    means = NUMERICAL_FAILURE if unknown else 1
    problem = twin_of(name) if twin else GivesUp(limit, space, level=level, means=means)
    campaign = stopping_campaign(problem, seed, budget=150)
    learned, rng = in_memory(campaign), np.random.default_rng([seed, 1])
    row = {
        "problem": name,
        "seed": seed,
        "twin": twin,
        "calls": len(learned.history),
        "ended": bool(len(learned.looks.table)) and learned.looks.is_known,
    }
    with one_thread():
        if not unknown:
            found = estimated(problem, learned.classifier, campaign.features, campaign.space, repeats, rng)
            return row | {"probability": found["probability"], "intervals": [one[:3] for one in found["estimates 50"]]}
        intervals = []
        for _ in range(repeats):
            estimator = Estimator.of(campaign, learned.history, learned.classifier, "failure")
            plan = estimator.plan(50, rng)
            one = estimator.estimate(plan, problem.run(plan.designs), 0.9)
            intervals.append((one.probability, one.low, one.high))
        return row | {"probability": float("nan"), "intervals": intervals}


def main():
    options = asked(__doc__, problems=[str], seeds=10, unknown=False, repeats=5, processes=1, out=Path)
    names = options.problems or [*PROBLEMS]
    rows, twins = Rows(options.out, unknown=options.unknown), (True, False)
    cases = [
        (n, s, t) for n in names for s in range(options.seeds) for t in twins if rows.lack(problem=n, seed=s, twin=t)
    ]
    for row in parallel(score, [(*case, options.unknown, options.repeats) for case in cases], options.processes):
        rows.add(**row)
    head("problem", "margin", "P", "calls", "ended", "P/P_ref", "wrong", "coverage", "median width")
    for name in names:
        true = probability_of(name)
        for twin in twins:
            own = rows.of(problem=name, twin=twin)
            ratio = np.array([row["probability"] for row in own]) / true
            _, low, high = np.moveaxis(np.array([row["intervals"] for row in own]), -1, 0)
            covered, width = (low <= true) & (true <= high), np.median(high - low) / true
            line(
                name,
                "whole" if twin else "lost",
                f"{true:.3g}",
                spread([row["calls"] for row in own], 0),
                f"{sum(row['ended'] for row in own)}/{len(own)}",
                spread(ratio),
                is_wrong(ratio).sum(),
                f"{covered.mean():.2f}",
                f"{width:.2f} P",
            )


if __name__ == "__main__":
    main()
