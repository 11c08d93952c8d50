"""Designs for a target: how often they meet it, what they ask for and cost, and what intervals and curves are worth.

    python studies/design.py                                     everything: 20 bearings, 50 problems (hours)
    python studies/design.py --parts formulas --seeds 2          a quick look
    python studies/design.py --parts designs --seed 91           searched bearings against fresh pulses
    python studies/design.py --parts intervals,curves --seed 1   the classifier of the bearings (about an hour)

The parts are

    formulas   `design` where a formula gives the probability. For each seed and problem a campaign learns the limit
               state in the ranges of its design; the loads are uncertain and lognormal. A design is drawn, but for its
               free variables, and `design` makes it as cheap as the target allows. "fresh" are the fresh simulations of
               all looks, "excess" the first free variable, or the cost, over the least that meets the target, of
               verified designs. The problems are
                   column  one free variable, a margin: capacity · grip over the demand
                   tank    the same, learned from outcomes alone
                   beam    a width and a height with the cost width · height, a margin; the height is best at its limit
                   frame   two limit states in series, the smaller margin: demand of the frame, and of a bearing that
                           moves with it
                   jump    the column after a campaign of 16, with 3 % of failures that a jump in an idle variable
                           hides; not in "all"
    designs    `Run.design`: status, simulations, the probability by 10,000 fresh pulses, and D_tot over the smallest
               one beyond which the target is met. That is read off a curve by 2,000 pulses, scaled to this probability
    intervals  estimates from 250 simulations of a bearing whose probability is near the target. They are drawn from
               8,000 pulses, whose outcomes are all simulated, so that the true share is known exactly. "cover" is the
               share of 95 % intervals that contain it, "x MC" and "x Sobol'" how many times more simulations Monte
               Carlo (normal interval) and scrambled Sobol' points (t-interval over 8 randomisations of 32) need for an
               interval of the same width. --estimators names other ways to draw them than the package's sceptical plan
    curves     the classifier's curves of each bearing of the first target, against PGV and against A_p, and those of
               simulations of the same 256 pulses: median and dispersion of the likeliest lognormal curve, for the
               pulses inside the campaign's design space; of the nearest lognormal curve, for all pulses; and median
               and standard deviation of the logarithm of the capacity from the increments, for all pulses

The last three are of a campaign of campaigns/bearing.toml, which is run first, or read from --campaign, and of bearings
drawn from Table 1 for each target. For intervals and curves the hazard is M 7, PGV 1 m/s, and a bearing is kept if the
classifier puts its required D_tot inside the range. For designs the classifier has no say: each bearing gets a site,
M 6.4 to 7.6 and a median PGV of 0.6 to 1.44 m/s, and is kept if of 500 pulses a share of at most 0.8 times the target
fails at the largest D_tot, and of at least 1.2 times the target at the smallest.

Each line of --out is one bearing or problem; a repeated command continues where it stopped.
"""

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import interp1d
from scipy.optimize import brentq, curve_fit, minimize
from scipy.special import ndtr
from scipy.stats import norm
from scipy.stats import t as student
from study import Rows, asked, campaign_of, head, in_memory, line

from activefail import create_run, open_run, simulate
from activefail.analyses.design.design_task import Requirement, design_task
from activefail.analyses.design.search import find_design
from activefail.campaign.inquiry import Inquiry
from activefail.estimates import estimate as importance
from activefail.estimates.integral import boundary_of
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.seismic.bearing.pulse import amplitude_of
from activefail.seismic.hazard.hazard import Hazard
from activefail.simulators.interface import Results
from activefail.space.weighted import WeightedRows

