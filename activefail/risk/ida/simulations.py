"""The simulations of an incremental dynamic analysis: of the bearing model or of a campaign, kept in a file."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import Model, Tolerance
from activefail.bearing.outcome import CAUSES, OUTCOMES
from activefail.bearing.simulation import simulate_records
from activefail.campaign.assembly import Campaign
from activefail.campaign.provenance import simulation_versions
from activefail.errors import InputError, SimulationError
from activefail.files import read_regular, replacing, writing_to
from activefail.risk.ida.capacity import Answers, Runs, Simulate
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array
from activefail.verification.stored_sets import first_fault_text
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.execution.executor import Executor

RECORD, VELOCITY = "record", "PGV"
"""Variables of a campaign under records: the record, whose whole part counts from 0, and the PGV after scaling."""

_LIFTED = CAUSES.index("failure_without_rim_touch")
_FAILURE = len(OUTCOMES) - 1

_PART = 100
"""Simulations after which the file is written: an interruption loses fewer."""

_FIRST = 4
"""Simulations of a campaign's simulator before the others: if all fail, the others would too, and might take long."""

_LARGEST_FILE = 100_000_000

Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class BearingUnderRecords:
    """Simulations of one bearing.

    Under a pulse of Table 1 no bearing fails before a rim touch, so `simulate` takes that for a numerical failure.
    Under records of some 3 g the slider rocks until a plate is above its rim: a failure by the model's own criterion,
    with an energy imbalance of 1e-6. Left out, it would bias the fragility, so it is a failure here, and counted.

    Attributes:
        bearing: (7,) a row of `simulate_records`.
        records: n records.
        intensities: (n,) intensity of the records as they are.
        model, tolerance, threads, progress: as for `simulate_records`.
    """

    bearing: Array
    records: Sequence[Accelerogram]
    intensities: Array
    model: Model
    tolerance: Tolerance
    threads: int | None = None
    progress: Progress | None = None

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            InputError: as `simulate_records` does.
        """
        moved = [self.records[k].scaled(level / self.intensities[k]) for k, level in runs]
        bearings = np.tile(self.bearing, (len(runs), 1))
        answers = simulate_records(bearings, moved, self.model, self.tolerance, self.threads, self.progress)
        lifted = answers.cause == _LIFTED
        return Answers(np.where(lifted, _FAILURE, answers.outcome).astype(np.int8), lifted)

    @property
    def identity(self) -> dict[str, Any]:
        """All that the outcomes depend on, besides record and level."""
        return {
            "bearing": self.bearing.tolist(),
            "own": self.intensities.tolist(),
            "records": digest_of(self.records),
            "model": asdict(self.model),
            "tolerance": asdict(self.tolerance),
            "versions": simulation_versions(),
        }


@dataclass(eq=False)
class CampaignUnderRecords:
    """Simulations by the simulator of a campaign under records, which scales them itself.

    Attributes:
        campaign: with the variables `record` and `PGV`.
        values: of all other variables.
        records: of the set, in the campaign's order.
        executor: runs the simulations.
        progress: called with numbers of simulations that ended.
        answered: whether a simulation has given an outcome.
        first_fault: why the first numerical failure happened, as a sentence; empty without one.

    Raises:
        InputError: if the campaign lacks a variable, has another number of records, or a value is missing.
    """

    campaign: Campaign
    values: Mapping[str, float]
    records: Sequence[Accelerogram]
    executor: "Executor"
    progress: Progress | None = None
    answered: bool = field(default=False, init=False)
    first_fault: str = field(default="", init=False)

    def __post_init__(self) -> None:
        check_under_records(self.campaign, self.values, len(self.records))

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            SimulationError: if the first simulations give no outcome, which is a fault of the simulator; or as the
                executor does.
        """
        if not self.answered and len(runs) > _FIRST:
            return _joined(self(runs[:_FIRST]), self(runs[_FIRST:]))
        space, ground = self.campaign.space, np.array(runs)
        # Half a number from the next record, so that rounding changes nothing.
        columns = {name: np.full(len(runs), value) for name, value in self.values.items()}
        columns |= {RECORD: ground[:, 0] + 0.5, VELOCITY: ground[:, 1]}
        X = np.column_stack([columns[name] for name in space.names])
        results = self.executor.run(self.campaign.simulator, X, self.progress)
        self.first_fault = self.first_fault or first_fault_text(results.faults.values()).strip()
        self.answered = self.answered or bool((results.outcome != NUMERICAL_FAILURE).any())
        if not self.answered:
            raise SimulationError(f"None of {len(runs)} simulations gave an outcome. {self.first_fault}".rstrip())
        return Answers(results.outcome, np.zeros(len(runs), dtype=bool))

    @property
    def identity(self) -> dict[str, Any]:
        """All that the outcomes depend on and that is known, besides record and level."""
        return {
            "simulator": self.campaign.settings.model_dump(
                mode="json", include={"simulator": {"python", "command", "outcomes"}}
            ),
            "sources": self.campaign.sources,
            "space": self.campaign.space.names,
            "values": {**self.campaign.space.fixed, **self.values},
            "records": digest_of(self.records),
            "versions": simulation_versions(),
        }


