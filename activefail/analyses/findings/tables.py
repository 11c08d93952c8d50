"""Tables of designs and simulations: DataFrames, CSV tables to predict and export, and a Parquet file."""

import importlib
import warnings
from collections.abc import Callable, Sequence
from numbers import Number
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activefail.campaign.assembly import Campaign, predicted_columns
from activefail.errors import InputError, TableWarning
from activefail.learning.model.moments import undecided
from activefail.loop.history import History
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE, CHECK, GIVEN, INITIAL
from activefail.record.labels import labels_of
from activefail.record.store import Store
from activefail.simulators.command import CommandSimulator
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, cause_name
from activefail.space.space import Array, DesignSpace
from activefail.text.csv_table import Check, DesignTable, Source, Table, Target, rereadable, writing
from activefail.text.files import replacing, target_of, writing_to

if TYPE_CHECKING:
    from pandas import DataFrame

    from activefail.learning.model.classifier import Classifier
    from activefail.learning.model.saved import SavedClassifier

_ORIGINS = {INITIAL: "seed", ACTIVE: "active", CHECK: "check", GIVEN: "given"}

DOES_NOT_EXIST = "does not exist"
"""Likeliest outcome of a design that probably does not exist."""

UNKNOWN = "unknown"
"""Likeliest outcome of a design far from all simulations, of which the classifier does not know the outcome."""

Advance = Callable[[int], None]


def _columns(space: DesignSpace, X: Array) -> dict[str, Any]:
    """The variables of designs, (n, d), as columns of a DataFrame; texts are categories, all of them in any table."""
    import pandas as pd

    texts = {one.name: one.choices for one in space.parameters if one.has_texts}
    return {name: pd.Categorical(x, texts[name]) if name in texts else x for name, x in space.columns(X).items()}


def designs_frame(campaign: Campaign, asked: Asked) -> "DataFrame":
    """Designs that were handed out: `id`, the variables, and the fixed quantities."""
    import pandas as pd

    columns: dict[str, Any] = {"id": asked.id}
    columns |= _columns(campaign.space, asked.designs)
    columns |= {name: np.full(len(asked), value) for name, value in campaign.space.fixed.items()}
    return pd.DataFrame(columns)


def simulations_frame(campaign: Campaign, store: Store) -> "DataFrame":
    """The simulations of a record, in its order.

    `id`, `iteration`, `origin`, the variables, `outcome`, `cause` ("" if there is none), the margins (NaN where
    undefined), `seconds`, `folder` if a program that repeats runs them, and the user's own columns of tables.
    """
    import pandas as pd

    history, space = History.of(store.batches), campaign.space
    columns: dict[str, Any] = {"id": history.id, "iteration": history.iteration}
    columns["origin"] = [_ORIGINS[origin] for origin in history.origin.tolist()]
    columns |= _columns(space, history.designs)
    columns |= _result_columns(campaign, history)
    columns["seconds"] = np.concatenate([np.empty(0), *(batch.results.seconds for batch in store.batches)])
    if isinstance(campaign.simulator, CommandSimulator) and campaign.simulator.repeatable:
        columns["folder"] = [str(campaign.simulator.folder_of(x)) for x in history.designs.reshape(-1, space.dimension)]
    labels = labels_of(store, history.id)
    return pd.DataFrame(columns | {name: cells for name, cells in labels.items() if name not in columns})


def corrections_frame(campaign: Campaign, store: Store) -> "DataFrame":
    """The corrections of a record, in their order: `id`, the former results, and those that replaced them."""
    import pandas as pd

    corrections = store.corrections
    columns: dict[str, Any] = {"id": History.of(store.batches).id[corrections.place]}
    for prefix, results in (("former_", corrections.former), ("", corrections.results)):
        columns |= {prefix + name: column for name, column in _result_columns(campaign, results).items()}
    return pd.DataFrame(columns)


def _result_columns(campaign: Campaign, results: Results | History) -> dict[str, Any]:
    """The columns `outcome`, `cause` and the margins of n results."""
    simulator = campaign.simulator
    outcomes = (*simulator.outcomes, "numerical_failure")
    assert NUMERICAL_FAILURE == -1  # the last of these names
    margins = results.margins.reshape(len(results), len(simulator.margins))
    return {
        "outcome": [outcomes[outcome] for outcome in results.outcome.tolist()],
        "cause": [cause_name(simulator.causes, cause) for cause in results.cause.tolist()],
        **dict(zip(simulator.margins, margins.T, strict=True)),
    }