TARGETS = (0.10, 0.025)
POOL, TRUTH, CURVE, SIMULATIONS, REPEATS = 8_000, 10_000, 2_000, 250, 100
LEVELS, PERIODS = 48, 256
HAZARD = {"magnitude": {"M": 7.0}, "pgv": {"median_m_s": 1.0, "dispersion": 0.25}}
FREE, RANGE = "D_tot", (0.45, 0.85)
FAILURE = 2
JUMP = norm.isf(0.03)
KINDS = {
    "inside": "pulses of the design space, likeliest lognormal",
    "nearest": "all pulses, nearest lognormal",
    "moments": "all pulses, increments",
}


class Study:
    """A trained campaign, its hazard, and bearings near the targets."""

    def __init__(self, folder, seed):
        self.run = open_run(folder, write=True) if folder.exists() else create_run(folder, "campaigns/bearing.toml")
        if self.run.history.asked_for < self.run.settings.sampling.budget:
            self.run.take()
        self.hazard = Hazard.of(HAZARD, Path("hazard.toml"))
        self.standardised = boundary_of(self.run.classifier, self.run.campaign.features, "failure")
        self.rng = np.random.default_rng(seed)

    def question(self, bearing):
        return self.hazard.question(self.run.space, bearing)

    def drawn(self):
        """A bearing of Table 1 without D_tot."""
        return {
            p.name: p.low + (p.high - p.low) * self.rng.random()
            for p in self.run.space.parameters[:7]
            if p.name != FREE
        }

    def chance(self, bearing, grid, n):
        """The classifier's probabilities on a grid of D_tot."""
        question = self.question({**bearing, FREE: 0.65})
        U = question.space.sobol(n, np.random.default_rng(0))
        return [float(ndtr(self.standardised(question.at({FREE: value}).designs(U))).mean()) for value in grid]

    def bearings(self, target, count):
        """Bearings whose required D_tot lies within the range, without it."""
        while count:
            bearing = self.drawn()
            worst, best = self.chance(bearing, RANGE, 256)
            if best < 0.85 * target < target < worst:
                count -= 1
                yield bearing

    def sites(self, target, count):
        """Bearings without D_tot, with their hazards and questions."""
        while count:
            bearing = self.drawn()
            pgv = {"median_m_s": 0.6 * 2.4 ** self.rng.random(), "dispersion": 0.25}
            hazard = Hazard.of({"magnitude": {"M": 6.4 + 1.2 * self.rng.random()}, "pgv": pgv}, Path("hazard.toml"))
            question = hazard.question(self.run.space, {**bearing, FREE: RANGE[0]})
            X = self.draw(question, 500, self.rng)
            smallest, largest = (self.failed(question.at({FREE: value}), X).mean() for value in RANGE)
            if largest <= 0.8 * target and smallest >= 1.2 * target:
                count -= 1
                yield bearing, hazard, question

    def required(self, bearing, target):
        """D_tot at which the classifier's probability is the target."""
        grid = np.linspace(*RANGE, 9)
        P = self.chance(bearing, grid, 512)
        last = max((k for k in range(8) if P[k] > target), default=0)
        return float(np.interp(-np.log(target), -np.log(P[last : last + 2]), grid[last : last + 2]))

    def failed(self, question, X):
        return simulate(question.designs(X)).outcome == FAILURE

    def draw(self, question, n, rng):
        return question.space.from_unit(rng.random((n, question.space.dimension)))


EDGES, FINE = (0.005, 0.02, 0.08, 0.25), (0.0005, 0.02, 0.15)


def by_plan(make):
    """An interval from a plan of the package over numbered rows: a function of (latent, rows, rng)."""

    def interval(z, failed, rng):
        rows = WeightedRows(("row",), np.arange(len(z), dtype=float)[:, None], np.ones(len(z)))
        plan = make(lambda numbers: z[numbers[:, 0].astype(int)], rows, rng)
        found = plan.estimate(failed[plan.designs[:, 0].astype(int)], np.ones(SIMULATIONS, dtype=bool), 0.95)
        return found.low, found.high

    return interval


