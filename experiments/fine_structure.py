"""Are the classifier's errors a fine structure of the boundary? Compares labels of designs and of displaced copies.

    python experiments/fine_structure.py --n 4000
    python experiments/fine_structure.py --n 4000 --run runs/bearing

Every design is moved along a random direction of the unit cube, by a share of the variables' ranges per coordinate
(root mean square), and simulated again. Printed is the share [%] of outcomes "failure" that change. With a run folder,
the same shares are printed for the designs that its classifier gets wrong and for those it gets right, and how often a
wrong one is in a pocket, where most of its copies have the outcome that the classifier gave.
"""

import argparse
from pathlib import Path

import numpy as np

from activefail.bearing import TABLE_1, simulate
from activefail.bearing.outcome import FAILURE

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


def percent(flags, rows=slice(None)):
    """Share of copies, with its standard error over designs."""
    share = 100.0 * flags[rows].mean(axis=1)
    return f"{share.mean():6.2f} ± {share.std() / np.sqrt(len(share)):4.2f}" if len(share) > 1 else "     -"


def wrong_designs(folder, X, failed):
    """Whether the classifier of a run folder puts a design on the wrong side of the failure boundary, (n,) bool."""
    from activefail.campaign.on_disk import open_campaign
    from activefail.loop.learning import current_classifier

    with open_campaign(Path(folder), write=False) as (campaign, store):
        classifier = current_classifier(campaign, store, write=False)
    return (classifier.latent("failure").moments(classifier.features(X)).mean > 0.0) != failed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=4000, help="designs")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--run", help="run folder of a campaign on the bearing")
    arguments = parser.parse_args()

    U = np.random.default_rng(arguments.seed).random((arguments.n, TABLE_1.dimension))
    X = TABLE_1.from_unit(U)
    failed = fails(X)
    wrong = None if arguments.run is None else wrong_designs(arguments.run, X, failed)
    extra = "" if wrong is None else f"  {'wrong':>13}  {'right':>13}  {'pockets':>8}"
    print(f"{'moved by':>10}  {'all':>13}{extra}")
    for distance in DISTANCES:
        copies = TABLE_1.from_unit(displaced(U, distance, np.random.default_rng([arguments.seed, 1])))
        changed = fails(copies).reshape(arguments.n, COPIES) != failed[:, None]
        line = f"{distance:10g}  {percent(changed):>13}"
        if wrong is not None:
            pockets = 100.0 * np.mean(changed[wrong].mean(axis=1) > 0.5)
            line += f"  {percent(changed, wrong):>13}  {percent(changed, ~wrong):>13}  {pockets:8.1f}"
        print(line, flush=True)
    if wrong is not None:
        print(f"wrong: {wrong.sum()} of {arguments.n}")


if __name__ == "__main__":
    main()