def predictions_frame(
    campaign: Campaign, classifier: "Classifier | SavedClassifier", X: Array, index: Any = None
) -> "DataFrame":
    """Predictions for designs, (n, d): the variables, and the columns of `predicted_columns`.

    Args:
        campaign, classifier: the campaign and its classifier.
        X: the designs.
        index: of the table; 0, 1, ... if None.
    """
    import pandas as pd

    outside = X[~campaign.space.contains(X)]
    if len(outside):
        warnings.warn(outside_in_words(campaign.space, len(outside), outside[0]), TableWarning, stacklevel=3)
    values = _predicted_values(campaign, classifier, X)
    columns = _columns(campaign.space, X)
    return pd.DataFrame(columns | dict(zip(predicted_columns(classifier.outcomes), values, strict=True)), index=index)


def outside_in_words(space: DesignSpace, designs: int, first: Array) -> str:
    """A warning of predictions outside the design space, with the rule that the first such design, (d,), breaks."""
    lie = "design lies" if designs == 1 else "designs lie"
    broken = space.broken_rule(first)
    assert broken is not None
    name, rule, value = broken
    return (
        f"{designs} {lie} outside the design space, where the classifier may extrapolate (the first by {name}: {rule}, "
        f"got {value})"
    )


def _predicted_values(campaign: Campaign, classifier: "Classifier | SavedClassifier", X: Array) -> list[list[Any]]:
    """The columns of `predicted_columns` for designs, (n, d); those that probably do not exist have no numbers."""
    predicted, exists = classifier.predicted(X), classifier.existence(X) >= 0.5
    moments = predicted.moments[campaign.severity - 1]
    names = np.array(classifier.outcomes, dtype=object)[predicted.probabilities.argmax(axis=1)]
    names[undecided(classifier, X)] = UNKNOWN
    likeliest = np.where(exists, names, DOES_NOT_EXIST).tolist()
    numbers = np.where(exists, [*predicted.probabilities.T, moments.mean, moments.sd], np.nan)
    return [likeliest, *numbers.tolist()]


