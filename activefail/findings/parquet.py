"""Export a campaign as a Parquet file, with pyarrow where it is installed."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.files import replacing, target_of, writing_to
from activefail.findings.tables import Column, exported_columns, exported_names
from activefail.record.store import Store

_TEXTS, _WHOLE = ("origin", "outcome", "cause"), ("id", "iteration")


def export_parquet(campaign: Campaign, store: Store, target: Path) -> int:
    """Write every simulation of a campaign as a row of a Parquet file, which gets its name once complete.

    The columns are those of `tables.export_table`: texts, int64 (`id`, `iteration`) and float64 (all others). An
    undefined margin and the cause of a simulation without one are null. The field of a variable with a unit, and that
    of `seconds`, has the metadata `unit`.

    Returns:
        Number of simulations.

    Raises:
        InputError: if pyarrow is not installed or the file cannot be written.
    """
    pa, parquet = _pyarrow()
    units = {variable.name: variable.unit for variable in campaign.space.parameters} | {"seconds": "s"}

    def field(name: str) -> Any:
        kind = pa.string() if name in _TEXTS else pa.int64() if name in _WHOLE else pa.float64()
        return pa.field(name, kind, metadata={"unit": units[name]} if units.get(name) else None)

    schema = pa.schema([field(name) for name in exported_names(campaign)])
    columns: dict[str, list[Column]] = {name: [] for name in schema.names}
    for part in exported_columns(campaign, store):
        for name, column in part.items():
            columns[name].append(column)
    arrays = [_array(pa, columns[one.name], one.type) for one in schema]
    with writing_to(target), replacing(target_of(target), "xb") as file:
        parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), file)
    return sum(len(batch) for batch in store.batches)


def _array(pa: Any, parts: list[Column], kind: Any) -> Any:
    if kind == pa.string():
        return pa.array([text or None for part in parts for text in part], kind)
    # from_pandas: NaN becomes null.
    return pa.array(np.concatenate([np.empty(0, kind.to_pandas_dtype()), *parts]), kind, from_pandas=True)


def _pyarrow() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            "--parquet: requires the package pyarrow; install it with `pip install 'activefail[parquet]'`."
        ) from None
