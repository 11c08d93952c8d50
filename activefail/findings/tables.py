"""Simulate a CSV table, predict a CSV table, export a campaign as one."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activefail.bearing import outcome as o
from activefail.bearing.design import LARGEST, TABLE_1, Bearing, Model, Pulse, Tolerance
from activefail.bearing.simulation import simulate
from activefail.campaign.assembly import Campaign, predicted_columns
from activefail.csv_table import DesignTable, writing
from activefail.errors import InputError
from activefail.record.batch import ACTIVE, CHECK, INITIAL
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, cause_name
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.surrogate.classifier import Classifier

_ORIGINS = {INITIAL: "seed", ACTIVE: "active", CHECK: "check"}

Advance = Callable[[int], None]


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
    source: Path,
    target: Path,
    model: Model,
    tolerance: Tolerance,
    begin: Callable[[int], Advance] = lambda _: lambda _: None,
) -> dict[str, int]:
    """Simulate every design of a CSV file and write the table with outcome, cause and margins added.

    Args:
        source: table of designs.
        target: table to write.
        model: bearing model.
        tolerance: of the integration.
        begin: called with the number of rows once they are checked; returns a callback for finished rows.

    Returns:
        Counts by outcome.

    Raises:
        InputError: naming the file, row, column, rule and value of the first bad cell; nothing is written then.
    """
    added = ("outcome", "cause", *o.COLUMNS)
    table = DesignTable.checked(source, TABLE_1.names, added, check_bearing(model))
    advance = begin(table.rows)
    counts = dict.fromkeys(o.OUTCOME_NAMES, 0)
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
    classifier: "Classifier",
    source: Path,
    target: Path,
    begin: Callable[[int], Advance] = lambda _: lambda _: None,
) -> int:
    """Write a CSV file of designs with outcome probabilities and the latent of the target boundary added.

    Returns:
        Number of designs outside the design space, where the classifier extrapolates.

    Raises:
        InputError: naming the file, row, column, rule and value of the first bad cell; nothing is written then.
    """
    space, boundary = campaign.space, campaign.settings.acquisition.main_boundary
    added = predicted_columns(classifier.outcomes)

    def check(design: Array) -> str | None:
        with np.errstate(all="ignore"):
            if np.isfinite(campaign.features(design[None])).all():
                return None
        for parameter, value in zip(space.parameters, design.tolist(), strict=True):
            if parameter.low > 0.0 >= value:
                return f"column {parameter.name}: `{parameter.name} > 0` must hold, got {value:g}"
        return f"features: must be finite; those of {design.tolist()} are not"

    table = DesignTable.checked(source, space.names, added, check)
    advance = begin(table.rows)
    outside = 0
    with writing(target, [*table.header, *added]) as write:
        for texts, X in table.chunks():
            outside += int(np.count_nonzero(~space.contains(X)))
            latent = classifier.latent(boundary).moments(campaign.features(X))
            predictions = np.column_stack([classifier.probabilities(X), latent.mean, latent.sd])
            write([[*text, *map(repr, row)] for text, row in zip(texts, predictions.tolist(), strict=True)])
            advance(len(X))
    return outside


def export_table(campaign: Campaign, store: Store, target: Path) -> int:
    """Write every simulation of a campaign as a row of a CSV file; returns their number."""
    names = campaign.simulator.outcomes
    header = ["id", "iteration", "origin", *campaign.space.names, "outcome", "cause", *campaign.simulator.margins]
    number = 0
    with writing(target, [*header, "seconds"]) as write:
        for batch in store.batches:
            results = batch.results
            for row in range(len(batch)):
                outcome = int(results.outcome[row])
                margins = results.margins[row].tolist()
                write(
                    [
                        [
                            number,
                            batch.iteration,
                            _ORIGINS[int(batch.origin[row])],
                            *map(repr, batch.designs[row].tolist()),
                            "numerical_failure" if outcome == NUMERICAL_FAILURE else names[outcome],
                            cause_name(campaign.simulator.causes, int(results.cause[row])),
                            *("" if np.isnan(m) else repr(m) for m in margins),
                            repr(float(results.seconds[row])),
                        ]
                    ]
                )
                number += 1
    return number
