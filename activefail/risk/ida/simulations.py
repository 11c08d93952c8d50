"""Scales records to the levels of an analysis and simulates them: by the bearing model, or as a campaign does."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activefail.accelerogram_sets import RecordSet
from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import TABLE_1, Model, Tolerance
from activefail.bearing.outcome import CAUSES, OUTCOMES
from activefail.bearing.simulation import simulate_records
from activefail.campaign.assembly import Campaign
from activefail.campaign.on_disk import read_campaign
from activefail.campaign.provenance import simulation_versions
from activefail.campaign.question import checked_values, read_fixed
from activefail.campaign.shipped import campaign_file
from activefail.errors import InputError, SimulationError
from activefail.risk.ida.capacity import Answers, Runs
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

_FIRST = 4
"""Simulations of a campaign's simulator before the others: if all fail, the others would too, and might take long."""

Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class BearingUnderRecords:
    """Simulations of one bearing.

    Under a pulse of Table 1 no bearing fails before a rim touch, so `simulate` takes that for a numerical failure.
    Under records of some 3 g the slider rocks until a plate is above its rim: a failure by the model's own criterion,
    with an energy imbalance of 1e-6. Left out, it would bias the fragility, so it is a failure here, and counted, with
    the bearings that vertical motion lifts over a rim.

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
        outcome = np.where(answers.cause == _LIFTED, _FAILURE, answers.outcome).astype(np.int8)
        return Answers(outcome, (outcome == _FAILURE) & np.isnan(answers.margin("first_touch_time")))

    @property
    def identity(self) -> dict[str, Any]:
        """All that the outcomes depend on, besides record and level."""
        return {
            "bearing": dict(zip(TABLE_1.names, self.bearing.tolist(), strict=False)),
            "intensities": self.intensities.tolist(),
            "records": digest_of(self.records),
            "model": asdict(self.model),
            "tolerance": asdict(self.tolerance),
            "versions": simulation_versions(),
        }


@dataclass(frozen=True, eq=False)
class CampaignUnderRecords:
    """A campaign under records, whose simulator scales them itself, with values of its other variables.

    Attributes:
        name: of the campaign.
        campaign: with the variables `record` and `PGV`.
        values: of all other variables.
        records: the campaign's set, in its order.

    Raises:
        InputError: if the campaign lacks a variable, has another number of records, or a value is missing.
    """

    name: str
    campaign: Campaign
    values: Mapping[str, float]
    records: RecordSet

    def __post_init__(self) -> None:
        space, records = self.campaign.space, len(self.records.records)
        for name in (RECORD, VELOCITY):
            if name not in space.names:
                raise InputError(
                    f"--simulator: must be a campaign under records, with the variables {RECORD} and {VELOCITY}; got "
                    f"{visible(', '.join(space.names))}."
                )
            if name in self.values:
                raise InputError(f"--bearing: {name} belongs to the ground motion; leave it out.")
        number = float(space.high[space.names.index(RECORD)])
        if number != records:
            raise InputError(f"--records: must be the {number:g} records of the campaign, got {records}.")
        if missing := [name for name in space.names if name not in (*self.values, RECORD, VELOCITY)]:
            raise InputError(f"--bearing: requires {visible(', '.join(missing))}.")


def campaign_under_records(
    file: str | Path, values: Mapping[str, float] | str | Path, records: RecordSet
) -> CampaignUnderRecords:
    """A campaign under records, for `ida_of_campaign`.

    Args:
        file: the campaign file, or the name of a shipped campaign, such as "building_records". Its folder has the
            simulator's code, which is executed.
        values: of all variables but `record` and `PGV`: by name, or a TOML file.
        records: the campaign's set, in its order.

    Raises:
        InputError: naming the file, the key, the rule and the value.
    """
    file = campaign_file(Path(file))
    campaign = read_campaign(file, code=file.absolute().parent, features=False)
    campaign.check_simulates()
    if isinstance(values, str | Path):
        values = read_fixed(Path(values), campaign.space)
    else:
        values = checked_values(values, campaign.space)
    return CampaignUnderRecords(file.name, campaign, values, records)


@dataclass(eq=False)
class CampaignSimulations:
    """Simulations by the simulator of a campaign under records.

    Attributes:
        asked: campaign, values and records.
        executor: runs the simulations.
        progress: called with numbers of simulations that ended.
        answered: whether a simulation has given an outcome.
        first_fault: why the first numerical failure happened, as a sentence; empty without one.
    """

    asked: CampaignUnderRecords
    executor: "Executor"
    progress: Progress | None = None
    answered: bool = field(default=False, init=False)
    first_fault: str = field(default="", init=False)

    def __call__(self, runs: Runs) -> Answers:
        """The outcomes of records at levels.

        Raises:
            SimulationError: if the first simulations give no outcome, which is a fault of the simulator; or as the
                executor does.
        """
        if not self.answered and len(runs) > _FIRST:
            return _joined(self(runs[:_FIRST]), self(runs[_FIRST:]))
        campaign, ground = self.asked.campaign, np.array(runs)
        # Half a number from the next record, so that rounding changes nothing.
        columns = {name: np.full(len(runs), value) for name, value in self.asked.values.items()}
        columns |= {RECORD: ground[:, 0] + 0.5, VELOCITY: ground[:, 1]}
        X = np.column_stack([columns[name] for name in campaign.space.names])
        results = self.executor.run(campaign.simulator, X, self.progress)
        self.first_fault = self.first_fault or first_fault_text(results.faults.values()).strip()
        self.answered = self.answered or bool((results.outcome != NUMERICAL_FAILURE).any())
        if not self.answered:
            raise SimulationError(f"None of {len(runs)} simulations gave an outcome. {self.first_fault}".rstrip())
        return Answers(results.outcome, np.zeros(len(runs), dtype=bool))

    @property
    def identity(self) -> dict[str, Any]:
        """All that the outcomes depend on and that is known, besides record and level."""
        campaign = self.asked.campaign
        return {
            "simulator": campaign.settings.model_dump(
                mode="json", include={"simulator": {"python", "command", "outcomes", "margins", "levels"}}
            )["simulator"],
            "code": campaign.sources,
            "bearing": {**campaign.space.fixed, **self.asked.values},
            "records": digest_of([record.motion for record in self.asked.records.records]),
            "versions": simulation_versions(),
        }


def _joined(*parts: Answers) -> Answers:
    return Answers(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def digest_of(records: Sequence[Accelerogram]) -> str:
    """SHA-256 of the samples and intervals of records, in their order."""
    digest = hashlib.sha256()
    for record in records:
        for part in (np.array([record.dt]), record.acceleration, record.vertical):
            part = np.empty(0) if part is None else part
            digest.update(np.array([len(part)]).tobytes())
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()
