"""Files of the record: arrays in HDF5 images built in memory, behind a block that detects any changed bit.

A file is a 512-byte HDF5 user block (text: magic, format version, length and SHA-256 of the rest, and the block's own
SHA-256 in its last 64 bytes) followed by plain HDF5, so that any HDF5 tool opens it. The HDF5 library never accesses
the disk: it crashes with SIGSEGV on a full disk and returns wrong values for a flipped bit.
"""

import hashlib
import io
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from activefail.errors import DamagedError, StoreError
from activefail.visible import visible

FORMAT = 1
"""Version of the user block and of the rules for an image's content."""

MAGIC = "activefail record"
BLOCK_BYTES = 512
DIGEST_BYTES = 64
CHUNK_BYTES = 1 << 20


def encode(content: Mapping[str, NDArray[Any] | str], attributes: Mapping[str, str]) -> bytes:
    """The bytes of a file with arrays, texts and attributes; the same content gives the same bytes.

    Raises:
        ValueError: if a text contains a NUL, which a fixed-length HDF5 string cannot store.
    """
    with h5py.File(
        # HDF5 distinguishes in-memory files by name; nothing is written to it.
        secrets.token_hex(8),
        "w",
        driver="core",
        backing_store=False,
        libver=("v110", "v110"),
        userblock_size=BLOCK_BYTES,
    ) as root:
        for name, value in sorted(content.items()):
            array = _fixed_length(value)[np.newaxis] if isinstance(value, str) else np.asarray(value, order="C")
            # HDF5 cannot chunk, and so cannot checksum, a scalar or an empty array; the block's SHA-256 covers it.
            chunked = {"chunks": _chunks(array), "fletcher32": True} if array.ndim and array.size else {}
            root.create_dataset(name, data=array, track_times=False, **chunked)
        for name, text in sorted(attributes.items()):
            value = _fixed_length(text)
            root.attrs.create(name, value, dtype=value.dtype)
        root.flush()
        image: bytes = root.id.get_file_image()
    return user_block(image) + image


def _fixed_length(text: str) -> NDArray[Any]:
    if "\0" in text:
        raise ValueError(f"A text in the record must not contain NUL, got {text[:80]!r}.")
    data = text.encode()
    return np.array(data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))


