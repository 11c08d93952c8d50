"""Tables of the Python interface as pandas DataFrames: simulations, designs in flight, predictions."""

from collections.abc import Sequence
from numbers import Number
from typing import TYPE_CHECKING, Any

import numpy as np

from activefail.campaign.assembly import Campaign, predicted_columns
from activefail.errors import InputError
from activefail.findings.tables import exported_columns, exported_names, result_columns
from activefail.loop.history import History
from activefail.record.asked import Asked
from activefail.record.store import Store
from activefail.space import Array

if TYPE_CHECKING:
    from pandas import DataFrame

    from activefail.surrogate.saved import SavedClassifier


def designs_frame(campaign: Campaign, asked: Asked) -> "DataFrame":
    """Designs that were handed out: `id`, the variables, and the fixed quantities."""
    import pandas as pd

    columns: dict[str, Any] = {"id": asked.id}
    columns |= dict(zip(campaign.space.names, asked.designs.T, strict=True))
    columns |= {name: np.full(len(asked), value) for name, value in campaign.space.fixed.items()}
    return pd.DataFrame(columns)


def simulations_frame(campaign: Campaign, store: Store) -> "DataFrame":
    """The simulations of a record, in its order, with the columns of an exported table."""
    import pandas as pd

    parts: dict[str, list[Any]] = {name: [] for name in exported_names(campaign)}
    for columns in exported_columns(campaign, store):
        for name, column in columns.items():
            parts[name].extend(column)
    return pd.DataFrame(parts)


def corrections_frame(campaign: Campaign, store: Store) -> "DataFrame":
    """The corrections of a record, in their order: `id`, the former results, and those that replaced them."""
    import pandas as pd

    corrections = store.corrections
    columns: dict[str, Any] = {"id": History.of(store.batches).id[corrections.place]}
    for prefix, results in (("former_", corrections.former), ("", corrections.results)):
        columns |= {prefix + name: column for name, column in result_columns(campaign, results).items()}
    return pd.DataFrame(columns)


def predictions_frame(campaign: Campaign, classifier: "SavedClassifier", X: Array, index: Any = None) -> "DataFrame":
    """Predictions for designs, (n, d): the variables, the probability of each outcome, and the latent's moments.

    Args:
        campaign, classifier: the campaign and its classifier.
        X: the designs.
        index: of the table; 0, 1, ... if None.
    """
    import pandas as pd

    from activefail.findings.prediction import predicted_values

    values = predicted_values(campaign, classifier, X)
    columns = dict(zip(campaign.space.names, X.T, strict=True))
    return pd.DataFrame(columns | dict(zip(predicted_columns(classifier.outcomes), values.T, strict=True)), index=index)


def designs_of(campaign: Campaign, X: Any) -> Array:
    """Designs, (n, d), from an array or a list of rows in the space's order, or from a table with names.

    Args:
        campaign: the campaign.
        X: the array or rows; or a DataFrame, a dictionary of columns, or a list of dictionaries, whose names decide.

    Raises:
        InputError: if a variable is missing, a value is not a finite number, or the shape is wrong.
    """
    from activefail.csv_table import Table

    space = campaign.space
    if isinstance(X, Sequence) and not isinstance(X, str) and X and all(map(_is_plain, X)):
        try:
            X = np.array(X, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(
                "X: must be a DataFrame, a dictionary of columns, a list of dictionaries, or an "
                f"(n, {space.dimension}) array of numbers."
            ) from None
    if isinstance(X, np.ndarray):
        if X.ndim != 2 or X.shape[1] != space.dimension or X.dtype.kind not in "fiu":
            raise InputError(
                f"X: must be an (n, {space.dimension}) array of numbers with the columns {', '.join(space.names)}, "
                f"got shape {X.shape} and type {X.dtype}."
            )
        designs = X.astype(np.float64)
        if not np.isfinite(designs).all():
            row, column = np.argwhere(~np.isfinite(designs))[0].tolist()
            raise InputError(f"X: row {row}, column {space.names[column]}: must be finite, got {designs[row, column]}.")
        return designs
    return Table.of_python(X).numbers(space.names)


def _is_plain(row: object) -> bool:
    """Whether a row has no names, so that its order decides; a Series and a named tuple have names."""
    return isinstance(row, np.ndarray | Number | str) or (isinstance(row, list | tuple) and not hasattr(row, "_fields"))
