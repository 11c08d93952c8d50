"""The cost of the regression of a margin: fitting, and the predictions of one proposal.

    python studies/margin_regression.py

Half of the designs are spread and half lie near the boundary of a smooth margin, as in a campaign. With "truncated",
no margin is below 0. Each case is measured in a fresh process. The table gives the processor time of a fit without an
earlier one, of a fit to 1 % more designs, and of predictions at 12,000 designs; the largest memory of the process; and
for 4,000 fresh designs the share on the wrong side of the boundary and the log score [nat], beside those of the
classifier of the outcomes.
"""

import resource
from itertools import product

import numpy as np
import torch
from scipy.special import log_ndtr
from study import asked, head, line, parallel, timed

from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.margin import MarginLatent, fit_margin


def margin(X):
    return 3.0 - X.sum(axis=1) / np.sqrt(X.shape[1]) + 0.3 * np.sin(2.0 * X[:, 0]) + 0.1 * X[:, 1] * X[:, 2]


def drawn(n, dimension, rng):
    X, pool = (1.5 * rng.standard_normal((size, dimension)) for size in (n, 10 * n))
    near = np.argsort(np.abs(margin(pool)))[: 2 * n]
    X[n // 2 :] = pool[rng.permutation(near)[: n - n // 2]]
    return X[rng.permutation(n)]


def measured(n, dimension, truncated):
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    more = drawn(n + n // 100, dimension, rng)
    g = np.maximum(margin(more), 0.0) if truncated else margin(more)
    fresh = 1.5 * rng.standard_normal((12_000, dimension))
    side = np.where(margin(fresh) <= 0.0, 1.0, -1.0)[:4000]
    trained, cold = timed(fit_margin, more[:n], g[:n], truncated)
    _, warm = timed(fit_margin, more, g, truncated, trained)
    moments, prediction = timed(MarginLatent(trained).moments, fresh)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    outcomes = VariationalGP("matern52").learned(more[:n], g[:n] <= 0.0).moments(fresh[:4000])
    z = moments.standardised[:4000], outcomes.mean / np.sqrt(1.0 + outcomes.sd**2)
    return [cold, warm, prediction, memory], [
        (100.0 * np.mean(side * one < 0.0), log_ndtr(side * one).mean()) for one in z
    ]


def main():
    sizes = asked(__doc__, sizes=[500, 1000, 2000, 5000, 10000]).sizes
    head("", "cold s", "warm s", "predict s", "MB", "margin: wrong, score", "outcomes")
    for dimension, truncated, n in product((5, 30), (False, True), sizes):
        for (cold, warm, prediction, memory), scores in parallel(measured, [(n, dimension, truncated)]):
            cells = [f"{wrong:.2f} % {score:.4f}" for wrong, score in scores]
            times = f"{cold:.1f}", f"{warm:.2f}", f"{prediction:.1f}", f"{memory:.0f}"
            line(f"{dimension}-d {'truncated ' if truncated else ''}{n}", *times, *cells)


if __name__ == "__main__":
    main()
