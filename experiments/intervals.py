"""Intervals of a probability that is not rare: which estimator covers, and at what cost (docs/decisions/0019).

    python experiments/intervals.py --campaign runs/bearing --bearings 20

The campaign is one of campaigns/bearing.toml, finished. Bearings of Table 1 are drawn until D_tot can be chosen such
that the classifier's probability is 10 or 2.5 % under a hazard (M 7, PGV 1 m/s). The outcomes of 8,000 pulses of each
are simulated once; estimates then draw 250 of them, 100 times. Printed for each target and estimator: the coverage of
nominal 95 % intervals (mean and worst bearing), and how many more simulations Monte Carlo needs for the same width.
Then a made-up classifier that is far too sure, at probabilities of 10 to 0.15 % (--made-up: this table alone).
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from scipy.special import ndtr
from scipy.stats import norm

from activefail import open_run, simulate
from activefail.campaign.hazard import hazard_of, hazard_question
from activefail.parameter import Parameter
from activefail.reliability import estimate as reliability
from activefail.reliability.estimate import baseline, plan_estimate
from activefail.reliability.integral import boundary_of
from activefail.reliability.strata import plan_strata, plan_wide_strata
from activefail.space import DesignSpace
from activefail.weighted import WeightedRows

TARGETS, PULSES, SIMULATIONS, REPEATS = (0.10, 0.025), 8000, 250, 100
EDGES = (0.005, 0.02, 0.08, 0.25)
FINE = (0.0005, 0.02, 0.15)


def pools(folder, count, rng):
    """For each target, bearings with the latent's mean/sd and the failures of their pulses."""
    run = open_run(folder)
    standardised = boundary_of(run.classifier, run.campaign.features, "failure")
    hazard = hazard_of({"magnitude": {"M": 7.0}, "pgv": {"median_m_s": 1.0, "dispersion": 0.25}}, Path("hazard.toml"))
    names, low, high, grid = run.space.names[:7], run.space.low[:7], run.space.high[:7], np.linspace(0.45, 0.85, 9)
    found = {target: [] for target in TARGETS}
    while any(len(rows) < count for rows in found.values()):
        bearing = dict(zip(names, (low + (high - low) * rng.random(7)).tolist(), strict=True))
        question = hazard_question(hazard, run.settings, run.space, bearing)
        U = question.space.sobol(512, np.random.default_rng(0))
        P = np.array([ndtr(standardised(question.at({"D_tot": D}).designs(U))).mean() for D in grid])
        for target, rows in found.items():
            last = np.flatnonzero((P[:-1] > target) & (P[1:] <= target))
            if not len(last) or len(rows) == count:
                continue
            k = last[-1]
            D = float(np.interp(-np.log(target), -np.log(P[k : k + 2]), grid[k : k + 2]))
            X = question.at({"D_tot": D}).designs(question.space.from_unit(rng.random((PULSES, 2))))
            rows.append((standardised(X), simulate(X).outcome == 2))
    return found


def by_importance(weight, wider):
    """The package's estimator with another prior weight and factor of the standard deviation."""

    def interval(z, failed, rng):
        reliability._PRIOR_WEIGHT, reliability._WIDER = weight, wider
        rows = WeightedRows(("row",), np.arange(len(z), dtype=float)[:, None], np.ones(len(z)))

        def of_rows(numbers):
            return z[numbers[:, 0].astype(int)]

        plan = plan_estimate(of_rows, rows, baseline(of_rows, rows), SIMULATIONS, rng)
        chosen = plan.designs[:, 0].astype(int)
        found = plan.estimate(failed[chosen], np.ones(SIMULATIONS, dtype=bool), 0.95)
        return found.low, found.high

    return interval


def of_package(z, failed, rng):
    """The package's strata."""
    rows = WeightedRows(("row",), np.arange(len(z), dtype=float)[:, None], np.ones(len(z)))
    plan = plan_strata(lambda numbers: z[numbers[:, 0].astype(int)], rows, SIMULATIONS, rng)
    found = plan.estimate(failed[plan.designs[:, 0].astype(int)], np.ones(SIMULATIONS, dtype=bool), 0.95)
    return found.low, found.high


def by_strata(a, b, by_doubt, edges=EDGES, by_volume=0.3):
    """Strata of the classifier's doubt and its side, with Beta posteriors of their mistakes.

    Args:
        a, b: of the prior.
        by_doubt: whether the stratum's expected share of mistakes q is added: Beta(a + q, b + 1 - q).
        edges: probabilities of being wrong that separate the strata.
        by_volume: share of the simulations that are shared out by volume.
    """

    sides = len(edges) + 1

    def interval(z, failed, rng):
        doubt = np.minimum(ndtr(z), ndtr(-z))
        stratum = np.searchsorted(edges, doubt, side="right") + sides * (z > 0.0)
        volume = np.bincount(stratum, minlength=2 * sides) / len(z)
        q = np.bincount(stratum, weights=doubt, minlength=2 * sides) / np.maximum(1.0, volume * len(z))
        neyman = volume * np.sqrt(np.maximum(q, 1e-4) * (1.0 - q))
        shares = SIMULATIONS * ((1.0 - by_volume) * neyman / neyman.sum() + by_volume * volume)
        n = np.floor(shares).astype(int)
        n[np.argsort(n - shares)[: SIMULATIONS - n.sum()]] += 1
        wrong = np.zeros(2 * sides)
        for k in range(2 * sides):
            rows = np.flatnonzero(stratum == k)
            n[k] = n[k] if len(rows) else 0
            chosen = rng.choice(rows, n[k]) if n[k] else rows[:0]
            wrong[k] = (failed[chosen] != (z[chosen] > 0.0)).sum()
        more = q if by_doubt else 0.0 * q
        shares = rng.beta(a + more + wrong, b + (1.0 - more) * by_doubt + n - wrong, (4000, 2 * sides))
        total = volume[sides:].sum() + shares @ (volume * np.repeat([1.0, -1.0], sides))
        return np.quantile(total, 0.025), np.quantile(total, 0.975)

    return interval


