"""The frame of campaigns/frame.toml: whether it is right, and what a study with it costs in runs.

    python studies/frame.py --opensees opensees/bin/python --part checks
    python studies/frame.py --opensees opensees/bin/python --part goals --seeds 3
    python studies/frame.py --part picture

It needs `activefail[records]`, and an interpreter that has openseespy (docs/opensees.md). Every run is kept under
--work, by its design, so that none is made twice and an interrupted study continues.

`checks`: periods, pushover, statics, the response on a stiff frame against activefail's bearing, and the step.

`goals`: for each seed a campaign of 60 runs. From copies of it: P(collapse) of four designs, one after another, at one
peak ground velocity under 44 records; a fragility curve; and D_tot for three targets, one after another. All with
--wrong 0.01. The truth is the result of all records.

`picture`: runs against designs, from the results of `goals`, into docs/images/frame.png.
"""

import json
import math
import os
import shutil
import subprocess
import sys
import time
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
from opensees import rigid_limit
from study import Rows, asked, head, line

import activefail
from activefail.analyses.fragility.capacities import fit_lognormal
from activefail.seismic.bearing import Bearing, Model, Tolerance, simulate_one
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.motions.accelerogram_sets import read_record_set

ROOT = Path(__file__).parents[1]
CAMPAIGN = ROOT / "campaigns" / "frame.toml"
PICTURE = ROOT / "docs" / "images" / "frame.png"

WRONG, RECORDS, HOURS = 0.01, 44, 2.0
USUAL = 28 * 6
"""Runs a design: 28 motions at six intensities."""

MCE = 1.3
"""PGV of the maximum considered earthquake [m/s]."""

DESIGNS = (  # T_b [s], mu, D_tot [m], Cy
    (4.0, 0.08, 0.50, 0.30),
    (3.5, 0.06, 0.55, 0.25),
    (3.0, 0.10, 0.45, 0.30),
    (4.5, 0.06, 0.60, 0.35),
)
NAMES = ("T_b", "mu", "D_tot", "Cy")
SOUGHT = ((DESIGNS[1], 0.1), (DESIGNS[1], 0.025), (DESIGNS[0], 0.025))
"""Designs of which D_tot is sought, and targets, in this order."""

RATIO = 1.04
"""Between levels of the true fragility."""

KEEPING = """
import ast, hashlib, json, os, subprocess, sys
from pathlib import Path
python, store, here, design, out = sys.argv[1:]
known = {name: value for name, value in json.loads(Path(design).read_text()).items() if name != "record"}
program = Path(here, "frame_model.py")
code = ast.parse(program.read_text())
words = [ast.dump(one) for one in ast.walk(code) if isinstance(one, ast.stmt) and not hasattr(one, "body")]
words = [word for word in words if not word.startswith("Expr(value=Constant(")]
text = json.dumps(known, sort_keys=True) + "".join(words)
kept = Path(store, hashlib.sha256(text.encode()).hexdigest()[:24] + ".json")
if not kept.exists():
    subprocess.run([python, program, design, out], check=True)
    os.replace(out, f"{kept}.new")
    os.replace(f"{kept}.new", kept)
Path(out).write_text(kept.read_text())
"""
"""A program that looks for an answer before it runs the frame. Comments and docstrings of the frame do not count."""


