"""Which criterion by default: accuracy of campaigns from outcomes alone, against static designs and other libraries.

    python benchmarks/criteria.py                                        all problems and methods, ten seeds
    python benchmarks/criteria.py --problems shell-3d --seeds 3          a quick look
    python benchmarks/criteria.py --table --write docs/which.md          the table of the finished campaigns

A method is `static` (a Latin hypercube of the whole budget), a criterion, or a peer of benchmarks/peers.py. With
`-continued` (`entropy-continued`), hyperparameters are learned from one start only, that of the previous iteration. All
but `static` start from the same Latin hypercube of half the budget. Campaigns run the loop in memory, with the default
classifier unless a problem says otherwise. Finished campaigns are lines of --out and are not run again.

Problems are in the unit cube, or in standard normal variables, and fail where their limit state is at most 0. The same
fresh designs score all methods of a problem: the share that the classifier puts on the right side of the boundary. A
cell of the table has the median over the seeds (least .. greatest) [%]; the mean difference to the static design of the
same seed with its 95 % interval [points]; the number of seeds. The last rows have the worst mean difference of a
problem and the worst difference of a seed, and the processor seconds of a campaign, as a median.
"""

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import peers
from numpy.typing import NDArray
from reliability_problems import Problem

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import CampaignSettings, read_settings
from activefail.execution.local import ThreadExecutor
from activefail.loop import learning
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import STARTED_AFRESH, accuracy, current, learn_from
from activefail.record.memory import MemoryStore
from activefail.sample_mean import Estimate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array
from activefail.surrogate.threads import one_thread

FIRST_SEED = 3000
METHODS = ("static", "entropy", "eavc", "static-continued", "entropy-continued")
PEERS = ("gpc", "aepsych")
BEGIN, END = "<!-- table of benchmarks/criteria.py -->", "<!-- end of the table -->"
BUILDING = Path(__file__).resolve().parent.parent / "campaigns" / "building.toml"


def distance(X: Array, *centre: float) -> Array:
    return np.linalg.norm(X - np.array(centre), axis=1)


def islands(*balls: tuple[float, ...]) -> Callable[[Array], Array]:
    """Failure inside balls, each by its centre and radius."""
    return lambda X: np.min([distance(X, *centre) - radius for *centre, radius in balls], axis=0)


def corners(X: Array) -> Array:
    """Two opposite corners of the cube."""
    opposite = np.arange(X.shape[1]) % 2
    return np.minimum(np.abs(X - opposite).sum(axis=1), np.abs(X - (1 - opposite)).sum(axis=1)) - 1.5


def lobe(X: Array) -> Array:
    """A curved boundary, and behind it a separate region."""
    main = 0.45 + 0.25 * np.sin(math.pi * X[:, 1]) + 0.3 * X[:, 2] * X[:, 3] + 0.1 * X[:, 4] - X[:, 0]
    return np.minimum(main, np.linalg.norm(X[:, :4] - [0.15, 0.8, 0.8, 0.3], axis=1) - 0.33)


def branches(Z: Array) -> Array:
    """Four half-spaces in pairs of eight normal variables."""
    return np.min(1.3 + (Z[:, ::2] + Z[:, 1::2]) / 2**0.5 * [1.0, -1.0, 1.0, -1.0], axis=1)


def sparse(X: Array) -> Array:
    """A wave in three of the variables."""
    return X[:, 1] - 0.5 - 0.3 * np.sin(2.0 * math.pi * X[:, 0]) + 0.3 * (X[:, 2] - 0.5)


