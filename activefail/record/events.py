"""Events of a record, and their bytes: a line of text that says what follows, then the arrays.

    activefail <digest> <bytes> [kind, attributes, [[name, type, shape, place], ...]]

A digest is a SHA-256 of the digest before it and of all that follows it in its entry, so that entries form a chain. The
arrays lie at places counted from the end of the line, each at a multiple of 8 bytes; bytes between them are zero.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError

MAGIC = b"activefail "
"""Where an entry begins."""

TYPES: dict[str, np.dtype[Any]] = {"<f8": np.dtype("<f8"), "<i8": np.dtype("<i8"), "|i1": np.dtype("i1")}
"""The types of arrays in a record; little-endian on every machine."""

_DEEPEST = 100
"""Most lists and objects, one in the other, in the attributes of an event."""

_LINE = re.compile(rb"activefail ([0-9a-f]{64}) (\d{1,15}) ")


class Event(NamedTuple):
    """Something that happened to a record.

    Attributes:
        kind: "batch", "asked", ...
        attributes: JSON values.
        arrays: float64, int64 or int8, by name.
    """

    kind: str
    attributes: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


def of_arrays(kind: str, arrays: Mapping[str, NDArray[Any]], **attributes: str | int) -> Event:
    """An event with copies of arrays."""
    return Event(kind, attributes, {name: np.array(array, order="C") for name, array in arrays.items()})


class Entry(NamedTuple):
    """An event as it was read.

    Attributes:
        event: its arrays are read-only and share memory with the bytes.
        digest: of the entry and all before it.
        content: digest of the event alone.
        end: where the next entry begins.
    """

    event: Event
    digest: str
    content: str
    end: int


def pack(event: Event, before: str) -> tuple[list[bytes], str, str]:
    """The bytes of an entry, in parts; the digest of it and all before it; and that of the event alone.

    Args:
        event: the event.
        before: the digest before it.
    """
    types, body = packed(event.arrays)
    line, digest, content = head(event.kind, event.attributes, types, body, before)
    return [line, *body], digest, content


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[list[tuple[Any, ...]], list[bytes]]:
    """Name, type, shape and place of each array, and the bytes of all of them."""
    types, body, place = [], [], 0
    for name, array in arrays.items():
        data = array.tobytes()
        types.append((name, array.dtype.str, array.shape, place))
        body.append(data.ljust(_rounded(len(data)), b"\0"))
        place += len(body[-1])
    return types, body


def head(
    kind: str, attributes: Mapping[str, Any], types: list[Any], body: list[bytes], before: str, length: int = 0
) -> tuple[bytes, str, str]:
    """The line of an entry with this body, of `length` bytes if given; and the two digests of `pack`."""
    text = json.dumps([kind, attributes, types], separators=(",", ":")).encode()
    # A reader looks for this where an entry was cut, to see whether others follow it.
    text = text.replace(MAGIC, MAGIC.replace(b" ", rb"\u0020"))
    start = f"{sum(map(len, body))} ".encode()
    fixed = len(MAGIC) + 64 + 1 + len(start) + 1
    line = start + text.ljust((length or _rounded(fixed + len(text))) - fixed) + b"\n"
    hashed = hashlib.sha256(line)
    for part in body:
        hashed.update(part)
    content = hashed.hexdigest()
    digest = _joined(before, content)
    return MAGIC + digest.encode() + b" " + line, digest, content


def unpack(data: bytes, at: int, before: str) -> Entry:
    """The entry that begins at a place of some bytes.

    Raises:
        DamagedError: if it is incomplete or altered, or has content that activefail never writes.
    """
    end = data.find(b"\n", at) + 1
    found = _LINE.match(data, at, max(at, end))
    if not end or (found is not None and end + int(found[2]) > len(data)):
        raise DamagedError("is incomplete")
    stop = 0 if found is None else end + int(found[2])
    content = hashlib.sha256(memoryview(data)[at + len(MAGIC) + 65 : stop]).hexdigest()
    if found is None or _joined(before, content) != found[1].decode():
        raise DamagedError("is altered")
    try:
        kind, attributes, types = json.loads(data[found.end() : end])
        if not is_bounded(attributes):
            raise ValueError(kind)
        arrays = {}
        for name, dtype, shape, place in types:
            if min(place, *shape, 0) < 0 or end + place + math.prod(shape) * TYPES[dtype].itemsize > stop:
                raise ValueError(name)
            arrays[name] = np.ndarray(shape, TYPES[dtype], data, end + place)
        return Entry(Event(str(kind), dict(attributes), arrays), found[1].decode(), content, stop)
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError):
        raise DamagedError("has content that activefail never writes") from None


def is_bounded(value: Any) -> bool:
    """Whether a value of JSON is nested at most `_DEEPEST` deep, and its whole numbers have at most 64 bits."""
    level = [value]
    for _ in range(_DEEPEST):
        if any(isinstance(one, int) and not -(2**63) <= one < 2**63 for one in level):
            return False
        several = [one for one in level if isinstance(one, dict | list)]
        level = [part for one in several for part in (one.values() if isinstance(one, dict) else one)]
        if not level:
            return True
    return False


def _joined(before: str, content: str) -> str:
    return hashlib.sha256(f"{before}{content}".encode()).hexdigest()


def _rounded(length: int) -> int:
    return -(-length // 8) * 8