class Study:
    """Run folders, and the runs of OpenSees, in a folder."""

    def __init__(self, work, opensees):
        self.work, self.code = work, work / "code"
        (work / "runs").mkdir(parents=True, exist_ok=True)
        self.code.mkdir(exist_ok=True)
        for name in ("frame_model.py", "frame_coarse.py"):
            shutil.copy(CAMPAIGN.parent / name, self.code)
        (self.code / "keeping.py").write_text(KEEPING)
        self.settings = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))
        program = f"{sys.executable} {{here}}/keeping.py {opensees} {work}/runs {{here}} design.json {{out}}"
        # One run at a time, on whatever machine.
        self.settings["simulator"] |= {"command": program, "cores": os.cpu_count()}
        self.settings["simulator"].pop("time_limit")

    def campaign(self, seed):
        """The folder of a campaign, at its budget."""
        folder = self.work / f"campaign-{seed}"
        with activefail.create_run(folder, self.settings | {"seed": seed}, code=self.code, exist_ok=True) as run:
            run.take(progress=False)
        return folder

    def copy(self, seed, name):
        """A fresh copy of a seed's campaign, open."""
        folder = self.work / f"{name}-{seed}"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.campaign(seed), folder)
        return activefail.open_run(folder, write=True, code=self.code)

    @cache  # noqa: B019 - one study a process
    def truth(self, design, pgv):
        """Which of all records collapse a design, (44,), by running all."""
        with self.copy(0, "truth") as run:
            stripe = run.probability(fixed=at(design, pgv), wrong=0.0, at_once=RECORDS).stripe
        if stripe.predicted.any() or stripe.lost.any():
            sys.exit(f"truth of {design} at {pgv}: not all records are simulated.")
        return stripe.beyond


def at(design, pgv, free=()):
    """Values of all variables but the record, and those that are free."""
    values = dict(zip(NAMES, design, strict=True)) | {"PGV": pgv}
    return {name: value for name, value in values.items() if name not in free}


def questions(study, seed, done):
    """P(collapse) of one design after another."""
    with study.copy(seed, "questions") as run:
        for number, design in enumerate(DESIGNS, 1):
            found = run.probability(fixed=at(design, MCE), wrong=WRONG)
            true = float(study.truth(design, MCE).mean())
            these, others = found.these, found.others
            done(
                part="question",
                seed=seed,
                number=number,
                runs=found.stripe.new,
                P=found.stripe.probability,
                true=true,
                holds=bool(these.low - 1e-9 <= true <= these.high + 1e-9),
                others=list(others or ()),
            )


def curve(study, seed, done):
    """The fragility of the first design."""
    fixed = at(DESIGNS[0], MCE, ["PGV"])
    with study.copy(seed, "curve") as run:
        found = run.fragility(against="PGV", fixed=fixed, wrong=WRONG)
    done(
        part="curve",
        seed=seed,
        runs=found.simulations,
        levels=len(found.levels),
        median=found.fit.fit.median,
        dispersion=found.fit.fit.dispersion,
    )


def sought(study, seed, done):
    """D_tot for one target after another."""
    with study.copy(seed, "sought") as run:
        for number, (design, target) in enumerate(SOUGHT, 1):
            fixed = at(design, MCE, ["D_tot"])
            found = run.design(target=f"{100 * target:g}%", free=["D_tot"], fixed=fixed, wrong=WRONG)
            place = found.place
            done(
                part="sought",
                seed=seed,
                number=number,
                runs=found.simulations,
                stripes=len(found.stripes),
                meets=found.meets,
                D_tot=found.candidates[place]["D_tot"],
                below=found.candidates[place - 1]["D_tot"] if place and found.meets else None,
            )


def check_sought(study, rows):
    """The true P of each design that was found, and one step below."""
    for row in list(rows.of(part="sought")):
        T_b, mu, _, Cy = SOUGHT[row["number"] - 1][0]
        for D_tot in (row["D_tot"], row["below"]):
            case = {"part": "share", "number": row["number"], "D_tot": D_tot}
            if D_tot is not None and rows.lack(**case):
                rows.add(**case, P=study.truth((T_b, mu, D_tot, Cy), MCE).mean())


