"""A simulator that does not repeat: the surface P(failure | design), and intervals of the probability.

    python studies/noise.py --seeds 20
    python studies/noise.py --stop --learns g --case half,rare
    python studies/noise.py --intervals 200
    python studies/noise.py --unlike 10

The margin is 1 - x - y + N(0, 0.15) over the unit square, or 1.7 - x - y ("rare"), and failure where it is at most 0. A
campaign simulates 160 designs. The table gives the mean absolute error of P(failure | design) over the square, that of
BoTorch's SingleTaskGP of the same margins or SingleTaskVariationalGP of the same outcomes, that of the best line, a
probit regression of these outcomes on x and y, the probability of failure, by the classifier and from 200 fresh
simulations, and how often the 90 % interval of these holds the truth. With --stop a campaign has the stop rule of a
probability, and ends before 160 where it knows it; the last columns say when. With --intervals it is how often
intervals hold it by classifiers that are wrong. With --unlike it is what a campaign of 150 from the margin says where
the noise is normal, has a deviation that grows with x, is 0.6 worse in 3 % of the runs, is one of ten values, or has
Student's t distribution with 2.5 degrees of freedom; with failure at 1 - x - y and at 1.8 - x - y.
"""

import itertools
import warnings
from pathlib import Path

import numpy as np
import torch
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP, SingleTaskVariationalGP
from gpytorch.likelihoods import BernoulliLikelihood
from gpytorch.mlls import ExactMarginalLogLikelihood, VariationalELBO
from scipy.optimize import minimize
from scipy.special import log_ndtr, ndtr
from scipy.stats import t
from study import Rows, asked, head, in_memory, line, parallel, spread

from activefail.analyses.findings.learned_from import noise_notes
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings, checked
from activefail.estimates.estimate import plan_estimate
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.simulators.interface import Results
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

NOISE, BUDGET, FRESH = 0.15, 160, 200

OFFSETS = {"half": 1.0, "rare": 1.7}

TEN = 0.25 * np.array([-1.2, -0.9, -0.7, -0.5, -0.3, 0.0, 0.2, 0.6, 1.3, 2.4])

UNLIKE = {
    "normal": (lambda rng, x: NOISE * rng.standard_normal(len(x)), lambda d, x: ndtr(d / NOISE)),
    "growing": (lambda rng, x: (0.05 + 0.2 * x) * rng.standard_normal(len(x)), lambda d, x: ndtr(d / (0.05 + 0.2 * x))),
    "3 % worse": (
        lambda rng, x: 0.1 * rng.standard_normal(len(x)) - 0.6 * (rng.random(len(x)) < 0.03),
        lambda d, x: 0.97 * ndtr(d / 0.1) + 0.03 * ndtr((d + 0.6) / 0.1),
    ),
    "one of ten": (lambda rng, x: -rng.choice(TEN, len(x)), lambda d, x: (d[:, None] + TEN >= 0.0).mean(axis=1)),
    "Student's t": (lambda rng, x: 0.08 * rng.standard_t(2.5, len(x)), lambda d, x: t.cdf(d / 0.08, 2.5)),
}
"""Draws of each noise at x, and P(failure) at a depth d beyond the middle of the boundary, at x."""

GRID = (np.stack(np.meshgrid(*[np.arange(64)] * 2), axis=-1).reshape(-1, 2) + 0.5) / 64


class HalfPlane:
    """The simulator; its noise is drawn anew for each run."""

    outcomes, margins, causes, releases_gil = ("safe", "failure"), ("g",), ("",), True

    def __init__(self, offset, seed, noise="normal"):
        self.offset, self.rng, self.draws = offset, np.random.default_rng(seed), UNLIKE[noise][0]

    def run(self, X):
        g = self.offset - X.sum(axis=1) + self.draws(self.rng, X[:, 0])
        zero = np.zeros(len(X))
        return Results((g <= 0.0).astype(np.int8), zero.astype(np.int8), g[:, None], zero)