ESTIMATORS = {
    "importance, prior of 12": by_importance(12.0, 2.0),
    "importance, prior of 16": by_importance(16.0, 2.0),
    "importance, not widened": by_importance(12.0, 1.0),
    "strata, the package's": of_package,
    "the same, five coarser ones, 30 % by volume": by_strata(0.2, 0.5, by_doubt=True),
    "strata, prior (0.1+q, 1.5-q)": by_strata(0.1, 0.5, by_doubt=True, edges=FINE, by_volume=0.5),
    "strata, Jeffreys": by_strata(0.5, 0.5, by_doubt=False, edges=FINE, by_volume=0.5),
}


def overconfident(target, sd, isolated, by_importance, repeats=200):
    """Estimates of a look with a classifier that is far too sure.

    Two standard normal variables; failure beyond a line, with a wave, and isolated failures. The classifier knows
    neither the wave nor these.

    Args:
        target: probability beyond the line.
        sd: of the classifier's latent, constant.
        isolated: share of the design space that fails in isolation.
        by_importance: whether the mistakes are drawn by importance; otherwise in strata.
        repeats: of the estimate.

    Returns:
        The probability; shares of the upper and lower ends that hold; the share of the upper ends that hold where no
        isolated failure was seen, and the share of such estimates; and the median upper end over the probability.
    """
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
        plan = None if by_importance else plan_strata(latent, space, 300, rng)
        if plan is None:
            integral = baseline(latent, space)
            of = plan_estimate if by_importance else plan_wide_strata
            plan = of(latent, space, integral, 300, rng)
        found = plan.estimate(fails(plan.designs), np.ones(300, dtype=bool), 0.92)
        unseen = not (scattered(plan.designs) & ~plan.predicted).any()
        rows.append((found.high >= P, found.low <= P, unseen, found.high / P))
    high, low, unseen, over = np.transpose(rows)
    of_unseen = high[unseen > 0.0].mean() if unseen.any() else float("nan")
    return P, high.mean(), low.mean(), of_unseen, unseen.mean(), float(np.median(over))


def made_up(repeats):
    """The table of the classifier that is too sure."""
    print(
        "a classifier that is too sure: P beyond the line, its sd, isolated failures, P, upper and lower ends of 96 %"
    )
    print("that hold, upper ends that hold where no isolated failure was seen (how often that is), upper end over P")
    shares = {0.1: (0.0, 0.002, 0.005), 0.009: (0.0, 0.0018), 0.004: (0.0, 0.0008), 0.0015: (0.0, 0.0003)}
    for target, isolated in shares.items():
        for sd, share, by_importance in itertools.product((0.05, 0.2), isolated, (False, True)):
            P, high, low, of_unseen, unseen, over = overconfident(target, sd, share, by_importance, repeats)
            kind = "importance" if by_importance else "strata    "
            print(
                f"  {kind} {100 * target:g} %, {sd}, {100 * share:g} %: {100 * P:.3f} %, {high:.3f}, {low:.3f}, "
                f"{of_unseen:.3f} ({unseen:.2f}), {over:.2f}",
                flush=True,
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", type=Path)
    parser.add_argument("--made-up", action="store_true")
    parser.add_argument("--repeats", type=int, default=200, help="of the made-up classifier")
    parser.add_argument("--bearings", type=int, default=20)
    parser.add_argument("--seed", type=int, default=42)
    options = parser.parse_args()
    if options.made_up:
        made_up(options.repeats)
        return
    if options.campaign is None:
        parser.error("give --campaign or --made-up")
    for target, rows in pools(options.campaign, options.bearings, np.random.default_rng(options.seed)).items():
        off = np.array([ndtr(z).mean() / failed.mean() - 1.0 for z, failed in rows])
        print(
            f"P = {100 * target:g} %, {len(rows)} bearings: the classifier's probability is off by "
            f"{100 * off.std():.1f} % (standard deviation), "
            f"{100 * off.min():.0f} to {100 * off.max():.0f} %, too low for {(off < 0.0).sum()}"
        )
        for name, estimator in ESTIMATORS.items():
            covers, gains, above = [], [], []
            for number, (z, failed) in enumerate(rows):
                rng, P = np.random.default_rng(number), failed.mean()
                ends = np.array([estimator(z, failed, rng) for _ in range(REPEATS)])
                covers.append(((ends[:, 0] <= P) & (ends[:, 1] >= P)).mean())
                half = 0.5 * (ends[:, 1] - ends[:, 0]).mean()
                above.append(ends[:, 1].mean() / P - 1.0)
                gains.append(1.96**2 * P * (1.0 - P) / SIMULATIONS / half**2)
            print(
                f"  {name:45s} cover {np.mean(covers):.3f}, worst {min(covers):.2f}; x MC {np.median(gains):.1f}; "
                f"upper bound over P {np.mean(above):.3f}"
            )
    made_up(options.repeats)


if __name__ == "__main__":
    main()