def true_curve(study, rows):
    """The exact curve of the first design: each record's capacity, to a ratio of 1.04 on a grid from the MCE on."""
    with study.copy(0, "capacities") as run:
        low, high = study.settings["space"]["PGV"]["low"], study.settings["space"]["PGV"]["high"]
        least, most = math.ceil(math.log(low / MCE, RATIO)), math.floor(math.log(high / MCE, RATIO))
        names = run.space.parameters[run.space.names.index("record")].choices
        safe, fails = np.full(RECORDS, least - 1), np.full(RECORDS, most + 1)
        hit = study.truth(DESIGNS[0], MCE)
        safe[~hit], fails[hit] = 0, 0
        step = 8
        while (open_ := np.flatnonzero(fails - safe > 1)).size:
            # From the MCE outwards by 8 steps, then by halves.
            place = {}
            for k in open_:
                if fails[k] == most + 1:
                    place[k] = min(most, safe[k] + step)
                elif safe[k] == least - 1:
                    place[k] = max(least, fails[k] - step)
                else:
                    place[k] = (safe[k] + fails[k]) // 2
            answers = run_designs(study, run, [(names[k], MCE * RATIO**p) for k, p in place.items()])
            for (k, p), collapsed in zip(place.items(), answers, strict=True):
                (fails if collapsed else safe)[k] = p
    lower = np.where(safe < least, 0.0, MCE * RATIO ** safe.astype(float))
    upper = np.where(fails > most, np.inf, MCE * RATIO ** fails.astype(float))
    fit = fit_lognormal(lower, upper)
    rows.add(part="true curve", median=fit.median, dispersion=fit.dispersion)


def run_designs(study, run, cases):
    """Whether the first design collapses under records at levels, (n,), by the campaign's simulator."""
    numbers = {name: k for k, name in enumerate(run.space.parameters[run.space.names.index("record")].choices)}
    values = [at(DESIGNS[0], pgv) | {"record": numbers[name]} for name, pgv in cases]
    X = np.array([[value[name] for name in run.space.names] for value in values], dtype=float)
    results = run.campaign.simulator.run(X)
    if (results.outcome < 0).any():
        sys.exit("a run of the true curve has no result.")
    return results.outcome == 1


def goals(study, options, rows):
    """All questions of all seeds that the rows lack, and the tables."""
    parts = {"question": questions, "sought": sought, "curve": curve}
    for seed in range(options.seeds):
        for part in options.ask:
            if rows.lack(part=part, seed=seed):
                found = []
                parts[part](study, seed, lambda found=found, **row: found.append(row))
                for row in found:  # an interrupted part is repeated as a whole
                    rows.add(**row)
                print(f"seed {seed}: {part} done", file=sys.stderr, flush=True)
    check_sought(study, rows)
    if rows.of(part="curve") and rows.lack(part="true curve"):
        true_curve(study, rows)
    tables(rows)


def listed(values, form):
    return ", ".join(form.format(value) for value in values)


def tables(rows):
    """The tables of docs/frame.md."""
    head("design at the MCE", "runs, by seed", "hours", "P of all records", "error of P [points]", "interval holds")
    for number, design in enumerate(DESIGNS, 1):
        found = rows.of(part="question", number=number)
        runs = [row["runs"] for row in found]
        errors = [100.0 * abs(row["P"] - row["true"]) for row in found]
        held = f"{sum(row['holds'] for row in found)} of {len(found)}"
        hours = listed((HOURS * run for run in runs), "{:.0f}")
        line(
            listed(design, "{:g}"), listed(runs, "{}"), hours, f"{found[0]['true']:.3f}", listed(errors, "{:.1f}"), held
        )
    print()
    head("D_tot sought for", "target", "runs, by seed", "hours", "D_tot [m]", "P of all records", "right")
    for number, (design, target) in enumerate(SOUGHT, 1):
        found = rows.of(part="sought", number=number)
        runs = [row["runs"] for row in found]
        places = [f"{'' if row['meets'] else '> '}{row['D_tot']:.3f}" for row in found]
        P = {row["D_tot"]: row["P"] for row in rows.of(part="share", number=number)}
        met = [row["meets"] == (P.get(row["D_tot"], math.nan) <= target + 1e-9) for row in found]
        least = [row["below"] is None or P.get(row["below"], math.nan) > target for row in found]
        shares = "; ".join(f"{D_tot:.3f}: {share:.3f}" for D_tot, share in sorted(P.items()))
        right = f"{sum(map(all, zip(met, least, strict=True)))} of {len(found)}"
        hours = listed((HOURS * run for run in runs), "{:.0f}")
        of = listed([design[0], design[1], design[3]], "{:g}")
        line(of, f"{100 * target:g} %", listed(runs, "{}"), hours, ", ".join(places), shares, right)
    print()
    true = rows.of(part="true curve")
    head("seed", "levels", "runs", "median [m/s]", "all records", "difference [%]", "dispersion", "all records")
    for row in rows.of(part="curve"):
        median, dispersion = (true[0]["median"], true[0]["dispersion"]) if true else (math.nan, math.nan)
        difference = f"{100.0 * (row['median'] / median - 1.0):+.1f}"
        found = f"{row['median']:.3f}", f"{median:.3f}", difference, f"{row['dispersion']:.3f}", f"{dispersion:.3f}"
        line(row["seed"], row["levels"], row["runs"], *found)


