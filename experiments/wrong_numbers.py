"""Limit states that are made to mislead: how often is a wrong probability certified?

    python experiments/wrong_numbers.py --seeds 5
    python experiments/wrong_numbers.py --seeds 5 --asynchronous --batch 5
    python experiments/wrong_numbers.py --seeds 20 --problems sliver,decoy

Each campaign has the defaults of `stop = { probability = "failure" }` and a budget of 100 simulations. With
--asynchronous, simulations take virtual time; those that end in failure take --slower times as long as others, and
results arrive in the order of these times. The table gives, for each problem,

    P          the true probability: in closed form, or from 5·10⁶ designs of a weighted sample
    ended      campaigns that the rule ended
    wrong      of these, those whose probability is more than 20 % off
    ratio      the classifier's probability over the true one: median and range
    calls      simulations: median and range
    coverage   share of 90 % intervals from 50 fresh simulations that contain the true probability, all campaigns
    of ended   the same for the campaigns that the rule ended
    plain      the same for all campaigns, if the interval did not grow with the deviation of the fresh margins
    told       share of the estimates that come with the sentence that fresh simulations contradict the classifier
               where it was sure, or that their margins deviate

A question of a problem is answered by the campaigns on the problem; its row has ratio and coverage.
"""

import argparse
import heapq
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any

import numpy as np
from scipy.stats import norm

from activefail.acquisition.population import population
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.asynchronous import learned_so_far
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.estimate import baseline, deviation_of_margins, plan_estimate
from activefail.simulators.interface import Results
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.threads import one_thread

FRESH, REPEATS = 50, 10
PARTS, PART = 10, 500_000
"""Populations of a true probability, and their sizes."""

NORMAL = {"distribution": "normal", "mean": 0.0, "sd": 1.0}


@dataclass(frozen=True)
class MadeUp:
    """A limit state as a simulator.

    Attributes:
        limit: designs (n, d) -> (n,); failure where it is at most 0.
        d: number of standard normal variables, unless `space` is given.
        space: of the variables.
        correlation: of the variables' values.
        questions: other variables by title.
        probability: the true one; None where a weighted sample gives it.
    """

    limit: Callable[[np.ndarray], np.ndarray]
    d: int = 2
    space: dict[str, dict[str, Any]] = field(default_factory=dict)
    correlation: tuple[tuple[str, str, float], ...] = ()
    questions: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    probability: float | None = None

    outcomes = ("safe", "failure")
    causes = ("",)
    margins = ("g",)
    releases_gil = True

    def run(self, X):
        g, nothing = self.limit(X), np.zeros(len(X))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), g[:, None], nothing)

    @property
    def variables(self):
        return self.space or {f"x{number}": NORMAL for number in range(1, self.d + 1)}


def _polygon(X):
    angles = np.array([0.3, 1.0, 2.1, 2.9, 3.8, 4.6, 5.5])
    offsets = np.array([3.1, 3.3, 3.0, 3.6, 3.2, 3.4, 3.1])
    return (offsets - X @ np.stack([np.cos(angles), np.sin(angles)])).min(axis=1)


def _finger(X):
    x, y = X.T
    return np.maximum(1.5 - x, np.abs(y - 0.3 * x) - 0.04)


def _disc(X, x, y, radius):
    return np.hypot(X[:, 0] - x, X[:, 1] - y) - radius


def _jump(X):
    return np.where(_disc(X, -1.6, -1.0, 0.3) <= 0.0, -1.0, 3.0 - X[:, 0])


def _noise(X):
    phase = np.modf(np.sin(X @ np.array([127.1, 311.7])) * 43758.5453)[0]
    return 2.8 - X[:, 0] + 0.4 * phase


def _late(X):
    x, y = X.T
    return 4.0 - x - 2.0 * np.maximum(0.0, x - 1.5) * y


def _planes(X):
    directions = np.random.default_rng(5).standard_normal((12, X.shape[1]))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return (3.4 + 0.3 * np.arange(12) / 11.0 - X @ directions.T).min(axis=1)


