"""The worker process: it loads the simulator that it receives, and simulates designs."""

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
    encode_frame,
    pack_answer,
    pack_error,
    pack_text,
)
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array

LOST = 71
"""The exit code of a worker whose connection was closed or replaced."""

_SEND_LIMIT = 60.0
"""Seconds in which an answer must be sent; it always fits, unless the simulator has filled the connection."""

Answer = Callable[[Simulator, Array], Results]
"""Simulates designs: results with their faults."""


@runtime_checkable
class _Prepared(Protocol):
    """A simulator that loads something before its first simulation, outside the time limit."""

    def prepare(self) -> None: ...


def serve(descriptor: int) -> None:
    """Answer the questions from a connection until its other end is closed."""
    next_question, reply = _connection(descriptor)
    # Parallel workers must not each start a thread per core, in libraries loaded now or later.
    threadpool_limits(1)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    loaded: tuple[Answer, Simulator] | None = None
    while (question := next_question()) is not None:
        kind, content = question
        try:
            if kind == QuestionKind.SIMULATOR:
                loaded = _load(content)
                reply(FrameKind.READY)
            else:
                assert loaded is not None
                answer, simulator = loaded
                # A copy, which the simulator may write to.
                results = answer(simulator, np.frombuffer(content, dtype=np.float64)[None].copy())
                reply(FrameKind.ANSWERED, pack_answer(results))
        except ActivefailError as error:
            reply(FrameKind.REFUSED, pack_error(error))
        except BaseException as error:
            # sys.exit ends the process, also while a module is imported.
            if kind != QuestionKind.SIMULATOR or isinstance(error, SystemExit):
                raise
            reply(FrameKind.UNLOADABLE, pack_text(description_of(error)))


def _connection(descriptor: int) -> tuple[Callable[[], tuple[QuestionKind, bytes] | None], Callable[..., None]]:
    """Functions that read the next question, None at the end, and answer the last one.

    The first question, answered here, contains the key of the checksums. As little as possible is kept within reach of
    a simulator, which might replace it.
    """
    connection = socket.socket(fileno=descriptor)
    # A simulator that reads from this descriptor by mistake must not wait forever.
    connection.settimeout(_SEND_LIMIT)
    getpid, fstat, leave = os.getpid, os.fstat, os._exit
    process, original, question = getpid(), os.fstat(descriptor), Question(b"", b"")

    def is_intact() -> bool:
        current = fstat(descriptor)
        return (current.st_dev, current.st_ino) == (original.st_dev, original.st_ino)

    def read(length: int) -> bytes:
        data = bytearray()
        while len(data) < length and is_intact():
            try:
                part = connection.recv(min(length - len(data), 1 << 20))
            except TimeoutError:
                continue
            if not part:
                break
            data += part
        return bytes(data)

    def next_question() -> tuple[QuestionKind, bytes] | None:
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
            # This is a child that the simulator forked.
            leave(0)
        try:
            if not is_intact():
                leave(LOST)
            connection.sendall(encode_frame(secret, question, process, kind, payload))
        except OSError:
            leave(LOST)

    greeting = next_question()
    secret = b"" if greeting is None else greeting[1]
    reply(FrameKind.READY)
    return next_question, reply


def _load(content: bytes) -> tuple[Answer, Simulator]:
    """The answer function and the prepared simulator."""
    answer, main, pickled = pickle.loads(content)
    _prepare(main)
    simulator = pickle.loads(pickled)
    if isinstance(simulator, _Prepared):
        simulator.prepare()
    return answer, simulator


def _prepare(main: Mapping[str, Any]) -> None:
    """Take over what the simulator needs from the main program: its arguments, perhaps its main module."""
    current = multiprocessing.current_process()
    # multiprocessing then rejects a main module that starts processes during its import.
    current._inheriting = True  # type: ignore[attr-defined]
    try:
        spawn.prepare(main)
    finally:
        del current._inheriting  # type: ignore[attr-defined]
