"""What a probability over finitely many values costs, how wrong it is, and how often its intervals hold.

    python studies/stripes.py --part questions --seeds 3
    python studies/stripes.py --part designs --seeds 3
    python studies/stripes.py --part curves --seeds 3
    python studies/stripes.py --part ida --seeds 3
    python studies/stripes.py --part intervals --repetitions 30
    python studies/stripes.py --part unsure --repetitions 150
    python studies/stripes.py --part halves --repetitions 300

`questions`: a bearing under the 44 far-field records of FEMA P695 (needs `activefail[records]`). After a campaign, one
design after another at one peak ground velocity is asked for with `--wrong`; the truth is the result of all records.

`designs`: the same campaign; `design --wrong` for the smallest D_tot of three bearings, for 10 % and then 2.5 %. A
result is right if it meets the target under all records, and the next smaller value does not.

`curves`: the same campaign; `fragility --wrong` against PGV of two bearings. The true median and dispersion are those
of the 44 capacities, to 2 %.

`ida`: the same campaign; an incremental dynamic analysis of two bearings that begins where the classifier predicts,
beside one by the ladder.

`intervals`: a made-up limit state of 44 values in 14 groups, as records in events, drawn anew in each repetition from a
population without end. A part of it is hidden: no feature shows it, so the classifier is wrong where it is sure. Or a
share of the values is irregular: at the asked design alone they end on the other side, so that no campaign shows it;
with equal weights and with lognormal ones. Each repetition is a campaign with three questions. The intervals are judged
by the share of these values, and of the population.

`unsure`: the rule and the interval of these values by made-up classifiers without a campaign, which is quick, over five
questions. Values lie at normal distances from the boundary, of which the classifier knows all but a normal part. It may
take this part for smaller than it is ("sure"), and all values of a question may share some of it ("common"). Irregular
values are on the other side, all of them or those that are predicted to be safe, in all questions or in the last alone.

`halves`: the interval of other records from half of the events. The truth is the share of all records, or of the other
half, which has a sampling error of its own.
"""

import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.special import ndtr
from study import asked, head, in_memory, line, percent, spread

from activefail.analyses.design.by_stripes import STEPS, design_by_stripes
from activefail.analyses.design.design_task import Requirement, design_task
from activefail.analyses.fragility.by_stripes import fragility_by_stripes
from activefail.analyses.fragility.capacities import fit_lognormal
from activefail.analyses.fragility.levels import ladder_of
from activefail.analyses.stripes.intervals import Checked, of_others
from activefail.analyses.stripes.stripe import Stripe, Stripes
from activefail.campaign.assembly import Campaign
from activefail.campaign.finite import FiniteValues
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import asked_of
from activefail.campaign.settings import CampaignSettings, checked
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.seismic.ida.by_campaign import capacities_by_campaign
from activefail.seismic.ida.capacity import BISECTIONS, LEVELS, capacities
from activefail.seismic.ida.simulations import CampaignSubject, Ground
from activefail.seismic.motions.accelerogram_sets import read_record_set
from activefail.simulators.interface import Results

HERE = Path(__file__).parent
BEARING = ("T_b", "mu", "D_tot", "h_sl_ratio", "h_rim_ratio", "p", "k")
OTHERS = {"h_sl_ratio": 0.6, "h_rim_ratio": 0.1, "p": 45.0, "k": 2e9}

RECORDS = {
    "T_b": {"low": 2.5, "high": 5.5},
    "mu": {"low": 0.02, "high": 0.12},
    "D_tot": {"low": 0.45, "high": 0.85},
    "record": {"choices": list(range(44))},
    "PGV": {"low": 0.3, "high": 3.0, "distribution": "log_uniform"},
}
SIZES = (2, 2, 2, 2, 4, 4, 4, 2, 4, 2, 4, 4, 4, 4)
"""Values in each of 14 groups, as records in the events of the far-field set."""

GROUP = np.repeat(np.arange(len(SIZES)), SIZES)


@cache
def records():
    """Motions, events and peak velocities of the far-field set."""
    found = read_record_set(Path("farfield"), None, None).records
    motions = [one.motion for one in found]
    return motions, [one.event for one in found], np.array([motion.peak_velocity for motion in motions])


