"""The bytes of the files beside the batches: states of the classifier, and sets of designs outside the budget."""

from collections.abc import Collection, Mapping
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError
from activefail.record.batch import COLUMNS, Schema, answers_of, results_of
from activefail.record.hdf5 import Image, encode, open_image
from activefail.record.segment import SCHEMA_VERSION, chain_start, check_version, read_columns
from activefail.simulators.interface import Results
from activefail.space import Array


def encode_state(iteration: int, arrays: Mapping[str, NDArray[Any]], chain: str, corrected: str = "") -> bytes:
    """The bytes of a state's file.

    Args:
        iteration, arrays: of the state.
        chain: the digest of the batches from which it was learned.
        corrected: the digest of the corrections of these batches; empty without any.
    """
    content = {_dataset_name(name): array for name, array in arrays.items()}
    attributes = {"schema_version": str(SCHEMA_VERSION), "iteration": str(iteration), "chain": chain}
    return encode(content, attributes | ({"corrected": corrected} if corrected else {}))


def decode_state(
    data: bytes, iteration: int, digests: Collection[str]
) -> tuple[tuple[str, str], dict[str, NDArray[Any]]]:
    """The digests of the batches, one of these digests, and of the corrections that a state learned from; its arrays.

    Raises:
        DamagedError: if the file is damaged, or belongs to another iteration or record.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        check_version(image)
        # The state may include a batch that was quarantined later.
        if image.attribute("chain") not in digests or image.attribute("iteration") != str(iteration):
            raise DamagedError("was not learned from the batches of this record")
        corrected = image.attributes("corrected").get("", "")
        arrays = {unquote(name): _state_array(image, name) for name in image.names}
        return (image.attribute("chain"), corrected), arrays


def encode_set(X: Array, results: Results, schema: Schema, campaign: str, provenance: Mapping[str, str]) -> bytes:
    """The bytes of a set's file; `campaign` is the digest at the start of the campaign's chain."""
    content: dict[str, NDArray[Any] | str] = {"designs": X, **answers_of(results), "schema": schema.text}
    attributes = {"schema_version": str(SCHEMA_VERSION), "campaign": campaign}
    return encode(content, attributes | {f"provenance.{name}": text for name, text in provenance.items()})


def decode_set(data: bytes, settings: str) -> tuple[Array, Results, dict[str, str]]:
    """Designs, results and provenance of a set of the campaign with these settings; early sets have no provenance.

    Raises:
        DamagedError: if the file is damaged or belongs to another campaign.
        StoreError: if another version wrote it.
    """
    with open_image(data) as image:
        check_version(image)
        schema = Schema.from_text(image.text("schema"))
        if image.attribute("campaign") != chain_start(settings, schema):
            raise DamagedError("belongs to another campaign")
        _, shape = image.declared("outcome")
        columns = read_columns(image, [key for key in COLUMNS if key != "origin"], shape[0], schema)
        X, results = columns["designs"], results_of(columns)
        schema.check(X, results)
        return X, results, image.attributes("provenance.")


def _dataset_name(name: str) -> str:
    """The dataset name of a state's array: in HDF5, `/` would make a group and `.` means the group itself."""
    return "%2E" if name == "." else quote(name, safe=" ")


def _state_array(image: Image, name: str) -> NDArray[Any]:
    dtype, shape = image.declared(name)
    if dtype not in (np.dtype("<f8"), np.dtype("<i8")):
        raise DamagedError(f"declares {unquote(name)!r} as {dtype}, not as float64 or int64")
    return image.array(name, dtype, shape)