def _heavy(count, cov):
    return {f"x{number}": {"distribution": "lognormal", "mean": 1.0, "cov": cov} for number in range(1, count + 1)}


def _pairs(names, rho):
    return tuple((a, b, rho) for i, a in enumerate(names) for b in names[i + 1 :])


def _product_probability(limit, cov, rho):
    """P(x1 x2 x3 >= limit) of lognormals of mean 1, correlated."""
    zeta2 = np.log1p(cov**2)
    between = np.log1p(rho * cov**2)
    return float(norm.sf((np.log(limit) + 1.5 * zeta2) / np.sqrt(3.0 * zeta2 + 6.0 * between)))


def _beyond(X):
    """A plane within the campaign's reach; a second one that only larger values of x2 meet."""
    return np.minimum(3.0 - X[:, 0], 7.5 - X[:, 1] + 0.5 * np.sin(3.0 * X[:, 0]))


def _kinked(X):
    return 3.0 - X[:, 0] + 2.0 * np.maximum(0.0, X[:, 1] - 3.5)


def _normals(*means_and_sds):
    return {
        f"x{number}": {"distribution": "normal", "mean": mean, "sd": sd}
        for number, (mean, sd) in enumerate(means_and_sds, start=1)
    }


_PRODUCT = {"limit": 150.0, "cov": 1.0, "rho": 0.6}

PROBLEMS = {
    # Thin regions and corners.
    "sliver": MadeUp(
        lambda X: np.abs(X[:, 0] + 0.3 * X[:, 1] - 2.6) - 0.04,
        probability=float(np.diff(norm.cdf(np.array([2.56, 2.64]) / np.sqrt(1.09)))[0]),
    ),
    "finger": MadeUp(_finger),
    "ring": MadeUp(lambda X: np.abs(np.hypot(X[:, 0], X[:, 1]) - 3.0) - 0.04),
    "corner": MadeUp(
        lambda X: np.maximum(2.2 - X[:, 0], 2.0 - X[:, 1]), probability=float(norm.sf(2.2) * norm.sf(2.0))
    ),
    "polygon": MadeUp(_polygon),
    "planes": MadeUp(_planes, d=5),
    # Several regions.
    "opposite": MadeUp(lambda X: 3.2 - np.abs(X[:, 0]), probability=2.0 * float(norm.sf(3.2))),
    "ten modes": MadeUp(
        lambda X: 3.5 - np.abs(X).max(axis=1), d=5, probability=float(1.0 - (1.0 - 2.0 * norm.sf(3.5)) ** 5)
    ),
    "skew pair": MadeUp(
        lambda X: np.minimum(3.2 - X.sum(axis=1) / 6**0.5, 1.5 * (3.2 + X.sum(axis=1) / 6**0.5)),
        d=6,
        probability=2.0 * float(norm.sf(3.2)),
    ),
    "islands": MadeUp(
        lambda X: np.min([_disc(X, 2.2, 1.0, 0.2), _disc(X, -2.0, 1.6, 0.25), _disc(X, 0.3, -2.7, 0.3)], 0)
    ),
    "jump": MadeUp(_jump),
    "decoy": MadeUp(
        lambda X: np.minimum(0.1 + 0.2 * ((X[:, 0] + 2.0) ** 2 + X[:, 1] ** 2), 1.5 * (3.2 - X[:, 0])),
        probability=float(norm.sf(3.2)),
    ),
    # Margins that are not smooth, or whose size misleads.
    "ripple": MadeUp(lambda X: 3.0 - X[:, 0] - 0.3 * np.sin(20.0 * X[:, 1])),
    "noise": MadeUp(_noise),
    "steps": MadeUp(lambda X: np.ceil(4.0 * (3.0 - X[:, 0] - 0.3 * X[:, 1] ** 2)) / 4.0),
    "root": MadeUp(lambda X: np.cbrt(3.0 - X[:, 0] - 0.3 * X[:, 1] ** 2)),
    "cube": MadeUp(lambda X: (3.0 - X[:, 0] - 0.3 * X[:, 1] ** 2) ** 3),
    "exponential": MadeUp(lambda X: np.exp(4.0 * (3.0 - X[:, 0] - 0.3 * X[:, 1] ** 2)) - 1.0),
    "late": MadeUp(_late),
    "oscillation": MadeUp(lambda X: 3.6 - X[:, 0] * np.cos(2.0 * X[:, 1]) - 0.5 * np.abs(X[:, 0])),
    # Correlated and heavy-tailed variables.
    "difference": MadeUp(
        lambda X: 3.0 * 0.02**0.5 - (X[:, 0] - X[:, 1]),
        correlation=(("x1", "x2", 0.99),),
        probability=float(norm.sf(3.0)),
    ),
    "product": MadeUp(
        lambda X: _PRODUCT["limit"] - X.prod(axis=1),
        space=_heavy(3, _PRODUCT["cov"]),
        correlation=_pairs(("x1", "x2", "x3"), _PRODUCT["rho"]),
        probability=_product_probability(**_PRODUCT),
    ),
    "heavy sum": MadeUp(lambda X: 60.0 - X.sum(axis=1), space=_heavy(4, 2.0)),
    "weakest link": MadeUp(
        lambda X: X.min(axis=1) - 1e-3,
        space={f"x{number}": {"distribution": "exponential", "mean": 1.0} for number in range(1, 5)},
        probability=float(-np.expm1(-4e-3)),
    ),
    "tails": MadeUp(
        lambda X: X[:, 1] - X[:, 0],
        space={
            "load": {"distribution": "gumbel_max", "mean": 1.0, "cov": 0.6},
            "strength": {"distribution": "weibull", "mean": 9.0, "cov": 0.3},
        },
        correlation=(("load", "strength", -0.7),),
    ),
    # Questions away from where the campaign learned.
    "plane behind": MadeUp(
        _beyond,
        probability=float(norm.sf(3.0)),
        questions={"wider": _normals((0.0, 1.0), (0.0, 2.5)), "far": _normals((0.0, 0.8), (6.0, 0.5))},
    ),
    "kink behind": MadeUp(
        _kinked, questions={"far": _normals((0.0, 1.5), (4.5, 0.7)), "wider": _normals((0.0, 2.0), (0.0, 2.0))}
    ),
}


