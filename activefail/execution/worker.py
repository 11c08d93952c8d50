"""A worker process: it answers the calls of the program until their connection is closed."""

import os
import pickle
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from threadpoolctl import threadpool_limits

from activefail.errors import ActivefailError
from activefail.text.current_folder import MATPLOTLIB, keep_out

_connection: Connection | None = None
"""To the program; None in a process that is no worker."""


def serve(descriptor: int) -> NoReturn:
    """Answer the calls from a connection until its other end is closed."""
    global _connection
    _connection = connection = Connection(descriptor)
    process = os.getpid()
    keep_out(MATPLOTLIB)
    # Parallel workers must not each start a thread per core, in libraries loaded now or later.
    threadpool_limits(1)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"
    while True:
        try:
            content = connection.recv_bytes()
        except (EOFError, OSError):
            os._exit(1)
        function, args, kwargs = pickle.loads(content)
        answer: tuple[Any, ActivefailError | None]
        try:
            answer = function(*args, **kwargs), None
        except ActivefailError as error:
            answer = None, error
        if os.getpid() != process:
            os._exit(0)  # a child that the user's code forked
        try:
            connection.send_bytes(pickle.dumps(answer))
        except OSError:
            os._exit(1)


def stopping() -> bool:
    """Whether this process is a worker that was asked to stop, or whose program has ended."""
    return _connection is not None and _connection.poll(0)