STRONG, STIFF = (0, 13, 22, 35), (3, 27, 33)
"""Numbers of the records with which the step is halved, and of those under which the frame is stiff."""


def checks(options, work):
    """The table of checks in docs/frame.md."""
    space = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))["space"]
    fixed = {name: entry["value"] for name, entry in space.items() if "value" in entry}
    records = [one.motion for one in read_record_set(Path("farfield"), None, None).records]
    work.mkdir(parents=True, exist_ok=True)

    def motion(number, pgv, **changes):
        record = records[number].scaled(pgv / records[number].peak_velocity)
        file = work / f"check-{number}.txt"
        np.savetxt(file, record.acceleration)
        design = at(DESIGNS[0], pgv) | {"record": str(file), "record_dt": record.dt} | changes
        return fixed | design, record

    halved = [motion(number, MCE, time_step=step)[0] for number in STRONG for step in (0.01, 0.005)]
    # Nearly rigid contacts, Coulomb friction, and a frame too stiff and strong to move.
    bearing = Bearing.from_table(T_b=4.0, mu=0.06, D_tot=0.9, h_sl_ratio=0.4, h_rim_ratio=0.1, p=45.0, k=2e13)
    length, friction = rigid_limit(bearing)
    stiff = {"T_b": 2.0 * math.pi * math.sqrt(length / GRAVITY), "mu": friction, "D_tot": 0.9, "Cy": 2.0, "T_s": 0.3}
    fine = {"time_step": 0.005, "mobilised": 1e-4}
    peaks, rigid = [], []
    for number in STIFF:
        design, record = motion(number, 1.2, **stiff)
        rigid += [design, design | fine]
        alone = simulate_one(bearing, record, Model(friction_velocity=1e-5), Tolerance(1e-5), to_the_end=True)
        peaks.append(np.abs(alone.q[:, 3]).max())
    program = [options.opensees, ROOT / "studies" / "frame_checks.py"]
    cases = json.dumps({"design": halved[0], "motions": halved + rigid})
    done = subprocess.run(
        program, input=cases, stdout=subprocess.PIPE, text=True, check=True, stderr=subprocess.DEVNULL
    )
    found = json.loads(done.stdout.splitlines()[-1])
    head("check", "result")
    for Cy, wanted, ours, matrices in found["periods"]:
        line(f"period on a fixed base, Cy = {Cy} [s]", f"{ours:.4f}; by matrices {matrices:.4f}; intended {wanted:.4f}")
    line("sum of the reactions under the weight, over it", f"{sum(found['reactions']):.8f}")
    for Cy, table in found["pushover"].items():
        drift, shear = max(table, key=lambda row: row[1])
        text = f"{shear:.3f} of the weight at a roof drift of {100 * drift:.1f} %; 0 at {100 * table[-1][0]:.1f} %"
        line(f"pushover, Cy = {Cy}", text)
    first = found["motions"][: len(halved)]
    pairs = list(zip(first[::2], first[1::2], strict=True))
    for name in ("displacement_ratio", "peak_drift"):
        text = listed((100.0 * (two[1][name] / one[1][name] - 1.0) for one, two in pairs), "{:+.2f}")
        line(f"{name}, step of 5 ms against 10 ms [%]", text)
    line("cause of collapse with either step", "; ".join(f"{one[0] or '–'}, {two[0] or '–'}" for one, two in pairs))
    shears = [one[2] / one[3] for one in found["motions"]]
    line("largest shear of the isolators over mu + x/L", f"{min(shears):.3f} to {max(shears):.3f}")
    line("peak of the rigid bearing [m]", listed(peaks, "{:.3f}"))
    last = found["motions"][len(halved) :]
    for name, part in (("10 ms, friction over 1 mm", last[::2]), ("5 ms, over 0.1 mm", last[1::2])):
        ratios = [one[1]["displacement_ratio"] * 0.9 / peak - 1.0 for one, peak in zip(part, peaks, strict=True)]
        line(f"peak of a stiff frame against it, {name} [%]", listed(np.multiply(100.0, ratios), "{:+.1f}"))
    count, seconds = features_of_a_campaign(work)
    line("features of a campaign of 60 runs", f"{count} designs, {seconds:.1f} s of processor time")


