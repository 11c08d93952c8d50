"""Are the classifier's errors a fine structure of the boundary? Compares labels of designs and of displaced copies.

    python studies/fine_structure.py --n 4000
    python studies/fine_structure.py --n 4000 --run runs/bearing

Every design is moved along a random direction of the unit cube, by a share of the variables' ranges per coordinate
(root mean square), and simulated again. Printed is the share [%] of outcomes "failure" that change. With a run folder,
the same shares are printed for the designs that its classifier gets wrong and for those it gets right, and how often a
wrong one is in a pocket, where most of its copies have the outcome that the classifier gave.
"""

from pathlib import Path

import numpy as np
from study import asked, head, line, percent, uniform

from activefail.campaign.on_disk import open_campaign
from activefail.loop.learning import current
from activefail.seismic.bearing import TABLE_1, simulate
from activefail.seismic.bearing.outcome import FAILURE

DISTANCES = (1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
COPIES = 4


def fails(X):
    return simulate(X).outcome == FAILURE


def displaced(U, distance, rng):
    """Copies of points of the unit cube, (n, d) -> (COPIES·n, d), reflected at its faces."""
    moved = np.repeat(U, COPIES, axis=0)
    direction = rng.standard_normal(moved.shape)
    direction *= np.sqrt(moved.shape[1]) / np.linalg.norm(direction, axis=1, keepdims=True)
    moved = np.abs(moved + distance * direction)
    return 1.0 - np.abs(1.0 - moved)


def wrong_designs(folder, X, failed):
    """Whether the classifier of a run folder puts a design on the wrong side of the failure boundary, (n,) bool."""
    with open_campaign(folder, write=False) as (campaign, store):
        classifier = current(campaign, store, write=False).classifier
    return (classifier.latent("failure").moments(classifier.features(X)).mean > 0.0) != failed


def main():
    options = asked(__doc__, n=4000, seed=31, run=Path)
    X = uniform(options.n, options.seed)
    U, failed = TABLE_1.to_unit(X), fails(X)
    wrong = np.zeros(len(X), dtype=bool) if options.run is None else wrong_designs(options.run, X, failed)
    head("moved by", "all", "wrong", "right", "pockets")
    for distance in DISTANCES:
        copies = TABLE_1.from_unit(displaced(U, distance, np.random.default_rng([options.seed, 1])))
        changed = (fails(copies).reshape(options.n, COPIES) != failed[:, None]).mean(axis=1)
        parts = [percent(changed[rows]) if rows.any() else "–" for rows in (wrong, ~wrong)]
        line(f"{distance:g}", percent(changed), *parts, percent(changed[wrong] > 0.5) if wrong.any() else "–")
    print(f"wrong: {wrong.sum()} of {options.n}")


if __name__ == "__main__":
    main()
