"""Designs for a target by `design` whose probability a formula gives: how many meet it, what they ask for and cost.

    python studies/design_formulas.py            40 designs for each of two targets: four problems, ten seeds (minutes)
    python studies/design_formulas.py --seeds 2  a quick look

For each seed and problem a campaign learns the limit state in the ranges of its design; the loads are uncertain and
lognormal. A design is drawn, but for its free variables, and `design` makes it as cheap as the target allows. The
problems are

    column   one free variable, a margin: capacity · grip over the demand
    tank     the same, learned from outcomes alone
    beam     a width and a height with the cost width · height, a margin; the height is best at its limit
    frame    two limit states in series, the smaller margin: demand of the frame, and of a bearing that moves with it
    jump     the column after a campaign of 16, with 3 % of failures that a jump in an idle variable hides; not in "all"

Each line of --out is one design; a repeated command continues where it stopped. "fresh" are the fresh simulations of
all looks, "excess" the first free variable, or the cost, over the least that meets the target, of verified designs.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm
from study import Rows, asked, campaign_of, head, in_memory, line

from activefail.campaign.inquiry import Inquiry
from activefail.execution.local import ThreadExecutor
from activefail.risk.design.design_task import Requirement, design_task
from activefail.risk.design.search import find_design
from activefail.simulators.interface import Results
from activefail.surrogate.threads import one_thread
from activefail.verification.probability_estimator import Estimator

JUMP = norm.isf(0.03)


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


def designed(name, seed, target, of, simulations=1000):
    """A design, and what is true of it."""
    problem, rng = PROBLEMS[name], np.random.default_rng([seed, round(1e4 * target)])
    while True:
        held = {key: one["low"] + rng.random() * (one["high"] - one["low"]) for key, one in problem.design.items()}
        fixed = {key: value for key, value in held.items() if key not in problem.free}
        if np.isfinite(least := problem.least(fixed, target)):
            break
    asked_of = Inquiry.of(of.campaign, None, None, fixed, problem.free)
    task = design_task(asked_of, (Requirement("failure", target),), problem.free, problem.cost, 0.95, simulations)
    with ThreadExecutor(1) as executor, one_thread():
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


def main():
    options = asked(__doc__, problems=list(PROBLEMS), seeds=10, targets=[0.1, 0.025], simulations=1000, out=Path)
    rows = Rows(options.out, simulations=options.simulations)
    for seed in range(options.seeds):
        for name in options.problems:
            wanted = [target for target in options.targets if name != "jump" or target > 0.03]
            missing = [target for target in wanted if rows.lack(problem=name, seed=seed, target=target)]
            of = learned(name, seed) if missing else None
            for target in missing:
                found = designed(name, seed, target, of, options.simulations)
                rows.add(problem=name, seed=seed, target=target, **found)
    head("target", "problem", "verified", "meet", "fresh, median and most", "excess of the cost, median and most")
    for target in options.targets:
        for name in (*options.problems, "all"):
            some = [row for row in rows.of(target=target) if row["problem"] == name or name == "all"]
            some = [row for row in some if name != "all" or row["problem"] != "jump"]
            if not some:
                continue
            good = [row for row in some if row["status"] == "verified"]
            fresh, excess = [row["fresh"] for row in some], [100.0 * row["excess"] for row in good] or [np.nan]
            meet = f"{sum(row['meets'] for row in good)} of {len(good)}"
            spread = f"{np.median(excess):.1f}, {np.max(excess):.1f} %"
            line(
                f"{100 * target:g} %",
                name,
                f"{len(good)} of {len(some)}",
                meet,
                f"{np.median(fresh):.0f}, {np.max(fresh)}",
                spread,
            )


if __name__ == "__main__":
    main()
