"""Campaigns in batches and asynchronous: how busy their workers are, and the accuracy after the same simulations.

    python benchmarks/asynchronous.py --busy --workers 8
    python benchmarks/asynchronous.py --accuracy --seeds 5 --features collision

Busy: a simulator sleeps for a time that depends on the design (uniform from a tenth of twice the mean to twice the
mean), on real threads. Printed is the share of the workers' time that they slept, from the first simulation to the
last. Learning and proposing take place in between, as in any campaign.

Accuracy: the bearing model runs on workers with an imagined clock. A simulation takes a time that a lognormal
distribution (deviation of the logarithm 0.7) gives for its design, and learning takes no time. Results arrive in the
order of that clock. Scores are on fresh designs, with the difference of the two modes over seeds.
"""

import argparse
import hashlib
import heapq
import math
import time
from collections.abc import Callable

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings, parse_settings
from activefail.comparison.measures import FreshSet, measures
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.learning import current_classifier
from activefail.record.memory import MemoryStore
from activefail.sample_mean import Estimate
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator
from activefail.space import Array
from activefail.surrogate.threads import one_thread

FIRST_SEED = 5000

MEASURES = {"accuracy": "failure accuracy", "log_score": "log score", "outcome_accuracy": "accuracy of outcomes"}


def share_of(design: Array) -> float:
    """A pseudo-random number between 0 and 1 that depends only on the design."""
    return (int.from_bytes(hashlib.sha256(design.tobytes()).digest()[:6], "big") + 0.5) / 2.0**48


class Sleeping:
    """A ball in the unit cube whose simulation sleeps; records when each begins and ends."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), (), True

    def __init__(self, mean: float) -> None:
        self.mean = mean
        self.slept: list[tuple[float, float]] = []

    def run(self, X: Array) -> Results:
        answers = []
        for design in X:
            began = time.perf_counter()
            time.sleep(self.mean * (0.2 + 1.8 * share_of(design)))
            self.slept.append((began, time.perf_counter()))
            answers.append(float(np.linalg.norm(design - 0.5) < 0.4))
        n = len(X)
        return Results(np.array(answers, dtype=np.int8), np.zeros(n, dtype=np.int8), np.empty((n, 0)), np.zeros(n))


class ImaginedWorkers:
    """Workers whose simulations take an imagined time; real time passes only for the computation."""

    def __init__(self, workers: int) -> None:
        self._now = 0.0
        self._free = [0.0] * workers
        self._ends: list[tuple[float, int, Results]] = []

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        return simulator.run(X)

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        # The lognormal's quantile, by the logistic approximation of the normal's: any unequal times will do.
        u = share_of(x)
        seconds = math.exp(0.7 * math.log(u / (1.0 - u)) / 1.702)
        end = max(self._now, heapq.heappop(self._free)) + seconds
        heapq.heappush(self._free, end)
        heapq.heappush(self._ends, (end, ticket, simulator.run(x[None])))

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        self._now, ticket, results = heapq.heappop(self._ends)
        return [(ticket, results)]

    def __enter__(self) -> "ImaginedWorkers":
        return self

    def __exit__(self, *exception: object) -> None: ...


def busy(workers: int, extra: int, mean: float, simulations: int) -> None:
    space = "\n".join(f"space.x{i} = {{ low = 0.0, high = 1.0 }}" for i in range(4))
    for asynchronous in (False, True):
        batch = workers + extra if asynchronous else workers
        text = f"""
            classifier.features = "design"
            {space}
            [sampling]
            initial = {4 * batch}
            budget = {simulations}
            batch = {batch}
            asynchronous = {str(asynchronous).lower()}"""
        simulator = Sleeping(mean)
        campaign = Campaign.of(parse_settings(text, "busy"), simulator=simulator)
        with ThreadExecutor(workers) as executor:
            run(campaign, MemoryStore(campaign.schema), executor, simulations)
        begun, ended = np.array(simulator.slept).T
        share = (ended - begun).sum() / (workers * (ended.max() - begun.min()))
        kind = f"without batches, {batch} in flight" if asynchronous else f"in batches of {batch}"
        print(
            f"{kind:<32} {workers} workers, {simulations} simulations of {mean:g} s in the mean: "
            f"{100 * share:.1f} % busy, {ended.max() - begun.min():.0f} s",
            flush=True,
        )


def accuracy(seeds: int, features: str, criterion: str, workers: int, fresh: int) -> None:
    base = {"classifier.features": features, "classifier.kernel": "matern52", "acquisition.criterion": criterion}
    campaign = Campaign.of(CampaignSettings().changed(base))
    X = campaign.space.from_unit(np.random.default_rng([778, 0]).random((fresh, campaign.space.dimension)))
    with ThreadExecutor(2) as executor:
        outcome = executor.run(campaign.simulator, X).outcome
    kept = outcome != NUMERICAL_FAILURE
    test = FreshSet(X[kept], outcome[kept], outcome[kept][:, None])
    scores_by_kind: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        for asynchronous, scores in scores_by_kind.items():
            changes = base | {"seed": seed, "sampling.asynchronous": asynchronous}
            campaign = Campaign.of(CampaignSettings().changed(changes))
            store = MemoryStore(campaign.schema)
            run(campaign, store, ImaginedWorkers(workers), campaign.settings.sampling.budget)
            with one_thread():
                classifier = current_classifier(campaign, store, write=False)
                scores.append(measures(classifier, campaign.severity, test))
        line = "  ".join(
            f"{name} {scores_by_kind[False][-1][measure]:.4f} {scores_by_kind[True][-1][measure]:.4f}"
            for measure, name in MEASURES.items()
        )
        print(f"seed {seed}  in batches, without: {line}", flush=True)
    for measure, name in MEASURES.items():
        before, after = (np.array([score[measure] for score in scores_by_kind[kind]]) for kind in (False, True))
        gain = Estimate.over(after - before) if seeds > 1 else None
        difference = ""
        if gain is not None:
            difference = f", difference {gain.mean:+.4f} ({gain.of_mean[0]:+.4f} to {gain.of_mean[1]:+.4f})"
        print(f"{name}: in batches {np.median(before):.4f}, without {np.median(after):.4f}{difference}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--accuracy", action="store_true")
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--extra", type=int, default=6, help="in flight beyond the workers")
    parser.add_argument("--mean", type=float, default=2.0, help="seconds of a sleep")
    parser.add_argument("--simulations", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--features", default="collision")
    parser.add_argument("--criterion", default="eavc")
    parser.add_argument("--fresh", type=int, default=10_000)
    options = parser.parse_args()
    if options.busy:
        busy(options.workers, options.extra, options.mean, options.simulations)
    if options.accuracy:
        accuracy(options.seeds, options.features, options.criterion, options.workers, options.fresh)


if __name__ == "__main__":
    main()
