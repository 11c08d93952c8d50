"""A summary of a campaign from its record, without importing the machine learning libraries."""

import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.boundaries import boundary_shares
from activefail.files import check_dots
from activefail.findings.lost import where_lost
from activefail.record.asked import NO_ROW, Asked, rows_with_results
from activefail.record.batch import GIVEN, INITIAL, Batch, Schema
from activefail.shares import percent
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.verification.unseen import unseen_outcomes, unseen_warning
from activefail.visible import visible

_IDS_SHOWN = 20
"""Most ids of designs in flight that `status` lists."""


@dataclass(frozen=True)
class SettingsInBrief:
    """A campaign's settings in brief. All text is made visible, since a run folder may come from a stranger.

    Attributes:
        simulator: its name, "module:function", the command, or "elsewhere".
        variables: number of variables.
        initial: simulations of the initial design.
        features: their name; or "variables", if included, with "module:function" or the names of expressions.
        custom_code: whether the simulator or the features are user code.
        stop_simulations: simulations of a look of the stop rule; None without a rule.
        batch: simulations of a batch.
        is_elsewhere: whether simulations are made elsewhere.
        boundaries: share of each target boundary, by outcome.
        learns: `classifier.learns`.
        stop_outcome: outcome of the stop rule for a probability; empty without this rule.
    """

    description: str
    simulator: str
    seed: int
    variables: int
    initial: int
    budget: int
    kernel: str
    features: str
    criterion: str
    boundaries: dict[str, float]
    custom_code: bool = False
    stop_simulations: int | None = None
    batch: int = 1
    is_elsewhere: bool = False
    learns: str = "outcomes"
    stop_outcome: str = ""

    @classmethod
    def of(cls, text: str) -> Self:
        """The settings in brief of a frozen campaign.toml, which contains all defaults.

        Raises:
            ValueError: if the text is not such a file.
        """
        check_dots(text)
        settings = tomllib.loads(text)
        match settings:
            case {
                "description": str(description),
                "simulator": (
                    str(simulator)
                    | {"python": str(simulator)}
                    | {"command": str(simulator)}
                    | {"elsewhere": True as simulator}
                ),
                "seed": int(seed),
                "space": dict(space),
                "sampling": {"initial": int(initial), "budget": int(budget), "batch": int(batch)},
                "classifier": {
                    "kernel": str(kernel),
                    "features": (str() | {"python": str()} | {"expressions": dict()} as features),
                },
                "acquisition": {"criterion": str(criterion), "boundary": str() | dict() as boundary},
            } if all(isinstance(one, dict) for one in space.values()) and _is_boundary(boundary):
                return cls(
                    visible(description),
                    "elsewhere" if simulator is True else visible(simulator),
                    seed,
                    sum("value" not in variable for variable in space.values()),
                    initial,
                    budget,
                    visible(kernel),
                    visible(_features_in_words(features)),
                    visible(criterion),
                    {visible(name): share for name, share in boundary_shares(boundary).items()},
                    (not isinstance(simulator, bool) and not isinstance(settings["simulator"], str))
                    or (isinstance(features, dict) and "python" in features),
                    _stop_simulations(settings.get("stop")),
                    batch,
                    simulator is True,
                    visible(str(settings["classifier"].get("learns", "outcomes"))),
                    _stop_outcome(settings.get("stop")),
                )
            case _:
                raise ValueError("The settings must be those of a campaign, with every default written out.")


def _stop_simulations(rule: object) -> int | None:
    match rule:
        case {"simulations": int(simulations)}:
            return simulations
        case _:
            return None


def _stop_outcome(rule: object) -> str:
    match rule:
        case {"probability": str(outcome)}:
            return visible(outcome)
        case _:
            return ""


def _features_in_words(features: str | dict[str, Any]) -> str:
    if isinstance(features, str):
        return features
    match features:
        case {"python": str(reference)}:
            names = [reference]
        case {"expressions": dict(expressions)}:
            names = list(expressions)
        case _:
            names = []
    return ", ".join((["variables"] if features.get("variables", True) else []) + names)


def _is_boundary(boundary: str | dict[str, Any]) -> bool:
    if isinstance(boundary, str):
        return True
    weights = boundary.values()
    return bool(weights) and all(isinstance(one, int | float) and 0.0 < one <= sys.float_info.max for one in weights)


