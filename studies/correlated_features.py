"""Features of correlated variables: the variables, the copula's independent normals, or decorrelated variables.

    python studies/correlated_features.py --seeds 5

Two variables of each problem have the correlation ρ. Some limit states depend on their difference in units of its own
standard deviation ("difference", "ratio", "uniform", "gumbel"), others on their sum ("sum", "load"). The regression of
the margin learns from 30 designs, the classifier of outcomes from 80: Latin hypercubes in standard normal space, with
1.7 times the standard deviation for variables without bounds. The table gives means over the seeds of the log score
[nat] of 5,000 fresh designs, and of their share on the wrong side.
"""

import warnings
from itertools import product

import numpy as np
import torch
from scipy.special import log_ndtr, ndtri
from scipy.stats import qmc
from study import asked, head, line

from activefail.learning.features import FeatureMap, feature_map
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.margin import MarginLatent, fit_margin
from activefail.space.distributions import FAMILIES
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

SETS = ("design", "normals", "decorrelated")


def normal(name, mean=0.0, sd=1.0):
    return Parameter(name, mean - 6.4 * sd, mean + 6.4 * sd, distribution="normal", mean=mean, sd=sd)


def lognormal(name, mean, sd):
    bounds = mean * np.exp(np.array([-6.0, 6.0]) * sd / mean)
    return Parameter(name, *bounds, distribution="lognormal", mean=mean, sd=sd)


def gumbel(name, mean, sd):
    return Parameter(name, mean - 3.0 * sd, mean + 14.0 * sd, distribution="gumbel_max", mean=mean, sd=sd)


def problems(rho):
    """Name, variables (the last two correlated) and limit state; z is the difference in its standard deviations."""
    gap, total = np.sqrt(2.0 * (1.0 - rho)), np.sqrt(2.0 * (1.0 + rho))
    pair = (normal("x"), normal("y"))
    yield "difference", pair, lambda x, y: 2.5 - (x - y) / gap - 0.15 * ((x + y) / total) ** 2
    yield "sum", pair, lambda x, y: 2.5 - (x + y) / total + 0.1 * x**2
    loads = (lognormal("a", 50.0, 10.0), lognormal("b", 40.0, 8.0))
    yield "load", (lognormal("r", 120.0, 12.0), *loads), lambda r, a, b: 2.0 * r - 1.5 * a - 1.5 * b
    yield (
        "ratio",
        (lognormal("r", 3.0, 0.3), *loads),
        lambda r, a, b: np.log(r) - 1.1 - (a / 50.0 - b / 40.0) / np.sqrt(1.0 - rho) - 0.3 * np.sin(3.0 * r),
    )
    yield (
        "uniform",
        (Parameter("z", -1.0, 1.0), Parameter("x", -1.0, 1.0), Parameter("y", -1.0, 1.0)),
        lambda z, x, y: 0.6 - 0.8 * (x - y) / gap + 0.3 * np.sin(3.0 * z) + 0.2 * x,
    )
    yield (
        "gumbel",
        (normal("r", 100.0, 10.0), gumbel("a", 50.0, 10.0), gumbel("b", 40.0, 8.0)),
        lambda r, a, b: (
            r / 10.0 - 7.8 - 1.2 * (a / 10.0 - b / 8.0) / gap + 0.3 * np.sin(0.3 * (r - 100.0))  # a/10 − b/8 has mean 0
        ),
    )


def features_of(name, space):
    if name == "normals":
        return FeatureMap(space.names, space.to_normal, np.zeros(space.dimension, dtype=bool), space)
    return feature_map(name, space)


def drawn(space, n, rng):
    widened = np.where([FAMILIES[p.distribution].is_bounded for p in space.parameters], 1.0, 1.7)
    return space.from_normal(ndtri(qmc.LatinHypercube(space.dimension, rng=rng).random(n)) * widened)


def scores(parameters, limit, rho, seed):
    """Log score and share on the wrong side of each feature set, by regression and by classifier, (sets, 4)."""
    names = [p.name for p in parameters]
    space = DesignSpace(parameters, correlation=((*names[-2:], rho),))
    rng = np.random.default_rng(seed)
    few, many, fresh = drawn(space, 30, rng), drawn(space, 80, rng), drawn(space, 5000, rng)
    g = [limit(*X.T) for X in (few, many, fresh)]
    side, rows = np.where(g[2] <= 0.0, 1.0, -1.0), []
    for name in SETS:
        features = features_of(name, space)
        moments = MarginLatent(fit_margin(features(few), g[0])).moments(features(fresh))
        outcomes = VariationalGP("matern52").learned(features(many), g[1] <= 0.0).moments(features(fresh))
        z = moments.standardised, outcomes.mean / np.sqrt(1.0 + outcomes.sd**2)
        rows.append([value for one in z for value in (log_ndtr(side * one).mean(), np.mean(side * one < 0.0))])
    return rows


def main():
    seeds = asked(__doc__, seeds=5).seeds
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    columns = [f"{kind}, {name}" for kind, name in product(("margin", "outcomes"), SETS)]
    head("", "ρ", *columns)
    for rho in (0.3, 0.5, 0.7, 0.9, 0.99, 0.9999):
        for name, parameters, limit in problems(rho):
            table = np.mean([scores(parameters, limit, rho, seed) for seed in range(seeds)], axis=0)
            cells = [f"{row[part]:.4f} {100.0 * row[part + 1]:.2f} %" for part in (0, 2) for row in table]
            line(name, rho, *cells)


if __name__ == "__main__":
    main()