def scaled(record, pgv):
    """The records of designs, scaled, for `simulate_records`."""
    motions, _, velocities = records()
    return [motions[int(k)].scaled(v / velocities[int(k)]) for k, v in zip(record, pgv, strict=True)]


def rows_of(T_b, mu, D_tot):
    """Bearings, (n, 7)."""
    columns = {"T_b": T_b, "mu": mu, "D_tot": D_tot} | OTHERS
    return np.column_stack([np.broadcast_to(columns[name], np.shape(D_tot)) for name in BEARING])


class Simulated:
    """A simulator of two outcomes by a function of designs, (n, d) -> whether each fails, (n,)."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("",), (), True

    def __init__(self, fails):
        self.fails = fails

    def run(self, X):
        n = len(X)
        outcome = np.asarray(self.fails(X)).astype(np.int8)
        return Results(outcome, np.zeros(n, dtype=np.int8), np.empty((n, 0)), np.zeros(n))


def bearing_fails(X):
    from activefail.seismic.bearing import simulate_records

    T_b, mu, D_tot, record, pgv = X.T
    return simulate_records(rows_of(T_b, mu, D_tot), scaled(record, pgv), threads=1).outcome == 2


def features(X, space):
    """The design, the velocity, and the two cheap models under the record."""
    from activefail.seismic.bearing.record_features import record_features

    motions, _, velocities = records()
    T_b, mu, D_tot, record, pgv = space.table(X, tuple(RECORDS)).T
    which = record.astype(int)
    physics = record_features(rows_of(T_b, mu, D_tot), motions, which, pgv / velocities[which])
    return np.column_stack([T_b, mu, D_tot, np.log(pgv), physics])


def learned_campaign(fails, space, features, runs, seed):
    """A campaign in memory, run to its end."""
    settings = {
        "seed": seed,
        "space": space,
        "sampling": {"initial": 2 * runs // 3, "budget": runs, "batch": 5},
        "classifier": {"features": features, "kernel": "matern52"},
        "acquisition": {"boundary": "failure"},
    }
    campaign = Campaign.of(checked(CampaignSettings, settings, "study"), HERE, simulator=Simulated(fails))
    return in_memory(campaign)


def asking(found, executor, at_once=3):
    """What asks, and learns after each round."""
    kept = [None]

    def learn():
        kept[0] = current(found.campaign, found.store, True, kept[0])
        return kept[0].classifier

    return Stripes(found.campaign, found.store, executor, learn, at_once)


CONFIDENCE = 0.9
ROUNDING = 1e-9


def holds(interval, truth):
    return interval is not None and interval.low - ROUNDING <= truth <= interval.high + ROUNDING


def questions(options):
    """Runs and errors of one question after another."""
    kept = {}
    low, high = np.array([[one["low"], one["high"]] for one in list(RECORDS.values())[:3]]).T
    for wrong in options.wrong:
        for seed in range(options.seeds):
            of_records = {"python": "stripes:features", "variables": False}
            found = learned_campaign(bearing_fails, RECORDS, of_records, options.runs, seed)
            rng = np.random.default_rng(seed)
            with ThreadExecutor(1) as executor, one_thread():
                asks = asking(found, executor)
                for number in range(options.questions):
                    design = low + rng.random(3) * (high - low)
                    fixed = dict(zip(("T_b", "mu", "D_tot"), design.tolist(), strict=True)) | {"PGV": options.pgv}
                    X = np.column_stack([np.tile(design, (44, 1)), np.arange(44.0), np.full(44, options.pgv)])
                    truth = float(bearing_fails(X).mean())
                    stripe = asks.ask(asked_of("study", found.campaign.space, {}, fixed), "failure", wrong)
                    error = 100.0 * abs(stripe.probability - truth)
                    row = stripe.new, error, holds(stripe.of_these(CONFIDENCE), truth)
                    kept.setdefault((wrong, number), []).append(row)
                    print(f"seed {seed} wrong {wrong} question {number + 1}: P {truth:.3f}, {row}", file=sys.stderr)
    head(
        "runs before",
        "wrong",
        "question",
        "runs",
        "mean",
        "error of P [points]",
        "mean",
        "interval holds",
        "all records",
    )
    for (wrong, number), rows in sorted(kept.items()):
        runs, errors, held = zip(*rows, strict=True)
        means = f"{np.mean(runs):.1f}", f"{np.mean(errors):.2f}"
        held = f"{sum(held)} of {len(held)}"
        line(options.runs, wrong, number + 1, spread(runs, 0), means[0], spread(errors, 1), means[1], held, 44)


def designs(options):
    """Runs and results of one design after another."""
    grid = np.linspace(RECORDS["D_tot"]["low"], RECORDS["D_tot"]["high"], STEPS + 1)
    head("seed", "T_b [s]", "mu", "target", "D_tot [m]", "stripes", "runs", "all records", "right")
    for seed in range(options.seeds):
        of_records = {"python": "stripes:features", "variables": False}
        found = learned_campaign(bearing_fails, RECORDS, of_records, options.runs, seed)
        with ThreadExecutor(1) as executor, one_thread():
            asks = asking(found, executor)
            for T_b, mu in ((3.5, 0.06), (4.5, 0.08), (3.0, 0.1)):
                for target in (0.1, 0.025):
                    fixed = {"T_b": T_b, "mu": mu, "PGV": options.velocity}
                    inquiry = Inquiry.of(found.campaign, fixed=fixed, free=["D_tot"])
                    task = design_task(inquiry, (Requirement("failure", target),))
                    result = design_by_stripes(asks, task, options.wrong[0])
                    place, right = int(np.argmin(np.abs(grid - result.values["D_tot"]))), True
                    is_met = result.status == "met"
                    for k, meets in ((place, is_met), (place - 1, False)):
                        if k >= 0 and (k == place or is_met):
                            X = [[T_b, mu, grid[k], record, options.velocity] for record in range(44)]
                            right &= bool(bearing_fails(np.array(X)).mean() <= target + ROUNDING) == meets
                    at = f"{grid[place]:.2f}" if is_met else f"> {grid[-1]:.2f}"
                    count = len(result.looks)
                    line(seed, T_b, mu, target, at, count, result.simulations, 44 * count, "yes" if right else "no")


@cache
def exact_curve(T_b, mu, D_tot):
    """The lognormal curve of a bearing from 44 records at levels 2 % apart."""
    low, high = RECORDS["PGV"]["low"], RECORDS["PGV"]["high"]
    levels = low * 1.02 ** np.arange(int(np.log(high / low) / np.log(1.02)) + 1)
    X = np.array([[T_b, mu, D_tot, record, level] for level in levels for record in range(44)])
    fails = bearing_fails(X).reshape(len(levels), 44)
    first = np.where(fails.any(axis=0), fails.argmax(axis=0), len(levels))
    return fit_lognormal(np.append(0.0, levels)[first], np.append(levels, np.inf)[first])


def capacity(options):
    """Runs of incremental dynamic analyses that begin where the classifier predicts, and what they find."""
    low, high = RECORDS["PGV"]["low"], RECORDS["PGV"]["high"]
    head(
        "seed", "T_b [s]", "mu", "D_tot [m]", "runs a record", "most", "by the ladder", "median capacity differs",
        "largest", "median", "by the ladder", "dispersion", "by the ladder",
    )  # fmt: skip
    ground = Ground(records=read_record_set(Path("farfield"), None, None))
    for seed in range(options.seeds):
        of_records = {"python": "stripes:features", "variables": False}
        found = learned_campaign(bearing_fails, RECORDS, of_records, options.runs, seed)
        asked = SimpleNamespace(campaign=found.campaign, store=found.store, space=found.campaign.space)
        for T_b, mu, D_tot in ((3.5, 0.06, 0.6), (4.5, 0.08, 0.7)):
            with ThreadExecutor(1) as executor, one_thread():
                asked.classifier = current(found.campaign, found.store, True).classifier
                asked.history = History.of(found.store.batches)
                values = {"T_b": T_b, "mu": mu, "D_tot": D_tot}
                subject = CampaignSubject("study", found.campaign, ground, values, executor)
                simulate = partial(subject.simulate, [], np.empty(0), lambda _: None)
                rungs = np.geomspace(low, high, LEVELS)
                few = capacities_by_campaign(subject, asked, simulate, 44, rungs, 1)
                subject.keep = lambda *_: None
                many = capacities(simulate, 44, rungs, BISECTIONS, 1)
            both = np.isfinite(few.capacity) & np.isfinite(many.capacity)
            differs = 100.0 * np.abs(few.capacity[both] / many.capacity[both] - 1.0)
            runs = np.array([len(one) for one in few.levels])
            fits = [fit_lognormal(one.below, one.capacity) for one in (few, many)]
            medians, dispersions = ([f"{getattr(one, of):.3f}" for one in fits] for of in ("median", "dispersion"))
            found_of = f"{np.median(differs):.1f} %", f"{differs.max():.0f} %", *medians, *dispersions
            line(seed, T_b, mu, D_tot, f"{runs.mean():.1f}", runs.max(), f"{many.runs / 44:.1f}", *found_of)


def curves(options):
    """Runs, and errors of median and dispersion, of one curve after another."""
    head("seed", "T_b [s]", "mu", "D_tot [m]", "levels", "runs", "all records", "median", "true", "dispersion", "true")
    for seed in range(options.seeds):
        of_records = {"python": "stripes:features", "variables": False}
        found = learned_campaign(bearing_fails, RECORDS, of_records, options.runs, seed)
        with ThreadExecutor(1) as executor, one_thread():
            asks = asking(found, executor)
            for T_b, mu, D_tot in ((3.5, 0.06, 0.6), (4.5, 0.08, 0.7)):
                exact = exact_curve(T_b, mu, D_tot)
                inquiry = Inquiry.of(found.campaign, fixed={"T_b": T_b, "mu": mu, "D_tot": D_tot})
                ladder = ladder_of(inquiry, against="PGV")
                found_curve = fragility_by_stripes(asks, inquiry, ladder, "failure", options.wrong[0], CONFIDENCE)
                curve = found_curve.boundaries[0]
                fit = curve.fit.fit
                count, runs = len(curve.verified), sum(one.estimate.simulations for one in curve.verified)
                found_of = (
                    f"{fit.median:.2f}",
                    f"{exact.median:.2f}",
                    f"{fit.dispersion:.2f}",
                    f"{exact.dispersion:.2f}",
                )
                line(seed, T_b, mu, D_tot, count, runs, 44 * count, *found_of)


MADE_UP = {
    "x": {"low": -1.0, "high": 2.5},
    "y": {"low": 0.0, "high": 2.0},
    "record": {"choices": list(range(44))},
}


class MadeUp:
    """A limit state 1.4 x + 0.4 y f₁ + 0.7 (e + f₀) + c h > 1.6 with normal e of a group, f and h of a value.

    Of the values of a question, those that are irregular end on the other side.
    """

    def __init__(self, hidden, rng):
        self.irregular = {}
        of_group, self.hidden = rng.normal(size=len(SIZES))[GROUP], hidden
        f = rng.normal(size=(44, 2))
        self.seen, self.other = of_group + f[:, 0], f[:, 1]
        # A part of what is hidden belongs to the group, too.
        self.unseen = np.sqrt(0.5) * (rng.normal(size=len(SIZES))[GROUP] + rng.normal(size=44))

    def fails(self, X):
        x, y, record = X.T
        k = record.astype(int)
        regular = 1.4 * x + 0.4 * y * self.other[k] + 0.7 * self.seen[k] + self.hidden * self.unseen[k] > 1.6
        none = np.zeros(44, bool)
        return regular ^ [self.irregular.get(at, none)[one] for at, one in zip(x.tolist(), k, strict=True)]

    def probability(self, x, y):
        """Of the population."""
        return float(ndtr((1.4 * x - 1.6) / np.sqrt(0.16 * y**2 + 0.98 + self.hidden**2)))

    def features(self, X, space):
        x, y, record = space.table(X, ("x", "y", "record")).T
        k = record.astype(int)
        return np.column_stack([x, y, self.seen[k], self.other[k]])


CASE = [None]
"""The present one: a campaign's features are a function of a module."""


