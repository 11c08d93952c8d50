"""A summary of a campaign from its record, without importing the machine learning libraries."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.sections import (
    CommandSimulatorSettings,
    ExpressionFeaturesSettings,
    PythonFeaturesSettings,
    PythonSimulatorSettings,
    Variable,
)
from activefail.campaign.settings import CampaignSettings
from activefail.findings.lost import where_lost
from activefail.loop.history import History
from activefail.record.asked import Asked
from activefail.record.batch import GIVEN, Schema
from activefail.shares import percent
from activefail.verification.unseen import unseen_outcomes, unseen_warning
from activefail.visible import visible

_IDS_SHOWN = 20
"""Most ids of designs in flight that `status` lists."""


def simulator_in_words(settings: CampaignSettings) -> str:
    """The simulator's name, "module:function", the command, or "elsewhere"."""
    match settings.simulator:
        case PythonSimulatorSettings(python=name) | CommandSimulatorSettings(command=name) | str(name):
            return visible(name)
        case _:
            return "elsewhere"


def features_in_words(settings: CampaignSettings) -> str:
    """The features' name; or "variables", if included, with "module:function" or the names of expressions."""
    match settings.classifier.features:
        case str(name):
            return name
        case PythonFeaturesSettings(python=reference, variables=included):
            names = [reference]
        case ExpressionFeaturesSettings(expressions=expressions, variables=included):
            names = list(expressions)
    return visible(", ".join((["variables"] if included else []) + names))


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
        elsewhere: how many of them are simulated elsewhere.
        margins: names of the margins.
        corrected: number of corrections.
        lost: where runs gave no result; empty if all gave one.
    """

    settings: CampaignSettings
    outcomes: tuple[str, ...]
    iteration: int
    initial: NDArray[np.int64]
    chosen: NDArray[np.int64]
    given: NDArray[np.int64]
    in_flight: tuple[int, ...] = ()
    margins: tuple[str, ...] = ()
    corrected: int = 0
    lost: str = ""
    elsewhere: int = 0

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
            f"the {visible(name)} boundary" + (f" ({percent(share, 0)})" if share < 1.0 else "")
            for name, share in settings.acquisition.boundaries.items()
        )
        done = f"{self.done} of {settings.sampling.budget} simulations"
        if self.done > settings.sampling.budget:
            done = f"{self.done} simulations, {settings.sampling.budget} planned"
        names = (*self.outcomes, "numerical failures")
        variables = sum(isinstance(one, Variable) for one in settings.space.values())
        return [
            ("simulator", f"{simulator_in_words(settings)}, {variables} variables, seed {settings.seed}"),
            (
                "learner",
                f"{settings.classifier.kernel} on {features_in_words(settings)} features, "
                f"{settings.acquisition.criterion} at {targets}",
            ),
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
    def of(cls, settings: CampaignSettings, schema: Schema, history: History, asked: Asked, corrected: int = 0) -> Self:
        """The summary of a campaign's simulations and the designs that were handed out.

        Args:
            settings: of the campaign.
            schema, history, asked: of the record.
            corrected: number of its corrections.
        """
        flight, outcomes = asked.in_flight(history.id), len(schema.outcomes)
        initial, given = history.initial, history.origin == GIVEN
        return cls(
            settings,
            _shown(schema.outcomes),
            history.last_iteration,
            _counts(history[initial], outcomes),
            _counts(history[~initial & ~given], outcomes),
            _counts(history[given], outcomes),
            tuple(flight.id.tolist()),
            schema.margins,
            corrected,
            where_lost(schema.variables, history.designs, ~history.answered),
            int((flight.loop == 0).sum()),
        )


def _shown(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(map(visible, names))


def _counts(history: History, outcomes: int) -> NDArray[np.int64]:
    """Simulations by outcome, then the numerical failures, (outcomes + 1,)."""
    return np.append(history.counts(outcomes), len(history.failed_designs))
