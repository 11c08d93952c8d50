"""One probability, and runs that say nothing: what the classifier says against direct simulation.

    python studies/answers.py --part fragility --campaign runs/bearing     8 bearings x 6 hazards (half an hour)
    python studies/answers.py --part lost                                  10 campaigns x 20 estimates
    python studies/answers.py --part outcomes --seeds 3                    3 campaigns x 10 estimates
    python studies/answers.py --part fresh                                 4 x 10 campaigns x 3 estimates, 10 designs

The parts are

    fragility  the curves of failure and of impact or worse of each bearing, and of that of docs/hazard.md at the lower
               bounds of its properties, for M 6 to 8: the largest excess of failure over impact or worse, and the risk
               in 50 years over that of simulations of the same pulses, where it is above 0.05 %. The campaign is one of
               campaigns/bearing.toml, run first if the folder does not exist
    lost       a solver that gives up where x2 < -2.5: 3 - x1 - 0.1 x2 <= 0 for normal variables. The share of nominal
               90 % intervals, each of 50 fresh simulations, that contain the probability if no lost run is a failure,
               and if all are. And, from outcomes, a mesh that dies where x2 < 0, with failure where 0.5 - x1 - 0.1 x2
               <= 0: how many runs are lost among the first 20 and the last 40

    outcomes   failure that is hardly rarer than impact or worse, 2 - x1 - 0.3 sin(2 x2) at most 0 or 0.25, learned from
               80 outcomes: how often P(failure) exceeds the other, and the coverage and mean width of nominal 90 %
               intervals, each of 50 fresh simulations
    fresh      failure where a normal variable exceeds 1.4, or jumps to failure in a slab of 3.3 %, from campaigns of 16
               simulations with its margin and two idle variables that a constraint ties, so that 100, 19, 2 or 0.5 % of
               the designs exist. The shares of nominal 90 % intervals from 400 fresh simulations that contain P, and of
               90 % bounds without a classifier that hold; different designs; the error. And designs for P <= 10 % with
               1 % of the designs: how many are verified, and how many of these exceed the target

Each line of --out is one bearing or campaign; a repeated command continues where it stopped.
"""

from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from problems import Problem, standard
from scipy.stats import norm
from study import Rows, asked, in_memory

from activefail import create_run, open_run, simulate
from activefail.analyses.design.design_task import DesignTask, Requirement
from activefail.analyses.design.search import find_design
from activefail.analyses.fragility.curve import Curve, Ladder, Rate, risk_of
from activefail.analyses.fragility.levels import curves_on
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.estimates.integral import BoundariesOf
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.seismic.hazard.hazard import Hazard
from activefail.simulators.interface import NUMERICAL_FAILURE

MAGNITUDES = (6.0, 6.4, 6.8, 7.0, 7.4, 8.0)
RATES = {"pgv_m_s": [0.2, 0.5, 1.0, 2.0], "annual_rate": [1e-2, 2e-3, 4e-4, 5e-5]}
DOCUMENTED = {"T_b": 4.0, "mu": 0.8 * 0.06, "D_tot": 0.65, "h_sl_ratio": 0.6, "h_rim_ratio": 0.1, "p": 45.0, "k": 2e9}
PULSES = 256
IF_NONE, IF_ALL = 1.4174e-3, 7.6e-3
OF_IMPACT, OF_FAILURE = 0.04353, 0.02519


