"""Campaigns in batches and asynchronous: how busy their workers are, and the accuracy after the same simulations.

    python studies/asynchronous.py --busy --workers 8
    python studies/asynchronous.py --accuracy --seeds 5 --features collision

Busy: a simulator sleeps for a time that depends on the design (uniform from a tenth of twice the mean to twice the
mean), on real threads. Printed is the share of the workers' time that they slept, from the first simulation to the
last. Learning and proposing take place in between, as in any campaign. An asynchronous campaign has --extra simulations
in flight beyond the workers.

Accuracy: the bearing model runs on workers with an imagined clock. A simulation takes a time that a lognormal
distribution (deviation of the logarithm 0.7) gives for its design, and learning takes no time. Results arrive in the
order of that clock. Scores are on fresh designs, with the difference of the two modes over seeds.
"""

import hashlib
import math
import time

import numpy as np
from comparison import FreshSet, measures
from study import VirtualTime, asked, campaign_of, head, in_memory, line, uniform

from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.seismic.ida.sample_mean import Estimate
from activefail.simulators.interface import NUMERICAL_FAILURE, Results

FIRST_SEED = 5000

MEASURES = {"accuracy": "failure accuracy", "log score": "log score", "accuracy of outcomes": "accuracy of outcomes"}


def share_of(design):
    """A pseudo-random number between 0 and 1 that depends only on the design."""
    return (int.from_bytes(hashlib.sha256(design.tobytes()).digest()[:6], "big") + 0.5) / 2.0**48


def seconds_of(design, results):
    """The lognormal's quantile, by the logistic approximation of the normal's: any unequal times will do."""
    u = share_of(design)
    return math.exp(0.7 * math.log(u / (1.0 - u)) / 1.702)


class Sleeping:
    """A ball in the unit cube whose simulation sleeps; records when each begins and ends."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), (), True

    def __init__(self, mean):
        self.mean, self.slept = mean, []

    def run(self, X):
        for design in X:
            began = time.perf_counter()
            time.sleep(self.mean * (0.2 + 1.8 * share_of(design)))
            self.slept.append((began, time.perf_counter()))
        outcome, nothing = np.linalg.norm(X - 0.5, axis=1) < 0.4, np.zeros(len(X))
        return Results(outcome.astype(np.int8), nothing.astype(np.int8), np.empty((len(X), 0)), nothing)


def busy(workers, extra, mean, simulations):
    head("", "workers", "simulations", "busy [%]", "wall clock [s]")
    for asynchronous in (False, True):
        batch, simulator = workers + extra if asynchronous else workers, Sleeping(mean)
        campaign = campaign_of(
            simulator,
            classifier__features="design",
            space={f"x{i}": {"low": 0.0, "high": 1.0} for i in range(4)},
            sampling={"initial": 4 * batch, "budget": simulations, "batch": batch, "asynchronous": asynchronous},
        )
        in_memory(campaign, ThreadExecutor(workers))
        begun, ended = np.array(simulator.slept).T
        took = ended.max() - begun.min()
        kind = f"asynchronous, {batch} in flight" if asynchronous else f"in batches of {batch}"
        line(kind, workers, simulations, f"{100.0 * (ended - begun).sum() / (workers * took):.1f}", f"{took:.0f}")


def accuracy(seeds, features, criterion, workers, fresh):
    base = {"classifier": {"features": features, "kernel": "matern52"}, "acquisition__criterion": criterion}
    X, scores = uniform(fresh, [778, 0]), {False: [], True: []}
    outcome = campaign_of(**base).simulator.run(X).outcome
    kept = outcome != NUMERICAL_FAILURE
    test = FreshSet(X[kept], outcome[kept], outcome[kept][:, None])
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        for asynchronous, of_kind in scores.items():
            campaign = campaign_of(**base, seed=seed, sampling__asynchronous=asynchronous)
            learned = in_memory(campaign, VirtualTime(workers, seconds_of))
            with one_thread():
                of_kind.append(measures(learned.classifier, campaign.severity, test))
        both = (f"{name} {scores[False][-1][key]:.4f} {scores[True][-1][key]:.4f}" for key, name in MEASURES.items())
        print(f"seed {seed}  in batches, asynchronous: {'  '.join(both)}", flush=True)
    head("", "in batches", "asynchronous", "difference")
    for key, name in MEASURES.items():
        before, after = (np.array([score[key] for score in of_kind]) for of_kind in scores.values())
        gain = Estimate.over(after - before) if seeds > 1 else None
        interval = f"{gain.mean:+.4f} ({gain.of_mean[0]:+.4f} to {gain.of_mean[1]:+.4f})" if gain else "–"
        line(name, f"{np.median(before):.4f}", f"{np.median(after):.4f}", interval)


def main():
    options = asked(
        __doc__,
        busy=False,
        accuracy=False,
        workers=8,
        extra=6,
        mean=2.0,
        simulations=300,
        seeds=5,
        features="collision",
        criterion="eavc",
        fresh=10_000,
    )
    if options.busy:
        busy(options.workers, options.extra, options.mean, options.simulations)
    if options.accuracy:
        accuracy(options.seeds, options.features, options.criterion, options.workers, options.fresh)


if __name__ == "__main__":
    main()
