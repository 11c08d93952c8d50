"""Bearings under records: the goals, with what is measured, and the tables of docs/records.md.

    python studies/records.py [--campaign runs/bearing] [--opensees opensees/bin/python] [--write docs/records.md]

Needs `activefail[records]`. `--campaign` is a run folder of the campaign `bearing`, which is created if it does not
exist; without the option there is no column of the classifier. `--opensees` is an interpreter that has openseespy and
NumPy; without it the last row of the goals is missing. `--write` replaces the part of a page between its markers. Times
are the processor time of one thread.

Sampled pulses are compared on designs of Table 1: outcomes of all, and peaks where neither run touches a rim, over the
whole motion. The second table is that of the bearing of 3.5 s. Its last columns compare the outcomes at the ladder's
levels with those under the equivalent pulse, with what the campaign's classifier predicts for that pulse, and with what
the reduced model predicts under the record: the same, failures missed, failures that do not occur.
"""

from pathlib import Path

import numpy as np
from opensees import compare, under_records
from study import asked, markdown, timed, write_between

import activefail
from activefail.seismic.analyses import ida
from activefail.seismic.bearing import (
    TABLE_1,
    Accelerogram,
    Bearing,
    Model,
    Pulse,
    Tolerance,
    simulate,
    simulate_one,
    simulate_records,
)
from activefail.seismic.bearing.design import GRAVITY
from activefail.seismic.bearing.pulse import HALF_DURATION, ground_acceleration
from activefail.seismic.ida.capacity import BISECTIONS, LEVELS, ladder
from activefail.seismic.motions.accelerogram_sets import read_record_set
from activefail.seismic.motions.intensity import Intensity

BEARINGS = {
    "3 s": [3.0, 0.06, 0.55, 0.6, 0.10, 45.0, 2e9],
    "3.5 s": [3.5, 0.06, 0.60, 0.6, 0.10, 45.0, 2e9],
    "4.5 s": [4.5, 0.10, 0.75, 0.5, 0.15, 40.0, 3e9],
}
SETS = ("farfield", "nearfield-pulse", "nearfield-no-pulse")
PGV = Intensity.of("pgv")
MARKERS = "<!-- written by `python studies/records.py` -->", "<!-- until here -->"


def sampled(period, amplitude, dt):
    t = np.arange(0.0, 2.0 * HALF_DURATION * period + dt, dt) - HALF_DURATION * period
    return Accelerogram(np.array([ground_acceleration(at, amplitude * GRAVITY, period) for at in t]), dt)


def outcomes_of_sampled_pulses(designs, seed):
    """A text, and the designs without an impact."""
    X = TABLE_1.from_unit(np.random.default_rng(seed).random((designs, 9)))
    records = [sampled(period, amplitude, 0.005) for period, amplitude in X[:, 7:]]
    simulate(X[:1])
    simulate_records(X[:1, :7], records[:1])
    pulses, of_pulses = timed(lambda: simulate(X, threads=1))
    found, of_records = timed(lambda: simulate_records(X[:, :7], records, threads=1))
    ratio = of_records / of_pulses
    text = (
        f"{100.0 * (pulses.outcome == found.outcome).mean():.2f} % of {designs}; energy error at most "
        f"{found.statistic('energy_error').max():.0e}; {ratio:.1f} times the processor time of the pulses"
    )
    return text, X[pulses.outcome == 0]


def peaks_of_sampled_pulses(X, dt, relative=1e-4):
    """Relative differences of the peak displacements of sampled and analytic pulses."""
    off, tolerance = [], Tolerance(relative)
    for row in X:
        bearing = Bearing.from_row(row.tolist(), Model().slider_diameter)
        motions = Pulse.from_table(*row[7:].tolist()), sampled(row[7], row[8], dt)
        both = [simulate_one(bearing, motion, tolerance=tolerance, to_the_end=True) for motion in motions]
        if all(one.outcome == 0 for one in both):
            exact, near = (one.margins.peak_displacement_ratio for one in both)
            off.append(abs(near / exact - 1.0))
    return np.array(off)


def text_of_peaks(off):
    return (
        f"{100.0 * (off <= 1e-3).mean():.1f} % of {len(off)} runs; {np.median(off):.1e} in the median, "
        f"{np.quantile(off, 0.99):.1e} for 99 %, {off.max():.1e} at most"
    )


