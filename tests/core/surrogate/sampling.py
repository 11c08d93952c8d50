"""Exact posteriors of small probit problems, by long Markov chains."""

import math

import numpy as np
from scipy.special import log_ndtr


def elliptical_slice_sampling(K, mean, signs, chains, steps, rng):
    """Samples of f, (steps, chains, n), of independent chains from the prior on (Murray, Adams and MacKay 2010)."""
    L = np.linalg.cholesky(K + 1e-10 * np.eye(len(K)))
    g = rng.standard_normal((chains, len(K))) @ L.T
    samples = []

    def log_likelihood(g):
        return log_ndtr(signs * (mean + g)).sum(1)

    for _ in range(steps):
        nu = rng.standard_normal(g.shape) @ L.T
        height = log_likelihood(g) + np.log(rng.random(chains))
        angle = rng.uniform(0.0, 2.0 * math.pi, chains)
        low, high = angle - 2.0 * math.pi, angle.copy()
        following, left = g.copy(), np.arange(chains)
        while len(left):
            trial = g[left] * np.cos(angle[left])[:, None] + nu[left] * np.sin(angle[left])[:, None]
            accepted = log_likelihood(trial) > height[left]
            following[left[accepted]] = trial[accepted]
            left = left[~accepted]
            below = angle[left] < 0.0
            low[left[below]], high[left[~below]] = angle[left[below]], angle[left[~below]]
            angle[left] = rng.uniform(low[left], high[left])
        g = following
        samples.append(mean + g)
    return np.stack(samples)
