"""What is analysed under records scaled to levels: a bearing by its model, or what a campaign simulates."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import campaign_file, read_campaign
from activefail.campaign.question import values_of
from activefail.errors import InputError, SimulationError, naming
from activefail.estimates.stored_sets import first_fault_text
from activefail.execution.executor import Executor, run_keeping
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.bearing.design import TABLE_1, Bearing, Model, Tolerance, outside_table_1
from activefail.seismic.bearing.outcome import CAUSES, OUTCOMES
from activefail.seismic.bearing.simulation import simulate_records
from activefail.seismic.ida.capacity import Answers, Runs, Simulate
from activefail.seismic.motions.accelerogram_sets import RecordSet
from activefail.seismic.motions.motions import Motions
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space.space import Array
from activefail.text.files import replacing, writing_to
from activefail.text.trust import read_regular
from activefail.visible import visible

RECORD, VELOCITY = "record", "PGV"
"""Variables of a campaign whose code reads the records: the record, whose whole part counts from 0, and its PGV."""

_LIFTED, _ESCAPE = CAUSES.index("failure_without_rim_touch"), CAUSES.index("escape")
_FAILURE = len(OUTCOMES) - 1

_FIRST = 4
"""Simulations of a campaign's simulator before the others: if all fail, the others would too, and might take long."""

Progress = Callable[[int], None]
Values = Mapping[str, float] | Sequence[float] | Array | Path | str
"""Values of variables: by name, in the order of Table 1, or in a TOML file."""


