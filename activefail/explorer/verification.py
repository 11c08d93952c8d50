"""A verification in the background: one at a time, with its progress, until it ends or is stopped."""

import secrets
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from activefail.errors import ActivefailError, InputError
from activefail.risk.design.design_task import LOOKS

STEPS = 2 * len(LOOKS)
"""Most stages of a verification: a search and simulations for each look."""


class AlreadyRunningError(InputError):
    """Another verification is running."""


class StoppedError(Exception):
    """A visitor stopped the verification."""


@dataclass
class Verification:
    """The progress of a verification, and whether it must stop.

    Attributes:
        id: names it in questions.
        state: "running", "done", "stopped" or "failed".
        text: the present stage, in words.
        step, steps: number of the present stage, from 1 on, and the most stages.
        predictions, simulations: so far.
        result: once it is done.
        error: why it failed.
    """

    id: str = field(default_factory=lambda: secrets.token_urlsafe(12))
    state: str = "running"
    text: str = "starting"
    step: int = 0
    steps: int = STEPS
    predictions: int = 0
    simulations: int = 0
    result: dict[str, Any] | None = None
    error: str = ""

    def __post_init__(self) -> None:
        self._stop = threading.Event()

    def stop(self) -> None:
        """Ask it to stop, which it does between two predictions or simulations."""
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

    def run(self, work: "Callable[[Verification], dict[str, Any]]") -> None:
        """Do the work, and keep its result or why there is none."""
        try:
            self.result = work(self)
            self.state = "done"
        except StoppedError:
            self.state = "stopped"
        except ActivefailError as error:
            self.error, self.state = str(error), "failed"
        except Exception:
            # As for a question: the terminal gets the details, a visitor does not.
            traceback.print_exc(file=sys.stderr)
            self.error, self.state = "The explorer failed; its terminal shows the error.", "failed"


class Verifications:
    """The verifications of a server. At most one runs at a time, and the last one is kept."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: Verification | None = None
        self._thread: threading.Thread | None = None

    def start(self, work: Callable[[Verification], dict[str, Any]]) -> dict[str, Any]:
        """Start a verification in a thread of its own; its progress.

        Raises:
            AlreadyRunningError: if another one is running.
        """
        with self._lock:
            if self._thread is not None and self._thread.is_alive():
                raise AlreadyRunningError("Another verification is running. Wait until it ends.")
            self._last = Verification()
            # The process does not wait for it.
            self._thread = threading.Thread(target=self._last.run, args=(work,), daemon=True)
            self._thread.start()
            return asdict(self._last)

    def progress(self, id: Any) -> dict[str, Any]:
        """How far the last verification is.

        Raises:
            InputError: if the id is not that of the last one.
        """
        return asdict(self._named(id))

    def stop(self, id: Any) -> dict[str, Any]:
        """Ask the last verification to stop; its progress. Raises as `progress` does."""
        verification = self._named(id)
        verification.stop()
        return asdict(verification)

    def _named(self, id: Any) -> Verification:
        if self._last is None or id != self._last.id:
            raise InputError("id: must be that of the last verification; verify again.")
        return self._last

    def close(self) -> None:
        """Stop the running one, if any, and wait for its end."""
        if self._last is not None and self._thread is not None:
            self._last.stop()
            self._thread.join()
