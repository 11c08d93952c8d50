"""What a worker process does: load the simulator that it is sent, and answer designs."""

import multiprocessing
import os
import pickle
import socket
from collections.abc import Callable, Mapping
from multiprocessing import spawn
from typing import Any, Protocol, runtime_checkable

import numpy as np
from threadpoolctl import threadpool_limits

from activefail.errors import ActivefailError, description_of
from activefail.execution.frames import (
    QUESTION,
    FrameKind,
    Question,
    QuestionKind,
    pack_answer,
    pack_error,
    pack_text,
    sealed,
)
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array

LOST = 71
"""The exit code of a worker whose connection is no longer the one that it was started with."""

_SEND_LIMIT = 60.0
"""Seconds in which an answer must be sent; it always fits, unless the simulator has filled the connection."""

Answer = Callable[[Simulator, Array], tuple[Results, str]]
"""Answers designs: results, and why the first one without an answer has none ("" if all have one)."""


@runtime_checkable
class _Prepared(Protocol):
    """A simulator with something to load before its first simulation, whose time limit that must not count to."""

    def prepare(self) -> None: ...


def serve(descriptor: int) -> None:
    """Answer all questions that come over a connection, until its other end is closed."""
    hear, reply = _connection(descriptor)
    # Side by side, workers must not each start a thread a core: not in libraries that are loaded, nor in later ones.
    threadpool_limits(1)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    loaded: tuple[Answer, Simulator] | None = None
    while (question := hear()) is not None:
        kind, content = question
        try:
            if kind == QuestionKind.SIMULATOR:
                loaded = _load(content)
                reply(FrameKind.READY)
            else:
                assert loaded is not None
                answer, simulator = loaded
                # A copy, which the simulator may write to.
                results, fault = answer(simulator, np.frombuffer(content, dtype=np.float64)[None].copy())
                reply(FrameKind.ANSWERED, pack_answer(results, fault))
        except ActivefailError as error:
            reply(FrameKind.REFUSED, pack_error(error))
        except Exception as error:
            if kind != QuestionKind.SIMULATOR:
                raise
            reply(FrameKind.UNLOADABLE, pack_text(description_of(error)))


def _connection(descriptor: int) -> tuple[Callable[[], tuple[QuestionKind, bytes] | None], Callable[..., None]]:
    """How a question is heard, None at the end of them, and how the last one is answered.

    The first question holds the key of the checksums and is answered here. No more of it is kept in reach of a
    simulator than must be, as it might put something else in its place.
    """
    connection = socket.socket(fileno=descriptor)
    # A simulator that reads from it, not knowing whose it is, must not wait for what never comes.
    connection.settimeout(_SEND_LIMIT)
    getpid, fstat, leave = os.getpid, os.fstat, os._exit
    process, place, question = getpid(), os.fstat(descriptor), Question(b"", b"")

    def is_ours() -> bool:
        here = fstat(descriptor)
        return (here.st_dev, here.st_ino) == (place.st_dev, place.st_ino)

    def read(length: int) -> bytes:
        data = bytearray()
        while len(data) < length and is_ours():
            try:
                part = connection.recv(min(length - len(data), 1 << 20))
            except TimeoutError:
                continue
            if not part:
                break
            data += part
        return bytes(data)

    def hear() -> tuple[QuestionKind, bytes] | None:
        nonlocal question
        try:
            head = read(QUESTION.size)
            if len(head) < QUESTION.size:
                return None
            ticket, kind, length = QUESTION.unpack(head)
            content = read(length)
        except OSError:
            return None
        if len(content) < length:
            return None
        question = Question.about(content, ticket)
        return QuestionKind(kind), content

    def reply(kind: FrameKind, payload: bytes = b"") -> None:
        if getpid() != process:
            # The simulator forked, and this is the child, which nobody asked.
            leave(0)
        try:
            if not is_ours():
                leave(LOST)
            connection.sendall(sealed(secret, question, process, kind, payload))
        except OSError:
            leave(LOST)

    greeting = hear()
    secret = b"" if greeting is None else greeting[1]
    reply(FrameKind.READY)
    return hear, reply


def _load(content: bytes) -> tuple[Answer, Simulator]:
    """What answers, and the simulator, prepared."""
    answer, main, simulator = pickle.loads(content)
    _prepare(main)
    made = pickle.loads(simulator)
    if isinstance(made, _Prepared):
        made.prepare()
    return answer, made


def _prepare(main: Mapping[str, Any]) -> None:
    """Be as the main program is where the simulator needs it: its arguments, perhaps its main module."""
    current = multiprocessing.current_process()
    # A main module that starts processes as it is imported is told so by multiprocessing.
    current._inheriting = True  # type: ignore[attr-defined]
    try:
        spawn.prepare(main)
    finally:
        del current._inheriting  # type: ignore[attr-defined]