def _corrections_in_words(number: int) -> str:
    return f"{number} correction{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class Summary:
    """The state of a campaign in counts.

    Attributes:
        settings: of the campaign.
        outcomes: names of the outcomes, as visible text.
        iteration: active batches so far.
        initial, chosen, given: (number of outcomes + 1,) recorded simulations of the initial design, those that the
            campaign chose, and those that it did not ask for, by outcome, numerical failures last.
        in_flight: ids of the designs in flight.
        margins: names of the margins.
        corrected: number of corrections.
        lost: where runs gave no result; empty if all gave one.
    """

    settings: SettingsInBrief
    outcomes: tuple[str, ...]
    iteration: int
    initial: NDArray[np.int64]
    chosen: NDArray[np.int64]
    given: NDArray[np.int64]
    in_flight: tuple[int, ...] = ()
    margins: tuple[str, ...] = ()
    corrected: int = 0
    lost: str = ""

    @property
    def counts(self) -> NDArray[np.int64]:
        """All recorded simulations by outcome, numerical failures last."""
        return self.initial + self.chosen + self.given

    @property
    def done(self) -> int:
        """Number of recorded simulations that count towards the budget."""
        return int((self.initial + self.chosen).sum())

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts that `activefail status` prints."""
        settings = self.settings
        targets = " and ".join(
            f"the {name} boundary" + (f" ({percent(share, 0)})" if share < 1.0 else "")
            for name, share in settings.boundaries.items()
        )
        done = f"{self.done} of {settings.budget} simulations"
        if self.done > settings.budget:
            done = f"{self.done} simulations, {settings.budget} planned"
        names = (*self.outcomes, "numerical failures")
        return [
            ("simulator", f"{settings.simulator}, {settings.variables} variables, seed {settings.seed}"),
            ("learner", f"{settings.kernel} on {settings.features} features, {settings.criterion} at {targets}"),
            ("done", f"{done}, iteration {self.iteration}"),
            *(
                (title, ", ".join(f"{n} {name}" for n, name in zip(counts.tolist(), names, strict=True)))
                for title, counts in self._origins
            ),
            *([("corrected", _corrections_in_words(self.corrected))] if self.corrected else []),
            *([("in flight", self.flight_in_words)] if self.in_flight else []),
        ]

    @property
    def _origins(self) -> list[tuple[str, NDArray[np.int64]]]:
        given = [("given", self.given)] if self.given.any() else []
        return [("initial", self.initial), ("chosen", self.chosen), *given, ("all", self.counts)]

    @property
    def flight_in_words(self) -> str:
        """The designs in flight, with their first ids; empty without any."""
        if not self.in_flight:
            return ""
        shown = ", ".join(map(str, self.in_flight[:_IDS_SHOWN])) + (", ..." if len(self.in_flight) > _IDS_SHOWN else "")
        return f"1 design, id {shown}" if len(self.in_flight) == 1 else f"{len(self.in_flight)} designs, ids {shown}"

    @property
    def unseen_warning(self) -> str:
        """The warning about outcomes without a simulation; empty if there are none, or no simulations yet."""
        if not self.counts.any():
            return ""
        unseen = unseen_outcomes(self.outcomes, self.counts)
        answered, unanswered = int(self.initial[:-1].sum()), int(self.initial[-1])
        return unseen_warning(unseen, int(self.counts[:-1].sum()), answered, unanswered)

    @classmethod
    def of(cls, settings: str, schema: Schema, batches: Sequence[Batch], asked: Asked, corrected: int = 0) -> Self:
        """The summary of a campaign's batches and the designs that were handed out.

        Args:
            settings: TOML with all defaults.
            schema, batches, asked: of the record.
            corrected: number of its corrections.

        Raises:
            ValueError: if the settings are not those of a campaign.
        """
        none = np.empty(0, dtype=np.int8)
        outcome = np.concatenate([none, *(batch.results.outcome for batch in batches)])
        origin = np.concatenate([none, *(batch.origin for batch in batches)])
        return cls(
            SettingsInBrief.of(settings),
            _shown(schema.outcomes),
            batches[-1].iteration if batches else 0,
            *_by_origin(outcome, origin, len(schema.outcomes)),
            _in_flight(asked, batches),
            schema.margins,
            corrected,
            _where_lost(schema.variables, batches),
        )


def _shown(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(map(visible, names))


def _by_origin(
    outcome: NDArray[np.int8], origin: NDArray[np.int8], outcomes: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The counts of the initial design, of chosen and of given simulations."""
    initial, given = origin == INITIAL, origin == GIVEN
    return (
        _counts(outcome[initial], outcomes),
        _counts(outcome[~initial & ~given], outcomes),
        _counts(outcome[given], outcomes),
    )


def _in_flight(asked: Asked, batches: Sequence[Batch]) -> tuple[int, ...]:
    """The ids of the designs in flight."""
    designs = np.concatenate([np.empty((0, asked.designs.shape[1])), *(batch.designs for batch in batches)])
    origin = np.concatenate([np.empty(0, dtype=np.int8), *(batch.origin for batch in batches)])
    waiting = (rows_with_results(asked, designs, origin) == NO_ROW) & (asked.dropped == 0)
    return tuple(asked.id[waiting].tolist())


def _where_lost(names: Sequence[str], batches: Sequence[Batch]) -> str:
    lost = [batch.results.outcome == NUMERICAL_FAILURE for batch in batches]
    if not any(one.any() for one in lost):
        return ""
    return where_lost(names, np.concatenate([batch.designs for batch in batches]), np.concatenate(lost))


def _counts(outcome: NDArray[np.int8], outcomes: int) -> NDArray[np.int64]:
    answered = outcome[outcome != NUMERICAL_FAILURE]
    return np.append(np.bincount(answered, minlength=outcomes), len(outcome) - len(answered))
