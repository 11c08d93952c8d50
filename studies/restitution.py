"""The restitution of a rim collision, and what it does to the amplitude at which a bearing fails.

    python studies/restitution.py --n 40

Bearings and pulse periods of Table 1, drawn at random. Restitution: the top plate's speed at the end of the first
contact with a rim over that at its begin, at a friction of 0.001, for bearings that are hit and do not fail.
Capacity: the lowest of 48 amplitudes, with equal ratios from 0.05 to 1.6 g, at which the bearing fails.
"""

import numpy as np
from study import asked

from activefail.seismic.bearing import TABLE_1, Bearing, Model, Pulse, simulate, simulate_one
from activefail.seismic.bearing.motion import Motion
from activefail.seismic.bearing.outcome import FAILURE, IMPACT

AMPLITUDES = np.geomspace(0.05, 1.6, 48)


def rebound(row, model):
    """The plate's speed after over before its first contact with a rim."""
    run = simulate_one(Bearing.from_row(row.tolist(), model.slider_diameter), Pulse.from_table(*row[7:]), model)
    motion = Motion(run)
    t = run.margins.first_touch_time + np.arange(0.0, 0.5, 1e-4)
    pressed = motion.contacts(t)[1].max(axis=1) > 0.0
    began = int(pressed.argmax())
    ended = began + int((~pressed[began:]).argmax())
    return -motion.velocity(t[ended])[3] / motion.velocity(t[began])[3]


def main():
    options = asked(__doc__, n=40, seed=1)
    X = TABLE_1.latin_hypercube(options.n, np.random.default_rng(options.seed))
    ladder = np.repeat(X, len(AMPLITUDES), axis=0)
    ladder[:, 8] = np.tile(AMPLITUDES, len(X))
    capacity = {}
    for name in ("pairwise", "assembly"):
        model = Model(restitution=name)
        outcome = simulate(ladder, model).outcome
        slippery = ladder.copy()
        slippery[:, 1] = 1e-3
        fails = (outcome == FAILURE).reshape(len(X), -1)
        capacity[name] = np.where(fails.any(axis=1), AMPLITUDES[fails.argmax(axis=1)], np.nan)
        rows = slippery[simulate(slippery, model).outcome == IMPACT]
        found = [rebound(row, model) for row in rows[:: max(1, len(rows) // options.n)]]
        low, middle, high = np.quantile(found, [0.1, 0.5, 0.9])
        print(
            f"{name}: rebounds with {middle:.2f} of its speed ({low:.2f} to {high:.2f}, 10 to 90 %; {len(found)} runs)"
        )
    ratio = np.log(capacity["assembly"] / capacity["pairwise"])
    ratio = ratio[np.isfinite(ratio)]
    middle, mean = np.exp(np.median(ratio)), np.exp(ratio.mean())
    print(f"capacity of assembly over pairwise: median {middle:.2f}, geometric mean {mean:.2f} ({len(ratio)} bearings)")


if __name__ == "__main__":
    main()