@dataclass(eq=False)
class BearingSubject:
    """A bearing that is analysed.

    Attributes:
        row: (7,) its values in the units of Table 1.
        model, tolerance, threads: as for `simulate_records`.
        values: of its variables, by name.
        outcomes: from least to most severe.
        notes: what to know of it, as sentences.
        fault: why the first numerical failure happened; empty without one.
        answered: whether a simulation has given an outcome; a bearing's need not.
    """

    row: Array
    model: Model
    tolerance: Tolerance
    threads: int | None = None
    answered = True
    outcomes = OUTCOMES
    fault = ""

    def __post_init__(self) -> None:
        self.values = dict(zip(TABLE_1.names, self.row.tolist(), strict=False))
        self.notes = tuple(outside_table_1(self.row.tolist()))

    @classmethod
    def of(cls, values: Values, model: Model, tolerance: Tolerance, threads: int | None) -> "BearingSubject":
        """The bearing with these values of T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p and k."""
        names = TABLE_1.names[:7]
        if not isinstance(values, str | Path | Mapping):
            row = np.asarray(values, dtype=np.float64)
            if row.shape != (7,):
                raise InputError(f"bearing: must be the seven values {', '.join(names)}, got shape {row.shape}.")
            values = dict(zip(names, row.tolist(), strict=True))
        file = visible(str(values)) if isinstance(values, str | Path) else "bearing"
        known = values_of(values, TABLE_1, "bearing")
        if of_pulse := [name for name in known if name not in names]:
            raise InputError(f"{file}: {of_pulse[0]}: belongs to a pulse; the records are the ground motion.")
        if missing := [name for name in names if name not in known]:
            raise InputError(f"{file}: requires {', '.join(missing)}.")
        row = np.array([known[name] for name in names])
        with naming(f"{file}: "):
            Bearing.from_row(row.tolist(), model.slider_diameter)
        return cls(row, model, tolerance, threads)

    def simulate(self, records: Sequence[Accelerogram], intensities: Array, progress: Progress, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Under a pulse of Table 1 no bearing fails before a rim touch, so `simulate` takes that for a numerical failure.
        Under records of some 3 g the slider rocks until a plate is above its rim: a failure by the model's own
        criterion, with an energy imbalance of 1e-6. Left out, it would bias the fragility, so it is a failure here, and
        counted, with the bearings that vertical motion lifts over a rim.

        Args:
            records: n records.
            intensities: (n,) intensity of the records as they are.
            progress: called with numbers of simulations that ended.
            runs: records and levels.
        """
        moved = [records[k].scaled(level / intensities[k]) for k, level in runs]
        bearings = np.tile(self.row, (len(runs), 1))
        answers = simulate_records(bearings, moved, self.model, self.tolerance, self.threads, progress)
        outcome = np.where(answers.cause == _LIFTED, _FAILURE, answers.outcome).astype(np.int8)
        untouched = np.isnan(answers.margin("first_touch_time"))
        # Without rims the slider leaves its dish, and nothing is touched or lifted.
        lifted = untouched & ((answers.cause != _ESCAPE) | (self.model.rim != "none"))
        return Answers(outcome, (outcome == _FAILURE) & lifted)

    @property
    def identity(self) -> dict[str, Any]:
        """What the outcomes depend on, besides values, records and levels, as JSON values."""
        return {"model": asdict(self.model), "tolerance": asdict(self.tolerance)}


@dataclass(frozen=True)
class Ground:
    """The ground motion in the designs of a campaign.

    Attributes:
        record: the variable that says which record.
        level: the variable to which it is scaled.
        measure: the intensity that `level` is.
        records: the records; None if the campaign's code reads them.
    """

    record: str = RECORD
    level: str = VELOCITY
    measure: str = "pgv"
    records: RecordSet | None = None

    @classmethod
    def of(cls, campaign: Campaign) -> "Ground":
        """That of a campaign: of a variable with a set, or the variables `record` and `PGV`.

        Raises:
            InputError: if it has neither; or as reading the records does.
        """
        names = campaign.space.names
        for one in campaign.space.parameters:
            if isinstance(one.payload, Motions):
                if one.payload.level not in names:
                    raise InputError(
                        f"--simulator: requires a campaign whose space.{one.name}.scaled_to names a variable, to which "
                        "the records are scaled."
                    )
                return cls(one.name, one.payload.level, one.payload.measure, one.payload.found)
        if not {RECORD, VELOCITY} <= set(names):
            raise InputError(
                f"--simulator: must be a campaign under records, with a variable that has a `set`, or the variables "
                f"{RECORD} and {VELOCITY}; got {visible(', '.join(names))}."
            )
        return cls()


@dataclass(eq=False)
class CampaignSubject:
    """A campaign under records that is analysed; its simulator scales them itself.

    Attributes:
        name: of the campaign.
        campaign: its definition.
        ground: the ground motion in its designs.
        asked: values of its other variables.
        executor: runs the simulations.
        keep: called with the designs and results of simulations.
        simulated: number of simulations so far.
        values, outcomes, notes, fault, answered: as for `BearingSubject`.
    """

    name: str
    campaign: Campaign
    ground: Ground
    asked: Mapping[str, float]
    executor: Executor
    keep: Callable[[Array, Results], object] = lambda *_: None
    simulated: int = 0
    answered: bool = False
    fault: str = ""

    def __post_init__(self) -> None:
        self.values = {**self.campaign.space.fixed, **self.asked}
        self.outcomes = tuple(self.campaign.simulator.outcomes)
        of_code = (
            "The campaign's code reads and scales the records. Their names and events are those of --records, in the "
            "same order."
        )
        self.notes = () if self.ground.records else (of_code,)

    def simulate(self, records: Sequence[Accelerogram], intensities: Array, progress: Progress, runs: Runs) -> Answers:
        """The outcomes of records at levels (see `BearingSubject.simulate`).

        Raises:
            SimulationError: if the first simulations give no outcome, which is a fault of the simulator; or as the
                executor does.
        """
        if not self.answered and len(runs) > _FIRST:
            parts = (self.simulate(records, intensities, progress, part) for part in (runs[:_FIRST], runs[_FIRST:]))
            return Answers(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        X = self.designs(runs)
        results = run_keeping(self.executor, self.campaign.simulator, X, self.keep, progress)
        self.fault = self.fault or first_fault_text(results.faults.values()).strip()
        self.answered = self.answered or bool((results.outcome != NUMERICAL_FAILURE).any())
        if not self.answered:
            raise SimulationError(f"None of {len(runs)} simulations gave an outcome. {self.fault}".rstrip())
        self.keep(X, results)
        self.simulated += len(X)
        return Answers(results.outcome, np.zeros(len(runs), dtype=bool))

    def designs(self, runs: Runs) -> Array:
        """The designs of records at levels, (n, d)."""
        which, level = np.array(runs).T
        # Of a number between two whole ones rounding changes nothing.
        which = which if self.ground.records else which + 0.5
        columns = {name: np.full(len(runs), value) for name, value in self.asked.items()}
        columns |= {self.ground.record: which, self.ground.level: level}
        return np.column_stack([columns[name] for name in self.campaign.space.names])

    @property
    def identity(self) -> dict[str, Any]:
        """What the outcomes depend on and that is known, as for `BearingSubject`."""
        names = {"python", "command", "outcomes", "margins", "levels", "system", "lost", "pattern", "output"}
        settings = self.campaign.settings.model_dump(mode="json", include={"simulator": names})
        return {**settings, "code": self.campaign.sources}


def campaign_of(file: str | Path) -> tuple[str, Campaign]:
    """Name and campaign of a campaign file, or of a shipped one, whose code is executed."""
    file = campaign_file(Path(file))
    campaign = read_campaign(file, code=file.absolute().parent, features=False, frozen=True)  # no features are needed
    campaign.check_simulates()
    return file.name, campaign


def values_under_records(campaign: Campaign, ground: Ground, values: Values, records: RecordSet) -> dict[str, float]:
    """The values of all variables of a campaign but those of the ground motion.

    Raises:
        InputError: if the campaign has other records, or a value is missing.
    """
    space, known = campaign.space, values_of(values, campaign.space, "bearing")
    of_ground = (ground.record, ground.level)
    if motion := [name for name in of_ground if name in known]:
        raise InputError(f"--bearing: {motion[0]} belongs to the ground motion; leave it out.")
    if ground.records is None:
        number = float(space.high[space.names.index(ground.record)])
        if number != len(records.records):
            raise InputError(f"--records: must be the {number:g} records of the campaign, got {len(records.records)}.")
    elif records.digest != ground.records.digest:
        raise InputError(f"--records: must be those of the campaign, {ground.records.name}; leave them out.")
    if missing := [name for name in space.names if name not in (*known, *of_ground)]:
        raise InputError(f"--bearing: requires {visible(', '.join(missing))}.")
    return known


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