def labels(sets):
    """Texts of the ladder's outcomes against those at a tolerance of 1e-6, and against runs to the end."""
    runs, other, early, ended, whole = 0, 0, 0, 0.0, 0.0
    for records in sets.values():
        for row in BEARINGS.values():
            levels = ladder(PGV)
            moved = [r.motion.scaled(x / PGV.of_record(r.motion)) for r in records.records for x in levels]
            X = np.tile(row, (len(moved), 1))
            usual, complete = simulate_records(X, moved), simulate_records(X, moved, to_the_end=True)
            runs += len(moved)
            other += int((usual.outcome != simulate_records(X, moved, tolerance=Tolerance(1e-6)).outcome).sum())
            early += int((usual.outcome != complete.outcome).sum())
            ended += usual.statistic("steps").sum()
            whole += complete.statistic("steps").sum()
    return (
        f"{100.0 * (1.0 - other / runs):.2f} % of {runs} runs",
        f"{100.0 * (1.0 - early / runs):.2f} % of {runs} runs, which take {100.0 * ended / whole:.0f} % of the steps",
    )


def times(records):
    """Processor time of a ladder of LEVELS + BISECTIONS levels, and of the analysis with bisection [s]; its runs."""
    bearing = np.array(BEARINGS["3.5 s"])
    levels = np.geomspace(0.25, 4.0, LEVELS + BISECTIONS)
    moved = [r.motion.scaled(x / PGV.of_record(r.motion)) for r in records.records for x in levels]
    _, of_ladder = timed(lambda: simulate_records(np.tile(bearing, (len(moved), 1)), moved, threads=1))
    found, of_analysis = timed(lambda: ida(bearing, records, PGV, workers=1))
    return of_ladder, of_analysis, found.capacities.runs


def capacities_and_pulses(sets, learned):
    """The rows of the second table."""
    rows = []
    for name, records in sets.items():
        found = ida(BEARINGS["3.5 s"], records, PGV, pulses=True, run=learned)
        fit, one = found.fragility, found.pulses
        low, middle, high = np.exp([one.interval[0], one.mean, one.interval[1]])
        counts = one.levels, *(prediction.levels for prediction in found.predictions)
        rows.append(
            [
                name,
                f"{len(records.records)}, {records.events}",
                f"{fit.fit.median:.2f} ({fit.median[0]:.2f} to {fit.median[1]:.2f})",
                f"{fit.fit.dispersion:.2f} ({fit.dispersion[0]:.2f} to {fit.dispersion[1]:.2f})",
                f"{middle:.2f} ({low:.2f} to {high:.2f})",
                *(f"{c.same}, {c.missed}, {c.false}" for c in counts),
            ]
        )
    return rows


def learned_of(folder):
    if not folder.exists():
        with activefail.create_run(folder, "bearing") as run:
            run.take(progress=False)
    return activefail.open_run(folder)


def against_opensees(python):
    texts = []
    for name, n in (("synthetic", 60), ("farfield", 88), ("nearfield-pulse", 56)):
        compared = compare(python, under_records(name, n, 1), n, 0.01)
        peak = [abs(one["bearing, rigid"].peak / one["OpenSees"].peak - 1.0) for one in compared]
        texts.append(f"{name} {100.0 * np.median(peak):.2f} % of {len(peak)} runs")
    return ", ".join(texts)


def main():
    options = asked(__doc__, designs=2000, seed=0, campaign=Path, opensees=str, write=Path)
    sets = {name: read_record_set(Path(name)) for name in SETS}
    equal, X = outcomes_of_sampled_pulses(options.designs, options.seed)
    seconds_of_ladder, seconds, runs = times(sets["farfield"])
    tighter, ending = labels(sets)
    at_5_ms, at_1_ms = peaks_of_sampled_pulses(X[:300], 0.005), peaks_of_sampled_pulses(X[:300], 1e-3, 1e-6)
    goals = [
        ["44 far-field records at 15 levels: at most 15 s of one core", f"{seconds_of_ladder:.1f} s"],
        ["10 levels and 5 bisections: at most 12 s", f"{seconds:.1f} s for {runs} runs, with the curve"],
        ["the same outcome at tolerances of 10⁻⁴ and 10⁻⁶: at least 99.5 %", tighter],
        ["the same outcome whether or not a run may end early: all", ending],
        ["a pulse sampled at 5 ms has the outcome of the pulse: at least 99.8 %", equal],
        ["its peak displacement, within 10⁻³", text_of_peaks(at_5_ms)],
        ["the same, sampled at 1 ms, at a tolerance of 10⁻⁶", text_of_peaks(at_1_ms)],
    ]
    if options.opensees:
        median = against_opensees(options.opensees)
        goals.append(["peaks of the rigid bearing and OpenSees, before a rim touch: at most 2 % in the median", median])
    learned = None if options.campaign is None else learned_of(options.campaign)
    predictors = ("pulse", *(["classifier"] if learned else []), "reduced model")
    head = ("set", "records, events", "median PGV [m/s]", "dispersion", "pulse over record", *predictors)
    rows = capacities_and_pulses(sets, learned)
    text = f"{markdown(('goal', 'measured'), goals)}\n\n{markdown(head, rows)}"
    print(text)
    if options.write:
        write_between(options.write, *MARKERS, text)


if __name__ == "__main__":
    main()
