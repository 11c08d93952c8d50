"""Verifications in the background: one at a time, with its progress, until it ends or is stopped."""

import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Self

from activefail.errors import ActivefailError, InputError


class StoppedError(Exception):
    """A visitor stopped the verification."""


@dataclass(eq=False)
class Job:
    """A verification and its progress.

    Attributes:
        asked: what is verified.
        text: the present stage, in words.
        step: its number, from 1 on.
        predictions, simulations: so far.
        must_stop: whether it ends, as it does between two predictions or simulations.
        result: what it found, once it has ended.
    """

    asked: Any
    text: str = "starting"
    step: int = 0
    predictions: int = 0
    simulations: int = 0
    must_stop: bool = False
    result: "Future[Any]" = field(default_factory=Future)

    def stage(self, text: str) -> None:
        """Begin a stage; raises as `check` does."""
        self.check()
        self.text, self.step = text, self.step + 1

    def predicted(self, n: int) -> None:
        """Count predictions; raises as `check` does."""
        self.check()
        self.predictions += n

    def simulated(self, n: int) -> None:
        """Count simulations; raises as `check` does."""
        self.check()
        self.simulations += n

    def check(self) -> None:
        """Return, unless it must stop. Raises StoppedError."""
        if self.must_stop:
            raise StoppedError

    @property
    def state(self) -> str:
        """`running`, `done`, `stopped` or `failed`."""
        if not self.result.done():
            return "running"
        error = self.result.exception()
        return "done" if error is None else "stopped" if isinstance(error, StoppedError) else "failed"

    @property
    def fault(self) -> str:
        """Why it failed; the terminal has the details of what is no fault of the question."""
        error = self.result.exception()
        return (
            str(error) if isinstance(error, ActivefailError) else "The explorer failed; its terminal shows the error."
        )


class Jobs:
    """The verifications of a server; a context manager that stops them.

    Attributes:
        last: the last one; None if there was none.
    """

    def __init__(self) -> None:
        self.last: Job | None = None
        self._lock, self._worker = threading.Lock(), ThreadPoolExecutor(1)

    def start(self, work: Callable[[Job], Any], asked: Any) -> None:
        """Start a verification.

        Raises:
            InputError: if another one is running.
        """

        def logged() -> Any:
            try:
                return work(job)
            except (ActivefailError, StoppedError):
                raise
            except Exception:
                traceback.print_exc(file=sys.stderr)
                raise

        with self._lock:
            if self.last is not None and self.last.state == "running":
                raise InputError("Another verification is running. Wait until it ends.")
            self.last = job = Job(asked)
            job.result = self._worker.submit(logged)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop the running one, if any, and wait for its end."""
        if self.last is not None:
            self.last.must_stop = True
        self._worker.shutdown()