def fragility(folder, number):
    """The ratios of one bearing under all hazards."""
    opened = open_run(folder) if folder.exists() else create_run(folder, "campaigns/bearing.toml")
    with opened as opened:
        if opened.history.asked_for < opened.settings.sampling.budget:
            opened.take()
        space, rng, rows = opened.space, np.random.default_rng([abs(number), 3]), []
        bearing = {p.name: float(p.low + (p.high - p.low) * rng.random()) for p in space.parameters[:7]}
        bearing = bearing if number >= 0 else DOCUMENTED
        boundaries = BoundariesOf(opened.classifier, opened.campaign.features)
        for M in MAGNITUDES:
            pgv = {"median_m_s": 1.0, "dispersion": 0.25}
            hazard = Hazard.of({"magnitude": {"M": M}, "pgv": pgv, "curve": RATES}, Path("hazard.toml"))

            def at(level, hazard=hazard):
                return hazard.question(space, bearing, level)

            with one_thread():
                levels = Ladder(hazard.intensity, hazard.unit, hazard.levels(), is_log=True)
                curves = curves_on(boundaries, at, levels, space)[0]
            ladder = curves[0].ladder
            designs = [at(v).designs(at(v).space.sobol(PULSES, np.random.default_rng(1))) for v in ladder.levels]
            outcome = simulate(np.concatenate(designs)).outcome.reshape(len(designs), PULSES)
            excess = float(np.max(curves[1].probability - curves[0].probability))
            outside = at(1.0).share_outside(space)
            row = {"bearing": number, "M": M, "outside": outside, "excess": excess, "risk": [], "true": []}
            for severity, curve in enumerate(curves, start=1):
                true = Curve(ladder, (outcome >= severity).mean(axis=1), 0.0)
                for key, one in (("risk", curve), ("true", true)):
                    risk = risk_of(one, Rate(np.array(RATES["pgv_m_s"]), np.array(RATES["annual_rate"])))
                    row[key].append(risk.probability)
            rows.append(row)
    return rows


class GivesUp(Problem):
    """A limit state whose solver gives up far out: without margins nearer."""

    def run(self, X):
        results = super().run(X)
        lost = X[:, 1] < (-2.5 if self.margins else 0.0)
        margins = np.where(lost[:, None], np.nan, results.margins)
        return replace(results, outcome=np.where(lost, NUMERICAL_FAILURE, results.outcome), margins=margins)


SOLVER = GivesUp(lambda X: 3.0 - X[:, 0] - 0.1 * X[:, 1], standard(2))
MESH = GivesUp(lambda X: 0.5 - X[:, 0] - 0.1 * X[:, 1], standard(2), shown=None)


def lost(problem, seed, estimates=20):
    """One campaign and its estimates; none from outcomes."""
    margins = bool(problem.margins)
    campaign = problem.campaign(
        seed=seed,
        sampling__initial=12 if margins else 24,
        sampling__batch=4,
        sampling__budget=60 if margins else 100,
        limits__numerical_failures=1.0,
        **({"stop": {"probability": "failure", "cov": 0.1}} if margins else {}),
    )
    learned = in_memory(campaign)
    gone = ~learned.history.answered
    row = {"margins": margins, "seed": seed, "simulations": len(gone), "met": learned.looks.is_known}
    row |= {"first": gone[:20].sum(), "last": gone[-40:].sum(), "none": 0, "all": 0, "estimates": estimates}
    with ThreadExecutor(1) as executor, one_thread():
        last = learned.history.last_iteration
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, last)
        for draw in range(1, estimates + 1 if margins else 1):
            question = Question.of_space(campaign.space).drawn(draw)
            estimate = estimator.sample("failure", 50, question).estimate(0.9)
            row["none"] += bool(estimate.low <= IF_NONE <= estimate.high)
            row["all"] += bool(estimate.low <= IF_ALL <= estimate.high)
    return row


class Nearly(Problem):
    """A limit state with an impact nearby."""

    outcomes = ("safe", "impact", "failure")

    def run(self, X):
        return replace(super().run(X), outcome=np.digitize(-self.limit(X), [-0.25, 0.0]).astype(np.int8))


NEARLY = Nearly(lambda X: 2.0 - X[:, 0] - 0.3 * np.sin(2.0 * X[:, 1]), standard(2), shown=None)


