"""Simulators that go wrong; apart from the tests, so that a worker loads little for them."""

import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from campaign.stub import Disc

from activefail.campaign.simulator import Results
from activefail.space import Array


@dataclass(frozen=True)
class OnceAt(Disc):
    """Does what another disc does to its worker at some designs, the first time that they are simulated.

    Attributes:
        every: one design in so many, told by its digits.
    """

    fault: Disc | None = None
    folder: str = ""
    every: int = 4
    releases_gil = False

    def run(self, X: Array) -> Results:
        for design in X:
            key = int(abs(design[0]) * 1e9)
            note = Path(self.folder, f"at-{key}")
            if key % self.every == 0 and not note.exists():
                note.touch()
                assert self.fault is not None
                # That acts where the first number is 0.
                self.fault.run(np.array([[0.0, design[1]]]))
        return Disc().run(X)


@dataclass(frozen=True)
class Failing(Disc):
    """Fails in one way wherever x is below a bound."""

    how: str = "raises"
    below: float = -np.inf
    releases_gil = False

    def run(self, X: Array) -> Results:
        answers = Disc().run(X)
        bad = X[:, 0] < self.below
        if not bad.any():
            return answers
        match self.how:
            case "raises":
                raise ValueError("no convergence")
            case "nan":
                return replace(answers, outcome=np.where(bad, np.nan, answers.outcome))
            case "hangs":
                time.sleep(600)
            case "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            case "memory":
                np.empty(2**58)
        raise AssertionError(self.how)
