"""Compares ways to compute probabilities of three outcomes from the latents of two nested boundaries.

    python experiments/outcomes.py collision --static 500 --seeds 1000 1001 --fresh 778 8
    python experiments/outcomes.py collision --active 500 --criterion eavc --impact 0.3 --couplings consistent

No impact < impact < failure. Latent 1 gives P1 = P(impact or worse), latent 2 P2 = P(failure), each learned from all
designs. Pc is the probability of failure given an impact, learned from the designs with one. Pb is that of an impact
given no failure, learned from the designs without failure. Scores on fresh designs: mean log probability of the true
outcome [nat, times 100], and the shares [%] of right outcomes and of right sides of the failure and impact boundaries.
"""

import argparse
from typing import NamedTuple

import numpy as np
import torch

from activefail.acquisition.batch_proposal import propose_shared
from activefail.acquisition.criteria import criterion
from activefail.bearing import TABLE_1, simulate
from activefail.features import feature_map
from activefail.surrogate.classifier import Latent, train
from activefail.surrogate.fitting import fit

INITIAL, FRESH = 250, 8000


class Sampling(NamedTuple):
    """How active designs are chosen; the share `impact` of those without exploration targets the impact boundary."""

    criterion: str = "entropy"
    impact: float = 0.0
    exploration: float = 0.0
    batch: int = 10


def outcome_of(X):
    """0 no impact, 1 impact, 2 failure, (n,)."""
    return simulate(X, threads=1).outcome


def learn(features, X, beyond):
    return Latent(fit(torch.from_numpy(features(X)), torch.from_numpy(np.where(beyond, 1.0, -1.0)), "matern52"))


def designs(features, n, active, seed, sampling=None):
    """A Latin hypercube of n designs, or one of 250 that active sampling extends to n."""
    sampling = Sampling() if sampling is None else sampling
    start = INITIAL if active else n
    X = TABLE_1.latin_hypercube(start, np.random.default_rng([seed, start]))
    outcome, classifier = outcome_of(X), None
    boundaries = {"failure": 1.0 - sampling.impact, "impact": sampling.impact}
    while len(X) < n:
        classifier = train(X, outcome, ("no impact", "impact", "failure"), features, "matern52", classifier)
        batch = propose_shared(
            classifier,
            TABLE_1,
            criterion(sampling.criterion),
            boundaries=boundaries,
            exploration=sampling.exploration,
            first=len(X) - INITIAL,
            q=min(sampling.batch, n - len(X)),
            rng=np.random.default_rng([seed, len(X)]),
        )
        X, outcome = np.concatenate([X, batch]), np.concatenate([outcome, outcome_of(batch)])
    return X, outcome


def couplings(P1, P2, Pc, Pb):
    """Probabilities of the three outcomes, (n, 3), by the name of the coupling."""

    def nested(first, second):
        return np.column_stack([1.0 - first, first - second, second])

    joint = np.column_stack([(1.0 - P1) * (1.0 - P2), P1 * (1.0 - P2), P1 * P2])
    return {
        "maximum": nested(np.maximum(P1, P2), P2),
        "consistent": joint / joint.sum(axis=1, keepdims=True),
        "product": nested(P1, P1 * P2),
        "continued forward": nested(P1, P1 * Pc),
        "continued backward": nested(1.0 - (1.0 - P2) * (1.0 - Pb), P2),
    }


def judged(p, outcome):
    result = np.clip(p[np.arange(len(p)), outcome], 1e-12, None)
    return (
        np.log(result).mean(),
        np.mean(p.argmax(axis=1) == outcome),
        np.mean((p[:, 2] > 0.5) == (outcome == 2)),
        np.mean((p[:, 0] < 0.5) == (outcome >= 1)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", help="feature sets: paper, design, sliding, collision")
    parser.add_argument("--static", nargs="*", type=int, default=[], help="sizes of static samples")
    parser.add_argument("--active", nargs="*", type=int, default=[], help="budgets of active learning")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1000])
    parser.add_argument("--fresh", nargs="+", type=int, default=[777, 8], help="seed of the fresh designs")
    parser.add_argument("--couplings", nargs="+", help="names; all by default")
    parser.add_argument("--criterion", default="entropy")
    parser.add_argument("--impact", type=float, default=0.0, help="share of active designs for the impact boundary")
    parser.add_argument("--exploration", type=float, default=0.0)
    parser.add_argument("--batch", type=int, default=10)
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    X_fresh = TABLE_1.from_unit(np.random.default_rng(arguments.fresh).random((FRESH, TABLE_1.dimension)))
    happened = outcome_of(X_fresh)
    sampling = Sampling(arguments.criterion, arguments.impact, arguments.exploration, arguments.batch)
    for name in arguments.sets:
        features = feature_map(name, TABLE_1)
        F = features(X_fresh)
        for n, active in [(n, False) for n in arguments.static] + [(n, True) for n in arguments.active]:
            for seed in arguments.seeds:
                X, outcome = designs(features, n, active, seed, sampling)
                among = [(outcome >= 0, 1), (outcome >= 0, 2), (outcome >= 1, 2), (outcome <= 1, 1)]
                p = [learn(features, X[r], outcome[r] >= least).moments(F).probability for r, least in among]
                for coupling, probabilities in couplings(*p).items():
                    if arguments.couplings and coupling not in arguments.couplings:
                        continue
                    figures = "  ".join(f"{100.0 * figure:8.3f}" for figure in judged(probabilities, happened))
                    how = "active" if active else "static"
                    print(f"{name:10} {how} {n} seed {seed}  {coupling:18}  {figures}", flush=True)


if __name__ == "__main__":
    main()