def features_of_a_campaign(work):
    """How many designs' features a campaign computes, and their processor time [s]; the runs are made up."""
    settings = tomllib.loads(CAMPAIGN.read_text(encoding="utf-8"))
    settings["simulator"] = {"elsewhere": True, "outcomes": ["safe", "collapse"]}
    shutil.rmtree(work / "features", ignore_errors=True)
    with activefail.create_run(work / "features", settings, code=CAMPAIGN.parent) as run:
        run.features(run.space.sobol(4, np.random.default_rng(0)))  # compiles
        (module,) = (one for name, one in sys.modules.items() if name.endswith("frame_coarse"))
        respond, count, seconds = module.capacities, 0, 0.0

        def timed(*arguments):
            nonlocal count, seconds
            began = time.process_time()
            respond(*arguments)
            count, seconds = count + len(arguments[5]), seconds + time.process_time() - began

        module.capacities = timed
        while len(designs := run.ask(5)):
            run.tell(designs.assign(outcome=np.where(designs["PGV"] > MCE, "collapse", "safe")))
    return count, seconds


def picture(rows):
    """Runs against designs."""
    import matplotlib.pyplot as plt

    seeds = sorted({row["seed"] for row in rows.of(part="question")})
    n = np.arange(1, len(DESIGNS) + 1)
    total = np.array([60 + np.cumsum([row["runs"] for row in rows.of(part="question", seed=seed)]) for seed in seeds])
    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    axes.plot(n, USUAL * n, "s--", color="0.35", label="a usual study: 28 motions, 6 intensities")
    axes.plot(n, RECORDS * n, "^-.", color="C0", label="all 44 records at the MCE")
    axes.plot(n, np.median(total, axis=0), "o-", color="C3", label="activefail: 60 runs, then the doubtful records")
    axes.fill_between(n, total.min(axis=0), total.max(axis=0), color="C3", alpha=0.25, linewidth=0)
    axes.set(xlabel="designs", ylabel="runs", xticks=n, yscale="log", ylim=(30, 1500))
    axes.secondary_yaxis("right", functions=(lambda x: HOURS * x, lambda x: x / HOURS)).set_ylabel("hours at 2 h a run")
    axes.grid(alpha=0.3, which="both", linewidth=0.5)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    figure.savefig(PICTURE, dpi=110)


def main():
    options = asked(
        __doc__, part="goals", seeds=3, ask=["question", "sought", "curve"], work=Path, opensees=sys.executable
    )
    work = (options.work or ROOT / "build" / "frame").absolute()
    rows = Rows(work / "results.jsonl")
    if options.part == "picture":
        picture(rows)
    elif options.part == "tables":
        tables(rows)
    elif options.part == "checks":
        checks(options, work)
    else:
        goals(Study(work, options.opensees), options, rows)


if __name__ == "__main__":
    main()
