"""A verification in the background: one at a time, with its progress, until it ends or is stopped."""

import secrets
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any, Self

from activefail.errors import ActivefailError, InputError
from activefail.execution.executor import Executor
from activefail.risk.design.design_task import LOOKS
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array

STEPS = 2 * len(LOOKS)
"""Most stages of a verification: a search and simulations for each look."""


class AlreadyRunningError(InputError):
    """Another verification is running."""


class StoppedError(Exception):
    """A visitor stopped the verification."""


class Watch:
    """The progress of a verification, and whether it must stop.

    Attributes:
        text: the present stage, in words.
        step: number of the present stage, from 1 on.
        predictions, simulations: so far.
    """

    def __init__(self) -> None:
        self._stop = threading.Event()
        self.text, self.step, self.predictions, self.simulations = "starting", 0, 0, 0

    def stop(self) -> None:
        """Ask the verification to stop."""
        self._stop.set()

    def check(self) -> None:
        """Return, unless the verification must stop.

        Raises:
            StoppedError: if it must.
        """
        if self._stop.is_set():
            raise StoppedError

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


class WatchedExecutor:
    """An executor that counts simulations and ends when its watch says so."""

    def __init__(self, executor: Executor, watch: Watch) -> None:
        self._executor, self._watch = executor, watch

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """Simulate designs, (n, d) (see Executor)."""

        def counted(n: int) -> None:
            self._watch.simulated(n)
            if progress is not None:
                progress(n)

        return self._executor.run(simulator, X, counted)

    def __enter__(self) -> Self:
        self._executor.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.__exit__(*exception)


class Verification:
    """A verification in a thread of its own.

    Attributes:
        id: names it in requests.
    """

    def __init__(self, work: Callable[[Watch], dict[str, Any]]) -> None:
        self.id = secrets.token_urlsafe(12)
        self._work, self._watch = work, Watch()
        self._state, self._error = "running", ""
        self._result: dict[str, Any] | None = None
        # The process does not wait for it.
        self._thread = threading.Thread(target=self._run, name="verification", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._state == "running"

    def stop(self, wait: bool = False) -> None:
        """Ask it to stop, which it does between two predictions or simulations."""
        self._watch.stop()
        if wait and self._thread.is_alive():
            self._thread.join()

    def progress(self) -> dict[str, Any]:
        """How far it is: its state ("running", "done", "stopped" or "failed"), and its result once it is done."""
        watch = self._watch
        return {
            "id": self.id,
            "state": self._state,
            "text": watch.text,
            "step": watch.step,
            "steps": STEPS,
            "predictions": watch.predictions,
            "simulations": watch.simulations,
            "result": self._result,
            "error": self._error,
        }

    def _run(self) -> None:
        try:
            self._result = self._work(self._watch)
            self._state = "done"
        except StoppedError:
            self._state = "stopped"
        except ActivefailError as error:
            self._error, self._state = str(error), "failed"
        except Exception:
            # As for a request: the terminal gets the details, a visitor does not.
            traceback.print_exc(file=sys.stderr)
            self._error, self._state = "The explorer failed; its terminal shows the error.", "failed"


class Verifications:
    """The verifications of a server. At most one runs at a time, and the last one is kept."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: Verification | None = None

    def start(self, work: Callable[[Watch], dict[str, Any]]) -> dict[str, Any]:
        """Start a verification; its progress.

        Raises:
            AlreadyRunningError: if another one is running.
        """
        with self._lock:
            if self._last is not None and self._last.is_running:
                raise AlreadyRunningError("Another verification is running. Wait until it ends.")
            self._last = Verification(work)
            self._last.start()
            return self._last.progress()

    def of(self, name: Any) -> Verification:
        """The verification with an id.

        Raises:
            InputError: if it is not the last one.
        """
        last = self._last
        if last is None or not isinstance(name, str) or not secrets.compare_digest(name.encode(), last.id.encode()):
            raise InputError("id: must be that of the last verification; verify again.")
        return last

    def stop(self) -> None:
        """Stop the running one, if any, and wait for its end."""
        if self._last is not None:
            self._last.stop(wait=True)