def by_importance(weight, wider):
    """The package's importance sampling with another prior weight and factor of the standard deviation."""

    def make(latent, rows, rng):
        importance._PRIOR_WEIGHT, importance.WIDER = weight, wider
        return importance.plan_estimate(latent, rows, SIMULATIONS, rng)

    return by_plan(make)


def by_strata(a, b, by_doubt, edges, by_volume):
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
        n[volume == 0.0] = 0
        wrong = np.zeros(2 * sides)
        for k in np.flatnonzero(n):
            chosen = rng.choice(np.flatnonzero(stratum == k), n[k])
            wrong[k] = (failed[chosen] != (z[chosen] > 0.0)).sum()
        more = by_doubt * q
        shares = rng.beta(a + more + wrong, b + (1.0 - more) * by_doubt + n - wrong, (4000, 2 * sides))
        total = volume[sides:].sum() + shares @ (volume * np.repeat([1.0, -1.0], sides))
        return np.quantile(total, [0.025, 0.975])

    return interval


ESTIMATORS = {
    "sceptical": by_plan(
        lambda latent, rows, rng: importance.plan_estimate(latent, rows, SIMULATIONS, rng, sceptical=True)
    ),
    "importance-12": by_importance(12.0, 2.0),
    "importance-16": by_importance(16.0, 2.0),
    "importance-not-widened": by_importance(12.0, 1.0),
    "strata-five-of-each-side": by_strata(0.2, 0.5, True, EDGES, 0.3),
    "strata-0.1": by_strata(0.1, 0.5, True, FINE, 0.5),
    "strata-jeffreys": by_strata(0.5, 0.5, False, FINE, 0.5),
}


def intervals(study, bearing, target, number, options):
    rng = np.random.default_rng([number, 1])
    question = study.question({**bearing, FREE: study.required(bearing, target)})
    X = study.draw(question, POOL, rng)
    z, failed = study.standardised(question.designs(X)), study.failed(question, X)
    P, sobol = failed.mean(), []
    for _ in range(20):
        means = [study.failed(question, question.space.sobol(32, rng)).mean() for _ in range(8)]
        sobol.append(student.ppf(0.975, 7) * np.std(means, ddof=1) / np.sqrt(8.0))
    row = {"P": P, "off": ndtr(z).mean() / P - 1.0, "wrong": ((z > 0.0) != failed).mean()}
    for name in options.estimators:
        low, high = np.transpose([ESTIMATORS[name](z, failed, rng) for _ in range(REPEATS)])
        variance = SIMULATIONS * np.mean(0.5 * (high - low)) ** 2
        row |= {
            f"cover {name}": np.mean((low <= P) & (high >= P)),
            f"upper {name}": np.mean(high >= P),
            f"over {name}": np.mean(high) / P - 1.0,
            f"mc {name}": 1.96**2 * P * (1.0 - P) / variance,
            f"sobol {name}": np.mean(np.square(sobol)) * 256 / variance,
        }
    return row


def designs(study, site, target, number, options):
    bearing, hazard, question = site
    findings = study.run.design(
        target, hazard, fixed=bearing, simulations=options.simulations, executor=ThreadExecutor(1)
    )
    found = findings.designed
    value = found.values[FREE]
    rng = np.random.default_rng([number, 2])
    P = float(study.failed(question.at({FREE: value}), study.draw(question, TRUTH, rng)).mean())
    # The smallest D_tot that meets the target: a curve by fewer pulses, scaled to this probability.
    X, grid = study.draw(question, CURVE, rng), np.linspace(*RANGE, 5)
    curve = [np.log(max(1e-4, study.failed(question.at({FREE: other}), X).mean())) for other in grid]
    fine = np.linspace(*RANGE, 801)
    shape = interp1d(grid, curve, "quadratic")
    above = fine[shape(fine) - shape(value) + np.log(max(P, 1e-4)) > np.log(target)]
    return {
        "status": found.status,
        "simulations": found.simulations,
        "looks": [look.candidate.values[FREE] for look in found.looks],
        "outside": findings.outside.share,
        "D_tot": value,
        "model": float(found.result.candidate.model[0]),
        "high": found.result.estimates[0].high,
        "P": P,
        "meets": target >= P,
        "oversize": value / max([RANGE[0], *above]) - 1.0,
    }