class Arrivals(ThreadExecutor):
    """Simulations in flight in virtual time; those that fail take longer."""

    def __init__(self, slower):
        super().__init__(1)
        self.slower, self.now, self.flight = slower, 0.0, []

    def start(self, simulator, ticket, x):
        results = simulator.run(x[None])
        duration = self.slower if results.outcome[0] else 1.0
        heapq.heappush(self.flight, (self.now + duration, ticket, results))

    def answered(self, seconds):
        if not self.flight:
            return []
        self.now, ticket, results = heapq.heappop(self.flight)
        return [(ticket, results)]


def campaign_on(problem, variables, seed, terms):
    settings = CampaignSettings().changed(
        {
            "seed": seed,
            "space": variables,
            "correlation": [list(pair) for pair in problem.correlation],
            "sampling.initial": max(12, 2 * len(variables)),
            "sampling.batch": terms["batch"],
            "sampling.budget": terms["budget"],
            "sampling.asynchronous": terms["asynchronous"],
            "classifier.features": "design",
            "acquisition.criterion": "eavc",
            "stop": {"probability": "failure"},
        }
    )
    return Campaign.of(settings, simulator=problem)


def true_probability(problem, variables, terms):
    space = campaign_on(problem, variables, 0, terms).space
    rng, parts = np.random.default_rng(0), []
    for _ in range(PARTS):
        drawn = population(space, PART, None, rng)
        parts.append(float((drawn.weight * (problem.limit(drawn.X) <= 0.0)).mean()))
    return float(np.mean(parts)), float(np.std(parts) / np.sqrt(PARTS))


