"""From a target failure probability to a bearing: how often designs meet their targets, and what the intervals cover.

    python benchmarks/design.py                         everything: 20 bearings, two targets (about an hour)
    python benchmarks/design.py --parts designs         searched designs against fresh pulses
    python benchmarks/design.py --bearings 3 --seed 7   a quick look at other bearings

A campaign of campaigns/bearing.toml is run first, or read from --campaign. Bearings are drawn from Table 1 for each
target. For the parts intervals and curves the hazard is M 7, PGV 1 m/s, and a bearing is kept if the classifier puts
its required D_tot inside the range. For designs the classifier has no say: each bearing gets a site, M 6.4 to 7.6 and
a median PGV of 0.6 to 1.44 m/s, and is kept if of 500 pulses a share of at most 0.8 times the target fails at the
largest D_tot, and of at least 1.2 times the target at the smallest. The parts are

    intervals  estimates from 250 simulations of a bearing whose probability is near the target. They are drawn from
               8,000 pulses, whose outcomes are all simulated, so that the true share is known exactly. "cover" is the
               share of 95 % intervals that contain it, "x MC" and "x Sobol'" how many times more simulations Monte
               Carlo (normal interval) and scrambled Sobol' points (t-interval over 8 randomisations of 32) need for an
               interval of the same width
    designs    `Run.design`: status, simulations, the probability by 10,000 fresh pulses, and D_tot over the smallest
               one beyond which the target is met. That is read off a curve by 2,000 pulses, scaled to this probability
    curves     the classifier's curves of each bearing of the first target, against PGV and against A_p, and those of
               simulations of the same 256 pulses: median and dispersion of the likeliest lognormal curve, for the
               pulses inside the campaign's design space; of the nearest lognormal curve, for all pulses; and median
               and standard deviation of the logarithm of the capacity from the increments, for all pulses

Each line of --out is one bearing; a repeated command continues where it stopped.
"""

import argparse
import itertools
import json
from pathlib import Path

import numpy as np
from scipy.interpolate import interp1d
from scipy.optimize import curve_fit, minimize
from scipy.special import ndtr
from scipy.stats import t as student

from activefail import create_run, open_run, simulate
from activefail.bearing.pulse import amplitude_of
from activefail.campaign.hazard import hazard_of, hazard_question
from activefail.execution.local import ThreadExecutor
from activefail.reliability.integral import boundary_of
from activefail.reliability.strata import plan_strata
from activefail.surrogate.threads import one_thread
from activefail.weighted import WeightedRows

TARGETS = (0.10, 0.025)
POOL, TRUTH, CURVE, SIMULATIONS, REPEATS = 8_000, 10_000, 2_000, 250, 100
LEVELS, PERIODS = 48, 256
HAZARD = {"magnitude": {"M": 7.0}, "pgv": {"median_m_s": 1.0, "dispersion": 0.25}}
FREE, RANGE = "D_tot", (0.45, 0.85)
FAILURE = 2
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
        self.hazard = hazard_of(HAZARD, Path("hazard.toml"))
        self.standardised = boundary_of(self.run.classifier, self.run.campaign.features, "failure")
        self.rng = np.random.default_rng(seed)

    def question(self, bearing):
        return hazard_question(self.hazard, self.run.settings, self.run.space, bearing)

    def on_range(self, bearing):
        """The classifier's probabilities at the ends of the range of D_tot."""
        question = self.question({**bearing, FREE: 0.65})
        U = question.space.sobol(256, np.random.default_rng(0))
        return [float(ndtr(self.standardised(question.at({FREE: value}).designs(U))).mean()) for value in RANGE]

    def bearings(self, target, count):
        """Bearings whose required D_tot lies within the range, without it."""
        space, found = self.run.space, []
        names = [name for name in space.names[:7] if name != FREE]
        low, high = (dict(zip(space.names, side, strict=True)) for side in (space.low, space.high))
        while len(found) < count:
            bearing = {name: float(low[name] + (high[name] - low[name]) * self.rng.random()) for name in names}
            worst, best = self.on_range(bearing)
            if best < 0.85 * target < target < worst:
                found.append(bearing)
        return found

    def required(self, bearing, target):
        """D_tot at which the classifier's probability is the target."""
        question = self.question({**bearing, FREE: 0.65})
        U, grid = question.space.sobol(512, np.random.default_rng(0)), np.linspace(*RANGE, 9)
        P = [ndtr(self.standardised(question.at({FREE: value}).designs(U))).mean() for value in grid]
        last = max((k for k in range(8) if P[k] > target), default=0)
        return float(np.interp(-np.log(target), -np.log(P[last : last + 2]), grid[last : last + 2]))

    def failed(self, question, X):
        return simulate(question.designs(X)).outcome == FAILURE

    def draw(self, question, n, rng):
        return question.space.from_unit(rng.random((n, question.space.dimension)))


