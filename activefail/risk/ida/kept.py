"""The simulations of an incremental dynamic analysis in a file, from which an interrupted analysis continues."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.errors import InputError
from activefail.files import read_regular, replacing, writing_to
from activefail.risk.ida.capacity import Answers, Runs, Simulate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.visible import visible

_PART = 100
"""Simulations after which the file is written: an interruption loses fewer."""

_LARGEST_FILE = 100_000_000

_LONGEST = 20
"""Most characters of a value in a message."""

_WORDS = {
    "simulator": "another simulator",
    "code": "other code of the simulator",
    "bearing": "another bearing",
    "records": "other records",
    "intensities": "another --scale-to",
    "model": "another model",
    "tolerance": "another tolerance",
    "versions": "other versions",
}
"""What differs if a part of the identity does."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Simulations whose outcomes are kept in a file, from which an interrupted analysis continues.

    Numerical failures are not kept: they may have been those of a machine.

    Attributes:
        simulate: makes the simulations that the file lacks.
        file: JSON; a damaged one is replaced.
        identity: all that the outcomes depend on, besides record and level, as JSON values.
        progress: called with the number of simulations that were kept.
    """

    simulate: Simulate
    file: Path
    identity: Mapping[str, Any]
    progress: Callable[[int], None] | None = None

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            InputError: as `read` does, or if the file cannot be written; or as `simulate` does.
        """
        known = self.read()
        missing = [one for one in runs if one not in known]
        if self.progress is not None:
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
            rows, of = saved["simulations"], dict(saved["of"])
            if saved["digest"] != _digest([of, rows]):
                return {}
            known = {(int(k), float(level)): (int(outcome), bool(lifted)) for k, level, outcome, lifted in rows}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return {}
        if different := _different(of, json.loads(json.dumps(self.identity))):
            raise InputError(
                f"{visible(str(self.file))}: has simulations with {visible(different)}. Name another folder, or remove "
                "this file to simulate again."
            )
        return known

    def _write(self, known: Mapping[tuple[int, float], tuple[int, bool]]) -> None:
        rows = [[k, level, outcome, lifted] for (k, level), (outcome, lifted) in sorted(known.items())]
        of = dict(self.identity)
        with writing_to(self.file), replacing(self.file) as file:
            json.dump({"of": of, "digest": _digest([of, rows]), "simulations": rows}, file)


def _different(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """The parts of two identities that differ, in words; empty if none does."""
    parts = [name for name in (*here, *there) if there.get(name) != here.get(name)]
    if "records" in parts or "simulator" in parts:
        # They have other intensities, and another simulator has other values too.
        consequences = {"intensities"} | ({"bearing", "code", "model", "tolerance"} if "simulator" in parts else set())
        parts = [name for name in parts if name not in consequences]
    return " and ".join(
        _WORDS.get(name, name) + _values(there.get(name), here.get(name)) for name in dict.fromkeys(parts)
    )


def _values(there: Any, here: Any) -> str:
    """The values that differ, in brackets; empty if the part has no names."""
    if not (isinstance(there, dict) and isinstance(here, dict)):
        return ""
    names = [name for name in dict.fromkeys((*there, *here)) if there.get(name) != here.get(name)]
    pairs = {name: (str(there.get(name)), str(here.get(name))) for name in names}
    # Digests say nothing.
    texts = (
        name if max(map(len, pair)) > _LONGEST else f"{name} {pair[0]}, now {pair[1]}" for name, pair in pairs.items()
    )
    return f" ({'; '.join(texts)})"


def _digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
