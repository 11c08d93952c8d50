"""Compares criteria by what the classifier learns from the same number of bearing simulations.

The campaigns differ only in the criterion (and the seed) and are scored on the same fresh designs. A static Latin
hypercube of the same size is the reference.

    python experiments/criteria.py --seeds 3 --fresh 8000 --criteria static,entropy,globalmi
"""

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.campaign.settings import parse_settings
from activefail.loop.history import History
from activefail.loop.initial import initial_designs
from activefail.loop.learning import accuracy
from activefail.loop.proposing import next_designs
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, train
from activefail.surrogate.threads import one_thread

FIRST_SEED = 1000
CRITERIA = "static,entropy,u,straddle,bald,eavc,globalmi,sur"


def answered(campaign: Campaign, X: Array) -> tuple[Array, NDArray[np.int8]]:
    """Designs and outcomes without numerical failures."""
    outcome = campaign.simulator.run(X).outcome
    kept = outcome != NUMERICAL_FAILURE
    return X[kept], outcome[kept]


def fresh_designs(campaign: Campaign, n: int, cache: Path | None) -> tuple[Array, NDArray[np.int8]]:
    """n uniform designs and their outcomes, kept in a file between runs if one is named."""
    if cache is not None and cache.exists():
        with np.load(cache) as saved:
            return saved["X"], saved["outcome"]
    X, outcome = answered(campaign, campaign.space.from_unit(np.random.default_rng([777, 1]).random((n, 9))))
    if cache is not None:
        np.savez(cache, X=X, outcome=outcome)
    return X, outcome


def learned(campaign: Campaign, X: Array, outcome: NDArray[np.int8], warm: Classifier | None) -> Classifier:
    """The classifier of the campaign's settings on these designs."""
    kernel = campaign.settings.classifier.kernel
    return train(X, outcome, campaign.simulator.outcomes, campaign.features, kernel, warm)


def trajectory(
    campaign: Campaign, static: bool, budgets: list[int], test: tuple[Array, NDArray[np.int8]]
) -> list[tuple[float, float]]:
    """Accuracies on impact and failure at each budget."""
    scores = []
    if static:
        for n in budgets:
            X = campaign.space.latin_hypercube(n, stream(campaign.settings.seed, "static", n))
            classifier = learned(campaign, *answered(campaign, X), None)
            scores.append((accuracy(classifier, 1, *test), accuracy(classifier, 2, *test)))
        return scores
    X, outcome = answered(campaign, initial_designs(campaign))
    done, iteration, batch = campaign.settings.sampling.initial, 0, campaign.settings.sampling.batch
    classifier = learned(campaign, X, outcome, None)
    while True:
        if done in budgets:
            scores.append((accuracy(classifier, 1, *test), accuracy(classifier, 2, *test)))
        if done >= budgets[-1]:
            return scores
        iteration, done = iteration + 1, done + batch
        known = History(X, outcome, np.zeros(len(X), dtype=np.int64), np.zeros(len(X), dtype=np.int8))
        proposed = next_designs(
            campaign,
            classifier,
            known,
            stream(campaign.settings.seed, "propose", iteration),
            q=batch,
            chosen=(iteration - 1) * batch,
        )
        more_X, more_outcome = answered(campaign, proposed)
        X, outcome = np.concatenate([X, more_X]), np.concatenate([outcome, more_outcome])
        classifier = learned(campaign, X, outcome, classifier)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--criteria", default=CRITERIA)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--fresh", type=int, default=8000)
    parser.add_argument("--features", default="paper")
    parser.add_argument(
        "--settings", default="", help="additional settings in TOML, such as `acquisition.exploration = 0.1`"
    )
    parser.add_argument("--cache", type=Path, help="file (.npz) that keeps the fresh designs")
    arguments = parser.parse_args()
    budgets = [300, 400, 500]
    print(f"{'criterion':<10} {'seed':>5} {'simulations':>11} {'impact %':>9} {'failure %':>10} {'time [s]':>9}")
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        for name in arguments.criteria.split(","):
            static = name == "static"
            campaign = Campaign.of(
                parse_settings(
                    f"""
                    seed = {seed}
                    sampling = {{ initial = 250, budget = 500, batch = 10 }}
                    classifier = {{ features = "{arguments.features}", kernel = "matern52" }}
                    acquisition.criterion = "{"entropy" if static else name}"
                    {arguments.settings}
                    """,
                    "benchmark",
                )
            )
            test = fresh_designs(campaign, arguments.fresh, arguments.cache)
            began = time.perf_counter()
            with one_thread():
                scores = trajectory(campaign, static, budgets, test)
            seconds = time.perf_counter() - began
            for n, (impact, failure) in zip(budgets, scores, strict=True):
                print(
                    f"{name:<10} {seed:>5} {n:>11} {100 * impact:>9.2f} {100 * failure:>10.2f} {seconds:>9.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