def _joined(*parts: Answers) -> Answers:
    return Answers(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def check_under_records(campaign: Campaign, values: Mapping[str, float], records: int) -> None:
    """Check that a campaign is one under a number of records, and that its other variables have values.

    Raises:
        InputError: naming the option, the rule and the value.
    """
    space = campaign.space
    for name in (RECORD, VELOCITY):
        if name not in space.names:
            raise InputError(
                f"--simulator: must be a campaign under records, with the variables {RECORD} and {VELOCITY}; got "
                f"{visible(', '.join(space.names))}."
            )
        if name in values:
            raise InputError(f"--bearing: {name} belongs to the ground motion; leave it out.")
    number = float(space.high[space.names.index(RECORD)])
    if number != records:
        raise InputError(f"--records: must be the {number:g} records of the campaign, got {records}.")
    if missing := [name for name in space.names if name not in (*values, RECORD, VELOCITY)]:
        raise InputError(f"--bearing: requires {visible(', '.join(missing))}.")


def digest_of(records: Sequence[Accelerogram]) -> str:
    """SHA-256 of the samples and intervals of records, in their order."""
    digest = hashlib.sha256()
    for record in records:
        for part in (np.array([record.dt]), record.acceleration, record.vertical):
            part = np.empty(0) if part is None else part
            digest.update(np.array([len(part)]).tobytes())
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Kept:
    """Simulations whose outcomes are kept in a file, from which an interrupted analysis continues.

    Numerical failures are not kept: they may have been those of a machine.

    Attributes:
        simulate: makes the simulations that the file lacks.
        file: JSON; one of other simulations, or a damaged one, is replaced.
        identity: all that the outcomes depend on, besides record and level.
        progress: called with the number of simulations that were kept.
    """

    simulate: Simulate
    file: Path
    identity: Mapping[str, Any]
    progress: Progress | None = None

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            InputError: if the file cannot be written; or as `simulate` does.
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
        """The kept outcomes by record and level; none if the file is missing, damaged or of other simulations."""
        try:
            saved = json.loads(read_regular(self.file, _LARGEST_FILE, follow=True))
            rows = saved["simulations"]
            if saved["of"] != self._of or saved["digest"] != _digest(rows):
                return {}
            return {(int(k), float(level)): (int(outcome), bool(lifted)) for k, level, outcome, lifted in rows}
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return {}

    @property
    def _of(self) -> str:
        return _digest(self.identity)

    def _write(self, known: Mapping[tuple[int, float], tuple[int, bool]]) -> None:
        rows = [[k, level, outcome, lifted] for (k, level), (outcome, lifted) in sorted(known.items())]
        with writing_to(self.file), replacing(self.file) as file:
            json.dump({"of": self._of, "digest": _digest(rows), "simulations": rows}, file)


def _digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
