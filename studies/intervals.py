"""Intervals of a probability by a classifier that is far too sure: do upper ends hold (docs/decisions/0019)?

    python studies/intervals.py --repeats 100
    python studies/intervals.py --exact --repeats 60                 classifiers that are exact, of problems.py

Two standard normal variables. Failure is beyond a line with a wave, and in isolated cells; the classifier knows neither
the wave nor the cells. The plan is sceptical, as for questions from outcomes, or trusts the classifier where it is
sure, with 300 simulations. The table gives the probability beyond the line, the standard deviation of the classifier's
latent, the isolated share, the probability, the shares of the upper and lower ends of 96 % that hold, the share of the
upper ends that hold where no isolated failure was seen (and how often that is), and the median upper end over the
probability.

With --exact, 50 fresh simulations correct nothing, and the interval is the error of the integration. The table gives
the share of nominal 90 % intervals that contain the probability, and their median width over it.
"""

import itertools

import numpy as np
from problems import SETS, problem_of, true_probability
from scipy.stats import norm
from study import asked, head, line

from activefail.estimates.estimate import plan_estimate
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

ISOLATED = {0.1: (0.0, 0.002, 0.005), 0.009: (0.0, 0.0018), 0.004: (0.0, 0.0008), 0.0015: (0.0, 0.0003)}
"""Shares of the design space that fail in isolation, by the probability beyond the line."""


def overconfident(target, sd, isolated, sceptical, repeats):
    space = DesignSpace(tuple(Parameter(name, -6.0, 6.0, "", "normal", 0.0, 1.0) for name in "uv"))
    limit = float(norm.isf(target))

    def scattered(X):
        cells = np.floor(X * 20.0).astype(np.int64)
        # A hash of the cell, because failures on a lattice would lie at regular distances.
        mixed = (cells[:, 0].astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) ^ (
            cells[:, 1].astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        )
        mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        return (mixed >> np.uint64(40)) < isolated * 2**24

    def fails(X):
        return (X[:, 0] + 0.03 * np.sin(9.0 * X[:, 1]) > limit) | scattered(X)

    def latent(X):
        return (X[:, 0] - limit) / sd

    P = fails(space.from_unit(np.random.default_rng(0).random((2_000_000, 2)))).mean()
    rows = []
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        plan = plan_estimate(latent, space, 300, rng, sceptical=sceptical)
        found = plan.estimate(fails(plan.designs), np.ones(300, dtype=bool), 0.92)
        unseen = not (scattered(plan.designs) & ~plan.predicted).any()
        rows.append((found.high >= P, found.low <= P, unseen, found.high / P))
    high, low, unseen, over = np.transpose(rows)
    of_unseen = high[unseen > 0.0].mean() if unseen.any() else float("nan")
    return P, high.mean(), low.mean(), of_unseen, unseen.mean(), float(np.median(over))


def exact(name, repeats):
    problem, P, rows = problem_of(name), true_probability(name), []
    space = problem.campaign().space
    for seed in range(repeats):
        plan = plan_estimate(lambda X: -1e4 * problem.limit(X), space, 50, np.random.default_rng(seed))
        found = plan.estimate(plan.predicted, np.ones(len(plan.designs), dtype=bool), 0.9)
        rows.append((found.low <= P <= found.high, (found.high - found.low) / P))
    held, widths = np.transpose(rows)
    return name, f"{P:.3g}", f"{held.mean():.2f}", f"{np.median(widths):.3f}"


def main():
    options = asked(__doc__, repeats=200, exact=False, problems=list(SETS["benchmark"]))
    if options.exact:
        head("problem", "P", "coverage", "width over P")
        for name in options.problems:
            line(*exact(name, options.repeats))
        return
    head("plan", "beyond", "sd", "isolated", "P", "upper", "lower", "upper, none seen", "upper end over P")
    for target, isolated in ISOLATED.items():
        for sd, share, sceptical in itertools.product((0.05, 0.2), isolated, (True, False)):
            P, high, low, of_unseen, unseen, over = overconfident(target, sd, share, sceptical, options.repeats)
            ends = f"{high:.3f}", f"{low:.3f}", f"{of_unseen:.3f} ({unseen:.2f})", f"{over:.2f}"
            shares = f"{100 * target:g} %", sd, f"{100 * share:g} %", f"{100 * P:.3f} %"
            line("sceptical" if sceptical else "trusting", *shares, *ends)


if __name__ == "__main__":
    main()
