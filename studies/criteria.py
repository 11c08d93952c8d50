"""Which method learns a boundary best: criteria, static designs and other libraries, from outcomes alone.

    python studies/criteria.py                                        all problems, ten seeds
    python studies/criteria.py --problems shell-3d --seeds 3          a quick look
    python studies/criteria.py --table --write docs/which.md          the table of the finished campaigns

A method is `static` (a Latin hypercube of the whole budget), `random` or `sobol` (such designs of the same size), a
criterion, or a library of peers.py. With `-continued` (`entropy-continued`), hyperparameters are learned from one start
only, that of the previous iteration. All but static designs start from the same Latin hypercube of half the budget.
Campaigns run the loop in memory, with the default classifier unless a problem says otherwise. A library that is not
installed is left out. Finished campaigns are lines of --out and are not run again.

Problems are in the unit cube, or in standard normal variables, and fail where their limit state is at most 0; or they
are the bearing, with its features and 200 or 500 simulations, the building, or those of mixed.py (`--problems mixed`),
40 designs after 20 in batches of five. The same fresh designs score all methods of a problem, by --score: the share on
the right side of the boundary, or the mean log probability of the true side. A cell of the table has the median over
the seeds [% or hundredths of a nat] and the mean difference to the --reference of the same seed with its 95 % interval
[points]. The last rows have the mean difference over the problems, the worst mean difference of a problem and the worst
of a seed, and the processor seconds of a campaign, as a median. A design is a near copy if another one of its batch
lies within 1 % (or 5 %) of it: the root mean square over the scaled features, in units of their ranges.
"""

import math
import warnings
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import mixed
import numpy as np
import peers
from problems import Problem, standard, variables
from scipy.spatial.distance import cdist
from study import Rows, asked, campaign_of, in_memory, markdown, timed, write_between

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import read_settings
from activefail.estimates.scores import log_score, probability_of_truth
from activefail.learning.model.threads import one_thread
from activefail.loop import learning
from activefail.loop.history import History
from activefail.loop.learning import STARTED_AFRESH, learn_from
from activefail.seismic.bearing import simulate
from activefail.seismic.ida.sample_mean import Estimate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space.space import Array

METHODS = ("static", "entropy", "joint_entropy", "eavc", "static-continued", "entropy-continued", "gpc", "aepsych")
BEGIN, END = "<!-- table of studies/criteria.py -->", "<!-- end of the table -->"
NEAR = (1, 5)
BUILDING = Path(__file__).resolve().parent.parent / "campaigns" / "building.toml"


def distance(X, *centre):
    return np.linalg.norm(X - np.array(centre), axis=1)


def islands(*balls):
    """Failure inside balls, each by its centre and radius."""
    return lambda X: np.min([distance(X, *centre) - radius for *centre, radius in balls], axis=0)


def corners(X):
    """Two opposite corners of the cube."""
    opposite = np.arange(X.shape[1]) % 2
    return np.minimum(np.abs(X - opposite).sum(axis=1), np.abs(X - (1 - opposite)).sum(axis=1)) - 1.5


def lobe(X):
    """A curved boundary, and behind it a separate region."""
    main = 0.45 + 0.25 * np.sin(math.pi * X[:, 1]) + 0.3 * X[:, 2] * X[:, 3] + 0.1 * X[:, 4] - X[:, 0]
    return np.minimum(main, np.linalg.norm(X[:, :4] - [0.15, 0.8, 0.8, 0.3], axis=1) - 0.33)


def branches(Z):
    """Four half-spaces in pairs of eight normal variables."""
    return np.min(1.3 + (Z[:, ::2] + Z[:, 1::2]) / 2**0.5 * [1.0, -1.0, 1.0, -1.0], axis=1)


def sparse(X):
    """A wave in three of the variables."""
    return X[:, 1] - 0.5 - 0.3 * np.sin(2.0 * math.pi * X[:, 0]) + 0.3 * (X[:, 2] - 0.5)


LIMITS = {
    "wave-2d": (2, 80, 5, lambda X: X[:, 1] - 0.5 - 0.3 * np.sin(4.0 * math.pi * X[:, 0])),
    "islands-2d": (2, 80, 5, islands((0.2, 0.25, 0.13), (0.75, 0.7, 0.15), (0.25, 0.8, 0.1))),
    "checks-2d": (2, 100, 5, lambda X: np.sin(3.0 * math.pi * X).prod(axis=1)),
    "shell-3d": (3, 200, 10, lambda X: np.abs(distance(X, 0.5, 0.5, 0.5) - 0.38) - 0.06),
    "bands-3d": (3, 150, 10, lambda X: np.cos(3.0 * math.pi * (X @ [1.0, 0.6, -0.4])) - 0.3),
    "islands-3d": (3, 120, 10, islands((0.25, 0.3, 0.3, 0.22), (0.7, 0.75, 0.35, 0.24), (0.6, 0.3, 0.8, 0.2))),
    "band-4d": (4, 120, 10, lambda X: np.abs(X @ [1.0, 0.8, -0.7, 0.4] - 0.8) - 0.12),
    "corners-5d": (5, 120, 10, corners),
    "lobe-6d": (6, 150, 10, lobe),
    "branches-8d": (8, 150, 10, branches),
    "ball-10d": (10, 150, 10, lambda X: ((X - 0.4) ** 2) @ np.linspace(2.0, 0.4, 10) - 1.0),
    "sparse-12d": (12, 150, 10, sparse),
}
"""Variables, budget, batch, limit state."""