def intervals(study, bearing, target, number):
    rng = np.random.default_rng([number, 1])
    question = study.question({**bearing, FREE: study.required(bearing, target)})
    X = study.draw(question, POOL, rng)
    designs = question.designs(X)
    z, failed = study.standardised(designs), study.failed(question, X)
    rows = WeightedRows(("row",), np.arange(POOL, dtype=float)[:, None], np.ones(POOL))

    def of_rows(numbers):
        return z[numbers[:, 0].astype(int)]

    P, half, covered, above = failed.mean(), [], [], []
    for _ in range(REPEATS):
        plan = plan_strata(of_rows, rows, SIMULATIONS, rng)
        chosen = plan.designs[:, 0].astype(int)
        estimate = plan.estimate(failed[chosen], np.ones(SIMULATIONS, dtype=bool), 0.95)
        half.append(0.5 * (estimate.high - estimate.low))
        covered.append(estimate.low <= P <= estimate.high)
        above.append(estimate.high >= P)
    sobol = []
    for _ in range(20):
        means = [study.failed(question, question.space.sobol(32, rng)).mean() for _ in range(8)]
        sobol.append(student.ppf(0.975, 7) * np.std(means, ddof=1) / np.sqrt(8.0))
    width = np.mean(half)
    return {
        "P": P,
        "wrong": float(((z > 0.0) != failed).mean()),
        "cover": float(np.mean(covered)),
        "upper": float(np.mean(above)),
        "mc": float(1.96**2 * P * (1.0 - P) / SIMULATIONS / width**2),
        "sobol": float(np.mean(np.square(sobol)) * 256 / SIMULATIONS / width**2),
    }


def sites(study, target, count):
    """Bearings without D_tot, with their hazards and questions."""
    space = study.run.space
    names = [name for name in space.names[:7] if name != FREE]
    low, high = (dict(zip(space.names, side, strict=True)) for side in (space.low, space.high))
    while count:
        bearing = {name: float(low[name] + (high[name] - low[name]) * study.rng.random()) for name in names}
        pgv = {"median_m_s": 0.6 * 2.4 ** study.rng.random(), "dispersion": 0.25}
        hazard = hazard_of({"magnitude": {"M": 6.4 + 1.2 * study.rng.random()}, "pgv": pgv}, Path("hazard.toml"))
        question = hazard_question(hazard, study.run.settings, space, {**bearing, FREE: RANGE[0]})
        X = study.draw(question, 500, study.rng)
        smallest, largest = (question.at({FREE: value}) for value in RANGE)
        if study.failed(largest, X).mean() <= 0.8 * target and study.failed(smallest, X).mean() >= 1.2 * target:
            count -= 1
            yield bearing, hazard, question


def designs(study, site, target, number):
    bearing, hazard, question = site
    findings = study.run.design(target, hazard, fixed=bearing, executor=ThreadExecutor(1))
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
    """Median and dispersion of the lognormal curve nearest to a curve, by least squares, as `activefail fragility`."""
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


def curves(study, bearing, target, number):
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


PARTS = {"intervals": intervals, "designs": designs, "curves": curves}