def made_up_features(X, space):
    return sys.modules["__main__"].CASE[0].features(X, space)


def intervals(options):
    """How often both intervals hold, and what they cost."""
    head(
        "hidden", "irregular", "weights", "question", "number", "runs", "error [points]", "wrong where sure",
        "these hold", "width [points]", "others hold",
    )  # fmt: skip
    cases = [(hidden, 0.0, False) for hidden in options.hidden]
    cases += [(0.0, irregular, uneven) for irregular in options.irregular for uneven in (False, True)]
    for hidden, irregular, uneven in cases:
        rows = []
        for seed in range(options.repetitions):
            rng = np.random.default_rng([seed, int(100 * hidden)])
            CASE[0] = case = MadeUp(hidden, rng)
            weight = np.exp(rng.normal(size=44)) if uneven else np.ones(44)
            weight /= weight.sum()
            space = MADE_UP | {"record": MADE_UP["record"] | {"probabilities": weight.tolist()}}
            of_case = {"python": "stripes:made_up_features", "variables": False}
            found = learned_campaign(case.fails, space, of_case, options.runs, seed)
            with ThreadExecutor(1) as executor, one_thread():
                asks = asking(found, executor)
                for number in range(3):
                    x, y = rng.uniform(-0.6, 1.2), rng.uniform(0.0, 2.0)
                    case.irregular[x] = rng.random(44) < irregular
                    truth = case.fails(np.column_stack([np.full(44, x), np.full(44, y), np.arange(44.0)]))
                    stripe = asks.ask(
                        asked_of("study", found.campaign.space, {}, {"x": x, "y": y}), "failure", options.wrong[0]
                    )
                    values = replace(stripe.values, group=GROUP)
                    stripe, exact, these = replace(stripe, values=values), weight @ truth, stripe.of_these(CONFIDENCE)
                    rows.append(
                        (
                            number,
                            stripe.new,
                            100.0 * abs(stripe.probability - exact),
                            (stripe.beyond != truth).sum() / max(1, stripe.predicted.sum()),
                            holds(these, exact),
                            100.0 * (these.high - these.low),
                            holds(stripe.of_others(CONFIDENCE), case.probability(x, y)),
                        )
                    )
            print(f"{hidden} {irregular} {uneven} seed {seed}: {rows[-3:]}", file=sys.stderr)
        for numbers in ((0,), (1, 2)):
            some = [one for one in rows if one[0] in numbers]
            _, runs, errors, wrong, these, widths, others = map(np.array, zip(*some, strict=True))
            error = f"{errors.mean():.2f} (to {errors.max():.1f})"
            line(
                hidden, irregular, "unequal" if uneven else "equal", "first" if numbers == (0,) else "further",
                len(some), spread(runs, 0), error, percent(wrong), percent(these), f"{widths.mean():.0f}",
                percent(others) if irregular == 0.0 else "",
            )  # fmt: skip


