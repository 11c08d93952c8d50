"""A bearing under ground-motion records: the simulator of `records.toml` (docs/records.md)."""

import numpy as np

from activefail.bearing import outcome as o
from activefail.bearing import simulate_records

BEARING = ("T_b", "mu", "D_tot", "h_sl_ratio", "h_rim_ratio", "p", "k")

MARGINS = ("peak_displacement_ratio", "peak_gap_ratio", "peak_tilt", "peak_rim_force_ratio")


def run(design):
    """The outcome of a design and its margins, as a campaign reads them; `design["record"]` is the scaled record."""
    bearing = np.array([[design[name] for name in BEARING]])
    response = simulate_records(bearing, [design["record"].motion], threads=1)
    cause = response.cause_name[0]
    # Under strong records a plate can lift off by more than the rim's height before any rim touch: docs/records.md.
    outcome = "failure" if cause == o.CAUSES[o.NO_TOUCH] else str(response.outcome_name[0])
    if outcome not in o.OUTCOMES:
        raise RuntimeError(f"the simulation was abandoned: {cause}")
    return {"outcome": outcome, "margins": {name: float(response.margin(name)[0]) for name in MARGINS}}
