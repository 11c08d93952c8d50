"""The simulations of an incremental dynamic analysis in a file, from which an interrupted analysis continues."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.files import replacing, writing_to
from activefail.risk.ida.capacity import Answers, Runs, Simulate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.trust import read_regular

_PART = 100
"""Simulations after which the file is written: an interruption loses fewer."""

_LARGEST_FILE = 100_000_000


@dataclass(frozen=True, eq=False)
class Kept:
    """Simulations whose outcomes are kept in a JSON file: record, level, outcome, and whether a plate lifted off.

    Numerical failures are not kept: they may have been those of a machine. A damaged file is replaced.
    """

    simulate: Simulate  # makes the simulations that the file lacks
    file: Path  # the file
    progress: Callable[[int], None]  # called with the number of simulations that were kept

    @classmethod
    def of(
        cls, simulate: Simulate, folder: Path, identity: Mapping[str, Any], progress: Callable[[int], None]
    ) -> "Kept":
        """The simulations of an analysis; those of another have another file.

        Args:
            simulate, progress: see `Kept`.
            folder: of the files.
            identity: all that the outcomes depend on, besides record and level, as JSON values.
        """
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        return cls(simulate, folder / f"simulations-{digest[:12]}.json", progress)

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            InputError: if the file cannot be written.
        """
        known = self.read()
        missing = [one for one in runs if one not in known]
        self.progress(len(runs) - len(missing))
        for first in range(0, len(missing), _PART):
            part = missing[first : first + _PART]
            answers = self.simulate(part)
            known |= zip(part, zip(answers.outcome.tolist(), answers.lifted.tolist(), strict=True), strict=True)
            rows = [(*one, *answer) for one, answer in sorted(known.items()) if answer[0] != NUMERICAL_FAILURE]
            with writing_to(self.file), replacing(self.file) as file:
                json.dump(rows, file)
        outcome, lifted = zip(*(known[one] for one in runs), strict=True)
        return Answers(np.array(outcome, dtype=np.int8), np.array(lifted, dtype=bool))

    def read(self) -> dict[tuple[int, float], tuple[int, bool]]:
        """The kept outcomes by record and level; none if the file is missing or damaged."""
        try:
            rows = json.loads(read_regular(self.file, _LARGEST_FILE, follow=True))
            return {(k, level): (outcome, lifted) for k, level, outcome, lifted in rows}
        except (OSError, ValueError, TypeError):
            return {}