UNSURE = {
    "regular": {},
    "10 %": {"irregular": 0.1},
    "10 %, unequal weights": {"irregular": 0.1, "weights": "lognormal"},
    "10 % of the safe ones, unequal weights": {"irregular": 0.1, "safe": True, "weights": "lognormal"},
    "10 %, half of the weight on one value": {"irregular": 0.1, "weights": "one"},
    "10 %, three quarters of the weight on three values": {"irregular": 0.1, "weights": "three"},
    "10 % of 8 values": {"irregular": 0.1, "count": 8},
    "10 % of 20 values": {"irregular": 0.1, "count": 20},
    "5 % of 400 values": {"irregular": 0.05, "count": 400},
    "10 %, none predicted to fail": {"irregular": 0.1, "middle": (-6.0, -6.0)},
    "10 %, only in the last question": {"irregular": 0.1, "last": True},
    "10 %, only in the last question, none predicted to fail": {"irregular": 0.1, "last": True, "middle": (-6.0, -6.0)},
    "20 %, only in the last question, none predicted to fail": {"irregular": 0.2, "last": True, "middle": (-6.0, -6.0)},
    "too sure by 10": {"sure": 10.0, "unknown": 0.3},
    "too sure by 10, mistakes in common": {"sure": 10.0, "unknown": 0.3, "common": 0.8},
    "few predicted to fail, too sure by 10, in common": {
        "sure": 10.0, "unknown": 0.5, "common": 0.8, "middle": (-2.5, -1.5)
    },
}  # fmt: skip
"""Made-up classifiers."""