def outcomes(seed, estimates=10):
    """The estimates of both outcomes from one campaign."""
    campaign, rows = NEARLY.campaign(seed=seed, sampling__initial=80, sampling__batch=4, sampling__budget=80), []
    learned = in_memory(campaign)
    with ThreadExecutor(1) as executor, one_thread():
        last = learned.history.last_iteration
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, last)
        for draw in range(estimates):
            question = Question.of_space(campaign.space)
            question = question.drawn(draw) if draw else question
            of = [estimator.sample(one, 50, question).estimate(0.9) for one in NEARLY.outcomes[1:]]
            rows.append({"seed": seed, "draw": draw, "of": [(one.probability, one.low, one.high) for one in of]})
    return rows


SHARES = (1.0, 0.19, 0.02, 0.005)
JUMP = norm.cdf(-0.79) - norm.cdf(-0.91)
IDLE = {"a": {"low": 0.0, "high": 1.0}, "b": {"low": 0.0, "high": 1.0}}


def jumps(X, at):
    """A margin, from at, that jumps to failure in a slab."""
    return np.where((X > -0.91) & (X < -0.79), -1.0, at - X)


def tied(share):
    """The constraint on the idle variables that leaves this share of the designs."""
    return [f"a - b >= {1.0 - (2.0 * share) ** 0.5}"] if share < 0.5 else []


def fresh(share, seed, estimates=3):
    """The estimates from one campaign."""
    problem = Problem(lambda X: jumps(X[:, 2], 1.4), IDLE | standard(1))
    campaign = problem.campaign(
        seed=seed, constraints=tied(share), sampling__initial=12, sampling__batch=4, sampling__budget=16
    )
    learned, rows = in_memory(campaign), []
    with ThreadExecutor(1) as executor, one_thread():
        last = learned.history.last_iteration
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, last)
        for draw in range(1, estimates + 1):
            sampled = estimator.sample("failure", 400, Question.of_space(campaign.space).drawn(draw))
            one = sampled.estimate(0.9)
            row = {"share": share, "seed": seed, "draw": draw, "bound": one.bound}
            row |= {"of": (one.probability, one.low, one.high)}
            rows.append(row | {"different": len(np.unique(sampled.plan.designs, axis=0))})
    return rows


def designed(seed, target=0.1):
    """The design for a target from one campaign."""
    capacity = {"k": {"low": 1.0, "high": 4.0}}
    problem = Problem(lambda X: jumps(X[:, 2], X[:, 3]), IDLE | standard(1) | capacity)
    campaign = problem.campaign(
        seed=seed, constraints=tied(0.01), sampling__initial=12, sampling__batch=4, sampling__budget=16
    )
    learned = in_memory(campaign)
    with ThreadExecutor(1) as executor, one_thread():
        last = learned.history.last_iteration
        estimator = Estimator(campaign, learned.store, executor, learned.classifier, last)
        asked_for = Inquiry(None, Question.of_space(campaign.space))
        required = (Requirement("failure", target),)
        task = DesignTask(asked_for, {"k": 1.0}, {"k": 4.0}, itemgetter("k"), "k", required, 0.95, 1000)
        found = find_design(estimator, task)
    k = found.values["k"]
    return {"seed": seed, "design": True, "k": k, "true": JUMP + norm.sf(k), "status": found.status}


def show_fresh(rows):
    true = JUMP + norm.sf(1.4)
    print(f"P {true:.4f}")
    for share in SHARES:
        some = rows.of(share=share)
        middle, low, high = np.array([row["of"] for row in some]).T
        held, bounds = ((low <= true) & (true <= high)).mean(), np.mean([row["bound"] >= true for row in some])
        error, different = np.sqrt(np.mean((middle / true - 1.0) ** 2)), min(row["different"] for row in some)
        print(
            f"  {share:.1%}: {held:.2f} of {len(some)} intervals cover, mean width {np.mean(high - low) / true:.2f} P"
        )
        print(f"    bounds {bounds:.2f}, error {error:.2f}, at least {different} of 400 designs are different")
    some = rows.of(design=True)
    verified = [row for row in some if row["status"] == "verified"]
    over = sum(row["true"] > 0.1 for row in verified)
    print(f"{len(verified)} of {len(some)} designs verified, {over} of these exceed the target")


