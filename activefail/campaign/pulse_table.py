"""A table of pulses beside a hazard file: T_p, PGV or A_p, and weight."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from activefail.bearing.pulse import velocity_of
from activefail.campaign.hazard_sections import LARGEST_VELOCITY, LONGEST, SHORTEST
from activefail.campaign.question import AMPLITUDE, PERIOD, PGV
from activefail.csv_table import number_of, read_cells
from activefail.errors import InputError
from activefail.space import Array
from activefail.weighted import WeightedRows

MOST_ROWS = 20_000
"""Most rows of a table.

Each probability takes one prediction for each row; with added uncertainty, at least 2,048 predictions in all."""

WEIGHT = "weight"

_RANGES = {PERIOD: (SHORTEST, LONGEST), PGV: (1e-3, LARGEST_VELOCITY), AMPLITUDE: (1e-4, 10.0)}
_UNITS = {PERIOD: "s", PGV: "m/s", AMPLITUDE: "g"}


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
    header, rows, lines = read_cells(path)
    size = [column for column in (PGV, AMPLITUDE) if column in header]
    unknown = [column for column in header if column not in (PERIOD, PGV, AMPLITUDE, WEIGHT)]
    if PERIOD not in header or len(size) != 1 or unknown:
        raise InputError(
            f"{path}: the columns must be T_p, either PGV or A_p, and weight, which may be left out; got "
            f"{','.join(header)}."
        )
    if not 0 < len(rows) <= MOST_ROWS:
        raise InputError(f"{path}: must have 1 to {MOST_ROWS} rows, got {len(rows)}.")
    columns = {column: _numbers(path, rows, lines, column, header.index(column)) for column in header}
    for column, (least, most) in _RANGES.items():
        if column in columns:
            outside = ~((columns[column] >= least) & (columns[column] <= most))
            hint = "; is it in cm/s?" if column == PGV else ""
            rule = f"must be between {least:g} and {most:g} {_UNITS[column]}"
            _check(path, lines, column, columns[column], outside, rule, hint)
    weight = columns.get(WEIGHT, np.ones(len(rows)))
    _check(path, lines, WEIGHT, weight, ~(np.isfinite(weight) & (weight >= 0.0)), "must be finite and at least 0")
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


def _numbers(path: Path, rows: list[list[str]], lines: list[int], name: str, index: int) -> Array:
    values = np.empty(len(rows))
    for row, cells in enumerate(rows):
        text = cells[index].strip()
        try:
            values[row] = number_of(text)
        except ValueError:
            place = f"{path}: row {row + 1} (line {lines[row]}), column {name}"
            raise InputError(f"{place}: must be a number, got {text!r}.") from None
    return values


def _check(
    path: Path, lines: list[int], name: str, values: Array, bad: NDArray[np.bool_], rule: str, hint: str = ""
) -> None:
    for row in np.flatnonzero(bad)[:1]:
        raise InputError(
            f"{path}: row {row + 1} (line {lines[row]}), column {name}: {rule}, got {values[row]:g}{hint or '.'}"
        )