def measured(case, learns, criterion, initial, seed, stop):
    torch.set_num_threads(1)
    settings = {
        "seed": seed,
        "simulator": {"python": "noise:g", "margins": ["g"], "repeatable": False},
        "space": {name: {"low": 0.0, "high": 1.0} for name in "xy"},
        "sampling": {"initial": initial, "budget": BUDGET, "batch": 10},
        "classifier": {"learns": learns},
        "acquisition": {"criterion": criterion},
    } | ({"stop": {"probability": "failure"}} if stop else {})
    offset = OFFSETS[case]
    campaign = Campaign.of(checked(CampaignSettings, settings, "study"), simulator=HalfPlane(offset, [seed, 1]))
    learned = in_memory(campaign)
    surface = ndtr((GRID.sum(axis=1) - offset) / NOISE)
    of_classifier = learned.classifier.probabilities(GRID)[:, 1]
    with ThreadExecutor(1) as executor:
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, learned.history.last_iteration)
        estimate = estimator.sample("failure", FRESH, campaign.question).estimate(0.9)
        mean = estimator.probability("failure", campaign.question)
    return {
        "case": case,
        "learns": learns,
        "criterion": criterion,
        "initial": initial,
        "seed": seed,
        "error": np.abs(of_classifier - surface).mean(),
        "by_botorch": np.abs(by_botorch(learned.history, learns) - surface).mean(),
        "by_line": np.abs(by_line(learned.history) - surface).mean(),
        "truth": surface.mean(),
        "by_classifier": mean,
        "estimate": [estimate.low, estimate.probability, estimate.high],
        "simulations": len(learned.history),
        "ended": learned.looks.is_known,
    }


def by_botorch(history, learns):
    """P(failure) on the grid: by a SingleTaskGP of the margins, or a SingleTaskVariationalGP of the outcomes."""
    X, grid = torch.from_numpy(history.designs), torch.from_numpy(GRID)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if learns == "outcomes":
            y = torch.from_numpy(history.outcome.astype(float))
            model = SingleTaskVariationalGP(X, y[:, None], likelihood=BernoulliLikelihood(), inducing_points=len(X))
            model.double()
            fit_gpytorch_mll(VariationalELBO(model.likelihood, model.model, num_data=len(X)))
            with torch.no_grad():
                return model.likelihood(model.model.eval()(grid)).mean.numpy()
        model = SingleTaskGP(X, torch.from_numpy(history.margins))
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    with torch.no_grad():
        next_one = model.posterior(grid, observation_noise=True)
    return ndtr((-next_one.mean / next_one.variance.sqrt()).detach().numpy()[:, 0])


def by_line(history):
    """P(failure) on the grid: Φ(a + b·x + c·y), with the greatest likelihood of the outcomes."""
    X, side = history.designs, 2.0 * history.outcome - 1.0
    a, *slopes = minimize(lambda w: -log_ndtr(side * (w[0] + X @ w[1:])).sum(), np.zeros(3)).x
    return ndtr(a + GRID @ slopes)


def coverage(case, shift, ratio, repeats):
    """How often 90 % intervals hold the truth, by a classifier that is wrong: of a trusting and of a sceptical plan."""
    space = DesignSpace(tuple(Parameter(name, 0.0, 1.0) for name in "xy"))
    offset = OFFSETS[case]
    truth = ndtr((GRID.sum(axis=1) - offset) / NOISE).mean()

    def probit(X):
        return (X.sum(axis=1) - offset - shift) / (ratio * NOISE)

    held = []
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        for sceptical in (False, True):
            plan = plan_estimate(probit, space, FRESH, rng, repeatable=False, sceptical=sceptical)
            beyond = rng.random(FRESH) < ndtr((plan.designs.sum(axis=1) - offset) / NOISE)
            found = plan.estimate(beyond, np.ones(FRESH, dtype=bool), 0.9)
            held.append(found.low <= truth <= found.high)
    return np.reshape(held, (repeats, 2)).mean(axis=0)


