"""A bearing under ground-motion records: the simulator and the features of `records.toml` (docs/records.md).

A design is a bearing, a record of a set and the peak ground velocity to which the record is scaled. The record is a
variable without an order: its number says nothing. So the classifier does not see it, but what two cheap models of the
bearing do under it.

To use other records, copy this file and `records.toml` and change the four constants below. Then `python
bearing_records.py` prints the number of records, for the campaign file, and their digest, for this file.
"""

import hashlib
from functools import cache
from pathlib import Path

import numpy as np

from activefail.accelerogram_sets import read_record_set
from activefail.bearing import outcome as o
from activefail.bearing import simulate_records
from activefail.bearing.record_features import record_features

SET = "farfield"
"""A folder of records beside this file, or a set of FEMA P695 (`activefail[records]`): see `activefail ida --help`."""

UNIT = None
"""Unit of the accelerations in a folder without a table: "g", "m/s2" or "cm/s2"."""

DT = None
"""Interval between samples [s], where neither table nor files state it."""

DIGEST = "a553723c3af01186857b1862720ad69b521490649e1f37f3a262473f30f246eb"
"""SHA-256 of the records' samples and intervals; other records are refused. Empty: any records."""

BEARING = ("T_b", "mu", "D_tot", "h_sl_ratio", "h_rim_ratio", "p", "k")

MARGINS = ("peak_displacement_ratio", "peak_gap_ratio", "peak_tilt", "peak_rim_force_ratio")


def digest_of(motions):
    """SHA-256 of the samples and intervals of records, in their order."""
    digest = hashlib.sha256()
    for motion in motions:
        digest.update(np.array([motion.dt, len(motion.acceleration)]).tobytes())
        digest.update(motion.acceleration.tobytes())
    return digest.hexdigest()


@cache
def records():
    """The records of the set as `Accelerogram`s, their events, and their peak velocities [m/s].

    Raises:
        InputError: if they cannot be read.
        ValueError: if they are others than `DIGEST` says.
    """
    folder = Path(__file__).with_name(SET)
    found = read_record_set(folder if folder.exists() else Path(SET), UNIT, DT)
    motions = tuple(record.motion for record in found.records)
    if DIGEST and digest_of(motions) != DIGEST:
        raise ValueError(f"the records of {SET} have changed: their digest is {digest_of(motions)}, not {DIGEST}")
    return motions, tuple(r.event for r in found.records), np.array([motion.peak_velocity for motion in motions])


def number_of(record):
    """The record's number, from 0, of values of the variable `record`, of any shape."""
    return np.minimum(np.asarray(record).astype(int), len(records()[0]) - 1)


def ground_motion(design):
    """The scaled record of a design."""
    motions, _, velocities = records()
    k = int(number_of(design["record"]))
    return motions[k].scaled(design["PGV"] / velocities[k])


def run(design):
    """The outcome of a design and its margins, as a campaign reads them."""
    response = simulate_records(np.array([[design[name] for name in BEARING]]), [ground_motion(design)], threads=1)
    cause = response.cause_name[0]
    # Under strong records a plate can lift off by more than the rim's height before any rim touch: docs/records.md.
    outcome = "failure" if cause == o.CAUSES[o.NO_TOUCH] else str(response.outcome_name[0])
    if outcome not in o.OUTCOMES:
        raise RuntimeError(f"the simulation was abandoned: {cause}")
    return {"outcome": outcome, "margins": {name: float(response.margin(name)[0]) for name in MARGINS}}


def features(X, space):
    """The variables without the record's number, and the cheap models' v*, a* and m* under the scaled record.

    PGV enters as its logarithm.
    """
    motions, _, velocities = records()
    high = dict(zip(space.names, space.high.tolist(), strict=True)).get("record")
    if high is not None and high != len(motions):
        raise ValueError(f"space.record.high must be {len(motions)}, the number of records in {SET}, got {high:g}")
    number, velocity = space.table(X, ("record", "PGV")).T
    which = number_of(number)
    physics = record_features(space.table(X, BEARING), motions, which, velocity / velocities[which])
    others = [name for name in space.names if name not in ("record", "PGV")]
    return np.column_stack([space.table(X, others), np.log(velocity), physics])


if __name__ == "__main__":
    print(f"{len(records()[0])} records, digest {digest_of(records()[0])}")
