"""The frames in which worker processes answer: checked, plain data that the reader never executes.

A worker runs the user's code, which can reach everything in its process: it may fork and return twice, write to any
descriptor, or leave a process behind that still answers. A frame therefore names its question and its process, under a
checksum with a key known only to the worker and its parent. Anything else is rejected, and its sender is replaced.
"""

import hmac
import secrets
import socket
import struct
from enum import IntEnum
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from activefail.errors import ActivefailError, BusyError, InputError, SimulationError, StoreError
from activefail.simulators.interface import EXECUTION_CAUSES, NUMERICAL_FAILURE, Results, Simulator

SECRET = 32
"""Bytes of the key that a worker and its parent share."""

QUESTION = struct.Struct("<16sBQ")
"""The header of a question: ticket, QuestionKind, length of the content."""

MOST_TEXT = 1 << 14
"""Most bytes of a text in a frame; a longer text is cut."""

_MAGIC = b"AFframe1"
_HEAD = struct.Struct("<8s16s32sIBI")
"""Magic, ticket, digest of the question's content, process, FrameKind, length of the payload; then the checksum."""

_DIGEST = 32
_ANSWER = struct.Struct("<bbd")
"""Outcome, cause, seconds; then the margins as float64, and the fault as UTF-8."""

_ERRORS = {error.__name__: error for error in (ActivefailError, InputError, StoreError, BusyError, SimulationError)}
"""The errors that a worker can report by name."""

_SENDER = struct.Struct("=3i")
"""Linux's credentials of a message's sender: process, user, group."""

KERNEL_NAMES_SENDER = hasattr(socket, "SO_PASSCRED")
"""Whether the kernel reports a message's sender, which only a privileged process can forge (Linux)."""


class BrokenFrameError(Exception):
    """The received bytes are not a valid answer to the question."""


class QuestionKind(IntEnum):
    """What a question requests."""

    GREETING, SIMULATOR, DESIGN = range(3)


class FrameKind(IntEnum):
    """What a frame reports: done; a result; an ActivefailError; a simulator that cannot be loaded."""

    READY, ANSWERED, REFUSED, UNLOADABLE = range(4)


class Question(NamedTuple):
    """What identifies a question: an unguessable ticket and the digest of its content."""

    ticket: bytes
    digest: bytes

    @classmethod
    def about(cls, content: bytes, ticket: bytes = b"") -> "Question":
        """The question with a content; without a ticket, a new one is drawn."""
        return cls(ticket or secrets.token_bytes(16), blake2b(content, digest_size=_DIGEST).digest())


class Frame(NamedTuple):
    """A complete, valid frame; `has_trailing` if other bytes follow it, which are invalid."""

    kind: FrameKind
    payload: bytes
    process: int
    has_trailing: bool


def encode_frame(secret: bytes, question: Question, process: int, kind: FrameKind, payload: bytes = b"") -> bytes:
    """The bytes of the frame that answers a question."""
    head = _HEAD.pack(_MAGIC, question.ticket, question.digest, process, kind, len(payload))
    return b"".join((head, _checksum(secret, head, payload), payload))


def decode_frame(data: bytes, secret: bytes, question: Question, process: int | None, most: int) -> Frame | None:
    """The frame at the beginning of the received bytes, or None while it is incomplete.

    Args:
        data: the bytes received so far.
        secret: key of the worker.
        question: the question asked.
        process: the process that must answer; None accepts any.
        most: most bytes of the payload.

    Raises:
        BrokenFrameError: if the bytes are not the beginning of a valid answer to the question.
    """
    if not data.startswith(_MAGIC[: len(data)]):
        raise BrokenFrameError("it does not begin like a frame")
    begin = _HEAD.size + _DIGEST
    if len(data) < begin:
        return None
    head = data[: _HEAD.size]
    _, ticket, digest, sender, kind, length = _HEAD.unpack(head)
    if length > most:
        raise BrokenFrameError("it is too long")
    if kind not in list(FrameKind):
        raise BrokenFrameError("its kind is unknown")
    if len(data) < begin + length:
        return None
    payload = data[begin : begin + length]
    if not hmac.compare_digest(data[_HEAD.size : begin], _checksum(secret, head, payload)):
        raise BrokenFrameError("its checksum is wrong")
    if (ticket, digest) != question:
        raise BrokenFrameError("it answers another design")
    if process is not None and sender != process:
        raise BrokenFrameError("another process sent it")
    return Frame(FrameKind(kind), payload, sender, len(data) > begin + length)


