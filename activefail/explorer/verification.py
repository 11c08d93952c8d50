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

STEPS = 2 * LOOKS
"""Most stages of a verification: a search and simulations for each look."""


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
        must_stop: whether it ends, as it does between two predictions or simulations.
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
    must_stop: bool = False

    def stop(self) -> dict[str, Any]:
        """Ask it to stop; its progress."""
        self.must_stop = True
        return self.progress()

    def progress(self) -> dict[str, Any]:
        """How far it is, as JSON values."""
        return asdict(self)

    def check(self) -> None:
        """Return, unless the verification must stop.

        Raises:
            StoppedError: if it must.
        """
        if self.must_stop:
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
        self._last = Verification(state="none")
        self._thread = threading.Thread()

    @property
    def is_running(self) -> bool:
        """Whether one runs."""
        return self._last.state == "running"

    def start(self, work: Callable[[Verification], dict[str, Any]]) -> dict[str, Any]:
        """Start a verification in a thread of its own; its progress.

        Raises:
            InputError: if another one is running.
        """
        with self._lock:
            if self.is_running:
                raise InputError("Another verification is running. Wait until it ends.")
            self._last = Verification()
            # The process does not wait for it.
            self._thread = threading.Thread(target=self._last.run, args=(work,), daemon=True)
            self._thread.start()
            return self._last.progress()

    def named(self, name: str, id: Any) -> Verification:
        """Read the id of the last verification in a question.

        Raises:
            InputError: if it is another one's.
        """
        if id != self._last.id:
            raise InputError(f"{name}: must be that of the last verification; verify again.")
        return self._last

    def close(self) -> None:
        """Stop the running one, if any, and wait for its end."""
        if self.is_running:
            self._last.stop()
            self._thread.join()