def table(lines):
    for part, shown in (("intervals", TARGETS), ("designs", TARGETS), ("curves", TARGETS[:1])):
        for target in shown:
            rows = [line for line in lines if line["part"] == part and line["target"] == target]
            if not rows:
                continue

            def column(name, rows=rows):
                return np.array([row[name] for row in rows], dtype=float)

            head = f"{part:<9} P = {100 * target:g} %, {len(rows)} bearings:"
            if part == "intervals":
                cover = column("cover")
                print(
                    f"{head} cover {cover.mean():.3f}, worst {cover.min():.2f}; "
                    f"upper bounds {column('upper').mean():.3f}; "
                    f"x MC {np.median(column('mc')):.1f}; x Sobol' {np.median(column('sobol')):.1f} (medians); "
                    f"misclassified {100 * np.median(column('wrong')):.1f} %"
                )
            elif part == "designs":
                verified = [row for row in rows if row["status"] == "verified"]
                over = np.array([100.0 * row["oversize"] for row in verified])
                print(
                    f"| {100 * target:g} % | {len(verified)} of {len(rows)} | {sum(row['meets'] for row in verified)} "
                    f"of {len(verified)} | {np.median(over):.1f} % ({over.min():.1f} to {over.max():.1f} %) | "
                    f"{(over > 20.0).sum()} | {np.median(column('simulations')):.0f}, "
                    f"{column('simulations').max():.0f} |"
                )
            else:
                for axis, (name, words) in itertools.product(("pgv", "a_p"), KINDS.items()):
                    median, beta = (100.0 * np.abs(column(f"{name}_{of}_{axis}")) for of in ("median", "dispersion"))
                    print(
                        f"{head} against {axis}, {words}: median off by {np.median(median):.1f} % (at most "
                        f"{median.max():.1f}), dispersion by {np.median(beta):.1f} % ({beta.max():.1f}); within 1.5 %: "
                        f"{(median <= 1.5).sum()}, within 3 %: {(beta <= 3.0).sum()}, both: "
                        f"{((median <= 1.5) & (beta <= 3.0)).sum()}"
                    )
                for axis in ("pgv", "a_p"):
                    whole, inside = column(f"largest_{axis}"), column(f"largest_inside_{axis}")
                    misfit = column(f"misfit_{axis}")
                    print(
                        f"{head} against {axis}, a level off by {np.median(whole):.3f} (at most {whole.max():.3f}), "
                        f"inside the design space by {np.median(inside):.3f} ({inside.max():.3f}); misfit of the "
                        f"simulations' lognormal {misfit.min():.2f} to {misfit.max():.2f}"
                    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", type=Path, default=Path("runs/design-benchmark"))
    parser.add_argument("--bearings", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--parts", default="intervals,designs,curves")
    parser.add_argument("--targets", default=",".join(map(str, TARGETS)))
    parser.add_argument("--out", type=Path, default=Path("runs/design-benchmark.jsonl"))
    options = parser.parse_args()
    lines = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {(line["seed"], line["part"], line["target"], line["number"]) for line in lines}
    study, parts = Study(options.campaign, options.seed), options.parts.split(",")
    targets = [float(text) for text in options.targets.split(",")]
    with one_thread():
        for target, part in itertools.product(targets, parts):
            if part == "curves" and target != TARGETS[0]:
                continue
            study.rng = np.random.default_rng([options.seed, round(1000 * target)])
            drawn = (
                sites(study, target, options.bearings)
                if part == "designs"
                else study.bearings(target, options.bearings)
            )
            for number, bearing in enumerate(drawn):
                if (options.seed, part, target, number) in done:
                    continue
                result = PARTS[part](study, bearing, target, 1000 * options.seed + number)
                line = {"seed": options.seed, "part": part, "target": target, "number": number, **result}
                lines.append(line)
                options.out.parent.mkdir(parents=True, exist_ok=True)
                with options.out.open("a") as file:
                    file.write(json.dumps(line, default=float) + "\n")
                print(json.dumps(line, default=float), flush=True)
    table([line for line in lines if line["seed"] == options.seed])


if __name__ == "__main__":
    main()