def designs_of(campaign: Campaign, X: Any) -> Array:
    """Designs, (n, d), from an array or a list of rows in the space's order, or from a table with names.

    Choices are as the campaign file has them. An array of numbers is refused where variables have choices, because a
    number could be a choice or the number of one.

    Args:
        campaign: the campaign.
        X: the array or rows; or a DataFrame, a dictionary of columns, or a list of dictionaries, whose names decide.

    Raises:
        InputError: if a variable is missing, a value is neither a finite number nor a choice, or the shape is wrong.
    """
    space = campaign.space
    has_order = isinstance(X, Sequence) and not isinstance(X, str) and bool(X) and all(map(_is_plain, X))
    if not (has_order or isinstance(X, np.ndarray)):
        return Table.of_python(X).designs(space)
    of_choices = [one.name for one in space.parameters if one.choices]
    rule = f"X: must be a table or an (n, {space.dimension}) array of numbers with the columns {', '.join(space.names)}"
    try:
        designs = np.array(X, dtype=object if of_choices else np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{rule}: {error}.") from None
    if designs.ndim != 2 or designs.shape[1] != space.dimension:
        raise InputError(f"{rule}, got shape {designs.shape}.")
    if of_choices:
        if any(isinstance(row, np.ndarray) and row.dtype.kind in "iuf" for row in X):
            raise InputError(
                f"X: must be a table or rows with the choices of {', '.join(of_choices)}, got an array of numbers. The "
                "table of designs that the space returned is `space.columns(X)`."
            )
        places = [f"X: row {row}" for row in range(len(designs))]
        return Table("", space.names, designs.tolist(), places).designs(space)
    if not np.isfinite(designs).all():
        row, column = np.argwhere(~np.isfinite(designs))[0].tolist()
        raise InputError(f"X: row {row}, column {space.names[column]}: must be finite, got {designs[row, column]}.")
    return designs


def _is_plain(row: object) -> bool:
    """Whether a row has no names, so that its order decides; a Series and a named tuple have names."""
    return isinstance(row, np.ndarray | Number | str) or (isinstance(row, list | tuple) and not hasattr(row, "_fields"))


def predict_table(
    campaign: Campaign,
    classifier: "Classifier | SavedClassifier",
    source: Source,
    target: Target,
    begin: Callable[[int], Advance] = lambda _: lambda _: None,
) -> int:
    """Write a CSV table of designs with the columns of `predicted_columns` added.

    Returns:
        Number of designs outside the design space, where the classifier extrapolates. A warning names the rule.

    Raises:
        InputError: naming the file, row, column, rule and value of the first bad cell; nothing is written then.
    """
    space, outside, first = campaign.space, 0, np.empty((0, campaign.space.dimension))

    def check(design: Array) -> str | None:
        with np.errstate(all="ignore"):
            if np.isfinite(classifier.features(design[None])).all():
                return None
        for parameter, value in zip(space.parameters, design.tolist(), strict=True):
            if parameter.low > 0.0 >= value:
                return f"column {parameter.name}: `{parameter.name} > 0` must hold, got {value:g}"
        return f"features: must be finite; those of {space.row(design)} are not"

    def predicted(X: Array, advance: Advance) -> list[list[Any]]:
        nonlocal outside, first
        outside += int(np.count_nonzero(is_outside := ~space.contains(X)))
        first = np.concatenate([first, X[is_outside]])[:1]
        columns = _predicted_values(campaign, classifier, X)
        advance(len(X))
        return [list(map(cell_of, row)) for row in zip(*columns, strict=True)]

    extend_table(source, target, space, predicted_columns(classifier.outcomes), check, predicted, begin)
    if outside:
        warnings.warn(outside_in_words(space, outside, first[0]), TableWarning, stacklevel=3)
    return outside


def extend_table(
    source: Source,
    target: Target,
    space: DesignSpace,
    added: Sequence[str],
    check: Check,
    cells: Callable[[Array, Advance], list[list[Any]]],
    begin: Callable[[int], Advance],
) -> None:
    """Write a CSV table of designs with columns added.

    Args:
        source, target: the tables.
        space: whose designs they are.
        added: names of the added columns.
        check: a rule for each design.
        cells: of the added columns for n designs, (n, d), with a callback for finished rows.
        begin: called with the number of rows once they are checked; returns this callback.
    """
    with rereadable(source) as kept:
        table = DesignTable.checked(kept, space, added, check)
        advance = begin(table.rows)
        with writing(target, [*table.header, *added]) as write:
            for texts, X in table.chunks():
                write([[*text, *new] for text, new in zip(texts, cells(X, advance), strict=True)])


def cell_of(value: Any) -> Any:
    """A value of a CSV table: empty if it is NaN, which differs from itself."""
    return "" if value != value else value


def export_table(campaign: Campaign, store: Store, target: Target) -> int:
    """Write every simulation of a campaign as a row of a CSV table (see `simulations_frame`); returns their number."""
    frame = simulations_frame(campaign, store)
    with writing(target, list(frame)) as write:
        write([list(map(cell_of, row)) for row in zip(*(frame[name].tolist() for name in frame), strict=True)])
    return len(frame)


def export_parquet(campaign: Campaign, store: Store, target: Path) -> int:
    """Write every simulation of a campaign as a row of a Parquet file, which gets its name once complete.

    The columns are those of `simulations_frame`: texts, int64 and float64. An undefined margin and the cause of a
    simulation without one are null. The field of a variable with a unit, and that of `seconds`, has the metadata
    `unit`.

    Returns:
        Number of simulations.

    Raises:
        InputError: if pyarrow is not installed or the file cannot be written.
    """
    try:
        pa, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            "--parquet: requires the package pyarrow; install it with `pip install 'activefail[parquet]'`."
        ) from None
    units = {variable.name: variable.unit for variable in campaign.space.parameters} | {"seconds": "s"}
    kinds = {"i": pa.int64(), "f": pa.float64()}
    frame = simulations_frame(campaign, store)
    schema = pa.schema(
        [
            pa.field(name, kinds.get(kind.kind, pa.string()), metadata={"unit": units[name]} if units.get(name) else {})
            for name, kind in frame.dtypes.items()
        ]
    )
    table = pa.Table.from_pandas(frame.replace({"cause": {"": None}}), schema, preserve_index=False)
    with writing_to(target), replacing(target_of(target), "xb") as file:
        parquet.write_table(table.replace_schema_metadata(), file)
    return len(frame)