def estimates(problem, latent, features, space, true, rng):
    def standardised(X):
        return latent.moments(features(X)).side

    integral = baseline(standardised, space)
    counts = np.zeros(3)
    for _ in range(REPEATS):
        plan = plan_estimate(standardised, space, integral, FRESH, rng)
        margin, answered = problem.limit(plan.designs), np.ones(FRESH, dtype=bool)
        plain = plan.estimate(margin <= 0.0, answered, 0.9)
        if isinstance(latent, MarginLatent):
            plan = plan.deviating(deviation_of_margins(latent, features, plan.designs, margin))
        found = plan.estimate(margin <= 0.0, answered, 0.9)
        covers = [one.low <= true <= one.high for one in (found, plain)]
        counts += [*covers, found.deviation > 2.0 or found.surprising > 0]
    shares = dict(zip(("covered", "plain", "told"), counts / REPEATS, strict=True))
    return {"ratio": integral.probability / true, **shares}


def score(name, seed, terms, true):
    problem = PROBLEMS[name]
    campaign = campaign_on(problem, problem.variables, seed, terms)
    store = MemoryStore(campaign.schema)
    with Arrivals(terms["slower"]) as executor:
        run(campaign, store, executor, terms["budget"])
    known = learned_so_far if terms["asynchronous"] else current
    learned, history = known(campaign, store, write=False), History.of(store.batches)
    latent = learned.classifier.latent("failure")
    ended = bool(len(learned.looks.table)) and learned.looks.is_known
    rng, rows = np.random.default_rng([seed, 1]), []
    with one_thread():
        for title, variables in {"": problem.variables, **problem.questions}.items():
            space = campaign_on(problem, variables, seed, terms).space
            found = estimates(problem, latent, campaign.features, space, true[title], rng)
            rows.append({"title": title, "calls": len(history), "ended": ended, **found})
    return rows


WIDTHS = {"problem": -22, "P": 8, "ended": 6, "wrong": 6, "ratio": 18, "calls": 12, "coverage": 8}
WIDTHS |= {"of ended": 8, "plain": 6, "told": 5}


def line(cells):
    return " ".join(
        f"{cell:{'<' if width < 0 else '>'}{abs(width)}}" for cell, width in zip(cells, WIDTHS.values(), strict=True)
    )


def show(name, true, rows):
    ended, ratio, calls, covered, plain, told = (
        np.array([row[key] for row in rows]) for key in ("ended", "ratio", "calls", "covered", "plain", "told")
    )
    wrong = np.abs(ratio - 1.0) > 0.2
    cells = [
        name,
        f"{true:.2e}",
        f"{ended.sum()}/{len(rows)}",
        f"{(wrong & ended).sum()}/{ended.sum()}",
        f"{np.median(ratio):.2f} ({ratio.min():.2f}-{ratio.max():.2f})",
        f"{np.median(calls):.0f} ({calls.min()}-{calls.max()})",
        f"{covered.mean():.2f}",
        f"{covered[ended].mean():.2f}" if ended.any() else "–",
        f"{plain.mean():.2f}",
        f"{told.mean():.2f}",
    ]
    print(line(cells), flush=True)


def truths(name, terms):
    problem = PROBLEMS[name]
    found = {}
    for title, variables in {"": problem.variables, **problem.questions}.items():
        if title or problem.probability is None:
            found[title], error = true_probability(problem, variables, terms)
            assert error < 0.02 * found[title], (name, title, found[title], error)
        else:
            found[title] = problem.probability
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--asynchronous", action="store_true")
    parser.add_argument("--slower", type=float, default=20.0, help="duration of a simulation that fails")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    terms = {key: getattr(options, key) for key in ("batch", "budget", "asynchronous", "slower")}
    print(line(WIDTHS), flush=True)
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        for name in options.problems.split(","):
            true = truths(name, terms)
            tasks = [pool.submit(score, name, seed, terms, true) for seed in range(options.seeds)]
            results = [row for task in tasks for row in task.result()]
            for title in true:
                label = f"{name}: {title}" if title else name
                show(label, true[title], [row for row in results if row["title"] == title])


if __name__ == "__main__":
    main()