def by_classifier(probit, truth, weight, earlier, wrong, rng):
    """A question that a classifier with these latents, (n,), answers; it learns nothing from it."""
    n, rounds, p = len(weight), (), ndtr(probit)
    values, known = FiniteValues(("value",), np.zeros((n, 1)), weight, None), np.zeros(n, bool)
    order, asks = np.argsort(rng.exponential(size=n) / weight), SimpleNamespace(at_once=3)
    while True:
        beyond, doubt = np.where(known, truth, probit > 0.0), np.where(known, 0.0, np.minimum(p, 1.0 - p))
        stripe = Stripe(
            None, "failure", values, known.copy(), np.zeros(n, bool), beyond, doubt, wrong, rounds, earlier,
            int(known.sum()), 0,
        )  # fmt: skip
        if not (one := Stripes._chosen(asks, stripe, stripe.predicted, order)).rows:
            return stripe
        rounds = (*rounds, one)
        known[one.chosen] = True


def unsure(options):
    """How often the interval of these values holds, by made-up classifiers."""
    head("classifier", "question", "runs", "error [points]", "these hold", "width [points]")
    for name, of in UNSURE.items():
        of = {"count": 44, "irregular": 0.0, "unknown": 0.1, "common": 0.0, "middle": (-1.5, 1.0), "sure": 1.0} | of
        rows, n = [], of["count"]
        for seed in range(options.repetitions):
            rng, earlier = np.random.default_rng(seed), Checked(0, 0)
            for number in range(5):
                weight = np.exp(rng.normal(size=n)) if of.get("weights") == "lognormal" else np.ones(n)
                weight[: {"one": 1, "three": 3}.get(of.get("weights"), 0)] = n
                weight /= weight.sum()
                distance = rng.uniform(*of["middle"]) + rng.normal(size=n)
                shared, own = rng.normal(), rng.normal(size=n)
                off = of["unknown"] * (np.sqrt(of["common"]) * shared + np.sqrt(1.0 - of["common"]) * own)
                irregular = (rng.random(n) < of["irregular"]) & (number == 4 or not of.get("last"))
                if of.get("safe"):
                    irregular &= distance <= 0.0
                truth, probit = np.where(irregular, distance <= 0.0, distance + off > 0.0), distance / of["unknown"]
                stripe = by_classifier(of["sure"] * probit, truth, weight, earlier, options.wrong[0], rng)
                earlier = Checked(*np.add(earlier, stripe.checked).tolist())
                these, exact = stripe.of_these(CONFIDENCE), float(weight @ truth)
                error, width = abs(stripe.probability - exact), these.high - these.low
                rows.append((stripe.new, 100.0 * error, holds(these, exact), 100.0 * width))
        for number in (0, 4):
            runs, errors, held, widths = np.array(rows, float)[number::5].T
            line(
                name,
                number + 1,
                f"{runs.mean():.0f}",
                f"{errors.mean():.1f}",
                f"{held.mean():.3f}",
                f"{widths.mean():.0f}",
            )