def unlike(seeds):
    """What a campaign says of its noise, and its own probability over the truth."""
    head(
        "noise", "failure", "says that it is not normal", "P by the classifier / P, median", "least", "most", "not told"
    )
    for (noise, (_, of_noise)), offset in itertools.product(UNLIKE.items(), (1.0, 1.8)):
        truth, told, ratios = of_noise(GRID.sum(axis=1) - offset, GRID[:, 0]).mean(), [], []
        for seed in range(seeds):
            settings = {
                "seed": seed,
                "simulator": {"python": "noise:g", "margins": ["g"], "repeatable": False},
                "space": {name: {"low": 0.0, "high": 1.0} for name in "xy"},
                "sampling": {"initial": 40, "budget": 150, "batch": 10},
                "classifier": {"learns": "g"},
            }
            campaign = checked(CampaignSettings, settings, "study")
            learned = in_memory(Campaign.of(campaign, simulator=HalfPlane(offset, [seed, 1], noise)))
            told.append(bool(noise_notes(learned.classifier)))
            ratios.append(learned.classifier.probabilities(GRID)[:, 1].mean() / truth)
        off = sum(not (one or 0.7 <= ratio <= 1.4) for one, ratio in zip(told, ratios, strict=True))
        low, middle, high = np.quantile(ratios, (0.0, 0.5, 1.0))
        line(noise, f"{truth:.3f}", f"{sum(told)} of {seeds}", f"{middle:.2f}", f"{low:.2f}", f"{high:.2f}", off)


def main():
    options = asked(
        __doc__,
        intervals=0,
        unlike=0,
        stop=False,
        seeds=20,
        first_seed=0,
        case=list(OFFSETS),
        learns=["outcomes", "g"],
        criterion=["bald"],
        initial=[40],
        file=Path,
        processes=1,
    )
    if options.unlike:
        torch.set_num_threads(1)
        unlike(options.unlike)
        return
    if options.intervals:
        head("case", "classifier's shift", "its noise / true noise", "importance sampling covers", "strata cover")
        for case, shift, ratio in itertools.product(options.case, (0.0, 0.05), (0.5, 1.0, 2.0)):
            line(case, shift, ratio, *(f"{held:.3f}" for held in coverage(case, shift, ratio, options.intervals)))
        return
    rows = Rows(options.file, stop=options.stop)
    names = "case", "learns", "criterion", "initial"
    terms = list(itertools.product(*(getattr(options, name) for name in names)))
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    cases = [(*term, seed) for seed in seeds for term in terms]
    cases = [case for case in cases if rows.lack(**dict(zip((*names, "seed"), case, strict=True)))]
    for row in parallel(measured, [(*case, options.stop) for case in cases], options.processes):
        rows.add(**row)
    head(
        *names,
        "error of P",
        "BoTorch",
        "a line",
        "truth",
        "by the classifier",
        "estimate",
        "interval covers",
        "width",
        "simulations",
        "ended",
    )
    for term in terms:
        of = [row for row in rows.of(**dict(zip(names, term, strict=True))) if row["seed"] in seeds]
        numbers = ("error", "by_botorch", "by_line", "truth", "by_classifier")
        means = [f"{np.mean([row[name] for row in of]):.4f}" for name in numbers]
        low, middle, high = np.array([row["estimate"] for row in of]).T
        covered = (low <= of[0]["truth"]) & (of[0]["truth"] <= high)
        ends = spread([row["simulations"] for row in of], 0), f"{sum(row['ended'] for row in of)}/{len(of)}"
        line(*term, *means, f"{middle.mean():.4f}", f"{covered.mean():.2f}", f"{np.median(high - low):.4f}", *ends)


if __name__ == "__main__":
    main()