@dataclass(frozen=True)
class Task:
    """A problem at a size.

    Attributes:
        campaign: its settings, with the simulator.
        fresh: number of designs that score.
        code: folder of the simulator's code.
    """

    base: Campaign
    simulator: Problem | None
    fresh: int
    code: Path | None = None

    def campaign(self, **changes: Any) -> Campaign:
        """The campaign with other settings."""
        return Campaign.of(self.base.settings.changed(changes), self.code, simulator=self.simulator)

    def answers(self, X: Array) -> peers.Answers:
        """Simulated designs without numerical failures; margins of the bearing."""
        outcome, margin = self.base.simulator.run(X).outcome, np.full(len(X), math.nan)
        if self.simulator is None and self.code is None:
            margin = peers.failure_margin(X, simulate(X, threads=1))
        kept = outcome != NUMERICAL_FAILURE
        return peers.Answers(X[kept], outcome[kept] == len(self.base.simulator.outcomes) - 1, margin[kept])


@cache
def task(name: str) -> Task:
    """The problem of a name."""
    if name == "building-6d":
        settings = read_settings(BUILDING).changed(
            {"sampling.initial": 60, "sampling.budget": 120, "acquisition.boundary": "failure", "validation.size": 0}
            | {"classifier.learns": "outcomes"}
        )
        return Task(Campaign.of(settings, BUILDING.parent), None, 1_000, BUILDING.parent)
    if name in mixed.PROBLEMS:
        problem = replace(mixed.problem_of(name), shown=None)
        sizes = {"sampling__initial": mixed.INITIAL, "sampling__budget": mixed.SIZES[-1], "sampling__batch": 5}
        return Task(problem.campaign(**sizes), problem, mixed.FRESH)
    if name.startswith("bearing"):
        _, features, *budget = name.split("-")
        budget = int(budget[0]) if budget else 200
        sizes = {"sampling__initial": budget // 2, "sampling__budget": budget}
        return Task(campaign_of(classifier__features=features, **sizes), None, 5_000)
    d, budget, batch, limit = LIMITS[name]
    space = standard(d) if name.startswith("branches") else variables(*[("uniform", 0.0, 1.0)] * d)
    problem = Problem(limit, space, shown=None)
    sizes = {"sampling__initial": budget // 2, "sampling__budget": budget, "sampling__batch": batch}
    return Task(problem.campaign(**sizes), problem, 20_000)


PROBLEMS = (*LIMITS, "bearing-paper", "bearing-collision", "building-6d", *mixed.PROBLEMS)


@cache
def fresh(name: str) -> peers.Answers:
    """Fresh designs of a problem and their outcomes."""
    if name in mixed.PROBLEMS:
        X, failed = mixed.fresh(name)
        return peers.Answers(X, failed, np.full(len(X), math.nan))
    n, space = task(name).fresh, task(name).base.space
    return task(name).answers(space.sobol(1 << (n - 1).bit_length(), np.random.default_rng(777))[:n])


def near_copies(campaign: Campaign, history: History) -> dict[str, int]:
    """The designs that were chosen in batches, and how many of them are near copies of another one of their batch."""
    F = campaign.features(history.designs)
    F = F / np.ptp(campaign.features(campaign.space.sobol(4096, np.random.default_rng(0))), axis=0) / F.shape[1] ** 0.5
    batches = [F[history.iteration == iteration] for iteration in range(1, history.last_iteration + 1)]
    nearest = np.concatenate([(cdist(of, of) + np.diag(np.full(len(of), np.inf))).min(axis=1) for of in batches])
    return {"chosen": len(nearest)} | {f"near {p}": int((nearest < 0.01 * p).sum()) for p in NEAR}


def failure_probability(name: str, method: str, seed: int) -> Any:
    """What a campaign with a method has learned, a function of designs, (n, d) -> (n,), and its near copies."""
    if method in peers.PEERS:
        campaign = task(name).campaign(seed=seed)
        peer = peers.learned(method, campaign, task(name).answers)
        return lambda X: peer.probability(campaign.features(X)), {}
    sampling, _, continued = method.partition("-")
    learning.STARTED_AFRESH = 0 if continued else STARTED_AFRESH
    campaign = task(name).campaign(seed=seed)
    space, n = campaign.space, campaign.settings.sampling.budget
    rng = stream(seed, "static", n)
    match sampling:
        case "static":
            X = space.latin_hypercube(n, rng)
        case "random":
            X = space.from_unit(rng.random((n, space.dimension)))
        case "sobol":
            X = space.sobol(1 << (n - 1).bit_length(), rng)[:n]
        case _:
            X = None
            campaign = task(name).campaign(**{"seed": seed, "acquisition.criterion": sampling})
    if X is None:
        learned = in_memory(campaign)
        classifier, near = learned.classifier, near_copies(campaign, learned.history)
    else:
        classifier, near = learn_from(campaign, History.of_sample(X, campaign.simulator.run(X))), {}
    return lambda X: classifier.latents[-1].moments(classifier.features(X)).probability, near


def scored(name: str, method: str, seed: int) -> dict[str, Any]:
    """One campaign: its scores, and its processor seconds."""
    test = fresh(name)
    (probability, near), seconds = timed(failure_probability, name, method, seed)
    p = probability(test.X)
    return {
        "problem": name,
        "method": method,
        "seed": seed,
        "accuracy": np.mean((p > 0.5) == test.failed),
        "log_score": log_score(probability_of_truth(p, test.failed)),
        "seconds": round(seconds, 2),
        **near,
    }


def table(rows: Rows, problems: list[str], methods: list[str], reference: str, score: str) -> str:
    """A row for each problem and a column for each method, in Markdown."""
    means: dict[str, list[float]] = {method: [] for method in methods}
    least: dict[str, list[float]] = {method: [] for method in methods}

    def cell(name: str, method: str) -> str:
        own = {row["seed"]: 100.0 * row[score] for row in rows.of(problem=name, method=method)}
        if not own:
            return ""
        text = f"{np.median(list(own.values())):.1f}"
        base = {row["seed"]: 100.0 * row[score] for row in rows.of(problem=name, method=reference)}
        ahead = np.array([own[seed] - base[seed] for seed in own if seed in base])
        if method != reference and len(ahead) > 2:
            low, high = Estimate.over(ahead).of_mean
            text += f"; {ahead.mean():+.1f} ({low:+.1f} .. {high:+.1f})"
            means[method].append(ahead.mean())
            least[method].append(ahead.min())
        return text

    lines = [
        [name, str(task(name).base.settings.sampling.budget), *(cell(name, m) for m in methods)] for name in problems
    ]
    mean = [f"{np.mean(means[m]):+.2f}" if means[m] else "" for m in methods]
    worst = [f"{min(means[m]):+.1f}, {min(least[m]):+.1f}" if means[m] else "" for m in methods]

    def near(method: str, percent: int) -> str:
        of = [rows.of(problem=name, method=method) for name in problems]
        counts = [[(row[f"near {percent}"], row["chosen"]) for row in one if "chosen" in row] for one in of]
        sums = np.array([np.sum(one, axis=0) for one in counts if one])
        if not len(sums):
            return ""
        return f"{100.0 * sums[:, 0].sum() / sums[:, 1].sum():.1f}, {(100.0 * sums[:, 0] / sums[:, 1]).max():.1f}"

    seconds = [f"{np.median([row['seconds'] for row in rows.of(method=m)] or [np.nan]):.1f}" for m in methods]
    copies = [[f"near copies within {p} % [%]: all, worst problem", "", *(near(m, p) for m in methods)] for p in NEAR]
    ends = [["mean", "", *mean], ["worst problem, worst seed", "", *worst], *copies]
    ends.append(["seconds of a campaign", "", *seconds])
    return markdown(["problem", "simulations", *methods], lines + ends)


def main() -> None:
    options = asked(
        __doc__,
        problems=list(PROBLEMS),
        methods=list(METHODS),
        seeds=10,
        first_seed=3000,
        out=Path("criteria.jsonl"),
        table=False,
        reference="static",
        score="accuracy",
        write=Path,
    )
    options.problems = [one for name in options.problems for one in (mixed.PROBLEMS if name == "mixed" else [name])]
    rows, left_out = Rows(options.out), set()
    for seed in [] if options.table else range(options.first_seed, options.first_seed + options.seeds):
        for name in options.problems:
            for method in options.methods:
                if method in left_out or not rows.lack(problem=name, method=method, seed=seed):
                    continue
                try:
                    with one_thread(), warnings.catch_warnings():
                        warnings.simplefilter("ignore")  # of the libraries' optimisers
                        row = scored(name, method, seed)
                except ImportError as error:
                    left_out.add(method)
                    print(f"{method} is left out: {error}")
                    continue
                rows.add(**row)
                print("{problem:18} {method:14} seed {seed}  {accuracy:.4f}  {seconds:.1f} s".format(**row), flush=True)
    text = table(rows, options.problems, options.methods, options.reference, options.score)
    print(text)
    if options.write:
        write_between(options.write, BEGIN, END, text)


if __name__ == "__main__":
    main()