def show_outcomes(rows):
    of = np.array([row["of"] for row in rows])
    print(f"{len(of)} estimates; P(failure) exceeds P(impact or worse) in {(of[:, 1, 0] > of[:, 0, 0]).sum()}")
    for name, one, true in zip(NEARLY.outcomes[1:], of.swapaxes(0, 1), (OF_IMPACT, OF_FAILURE), strict=True):
        held = ((one[:, 1] <= true) & (true <= one[:, 2])).sum()
        print(f"  {name}: {held} of {len(one)} intervals cover; mean width {np.mean(one[:, 2] - one[:, 1]):.3f}")


def show_fragility(rows):
    for row in rows:
        if row["bearing"] < 0:
            risks = zip(("impact or worse", "failure"), row["risk"], row["true"], strict=True)
            said = "; ".join(f"{name} {risk:.3%}, simulated {true:.3%}" for name, risk, true in risks)
            print(f"the bearing of docs/hazard.md, M {row['M']:g}: {said}")
    print(f"{len(rows)} hazards; largest excess of failure {max(row['excess'] for row in rows):.2g}")
    for title, beyond in (("at most 10 % of the pulses outside", False), ("more of them", True)):
        some = [row for row in rows if (row["outside"] > 0.1) == beyond]
        pairs = [(r, t) for row in some for r, t in zip(row["risk"], row["true"], strict=True) if t > 5e-4]
        if pairs:
            ratios = np.array([r / t for r, t in pairs])
            within = (np.abs(np.log(ratios)) <= np.log(1.15)).sum()
            low, middle, high = np.quantile(ratios, (0.0, 0.5, 1.0))
            print(f"{title}: {within} of {len(ratios)} risks within 1.15; {middle:.2f} ({low:.2f} to {high:.2f})")


def show_lost(rows):
    for margins in (True, False):
        some = rows.of(margins=margins)
        first, last, none, everything, count, met = (
            sum(row[key] for row in some) for key in ("first", "last", "none", "all", "estimates", "met")
        )
        print(f"{'margins' if margins else 'outcomes'}: {len(some)} campaigns, {met} rules met")
        print(f"  lost: {first} of the first 20 of each, {last} of the last 40")
        if margins:
            print(f"  of {count} intervals {none} contain P if no lost run fails, {everything} if all do")


def main():
    options = asked(__doc__, part="", campaign=Path("runs/bearing"), bearings=8, seeds=10, out=Path)
    rows = Rows(options.out or Path(f"answers-{options.part}.jsonl"))
    match options.part:
        case "fragility":
            for number in range(-1, options.bearings):
                for row in fragility(options.campaign, number) if rows.lack(bearing=number) else ():
                    rows.add(**row)
            show_fragility(rows.finished)
        case "lost":
            for seed in range(options.seeds):
                for problem in (SOLVER, MESH):
                    if rows.lack(seed=seed, margins=bool(problem.margins)):
                        rows.add(**lost(problem, seed))
            show_lost(rows)
        case "outcomes":
            for seed in range(options.seeds):
                for row in outcomes(seed) if rows.lack(seed=seed) else ():
                    rows.add(**row)
            show_outcomes(rows.finished)
        case "fresh":
            for seed in range(options.seeds):
                for share in SHARES:
                    for row in fresh(share, seed) if rows.lack(seed=seed, share=share) else ():
                        rows.add(**row)
                if rows.lack(seed=seed, design=True):
                    rows.add(**designed(seed))
            show_fresh(rows)
        case _:
            raise SystemExit("--part: must be fragility, fresh, lost or outcomes.")


if __name__ == "__main__":
    main()