def _checksum(secret: bytes, head: bytes, payload: bytes) -> bytes:
    code = blake2b(head, digest_size=_DIGEST, key=secret)
    code.update(payload)
    return code.digest()


# --- payloads -----------------------------------------------------------------------------------------------------


def pack_text(text: str) -> bytes:
    """A text as UTF-8, cut to MOST_TEXT bytes."""
    return text.encode("utf-8", "backslashreplace")[:MOST_TEXT].decode("utf-8", "ignore").encode()


def unpack_text(payload: bytes) -> str:
    """The text of a payload.

    Raises:
        BrokenFrameError: if it is not UTF-8.
    """
    try:
        return payload.decode()
    except UnicodeDecodeError:
        raise BrokenFrameError("its text is not UTF-8") from None


def pack_error(error: ActivefailError) -> bytes:
    """An ActivefailError as its nearest class in `_ERRORS` and its text."""
    name = next(kind.__name__ for kind in type(error).__mro__ if _ERRORS.get(kind.__name__) is kind)
    return pack_text(f"{name} {error}")


def unpack_error(payload: bytes) -> ActivefailError:
    """The error of a payload.

    Raises:
        BrokenFrameError: if it names no class of `_ERRORS`.
    """
    name, _, text = unpack_text(payload).partition(" ")
    if name not in _ERRORS:
        raise BrokenFrameError("it names no error")
    return _ERRORS[name](text)


def longest_answer(simulator: Simulator) -> int:
    """Most bytes in the answer to a design."""
    return _ANSWER.size + 8 * len(simulator.margins) + MOST_TEXT


def pack_answer(results: Results) -> bytes:
    """The result of one design, with its fault."""
    numbers = _ANSWER.pack(int(results.outcome[0]), int(results.cause[0]), float(results.seconds[0]))
    return b"".join((numbers, results.margins[0].astype("<f8").tobytes(), pack_text(results.faults.get(0, ""))))


def unpack_answer(payload: bytes, simulator: Simulator) -> Results:
    """The result of one design, with its fault.

    Raises:
        BrokenFrameError: if the simulator cannot give this answer.
    """
    end = _ANSWER.size + 8 * len(simulator.margins)
    if len(payload) < end:
        raise BrokenFrameError("it is too short")
    outcome, cause, seconds = _ANSWER.unpack_from(payload)
    good = (
        NUMERICAL_FAILURE <= outcome < len(simulator.outcomes)
        and (cause in EXECUTION_CAUSES or 0 <= cause < len(simulator.causes))
        and 0.0 <= seconds < np.inf
    )
    if not good:
        raise BrokenFrameError("its outcome, cause or time is out of range")
    margins = np.frombuffer(payload, "<f8", len(simulator.margins), _ANSWER.size)
    fault = unpack_text(payload[end:])
    return Results(
        np.array([outcome], dtype=np.int8),
        np.array([cause], dtype=np.int8),
        margins.astype(np.float64).reshape(1, -1),
        np.array([seconds]),
        {0: fault} if fault else {},
    )


# --- senders ------------------------------------------------------------------------------------------------------


def request_senders(connection: socket.socket) -> None:
    """Ask the kernel to report the sender of each message on a connection, if it can."""
    if KERNEL_NAMES_SENDER:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)


def receive(connection: socket.socket, most: int = 1 << 16) -> tuple[bytes, int | None]:
    """Bytes from a connection, b"" at its end, and the process that sent them; None if the kernel cannot report it."""
    if not KERNEL_NAMES_SENDER:
        return connection.recv(most), None
    # No room for descriptors: the kernel closes any that are sent along.
    data, ancillary, _, _ = connection.recvmsg(most, socket.CMSG_SPACE(_SENDER.size))
    for level, kind, content in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS) and len(content) == _SENDER.size:
            return data, int(_SENDER.unpack(content)[0])
    return data, 0