def _chunks(array: NDArray[Any]) -> tuple[int, ...]:
    row = max(1, array.nbytes // len(array))
    return (max(1, min(len(array), CHUNK_BYTES // row)), *array.shape[1:])


def user_block(image: bytes | memoryview) -> bytes:
    """The user block of a file with this HDF5 image."""
    text = f"{MAGIC}\nformat {FORMAT}\nlength {len(image)}\nsha256 {hashlib.sha256(image).hexdigest()}\n"
    head = text.encode().ljust(BLOCK_BYTES - DIGEST_BYTES)
    return head + hashlib.sha256(head).hexdigest().encode()


def verify(data: bytes) -> None:
    """Check every bit of a file against its user block.

    Raises:
        DamagedError: if a bit differs, or bytes are missing or added.
        StoreError: if the block is valid but of another format version.
    """
    block = data[:BLOCK_BYTES]
    if len(data) > BLOCK_BYTES and block == user_block(memoryview(data)[BLOCK_BYTES:]):
        return
    head, digest = block[:-DIGEST_BYTES], block[-DIGEST_BYTES:]
    # Trust the version only in a block with a valid digest: a flipped bit can turn a 1 into a 3.
    if len(block) == BLOCK_BYTES and hashlib.sha256(head).hexdigest().encode() == digest:
        version = re.match(rf"{MAGIC}\nformat (\d+)\n".encode(), head)
        if version and int(version[1]) != FORMAT:
            raise StoreError(f"was written in format {int(version[1])}; this program reads format {FORMAT}.")
    raise DamagedError("is truncated or altered: its SHA-256 does not match its content")


class Image:
    """A verified file, open for reading; each request is checked before its bytes are read."""

    def __init__(self, root: h5py.File, size: int) -> None:
        self._root = root
        self._size = size
        self.names: tuple[str, ...] = tuple(root)
        # What was read before: a reader asks for the same attribute or declaration several times.
        self._attributes: dict[str, str] = {}
        self._declared: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        # Low-level calls: h5py's high-level ones take longer than reading the rest of a small file.
        for name in self.names:
            if root.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
                link = root.get(name, getlink=True)
                raise DamagedError(f"holds the {type(link).__name__} {name!r}, which is never followed")
            if h5py.h5o.get_info(root.id, name.encode()).type != h5py.h5o.TYPE_DATASET:
                raise DamagedError(f"holds {name!r}, which is not a dataset")

    def attribute(self, name: str) -> str:
        """The text of an attribute.

        Raises:
            DamagedError: if it is not a fixed-length text.
        """
        if name in self._attributes:
            return self._attributes[name]
        declared = h5py.h5a.open(self._root.id, name.encode())
        dtype, kind = declared.dtype, declared.get_space().get_simple_extent_type()
        if dtype.kind != "S" or kind != h5py.h5s.SCALAR:
            raise DamagedError(f"declares the attribute {name!r} as {dtype}, not as text")
        read = np.empty((), dtype)
        declared.read(read)
        self._attributes[name] = bytes(read[()]).decode()
        return self._attributes[name]

    def attributes(self, prefix: str) -> dict[str, str]:
        """The attributes whose names begin with `prefix`, by name without the prefix."""
        return {name.removeprefix(prefix): self.attribute(name) for name in self._root.attrs if name.startswith(prefix)}

    def declared(self, name: str) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """The type and shape that a dataset declares, without reading its data.

        Raises:
            DamagedError: if reading it would access another file, need a filter other than fletcher32, create Python
                objects, or fill memory with more than the file holds.
        """
        if name in self._declared:
            return self._declared[name]
        dataset = h5py.h5d.open(self._root.id, name.encode())
        # The creation list first: even the shape of a virtual dataset may open other files.
        plan = dataset.get_create_plist()
        if plan.get_layout() not in (h5py.h5d.CHUNKED, h5py.h5d.CONTIGUOUS):
            raise DamagedError(f"stores {name!r} as a virtual or compact dataset, which is never read")
        if plan.get_external_count():
            raise DamagedError(f"stores {name!r} in another file, which is never read")
        if any(plan.get_filter(i)[0] != h5py.h5z.FILTER_FLETCHER32 for i in range(plan.get_nfilters())):
            raise DamagedError(f"stores {name!r} with an HDF5 filter other than fletcher32")
        dtype = dataset.dtype
        empty = dataset.get_space().get_simple_extent_type() == h5py.h5s.NULL
        shape: tuple[int, ...] = dataset.shape
        if empty or dtype.hasobject:
            raise DamagedError(f"declares {name!r} with type {dtype} and shape {None if empty else shape}")
        count = 1
        for length in shape:
            count *= length  # Python integers: the product of hostile lengths may exceed 64 bits
        # Unwritten chunks read as zeros: a file of a kilobyte could declare a terabyte.
        if count * dtype.itemsize > min(self._size, dataset.get_storage_size()):
            raise DamagedError(f"declares {name!r} with shape {shape}, more than the file holds")
        self._declared[name] = dtype, shape
        return dtype, shape

    def check(self, name: str, dtype: DTypeLike, shape: tuple[int, ...]) -> None:
        """Check that a dataset may be read and has this type and shape, without reading its data.

        Raises:
            DamagedError: if it is missing, has another type or shape, or may not be read (see `declared`).
        """
        if name not in self.names:
            raise DamagedError(f"has no dataset {name!r}")
        declared = self.declared(name)
        if declared != (np.dtype(dtype), shape):
            raise DamagedError(f"declares {name!r} as {declared}, expected {(np.dtype(dtype), shape)}")

    def array(self, name: str, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
        """The dataset, which must have this type and shape.

        Raises:
            DamagedError: as `check` does.
        """
        self.check(name, dtype, shape)
        return np.asarray(self._root[name][()])

    def text(self, name: str) -> str:
        """The dataset as text."""
        declared, _ = self.declared(name)
        if declared.kind != "S":
            raise DamagedError(f"declares {name!r} as {declared}, not as text")
        return bytes(self.array(name, declared, (1,))[0]).decode()


@contextmanager
def open_image(data: bytes) -> Iterator[Image]:
    """The file `data`, read from memory after verification.

    Raises:
        DamagedError: if a bit differs, or the body encounters content that activefail never writes.
        StoreError: if it has another format version.
    """
    verify(data)
    try:
        # As a file object: HDF5 would copy a whole image, and often only a part of it is read.
        with h5py.File(io.BytesIO(data), "r") as root:
            yield Image(root, len(data))
    except (AttributeError, LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise DamagedError(f"has content that activefail never writes ({visible(str(error))})") from error