def halves(options):
    """How often the interval of other records from half of the events holds."""
    head("PGV [m/s]", "D_tot [m]", "P", "all records", "other half", "mean width [points]")
    events = np.unique(records()[1], return_inverse=True)[1]
    rng = np.random.default_rng(options.seed)
    for pgv in (1.2, 1.6, 2.0):
        for D_tot in (0.5, 0.65, 0.8):
            X = np.column_stack([np.tile([4.0, 0.06, D_tot], (44, 1)), np.arange(44.0), np.full(44, pgv)])
            fails, held, others, widths = bearing_fails(X), [], [], []
            for _ in range(options.repetitions):
                kept = np.isin(events, rng.permutation(events.max() + 1)[: (events.max() + 1) // 2])
                group = np.unique(events[kept], return_inverse=True)[1]
                found = of_others(
                    fails[kept], np.full(kept.sum(), 1.0 / kept.sum()), group, np.zeros((2, 1)), CONFIDENCE
                )
                held.append(holds(found, fails.mean()))
                others.append(holds(found, fails[~kept].mean()))
                widths.append(100.0 * (found.high - found.low))
            line(pgv, D_tot, f"{fails.mean():.3f}", percent(held), percent(others), f"{np.mean(widths):.0f}")


if __name__ == "__main__":
    options = asked(
        __doc__,
        part="questions",
        seeds=3,
        seed=1,
        repetitions=30,
        runs=60,
        questions=6,
        pgv=1.6,
        velocity=1.2,
        wrong=[0.01],
        hidden=[0.0, 0.3, 0.8],
        irregular=[0.01, 0.03, 0.05, 0.1],
    )
    {
        "questions": questions,
        "designs": designs,
        "curves": curves,
        "ida": capacity,
        "intervals": intervals,
        "unsure": unsure,
        "halves": halves,
    }[options.part](options)
