"""Tables of bearings, which are simulated."""

from typing import Any

from activefail.analyses.findings.tables import Advance, cell_of, extend_table
from activefail.errors import InputError
from activefail.seismic.bearing import outcome as o
from activefail.seismic.bearing.design import TABLE_1, Bearing, Model, Pulse, Tolerance
from activefail.seismic.bearing.simulation import simulate
from activefail.space.parameter import LARGEST
from activefail.space.space import Array
from activefail.text.csv_table import Check, Source, Target
from activefail.text.progress import Begin, uncounted


def check_bearing(model: Model) -> Check:
    """A check for `DesignTable.checked` that a design of Table 1's variables is a feasible bearing."""

    def check(design: Array) -> str | None:
        for name, value in zip(TABLE_1.names, design.tolist(), strict=True):
            if not 0.0 < value <= LARGEST:
                return f"column {name}: `0 < {name} <= {LARGEST:g}` must hold, got {value:g}"
        try:
            Bearing.from_row(design.tolist(), model.slider_diameter)
            Pulse.from_table(*design[7:].tolist())
        except InputError as error:
            # With every value in range, only the geometry can be infeasible; it depends on these columns.
            return f"columns {', '.join(TABLE_1.names[:5])}: {error}".rstrip(".")
        return None

    return check


def simulate_table(
    source: Source,
    target: Target,
    model: Model,
    tolerance: Tolerance,
    begin: Begin = uncounted,
) -> dict[str, int]:
    """Simulate every design of a CSV table and write the table with outcome, cause and margins added.

    Args:
        source: table of designs.
        target: table to write; a stream gets rows as they are computed.
        model: bearing model.
        tolerance: of the integration.
        begin: called with the number of rows once they are checked; returns a callback for finished rows.

    Returns:
        Counts by outcome.

    Raises:
        InputError: naming the file, row, column, rule and value of the first bad cell; nothing is written then.
    """
    counts = dict.fromkeys(o.OUTCOME_NAMES, 0)

    def simulated(X: Array, advance: Advance) -> list[list[Any]]:
        results = simulate(X, model, tolerance, progress=advance)
        outcomes, columns = results.outcome_name.tolist(), results.columns.tolist()
        for outcome in outcomes:
            counts[outcome] += 1
        rows = zip(outcomes, results.cause_name.tolist(), columns, strict=True)
        return [[outcome, cause, *map(cell_of, values)] for outcome, cause, values in rows]

    added = ("outcome", "cause", *o.COLUMNS)
    extend_table(source, target, TABLE_1, added, check_bearing(model), simulated, begin)
    return counts
