"""A table of pulses beside a hazard file: T_p, PGV or A_p, and weight."""

import os
from pathlib import Path

import numpy as np

from activefail.bearing.design import LARGEST
from activefail.bearing.pulse import velocity_of
from activefail.campaign.hazard_sections import LARGEST_VELOCITY, LONGEST, SHORTEST
from activefail.campaign.question import AMPLITUDE, PERIOD, PGV
from activefail.csv_table import DesignTable, read_cells
from activefail.errors import InputError
from activefail.space import Array
from activefail.weighted import WeightedRows

MOST_ROWS = 20_000
"""Most rows of a table.

Each probability takes one prediction for each row; with added uncertainty, at least 2,048 predictions in all."""

WEIGHT = "weight"

_RANGES = {
    PERIOD: (SHORTEST, LONGEST, " s"),
    PGV: (1e-3, LARGEST_VELOCITY, " m/s (not cm/s)"),
    AMPLITUDE: (1e-4, 10.0, " g"),
    WEIGHT: (0.0, LARGEST, ""),
}
"""Least and largest value of each column, and its unit."""


def read_pulses(folder: Path, name: str) -> WeightedRows:
    """Read the pulses of a file in a folder; rows without weight are left out.

    Raises:
        InputError: if the file is not in the folder, or naming its row, column, rule and value.
    """
    path = folder / name
    home = Path(os.path.realpath(folder))
    if not Path(os.path.realpath(path)).is_relative_to(home):
        # A hazard file may come from someone else; messages quote the cells of its table.
        raise InputError(f"samples: must be a file in the folder of the hazard file, got {name!r}.")
    header, rows, _ = read_cells(path)
    size = [column for column in (PGV, AMPLITUDE) if column in header]
    unknown = [column for column in header if column not in (PERIOD, PGV, AMPLITUDE, WEIGHT)]
    if PERIOD not in header or len(size) != 1 or unknown:
        raise InputError(
            f"{path}: the columns must be T_p, either PGV or A_p, and weight, which may be left out; got "
            f"{','.join(header)}."
        )
    if not 0 < len(rows) <= MOST_ROWS:
        raise InputError(f"{path}: must have 1 to {MOST_ROWS} rows, got {len(rows)}.")

    def outside(pulse: Array) -> str | None:
        for column, value in zip(header, pulse.tolist(), strict=True):
            low, high, unit = _RANGES[column]
            if not low <= value <= high:
                return f"column {column}: must be between {low:g} and {high:g}{unit}, got {value:g}"
        return None

    table = DesignTable.checked(path, header, (), outside)
    columns = dict(zip(header, np.concatenate([pulses for _, pulses in table.chunks()]).T, strict=True))
    weight = columns.get(WEIGHT, np.ones(len(rows)))
    weighs = weight > 0.0
    if not weighs.any():
        raise InputError(f"{path}: column {WEIGHT}: at least one weight must be positive, got 0 in every row.")
    X = np.column_stack([columns[PERIOD], columns[size[0]]])
    return WeightedRows((PERIOD, size[0]), X[weighs], weight[weighs] / weight.max())


def velocities(rows: WeightedRows) -> Array:
    """Peak ground velocities of pulses [m/s], (n,)."""
    if PGV in rows.names:
        return rows.column(PGV)
    return velocity_of(rows.column(AMPLITUDE), rows.column(PERIOD))