def nearest(levels, P):
    """Median and dispersion of the lognormal curve nearest to a curve, by least squares."""
    (median, dispersion), _ = curve_fit(
        lambda x, m, s: ndtr((x - m) / s), np.log(levels), P, p0=(np.log(levels[P.searchsorted(0.5) - 1]), 0.4)
    )
    return float(np.exp(median)), float(abs(dispersion))


def likeliest(levels, P):
    """Median and dispersion of the lognormal curve of greatest likelihood, with as many pulses at each level."""
    logs = np.log(levels)

    def surprise(numbers):
        p = np.clip(ndtr((logs - numbers[0]) * np.exp(-numbers[1])), 1e-9, 1.0 - 1e-9)
        return -np.sum(P * np.log(p) + (1.0 - P) * np.log1p(-p))

    start = nearest(levels, np.maximum.accumulate(P))
    found = minimize(surprise, np.log(start), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    return float(np.exp(found.x[0])), float(np.exp(found.x[1]))


def moments_of(levels, P):
    """Median of a curve, and the standard deviation of the capacity's logarithm, from its increments."""
    logs, share = np.log(levels), np.diff(P, prepend=0.0) / P[-1]
    mean = share @ logs
    return float(np.exp(np.interp(0.5, P, logs))), float(np.sqrt(share @ (logs - mean) ** 2))


def curves(study, bearing, target, number, _):
    bearing = {**bearing, FREE: study.required(bearing, target)}
    periods = study.draw(study.question(bearing), PERIODS, np.random.default_rng([number, 3]))[:, 0]
    values, bounds = np.array([bearing[name] for name in study.run.space.names[:7]]), study.run.space.parameters[7:]
    result = {}
    for axis, low, high in (("pgv", 0.2, 6.0), ("a_p", 0.02, 3.0)):
        levels = np.geomspace(low, high, LEVELS)
        model, truth, inside = [], [], []
        for level in levels:
            amplitude = amplitude_of(level, periods) if axis == "pgv" else np.full(PERIODS, level)
            X = np.column_stack([np.tile(values, (PERIODS, 1)), periods, amplitude])
            model.append(ndtr(study.standardised(X)))
            truth.append(simulate(X).outcome == FAILURE)
            inside.append(
                np.all([(x >= p.low) & (x <= p.high) for p, x in zip(bounds, X[:, 7:].T, strict=True)], axis=0)
            )
        model, truth, inside = np.array(model), np.array(truth, dtype=float), np.array(inside)
        # Where the campaign learned: the pulses inside its design space, at levels where these are at least half.
        kept = inside.mean(axis=1) >= 0.5
        own, known = (
            np.array([row[of].mean() for row, of in zip(P[kept], inside[kept], strict=True)]) for P in (model, truth)
        )
        pairs = {"inside": [likeliest(levels[kept], P) for P in (own, known)]}
        model, truth = np.maximum.accumulate(model.mean(axis=1)), np.maximum.accumulate(truth.mean(axis=1))
        pairs |= {
            name: [of(levels, P) for P in (model, truth)]
            for name, of in (("nearest", nearest), ("moments", moments_of))
        }
        for name, (ours, theirs) in pairs.items():
            result |= {
                f"{name}_median_{axis}": ours[0] / theirs[0] - 1.0,
                f"{name}_dispersion_{axis}": ours[1] / theirs[1] - 1.0,
            }
        median, dispersion = pairs["nearest"][1]
        fitted = ndtr(np.log(levels / median) / dispersion)
        result |= {
            f"largest_{axis}": float(np.max(np.abs(model - truth))),
            f"largest_inside_{axis}": float(np.max(np.abs(own - known))),
            f"misfit_{axis}": float(np.max(np.abs(fitted - truth))),
        }
    return result


def lognormal(median, dispersion):
    return {"distribution": "lognormal", "median": median, "dispersion": dispersion}


def between(low, high):
    return {"low": low, "high": high}


@dataclass(frozen=True)
class Problem:
    """A limit state g(x) <= 0 of named variables."""

    limit: object  # columns by name -> (n,)
    probability: object  # values of the design by name -> probability
    design: dict  # ranges of the design's variables, by name
    loads: dict
    free: tuple
    budget: int
    margins: tuple = ("g",)
    cost: str = ""

    outcomes = ("safe", "failure")
    causes = ("",)
    releases_gil = True

    def run(self, X):
        g = self.limit(dict(zip([*self.design, *self.loads], X.T, strict=True)))
        nothing = np.zeros(len(X))
        margins = g[:, None] if self.margins else np.empty((len(X), 0))
        return Results((g <= 0.0).astype(np.int8), nothing.astype(np.int8), margins, nothing)

    def price(self, values):
        return values["width"] * values["height"] if self.cost else values[self.free[0]]

    def least(self, fixed, target):
        """The least cost of a design that meets the target; NaN if the range has none."""
        first, *others = self.free
        low, high = (end for end in (self.design[first]["low"], self.design[first]["high"]))
        prices = []
        for share in np.linspace(0.0, 1.0, 201 if others else 1):
            held = {
                name: one["low"] + share * (one["high"] - one["low"])
                for name, one in self.design.items()
                if name in others
            }

            def over(x, held=held):
                return self.probability({**fixed, **held, first: x}) - target

            if over(low) > 0.0 >= over(high):
                prices.append(self.price({**held, first: brentq(over, low, high, xtol=1e-9)}))
        return min(prices, default=float("nan"))


def of_ratio(ratio, dispersion):
    return float(norm.sf(np.log(ratio) / dispersion))


def in_series(v):
    """P(min <= 0) of the frame: integrated over the pull, by a formula over the slip."""
    first = np.log(v["size"] / 0.9) / 0.35
    z = np.linspace(-8.0, first, 2001)
    pull = 0.9 * np.exp(0.35 * z)
    of_other = norm.sf(np.log(v["gap"] * v["size"] / (0.5 * np.sqrt(pull))) / 0.45)
    return float(norm.sf(first) + np.trapezoid(of_other * norm.pdf(z), z))


PROBLEMS = {
    "column": Problem(
        lambda v: np.log(v["capacity"] * np.sqrt(v["grip"]) / v["demand"]),
        lambda v: of_ratio(v["capacity"] * np.sqrt(v["grip"]), 0.4),
        {"capacity": between(0.5, 4.0), "grip": between(0.6, 1.5)},
        {"demand": lognormal(1.0, 0.4)},
        ("capacity",),
        24,
    ),
    "tank": Problem(
        lambda v: np.log(v["capacity"] * np.sqrt(v["grip"]) / v["demand"]),
        lambda v: of_ratio(v["capacity"] * np.sqrt(v["grip"]), 0.4),
        {"capacity": between(0.5, 4.0), "grip": between(0.6, 1.5)},
        {"demand": lognormal(1.0, 0.4)},
        ("capacity",),
        100,
        margins=(),
    ),
    "beam": Problem(
        lambda v: v["strength"] * v["width"] * v["height"] ** 2 / v["span"] - v["load"],
        lambda v: of_ratio(2.0 * v["width"] * v["height"] ** 2 / v["span"], np.hypot(0.3, 0.1)),
        {"width": between(0.2, 1.0), "height": between(0.8, 1.6), "span": between(0.8, 1.6)},
        {"strength": lognormal(2.0, 0.1), "load": lognormal(1.0, 0.3)},
        ("width", "height"),
        60,
        cost="width * height",
    ),
    "frame": Problem(
        lambda v: np.minimum(
            np.log(v["size"] / v["pull"]), np.log(v["gap"] * v["size"] / v["slip"] / np.sqrt(v["pull"]))
        ),
        in_series,
        {"size": between(0.8, 3.0), "gap": between(0.4, 1.2)},
        {"pull": lognormal(0.9, 0.35), "slip": lognormal(0.5, 0.45)},
        ("size",),
        60,
    ),
    "jump": Problem(
        lambda v: np.where(v["idle"] > JUMP, -0.3, np.log(v["capacity"] * np.sqrt(v["grip"]) / v["demand"])),
        lambda v: 0.03 + 0.97 * of_ratio(v["capacity"] * np.sqrt(v["grip"]), 0.4),
        {"capacity": between(0.5, 4.0), "grip": between(0.6, 1.5)},
        {"demand": lognormal(1.0, 0.4), "idle": {"distribution": "normal", "mean": 0.0, "sd": 1.0}},
        ("capacity",),
        16,
    ),
}


@cache
def learned(name, seed):
    problem = PROBLEMS[name]
    campaign = campaign_of(
        problem,
        seed=seed,
        space={**problem.design, **problem.loads},
        sampling__budget=problem.budget,
        sampling__initial=max(8, problem.budget // 3),
        sampling__batch=4,
        classifier__features="design",
    )
    return in_memory(campaign)


def formulas(_, name, target, seed, options):
    problem, of, rng = PROBLEMS[name], learned(name, seed), np.random.default_rng([seed, round(1e4 * target)])
    while True:
        held = {key: one["low"] + rng.random() * (one["high"] - one["low"]) for key, one in problem.design.items()}
        fixed = {key: value for key, value in held.items() if key not in problem.free}
        if np.isfinite(least := problem.least(fixed, target)):
            break
    asked_of = Inquiry.of(of.campaign, None, None, fixed, problem.free)
    task = design_task(
        asked_of, (Requirement("failure", target),), problem.free, problem.cost, 0.95, options.simulations
    )
    with ThreadExecutor(1) as executor:
        estimator = Estimator(of.campaign, of.store, executor, of.classifier, of.history.last_iteration)
        found = find_design(estimator, task)
    P = problem.probability({**fixed, **found.values})
    return {
        "status": found.status,
        "fresh": found.simulations,
        "looks": [(look.simulations, *task.question.at(look.candidate.values).fixed.values()) for look in found.looks],
        "P": P,
        "meets": bool(target >= P),
        "excess": task.cost(found.values) / least - 1.0,
    }


PARTS = {"formulas": formulas, "designs": designs, "intervals": intervals, "curves": curves}


def show(part, target, rows, options):
    """Print the rows of a part and a target."""

    def column(name):
        return np.array([row[name] for row in rows], dtype=float)

    title = f"{part:<9} P = {100 * target:g} %, {len(rows)} bearings:"
    match part:
        case "formulas":
            head("target", "problem", "verified", "meet", "fresh, median and most", "excess of the cost, median, most")
            for name in (*options.problems, "all"):
                some = [row for row in rows if row["problem"] == name or (name == "all" and row["problem"] != "jump")]
                if not some:
                    continue
                good = [row for row in some if row["status"] == "verified"]
                fresh, excess = [row["fresh"] for row in some], [100.0 * row["excess"] for row in good] or [np.nan]
                line(
                    f"{100 * target:g} %",
                    name,
                    f"{len(good)} of {len(some)}",
                    f"{sum(row['meets'] for row in good)} of {len(good)}",
                    f"{np.median(fresh):.0f}, {np.max(fresh)}",
                    f"{np.median(excess):.1f}, {np.max(excess):.1f} %",
                )
        case "intervals":
            off = 100.0 * column("off")
            print(
                f"{title} the classifier's probability is off by {off.std():.1f} % (standard deviation), "
                f"{off.min():.0f} to {off.max():.0f} %; misclassified {100 * np.median(column('wrong')):.1f} %"
            )
            for name in options.estimators:
                cover = column(f"cover {name}")
                print(
                    f"  {name}: cover {cover.mean():.3f}, worst {cover.min():.2f}; upper bounds "
                    f"{column(f'upper {name}').mean():.3f}, over P by {column(f'over {name}').mean():.3f}; "
                    f"x MC {np.median(column(f'mc {name}')):.1f}; x Sobol' {np.median(column(f'sobol {name}')):.1f}"
                )
        case "designs":
            verified = [row for row in rows if row["status"] == "verified"]
            over = np.array([100.0 * row["oversize"] for row in verified] or [np.nan])
            print(
                f"| {100 * target:g} % | {len(verified)} of {len(rows)} | {sum(row['meets'] for row in verified)} "
                f"of {len(verified)} | {np.median(over):.1f} % ({over.min():.1f} to {over.max():.1f} %) | "
                f"{(over > 20.0).sum()} | {np.median(column('simulations')):.0f}, {column('simulations').max():.0f} |"
            )
        case "curves":
            for axis, (name, words) in itertools.product(("pgv", "a_p"), KINDS.items()):
                median, beta = (100.0 * np.abs(column(f"{name}_{of}_{axis}")) for of in ("median", "dispersion"))
                print(
                    f"{title} against {axis}, {words}: median off by {np.median(median):.1f} % (at most "
                    f"{median.max():.1f}), dispersion by {np.median(beta):.1f} % ({beta.max():.1f}); within 1.5 %: "
                    f"{(median <= 1.5).sum()}, within 3 %: {(beta <= 3.0).sum()}, both: "
                    f"{((median <= 1.5) & (beta <= 3.0)).sum()}"
                )
            for axis in ("pgv", "a_p"):
                whole, inside, misfit = (column(f"{name}_{axis}") for name in ("largest", "largest_inside", "misfit"))
                print(
                    f"{title} against {axis}, a level off by {np.median(whole):.3f} (at most {whole.max():.3f}), "
                    f"inside the design space by {np.median(inside):.3f} ({inside.max():.3f}); misfit of the "
                    f"simulations' lognormal {misfit.min():.2f} to {misfit.max():.2f}"
                )


def cases_of(study, part, target, options):
    """Of a part: what a row is of, the bearing, site or problem, and its seed."""
    if part == "formulas":
        names = [name for name in options.problems if name != "jump" or target > 0.03]
        for seed, name in itertools.product(range(options.seed, options.seed + options.seeds), names):
            yield {"problem": name, "number": seed}, name, seed
        return
    study.rng = np.random.default_rng([options.seed, round(1000 * target)])
    drawn = (study.sites if part == "designs" else study.bearings)(target, options.bearings)
    for number, bearing in enumerate(drawn):
        yield {"number": number, "seed": options.seed}, bearing, 1000 * options.seed + number


def main():
    options = asked(
        __doc__,
        parts=list(PARTS),
        targets=list(TARGETS),
        seed=10,
        problems=list(PROBLEMS),
        seeds=10,
        bearings=20,
        campaign=Path("runs/design-benchmark"),
        estimators=["sceptical"],
        simulations=1000,
        out=Path("runs/design-benchmark.jsonl"),
    )
    rows = Rows(options.out, simulations=options.simulations)
    study = Study(options.campaign, options.seed) if {*options.parts} - {"formulas"} else None
    for part, target in itertools.product(options.parts, options.targets):
        if part == "curves" and target != TARGETS[0]:
            continue
        shown = []
        for case, of, number in cases_of(study, part, target, options):
            case |= {"part": part, "target": target}
            if rows.lack(**case):
                with one_thread():
                    found = PARTS[part](study, of, target, number, options)
                rows.add(**case, **found)
            shown += rows.of(**case)
        show(part, target, shown, options)


if __name__ == "__main__":
    main()
