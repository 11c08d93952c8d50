"""Simulate a CSV table, predict a CSV table, export a campaign as one."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from activefail.bearing import outcome as o
from activefail.bearing.design import LARGEST, TABLE_1, Bearing, Model, Pulse, Tolerance
from activefail.bearing.simulation import simulate
from activefail.campaign.assembly import Campaign, predicted_columns
from activefail.csv_table import DesignTable, Source, Target, rereadable, writing
from activefail.errors import InputError
from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL, Batch
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.surrogate.saved import SavedClassifier

_ORIGINS = {INITIAL: "seed", ACTIVE: "active", CHECK: "check", GIVEN: "given"}

Advance = Callable[[int], None]

Column = NDArray[Any] | list[str]
"""A column of an exported table: int64 or float64 numbers, or texts."""


def check_bearing(model: Model) -> Callable[[Array], str | None]:
    """A check for `DesignTable.checked` that a design of Table 1's variables is a feasible bearing."""

    def check(design: Array) -> str | None:
        for name, value in zip(TABLE_1.names, design.tolist(), strict=True):
            if value <= 0.0:
                return f"column {name}: `{name} > 0` must hold, got {value:g}"
            if value > LARGEST:
                return f"column {name}: `{name} <= {LARGEST:g}` must hold, got {value:g}"
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
    begin: Callable[[int], Advance] = lambda _: lambda _: None,
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
    added = ("outcome", "cause", *o.COLUMNS)
    counts = dict.fromkeys(o.OUTCOME_NAMES, 0)
    with rereadable(source) as kept:
        table = DesignTable.checked(kept, TABLE_1.names, added, check_bearing(model))
        advance = begin(table.rows)
        with writing(target, [*table.header, *added]) as write:
            for texts, X in table.chunks():
                results = simulate(X, model, tolerance, progress=advance)
                outcomes, causes = results.outcome_name.tolist(), results.cause_name.tolist()
                for outcome in outcomes:
                    counts[outcome] += 1
                write(
                    [
                        [*text, outcome, cause, *("" if np.isnan(value) else repr(value) for value in values)]
                        for text, outcome, cause, values in zip(
                            texts, outcomes, causes, results.columns.tolist(), strict=True
                        )
                    ]
                )
    return counts


def predict_table(
    campaign: Campaign,
    classifier: "SavedClassifier",
    source: Source,
    target: Target,
    begin: Callable[[int], Advance] = lambda _: lambda _: None,
) -> int:
    """Write a CSV table of designs with outcome probabilities and the latent of the target boundary added.

    Returns:
        Number of designs outside the design space, where the classifier extrapolates.

    Raises:
        InputError: naming the file, row, column, rule and value of the first bad cell; nothing is written then.
    """
    from activefail.findings.prediction import predicted_values

    space = campaign.space
    added = predicted_columns(classifier.outcomes)

    def check(design: Array) -> str | None:
        with np.errstate(all="ignore"):
            if np.isfinite(classifier.features(design[None])).all():
                return None
        for parameter, value in zip(space.parameters, design.tolist(), strict=True):
            if parameter.low > 0.0 >= value:
                return f"column {parameter.name}: `{parameter.name} > 0` must hold, got {value:g}"
        return f"features: must be finite; those of {design.tolist()} are not"

    outside = 0
    with rereadable(source) as kept:
        table = DesignTable.checked(kept, space.names, added, check)
        advance = begin(table.rows)
        with writing(target, [*table.header, *added]) as write:
            for texts, X in table.chunks():
                outside += int(np.count_nonzero(~space.contains(X)))
                predictions = predicted_values(campaign, classifier, X)
                write([[*text, *map(repr, row)] for text, row in zip(texts, predictions.tolist(), strict=True)])
                advance(len(X))
    return outside


def export_table(campaign: Campaign, store: Store, target: Target) -> int:
    """Write every simulation of a campaign as a row of a CSV table; returns their number."""
    number = 0
    with writing(target, exported_names(campaign)) as write:
        for columns in exported_columns(campaign, store):
            rows = list(zip(*map(_as_text, columns.values()), strict=True))
            write(rows)
            number += len(rows)
    return number


def exported_names(campaign: Campaign) -> list[str]:
    """The columns of an exported table, in order."""
    simulator = campaign.simulator
    return ["id", "iteration", "origin", *campaign.space.names, "outcome", "cause", *simulator.margins, "seconds"]


def exported_columns(campaign: Campaign, store: Store) -> Iterator[dict[str, Column]]:
    """The columns of an exported table by name, for the n simulations of one batch after another.

    A column is (n,) numbers, where an undefined margin is NaN, or n texts, where a simulation without a cause has "".
    """
    for batch in store.batches:
        yield _columns(campaign, batch)


def _columns(campaign: Campaign, batch: Batch) -> dict[str, Column]:
    columns: tuple[Column, ...] = (
        batch.id,
        np.full(len(batch), batch.iteration),
        [_ORIGINS[origin] for origin in batch.origin.tolist()],
        *batch.designs.T,
        *result_columns(campaign, batch.results).values(),
        batch.results.seconds,
    )
    return dict(zip(exported_names(campaign), columns, strict=True))


def result_columns(campaign: Campaign, results: Results) -> dict[str, Column]:
    """The columns `outcome`, `cause` and the margins of n results."""
    simulator = campaign.simulator
    outcomes = (*simulator.outcomes, "numerical_failure")
    assert NUMERICAL_FAILURE == -1  # the last of these names
    columns: dict[str, Column] = {
        "outcome": [outcomes[outcome] for outcome in results.outcome.tolist()],
        "cause": [cause_name(simulator.causes, cause) for cause in results.cause.tolist()],
    }
    return columns | dict(zip(simulator.margins, results.margins.T, strict=True))


def _as_text(column: Column) -> list[str]:
    if isinstance(column, list):
        return column
    return ["" if number != number else repr(number) for number in column.tolist()]  # NaN differs from itself
