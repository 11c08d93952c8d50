"""What worker processes answer: checked frames of plain data, which are never executed where they are read.

A worker runs the user's code, which can reach whatever the process holds: it may fork and return twice, write to
descriptors that are not its own, or leave a process behind that still answers. A frame therefore says which question it
answers, and which process answers it, under a checksum with a key that only the worker and its parent have. Whatever
else comes is no answer, and its sender is not asked again.
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
"""What precedes the content of a question: ticket, QuestionKind, length of the content."""

MOST_TEXT = 1 << 14
"""Most bytes of a text in a frame; longer ones are cut."""

_MAGIC = b"AFframe1"
_HEAD = struct.Struct("<8s16s32sIBI")
"""Magic, ticket, digest of the question's content, process, FrameKind, length of the payload; then the checksum."""

_DIGEST = 32
_ANSWER = struct.Struct("<bbd")
"""Outcome, cause, seconds; then the margins as float64, and what went wrong as UTF-8."""

_ERRORS = {error.__name__: error for error in (ActivefailError, InputError, StoreError, BusyError, SimulationError)}
"""The errors that a worker can report by name."""

_SENDER = struct.Struct("=3i")
"""What Linux says of the sender of a message: process, user, group."""

_KERNEL_KNOWS = hasattr(socket, "SO_PASSCRED")
"""Whether the kernel says which process sent a message, which only a privileged process can forge (Linux)."""


class BrokenFrameError(Exception):
    """Bytes that are no answer to what was asked."""


class QuestionKind(IntEnum):
    """What a question asks for."""

    GREETING, SIMULATOR, DESIGN = range(3)


class FrameKind(IntEnum):
    """What a frame says: done; the answer to a design; an error of activefail's own; that nothing could be loaded."""

    READY, ANSWERED, REFUSED, UNLOADABLE = range(4)


class Question(NamedTuple):
    """What names a question: a ticket that cannot be guessed, and the digest of its content."""

    ticket: bytes
    digest: bytes

    @classmethod
    def about(cls, content: bytes, ticket: bytes = b"") -> "Question":
        """A question with a content; a new one unless it has a ticket."""
        return cls(ticket or secrets.token_bytes(16), blake2b(content, digest_size=_DIGEST).digest())


class Frame(NamedTuple):
    """A frame that is whole and right; `more` if other bytes follow it, which nobody asked for."""

    kind: FrameKind
    payload: bytes
    process: int
    more: bool


def sealed(secret: bytes, question: Question, process: int, kind: FrameKind, payload: bytes = b"") -> bytes:
    """The frame that answers a question."""
    head = _HEAD.pack(_MAGIC, question.ticket, question.digest, process, kind, len(payload))
    return b"".join((head, _checksum(secret, head, payload), payload))


def opened(data: bytes, secret: bytes, question: Question, process: int | None, most: int) -> Frame | None:
    """The frame at the beginning of what has come so far, if it is complete.

    Args:
        data: what has come.
        secret: of the worker.
        question: that was asked.
        process: that must answer; any if None.
        most: bytes that the payload may have.

    Raises:
        BrokenFrameError: if this is no answer to the question, or cannot become one.
    """
    if not data.startswith(_MAGIC[: len(data)]):
        raise BrokenFrameError("it does not begin as a frame does")
    begin = _HEAD.size + _DIGEST
    if len(data) < begin:
        return None
    head = data[: _HEAD.size]
    _, ticket, digest, sender, kind, length = _HEAD.unpack(head)
    if length > most:
        raise BrokenFrameError("it is too long")
    if kind not in list(FrameKind):
        raise BrokenFrameError("it is of no known kind")
    if len(data) < begin + length:
        return None
    payload = data[begin : begin + length]
    if not hmac.compare_digest(data[_HEAD.size : begin], _checksum(secret, head, payload)):
        raise BrokenFrameError("its checksum is wrong")
    if (ticket, digest) != question:
        raise BrokenFrameError("it answers another question")
    if process is not None and sender != process:
        raise BrokenFrameError("another process sent it")
    return Frame(FrameKind(kind), payload, sender, len(data) > begin + length)


def _checksum(secret: bytes, head: bytes, payload: bytes) -> bytes:
    code = blake2b(head, digest_size=_DIGEST, key=secret)
    code.update(payload)
    return code.digest()


# --- what frames hold ---------------------------------------------------------------------------------------------


def pack_text(text: str) -> bytes:
    """A text as UTF-8, cut where it is too long."""
    return text.encode("utf-8", "backslashreplace")[:MOST_TEXT].decode("utf-8", "ignore").encode()


def unpack_text(payload: bytes) -> str:
    """The text of a payload.

    Raises:
        BrokenFrameError: if it is none.
    """
    try:
        return payload.decode()
    except UnicodeDecodeError:
        raise BrokenFrameError("its text is not UTF-8") from None


def pack_error(error: ActivefailError) -> bytes:
    """An error of activefail's own: the nearest class that has a name here, and its text."""
    name = next(kind.__name__ for kind in type(error).__mro__ if _ERRORS.get(kind.__name__) is kind)
    return pack_text(f"{name} {error}")


def unpack_error(payload: bytes) -> ActivefailError:
    """The error of a payload.

    Raises:
        BrokenFrameError: if it is none.
    """
    name, _, text = unpack_text(payload).partition(" ")
    if name not in _ERRORS:
        raise BrokenFrameError("it names no error")
    return _ERRORS[name](text)


def longest_answer(simulator: Simulator) -> int:
    """Bytes that the answer to a design may have."""
    return _ANSWER.size + 8 * len(simulator.margins) + MOST_TEXT


def pack_answer(results: Results, fault: str) -> bytes:
    """The answer to one design, as a record holds it, and what went wrong."""
    numbers = _ANSWER.pack(int(results.outcome[0]), int(results.cause[0]), float(results.seconds[0]))
    return b"".join((numbers, results.margins[0].astype("<f8").tobytes(), pack_text(fault)))


def unpack_answer(payload: bytes, simulator: Simulator) -> tuple[Results, str]:
    """The answer to one design, and what went wrong; "" if nothing did.

    Raises:
        BrokenFrameError: if it is none that the simulator can give.
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
        raise BrokenFrameError("it holds numbers without a meaning")
    margins = np.frombuffer(payload, "<f8", len(simulator.margins), _ANSWER.size)
    results = Results(
        np.array([outcome], dtype=np.int8),
        np.array([cause], dtype=np.int8),
        margins.astype(np.float64).reshape(1, -1),
        np.array([seconds]),
    )
    return results, unpack_text(payload[end:])


# --- who sent them ------------------------------------------------------------------------------------------------


def ask_for_senders(connection: socket.socket) -> None:
    """Have the kernel say which process sends what is read from a connection, where it can."""
    if _KERNEL_KNOWS:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)


def received(connection: socket.socket, most: int = 1 << 16) -> tuple[bytes, int | None]:
    """What has come over a connection, b"" at its end, and the process that sent it; None where no kernel says so."""
    if not _KERNEL_KNOWS:
        return connection.recv(most), None
    # Room for nothing else: descriptors that are sent along are closed by the kernel.
    data, about, _, _ = connection.recvmsg(most, socket.CMSG_SPACE(_SENDER.size))
    for level, kind, content in about:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS) and len(content) == _SENDER.size:
            return data, int(_SENDER.unpack(content)[0])
    return data, 0