LIMITS: dict[str, tuple[int, int, int, Callable[[Array], Array]]] = {
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
        simulator: replaces that of the settings.
        fresh: number of designs that score.
        code: folder of the simulator's code.
    """

    settings: CampaignSettings
    simulator: Problem | None
    fresh: int
    code: Path | None = None

    def campaign(self, **changes: Any) -> Campaign:
        """The campaign with other settings."""
        changed = self.settings.changed({key.replace("__", "."): value for key, value in changes.items()})
        return Campaign.of(changed, self.code, simulator=self.simulator)


@cache
def task(name: str) -> Task:
    """The problem of a name."""
    if name == "building-6d":
        settings = read_settings(BUILDING).changed(
            {"sampling.initial": 60, "sampling.budget": 120, "acquisition.boundary": "failure", "validation.size": 0}
            | {"classifier.learns": "outcomes"}
        )
        return Task(settings, None, 1_000, BUILDING.parent)
    if name.startswith("bearing"):
        sizes = {"sampling.initial": 100, "sampling.budget": 200}
        return Task(CampaignSettings().changed(sizes | {"classifier.features": name.split("-")[1]}), None, 4_000)
    d, budget, batch, limit = LIMITS[name]
    variable = ("normal", 0.0, 1.0) if name.startswith("branches") else ("uniform", 0.0, 1.0)
    problem = Problem((variable,) * d, limit, math.nan, labels=True)
    sizes = {"sampling.initial": budget // 2, "sampling.budget": budget, "sampling.batch": batch}
    settings = CampaignSettings().changed({"space": problem.space, "classifier.features": "design", **sizes})
    return Task(settings, problem, 20_000)


PROBLEMS = (*LIMITS, "bearing-paper", "bearing-collision", "building-6d")


@cache
def fresh(name: str) -> tuple[Array, NDArray[np.int8]]:
    """Fresh designs of a problem and their outcomes."""
    campaign = task(name).campaign()
    X = campaign.space.sobol(1 << (task(name).fresh - 1).bit_length(), np.random.default_rng(777))[: task(name).fresh]
    outcome = campaign.simulator.run(X).outcome
    return X[outcome != NUMERICAL_FAILURE], outcome[outcome != NUMERICAL_FAILURE]


def learned_by(name: str, method: str, seed: int) -> Callable[[Array, NDArray[np.int8]], float]:
    """Accuracy on designs, (n, d), and their outcomes, of a campaign with this method."""
    if method in PEERS:
        return learned_by_peer(name, method, seed)
    criterion, _, continued = method.partition("-")
    learning.STARTED_AFRESH = 0 if continued else STARTED_AFRESH
    campaign = task(name).campaign(seed=seed, **{} if criterion == "static" else {"acquisition__criterion": criterion})
    sampling, severity = campaign.settings.sampling, len(campaign.simulator.outcomes) - 1
    if criterion == "static":
        X = campaign.space.latin_hypercube(sampling.budget, stream(seed, "static", sampling.budget))
        classifier = learn_from(campaign, History.of_sample(X, campaign.simulator.run(X)))
    else:
        store = MemoryStore(campaign.schema)
        with ThreadExecutor(1) as executor:
            run(campaign, store, executor, sampling.budget)
        classifier = current(campaign, store, write=False).classifier
    return lambda X, outcome: accuracy(classifier, severity, X, outcome)


def learned_by_peer(name: str, method: str, seed: int) -> Callable[[Array, NDArray[np.int8]], float]:
    """The same, with a peer."""
    campaign = task(name).campaign(seed=seed)
    severity, sampling = len(campaign.simulator.outcomes) - 1, campaign.settings.sampling

    def simulated(X: Array) -> peers.Answers:
        outcome = campaign.simulator.run(X).outcome
        kept = outcome != NUMERICAL_FAILURE
        return peers.Answers(X[kept], outcome[kept] >= severity, np.full(int(kept.sum()), math.nan))

    sizes = peers.Sizes(sampling.initial, sampling.budget, sampling.batch)
    entry = peers.entries(1.0)[method]
    peer, _ = peers.campaign(entry, campaign.space, campaign.features, simulated, seed, sizes)
    return lambda X, outcome: peers.judged(peer, campaign.features(X), outcome >= severity)["accuracy"]


def cell(name: str, method: str, seed: int) -> dict[str, Any]:
    """One campaign: its accuracy, and its processor seconds."""
    X, outcome = fresh(name)
    began = time.process_time()
    accuracy_on = learned_by(name, method, seed)
    seconds = time.process_time() - began
    return {
        "problem": name,
        "method": method,
        "seed": seed,
        "budget": task(name).settings.sampling.budget,
        "accuracy": accuracy_on(X, outcome),
        "seconds": round(seconds, 2),
    }


def finished(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def table(lines: list[dict[str, Any]]) -> str:
    """A row for each problem and a column for each method, in Markdown."""
    by: dict[tuple[str, str], dict[int, dict[str, Any]]] = {}
    for line in lines:
        by.setdefault((line["problem"], line["method"]), {})[line["seed"]] = line
    methods = [method for method in (*METHODS, *PEERS) if any(method == other for _, other in by)]
    problems = [name for name in PROBLEMS if (name, "static") in by]
    rows = ["| problem | simulations | " + " | ".join(methods) + " |", "|---|---|" + "---|" * len(methods)]
    means: dict[str, list[float]] = {method: [] for method in methods}
    least: dict[str, list[float]] = {method: [] for method in methods}
    for name in problems:
        cells = []
        for method in methods:
            own = by.get((name, method), {})
            if not own:
                cells.append("")
                continue
            percent = 100.0 * np.array([line["accuracy"] for line in own.values()])
            text = f"{np.median(percent):.1f} ({percent.min():.1f} .. {percent.max():.1f})"
            static = by[name, "static"]
            ahead = 100.0 * np.array([own[i]["accuracy"] - static[i]["accuracy"] for i in own if i in static])
            if method != "static" and len(ahead) > 2:
                low, high = Estimate.over(ahead).of_mean
                text += f"; {ahead.mean():+.1f} ({low:+.1f} .. {high:+.1f})"
                means[method].append(ahead.mean())
                least[method].append(ahead.min())
            cells.append(f"{text}; {len(own)}")
        rows.append(f"| {name} | {task(name).settings.sampling.budget} | " + " | ".join(cells) + " |")
    worst = (f"{min(means[m]):+.1f}, {min(least[m]):+.1f}" if means[m] else "" for m in methods)
    rows.append("| worst problem, worst seed | | " + " | ".join(worst) + " |")
    seconds = (
        f"{np.median([line['seconds'] for (_, method), own in by.items() if method == m for line in own.values()]):.1f}"
        for m in methods
    )
    rows.append("| seconds of a campaign | | " + " | ".join(seconds) + " |")
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--methods", default=",".join((*METHODS, *PEERS)))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--out", type=Path, default=Path("criteria.jsonl"), help="file of finished campaigns")
    parser.add_argument("--table", action="store_true", help="only the table of the finished campaigns")
    parser.add_argument("--write", type=Path, help="page in which the table replaces what is between the marks")
    arguments = parser.parse_args()
    names, methods = arguments.problems.split(","), arguments.methods.split(",")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    done = {(line["problem"], line["method"], line["seed"]) for line in finished(arguments.out)}
    wanted = [(name, method, seed) for seed in seeds for name in names for method in methods]
    for key in [] if arguments.table else [key for key in wanted if key not in done]:
        with one_thread(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the peers' optimisers
            line = cell(*key)
        with arguments.out.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print("{problem:18} {method:14} seed {seed}  {accuracy:.4f}  {seconds:.1f} s".format(**line), flush=True)
    text = table([line for line in finished(arguments.out) if line["problem"] in names and line["method"] in methods])
    print(text)
    if arguments.write is not None:
        before, _, rest = arguments.write.read_text(encoding="utf-8").partition(BEGIN)
        _, _, after = rest.partition(END)
        arguments.write.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
