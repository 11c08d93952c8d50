"""A table of pulses beside a hazard file: T_p, PGV or A_p, and weight."""

from pathlib import Path

import numpy as np

from activefail.errors import InputError, naming
from activefail.seismic.bearing.pulse import velocity_of
from activefail.seismic.hazard.sections import LARGEST_VELOCITY, LONGEST, SHORTEST
from activefail.seismic.hazard.velocity import AMPLITUDE, PERIOD, PGV
from activefail.space.parameter import LARGEST
from activefail.space.space import Array
from activefail.space.weighted import WeightedRows
from activefail.text.csv_table import Table
from activefail.text.trust import path_beside

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
    with naming("samples: "):
        path = path_beside(folder, name, "hazard file")
    table = Table.of_csv(path, MOST_ROWS)
    size = [column for column in (PGV, AMPLITUDE) if column in table.columns]
    unknown = [column for column in table.columns if column not in _RANGES]
    if PERIOD not in table.columns or len(size) != 1 or unknown:
        raise InputError(
            f"{path}: the columns must be T_p, either PGV or A_p, and weight, which may be left out; got "
            f"{','.join(table.columns)}."
        )
    if not table.rows:
        raise InputError(f"{path}: must have 1 to {MOST_ROWS} rows, got none.")
    columns = dict(zip(table.columns, table.numbers(table.columns).T, strict=True))
    for column, values in columns.items():
        low, high, unit = _RANGES[column]
        for row in np.flatnonzero((values < low) | (values > high)).tolist():
            raise table.broken(row, column, f"must be between {low:g} and {high:g}{unit}", float(values[row]))
    weight = columns.get(WEIGHT, np.ones(len(table.rows)))
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
