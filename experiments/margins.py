"""Do margins help? The failure boundary learned from labels together with each simulation's distance from failure.

    python experiments/margins.py collision --static 500 --seeds 1000 1001 1002

One Gaussian process has two outputs with a free correlation: a latent with the probit likelihood, and the margin
(signed root of `peers.failure_margin`, each side scaled by its mean size) with Gaussian noise. So survivors and
failures also show how close they were. Scores are those of kernels.py, compared with the labels alone.
"""

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import torch
from kernels import PROBIT, Variant, correlation, log_score
from outcomes import FRESH, INITIAL, designs, outcome_of
from scipy.optimize import minimize
from scipy.special import ndtr

from activefail.bearing import TABLE_1, simulate
from activefail.features import feature_map
from activefail.surrogate import sites
from activefail.surrogate.sites import Sites

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

from peers import failure_margin


class WithMargins(Variant):
    """theta: 0, log scale and log length scales, log scale of the margin, artanh of the correlation, log noise."""

    def __init__(self, F, labels, margin):
        self.parts, self.threshold = [], False
        self.n, self.m = F.shape
        # The last column says which output a row is of.
        of_output = [np.column_stack([F, np.full(self.n, output)]) for output in (0.0, 1.0)]
        self.F = torch.from_numpy(np.concatenate(of_output))
        self.labels = torch.from_numpy(np.concatenate([labels, margin]))
        precision = np.repeat([0.1, 10.0], self.n)
        self.sites = Sites(self.labels * torch.from_numpy(precision), torch.from_numpy(precision))
        start = [0.0, math.log(10.0)] + [0.5 * math.log(self.m)] * self.m + [0.0, 1.0, math.log(0.3)]
        bounds = [(0.0, 0.0), (-5.0, 12.0)] + [(-5.0, 8.0)] * self.m + [(-4.0, 4.0), (-3.0, 3.0), (-4.0, 1.0)]
        options = {"ftol": 1e-5, "gtol": 1e-2, "maxiter": 100}
        self.at(minimize(self.objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x)

    def covariance(self, theta, A, B):
        length = torch.exp(theta[2 : 2 + self.m])
        scale = torch.exp(0.5 * theta[[1, 2 + self.m]])
        a, b = A[:, -1].long(), B[:, -1].long()
        same = torch.where(a.unsqueeze(1) == b, torch.ones_like(scale[0]), torch.tanh(theta[3 + self.m]))
        return scale[a].unsqueeze(1) * scale[b] * same * correlation("matern52", A[:, :-1] / length, B[:, :-1] / length)

    def log_prior(self, theta):
        means = [math.log(10.0)] + [math.sqrt(2.0) + 0.5 * math.log(self.m)] * self.m + [0.0, 1.0, -1.0]
        deviations = [2.0] + [math.sqrt(3.0)] * self.m + [2.0, 1.0, 1.0]
        return -0.5 * (((theta[1:] - torch.tensor(means)) / torch.tensor(deviations)) ** 2).sum()

    def likelihood(self, theta):
        noise = math.exp(2.0 * theta[-1])

        def expected(labels, mean, variance):
            n = self.n
            of_labels = PROBIT(labels[:n], mean[:n], variance[:n])
            off = labels[n:] - mean[n:]
            value = -0.5 * math.log(2.0 * math.pi * noise) - 0.5 * (off * off + variance[n:]) / noise
            of_margins = value, off / noise, torch.full_like(off, 1.0 / noise)
            return tuple(torch.cat(pair) for pair in zip(of_labels, of_margins, strict=True))

        return expected

    def objective(self, theta, tolerance=1e-4):
        value, gradient = super().objective(theta, tolerance)
        by_noise = [
            float(self.likelihood(np.append(theta[:-1], theta[-1] + step))(self.labels, *self.moments())[0].sum())
            for step in (1e-4, -1e-4)
        ]
        gradient[-1] -= (by_noise[0] - by_noise[1]) / 2e-4
        gradient[0] = 0.0
        return value, gradient

    def solve(self, theta, K, tolerance):
        self.solved = super().solve(theta, K, tolerance)
        return self.solved

    def moments(self):
        return self.solved.mean, self.solved.variance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", help="feature set: paper, design, sliding, collision")
    parser.add_argument("--static", nargs="*", type=int, default=[], help="sizes of static samples")
    parser.add_argument("--active", nargs="*", type=int, default=[], help=f"budgets, the first {INITIAL} static")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1000])
    parser.add_argument("--fresh", nargs="+", type=int, default=[777, 8], help="seed of the fresh designs")
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    features = feature_map(arguments.set, TABLE_1)
    X_fresh = TABLE_1.from_unit(np.random.default_rng(arguments.fresh).random((FRESH, TABLE_1.dimension)))
    failed, F_fresh = outcome_of(X_fresh) == 2, features(X_fresh)
    for n, active in [(n, False) for n in arguments.static] + [(n, True) for n in arguments.active]:
        for seed in arguments.seeds:
            sites.probit_expectations = PROBIT
            X, outcome = designs(features, n, active, seed)
            F, labels = features(X), np.where(outcome == 2, 1.0, -1.0)
            margin = failure_margin(X, simulate(X, threads=1))
            margin = np.sign(margin) * np.sqrt(np.abs(margin))
            for side in (margin > 0.0, margin <= 0.0):
                margin[side] /= np.abs(margin[side]).mean()
            alone = Variant("matern52", F, labels)
            both = WithMargins(F, labels, margin)
            of_labels = np.column_stack([F_fresh, np.zeros(len(F_fresh))])
            for name, z in {"labels": alone.probit(F_fresh), "with margins": both.probit(of_labels)}.items():
                score = log_score(ndtr(np.where(failed, z, -z)))
                right = 100.0 * np.mean((z > 0.0) == failed)
                print(f"{'active' if active else 'static'} {n} seed {seed}  {name:13} {right:8.3f}  {score:8.3f}")
            rho, noise = np.tanh(both.theta[-2]), math.exp(both.theta[-1])
            print(f"    correlation {rho:.3f}, noise of the margin {noise:.3f}", flush=True)


if __name__ == "__main__":
    main()
