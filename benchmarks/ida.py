"""Capacities of three bearings under the records of FEMA P695, beside those under equivalent pulses.

    activefail run bearing --out runs/bearing
    python benchmarks/ida.py --campaign runs/bearing

Needs `activefail[records]`. Each analysis is one thread's processor time. The second table compares the outcomes at
the ladder's levels with those under the equivalent pulse, with what the campaign's classifier predicts for that pulse,
and with what the reduced model predicts under the record: the same, failures missed, failures that do not occur.
"labels" compares the outcomes of the ladder at the tolerance 1e-4 with those at 1e-6, and of runs that may end early
with runs that continue to the end.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import activefail
from activefail.accelerogram_sets import read_record_set
from activefail.bearing import simulate_records
from activefail.bearing.design import Tolerance
from activefail.bearing.outcome import FAILURE
from activefail.risk.ida.calculation import analyse, ladder
from activefail.risk.ida.intensity import Intensity
from activefail.risk.ida.predictions import Surrogate

BEARINGS = {
    "T_b 3 s, mu 0.06, D_tot 0.55 m": [3.0, 0.06, 0.55, 0.6, 0.10, 45.0, 2e9],
    "T_b 3.5 s, mu 0.06, D_tot 0.60 m": [3.5, 0.06, 0.60, 0.6, 0.10, 45.0, 2e9],
    "T_b 4.5 s, mu 0.10, D_tot 0.75 m": [4.5, 0.10, 0.75, 0.5, 0.15, 40.0, 3e9],
}
SETS = ("farfield", "nearfield-pulse", "nearfield-no-pulse")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--campaign", type=Path, help="run folder of a campaign under pulses")
    options = parser.parse_args()
    intensity = Intensity.of("pgv")
    surrogate = None
    if options.campaign is not None:
        with activefail.open_run(options.campaign) as run:
            surrogate = Surrogate(run.campaign, run.classifier, FAILURE)
    titles = (
        "bearing",
        "set",
        "records, events",
        "median PGV [m/s]",
        "dispersion",
        "resurrections",
        "lifted",
        "runs",
        "s",
    )
    print(f"| {' | '.join(titles)} |")
    print("|---" * len(titles) + "|")
    for name in options.sets.split(","):
        records = read_record_set(Path(name))
        for title, row in BEARINGS.items():
            bearing = np.array(row)
            began = time.process_time()
            found = analyse(bearing, records, intensity, threads=1)
            seconds = time.process_time() - began
            fit = found.fragility
            print(
                f"| {title} | {name} | {len(records.records)}, {records.events} "
                f"| {fit.fit.median:.2f} ({fit.median[0]:.2f} to {fit.median[1]:.2f}) "
                f"| {fit.fit.dispersion:.2f} ({fit.dispersion[0]:.2f} to {fit.dispersion[1]:.2f}) "
                f"| {int((found.found.resurrections > 0).sum())} | {int(found.found.lifted.sum())} "
                f"| {found.found.runs} | {seconds:.1f} |",
                flush=True,
            )
    predictors = ("pulse", "reduced model") if options.campaign is None else ("pulse", "classifier", "reduced model")
    titles = "bearing", "set", "explained (10, 50, 90 %)", "pulse over record", "sd of ln", *predictors
    print(f"\n| {' | '.join(titles)} |")
    print("|---" * len(titles) + "|")
    for name in options.sets.split(","):
        records = read_record_set(Path(name))
        for title, row in BEARINGS.items():
            found = analyse(np.array(row), records, intensity, pulses=True, surrogate=surrogate, threads=1)
            one = found.pulses
            explained = np.quantile([pulse.explained for pulse in one.pulses], [0.1, 0.5, 0.9])
            shares = ", ".join(f"{x:.2f}" for x in explained)
            low, middle, high = np.exp([one.interval[0], one.mean, one.interval[1]])
            levels = one.levels, *(prediction.levels for prediction in found.predictions)
            counts = [f"{c.same} of {c.levels}, {c.missed}, {c.false}" for c in levels]
            print(
                f"| {title} | {name} | {shares} | {middle:.2f} ({low:.2f} to {high:.2f}) "
                f"| {one.spread:.2f} | {' | '.join(counts)} |",
                flush=True,
            )
    runs, other, early = 0, 0, 0
    for name in options.sets.split(","):
        records = read_record_set(Path(name))
        for row in BEARINGS.values():
            levels = ladder(intensity)
            moved = [r.motion.scaled(x / intensity.of_record(r.motion)) for r in records.records for x in levels]
            X = np.tile(row, (len(moved), 1))
            usual = simulate_records(X, moved)
            runs += len(moved)
            other += int((usual.outcome != simulate_records(X, moved, tolerance=Tolerance(1e-6)).outcome).sum())
            early += int((usual.outcome != simulate_records(X, moved, to_the_end=True).outcome).sum())
    print(f"labels: {runs} runs; {other} differ from a tolerance of 1e-6; {early} differ from runs to the end")


if __name__ == "__main__":
    main()
