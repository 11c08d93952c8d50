"""The simulations of an incremental dynamic analysis in a file, from which an interrupted analysis continues."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.errors import InputError
from activefail.files import replacing, writing_to
from activefail.risk.ida.capacity import Answers, Runs, Simulate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.trust import read_regular
from activefail.visible import visible

_PART = 100
"""Simulations after which the file is written: an interruption loses fewer."""

_LARGEST_FILE = 100_000_000

_WORDS = {
    "simulator": "another simulator",
    "code": "other code of the simulator",
    "records": "other records",
    "bearing": "another bearing",
    "intensities": "another --scale-to",
    "model": "another model",
    "tolerance": "another tolerance",
    "versions": "other versions",
}
"""What differs if a part of the identity does; one that differs may change those after it."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Simulations whose outcomes are kept in a JSON file, from which an interrupted analysis continues.

    Numerical failures are not kept: they may have been those of a machine. A damaged file is replaced.
    """

    simulate: Simulate  # makes the simulations that the file lacks
    file: Path  # the file
    identity: Mapping[str, Any]  # all that the outcomes depend on, besides record and level, as JSON values
    progress: Callable[[int], None]  # called with the number of simulations that were kept

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            InputError: if the file has simulations of another analysis, or cannot be written.
        """
        known = self.read()
        missing = [one for one in runs if one not in known]
        self.progress(len(runs) - len(missing))
        for first in range(0, len(missing), _PART):
            part = missing[first : first + _PART]
            answers = self.simulate(part)
            known |= zip(part, zip(answers.outcome.tolist(), answers.lifted.tolist(), strict=True), strict=True)
            self._write({key: answer for key, answer in known.items() if answer[0] != NUMERICAL_FAILURE})
        outcome, lifted = zip(*(known[one] for one in runs), strict=True)
        return Answers(np.array(outcome, dtype=np.int8), np.array(lifted, dtype=bool))

    def read(self) -> dict[tuple[int, float], tuple[int, bool]]:
        """The kept outcomes by record and level; none if the file is missing or damaged.

        Raises:
            InputError: if the file has simulations of another analysis, naming what differs.
        """
        try:
            saved = json.loads(read_regular(self.file, _LARGEST_FILE, follow=True))
            rows, there = saved["simulations"], dict(saved["of"])
            if saved["digest"] != _digest([there, rows]):
                return {}
            known = {(int(k), float(level)): (int(outcome), bool(lifted)) for k, level, outcome, lifted in rows}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return {}
        here = json.loads(json.dumps(self.identity))
        if different := next((words for name, words in _WORDS.items() if there.get(name) != here.get(name)), None):
            raise InputError(
                f"{visible(str(self.file))}: has simulations with {different}. Name another folder, or remove this "
                "file to simulate again."
            )
        return known

    def _write(self, known: Mapping[tuple[int, float], tuple[int, bool]]) -> None:
        rows = [[k, level, outcome, lifted] for (k, level), (outcome, lifted) in sorted(known.items())]
        of = dict(self.identity)
        with writing_to(self.file), replacing(self.file) as file:
            json.dump({"of": of, "digest": _digest([of, rows]), "simulations": rows}, file)


def _digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
