"""Compares feature sets by accuracy at the failure boundary and number of simulations.

    python experiments/features.py --static 500 --active 500 --seeds 3000 3001 paper sliding collision

For each seed a classifier learns from a Latin hypercube (static), or from one of 250 that entropy sampling extends in
batches of 10 (active). Options select another kernel, criterion or batch, or a share of each batch that is drawn at
random. Every classifier is scored on the same 8,000 fresh designs: the share on the right side of the failure boundary
and the mean log2 probability of the true label. The cost of the features is compared with that of the bearing model.
"""

import argparse
import time

import numpy as np
import torch

from activefail.acquisition.batch_proposal import propose
from activefail.acquisition.criteria import criterion
from activefail.bearing import TABLE_1, simulate
from activefail.bearing.outcome import FAILURE
from activefail.features import FeatureMap, feature_map
from activefail.surrogate.classifier import Latent
from activefail.surrogate.fitting import fit

INITIAL, FRESH = 250, 8000


def fails(X):
    """Whether designs fail, as labels -1 and 1, (n,)."""
    return np.where(simulate(X, threads=1).outcome == FAILURE, 1.0, -1.0)


def learn(features: FeatureMap, X, y, kernel, warm: Latent | None = None) -> Latent:
    start = None if warm is None else warm.trained
    return Latent(fit(torch.from_numpy(features(X)), torch.from_numpy(y), kernel, start))


def judged(latent: Latent, F, y) -> str:
    moments = latent.moments(F)
    p = np.clip(np.where(y > 0.0, moments.probability, 1.0 - moments.probability), 1e-9, None)
    return f"accuracy {np.mean((moments.mean > 0.0) == (y > 0.0)):.4f}  bits {np.mean(np.log2(p)):.4f}"


def static(features, n, options, seed, F_fresh, y_fresh) -> str:
    X = TABLE_1.latin_hypercube(n, np.random.default_rng([seed, n]))
    return judged(learn(features, X, fails(X), options.kernel), F_fresh, y_fresh)


def active(features, options, seed, F_fresh, y_fresh):
    """Yields each budget and the classifier at that budget."""
    X = TABLE_1.latin_hypercube(INITIAL, np.random.default_rng([seed, INITIAL]))
    y, latent, budgets = fails(X), None, options.active
    at_random = round(options.exploration * options.batch)
    while True:
        latent = learn(features, X, y, options.kernel, latent)
        if len(X) in budgets:
            yield len(X), judged(latent, F_fresh, y_fresh)
        if len(X) >= max(budgets):
            return
        rng = np.random.default_rng([seed, len(X)])
        batch = propose(latent, features, TABLE_1, criterion(options.criterion), options.batch - at_random, rng)
        if at_random:
            batch = np.concatenate([batch, TABLE_1.latin_hypercube(at_random, rng)])
        X, y = np.concatenate([X, batch]), np.concatenate([y, fails(batch)])


def milliseconds(function, X) -> float:
    function(X[:2])  # compiled before the clock runs
    began = time.perf_counter()
    function(X)
    return 1e3 * (time.perf_counter() - began) / len(X)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", help="paper, design, sliding, collision")
    parser.add_argument("--static", nargs="*", type=int, default=[], help="sizes of static samples")
    parser.add_argument("--active", nargs="*", type=int, default=[], help="budgets at which active learning is scored")
    parser.add_argument("--seeds", nargs="+", type=int, default=[3000])
    parser.add_argument("--fresh", nargs="+", type=int, default=[5151, 1], help="seed of the fresh designs")
    parser.add_argument("--kernel", default="matern52")
    parser.add_argument("--criterion", default="entropy")
    parser.add_argument("--batch", type=int, default=10)
    parser.add_argument("--exploration", type=float, default=0.0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    X = TABLE_1.from_unit(np.random.default_rng(arguments.fresh).random((FRESH, TABLE_1.dimension)))
    y = fails(X)
    print(f"bearing model  {milliseconds(lambda X: simulate(X, threads=1), X[:500]):.3f} ms")
    for name in arguments.sets:
        features = feature_map(name, TABLE_1)
        print(f"{name:14} {milliseconds(features, X[:500]):.3f} ms")
    for seed in arguments.seeds:
        for name in arguments.sets:
            features = feature_map(name, TABLE_1)
            F = features(X)
            for n in arguments.static:
                print(f"{name:10} seed {seed}  static {n:5}  {static(features, n, arguments, seed, F, y)}", flush=True)
            if arguments.active:
                for n, verdict in active(features, arguments, seed, F, y):
                    print(f"{name:10} seed {seed}  active {n:5}  {verdict}", flush=True)


if __name__ == "__main__":
    main()
