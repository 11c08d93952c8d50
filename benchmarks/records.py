"""Pulses sampled as records against the analytic pulses: outcomes, peaks, and the time of both.

    python benchmarks/records.py [--designs 2000] [--dt 0.005] [--tolerance 1e-4] [--seed 0]

Designs of Table 1. Peaks are compared where neither run touches a rim, over the whole motion.
"""

import argparse
import time

import numpy as np

from activefail.bearing import (
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
from activefail.bearing.design import GRAVITY
from activefail.bearing.pulse import HALF_DURATION, ground_acceleration


def sampled(period, amplitude, dt):
    t = np.arange(0.0, 2.0 * HALF_DURATION * period + dt, dt) - HALF_DURATION * period
    return Accelerogram(np.array([ground_acceleration(at, amplitude * GRAVITY, period) for at in t]), dt)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=2000)
    parser.add_argument("--dt", type=float, default=0.005)
    parser.add_argument("--tolerance", type=float, default=1e-4)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    tolerance = Tolerance(relative=options.tolerance)
    X = TABLE_1.from_unit(np.random.default_rng(options.seed).random((options.designs, 9)))
    records = [sampled(period, amplitude, options.dt) for period, amplitude in X[:, 7:]]
    simulate(X[:1])
    simulate_records(X[:1, :7], records[:1])

    began = time.process_time()
    pulses = simulate(X, tolerance=tolerance, threads=1)
    of_pulses = time.process_time() - began
    began = time.process_time()
    found = simulate_records(X[:, :7], records, tolerance=tolerance, threads=1)
    of_records = time.process_time() - began
    print(f"outcomes equal for {100.0 * (pulses.outcome == found.outcome).mean():.2f} % of {len(X)} designs")
    print(f"numerical failures {int((found.outcome < 0).sum())}; energy error at most "
          f"{found.statistic('energy_error').max():.1e}")  # fmt: skip
    print(f"processor time {of_pulses:.2f} s for pulses, {of_records:.2f} s for records; steps a run "
          f"{pulses.statistic('steps').mean():.0f} and {found.statistic('steps').mean():.0f}")  # fmt: skip

    off = []
    for number in np.flatnonzero(pulses.outcome == 0)[:300]:
        row, record = X[number], records[number]
        bearing = Bearing.from_row(row.tolist(), Model().slider_diameter)
        both = [
            simulate_one(bearing, motion, tolerance=tolerance, to_the_end=True)
            for motion in (Pulse.from_table(*row[7:].tolist()), record)
        ]
        if all(one.outcome == 0 for one in both):
            exact, near = (one.margins.peak_displacement_ratio for one in both)
            off.append(abs(near / exact - 1.0))
    print(f"peak displacement of {len(off)} runs without a rim touch: off by {np.median(off):.1e} in the median, "
          f"{np.quantile(off, 0.99):.1e} for 99 %, {max(off):.1e} at most")  # fmt: skip


if __name__ == "__main__":
    main()
