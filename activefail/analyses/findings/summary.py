"""A summary of a campaign from its record, without importing the machine learning libraries."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.sections import (
    CommandSimulatorSettings,
    ExpressionFeaturesSettings,
    PythonFeaturesSettings,
    PythonSimulatorSettings,
)
from activefail.campaign.settings import CampaignSettings
from activefail.campaign.variables import FixedVariable
from activefail.estimates.confidence_bounds import unseen_outcomes, upper_bound
from activefail.loop.history import History
from activefail.record.asked import Asked
from activefail.record.batch import Schema
from activefail.space.shares import percent
from activefail.space.space import Array
from activefail.text.numerals import counted, outcomes_in_words
from activefail.visible import visible

if TYPE_CHECKING:
    from activefail.session.session import Session

_IDS_SHOWN = 20
"""Most ids of designs in flight that `status` lists."""

_CONFIDENCE = 0.9
"""One-sided confidence of the bound on an unseen outcome's probability."""

_TELLING = 3.0
"""Least difference between the mean ranks of lost and other runs, in standard errors, that is no chance."""


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


def where_lost(
    names: Sequence[str], designs: Array, lost: NDArray[np.bool_], without_order: Collection[str] = ()
) -> str:
    """How many runs gave no result, and which variable tells them best from the others; empty if all gave one.

    Args:
        names: of the variables.
        designs: (n, d) of the simulations.
        lost: (n,) which gave no result.
        without_order: names of variables with choices, which are left out.
    """
    if not lost.any():
        return ""
    text = f"{int(lost.sum())} of {len(lost)} runs gave no result"
    columns = [column for column, name in enumerate(names) if name not in without_order]
    if lost.all() or not columns:
        return text
    names, designs = [names[column] for column in columns], designs[:, columns]
    ranks = np.argsort(np.argsort(designs, axis=0), axis=0) / max(1, len(lost) - 1)
    apart = ranks[lost].mean(axis=0) - ranks[~lost].mean(axis=0)
    column = int(np.argmax(np.abs(apart)))
    # A rank is uniform, with a variance of 1/12.
    error = np.sqrt((1.0 / lost.sum() + 1.0 / (~lost).sum()) / 12.0)
    if abs(apart[column]) < _TELLING * error:
        return f"{text}; no single variable shows where; simulator.lost of a new campaign says what that means"
    of_lost, of_others = (float(np.median(designs[rows, column])) for rows in (lost, ~lost))
    return (
        f"{text}, most of them at {'low' if apart[column] < 0.0 else 'high'} {visible(names[column])} (median "
        f"{of_lost:.3g}, of the others {of_others:.3g}); simulator.lost of a new campaign says what that means"
    )


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
        corrected: number of corrections.
        flag: the only margin, if all its values are 0 or 1, and both occur; otherwise empty.
    """

    settings: CampaignSettings
    outcomes: tuple[str, ...]
    iteration: int
    initial: NDArray[np.int64]
    chosen: NDArray[np.int64]
    given: NDArray[np.int64]
    in_flight: tuple[int, ...]
    elsewhere: int
    corrected: int = 0
    flag: str = ""

    @property
    def counts(self) -> NDArray[np.int64]:
        """All recorded simulations by outcome, numerical failures last."""
        return self.initial + self.chosen + self.given

    @property
    def done(self) -> int:
        """Number of recorded simulations that count towards the budget."""
        return int((self.initial + self.chosen).sum())

    @property
    def origins(self) -> dict[str, NDArray[np.int64]]:
        """The simulations by origin, and all."""
        return {"initial": self.initial, "chosen": self.chosen, "given": self.given, "all": self.counts}

    @property
    def learner(self) -> str:
        """What is learned from outcomes, and where, in words."""
        settings = self.settings
        targets = " and ".join(
            f"the {visible(name)} boundary" + (f" ({percent(share, 0)})" if share < 1.0 else "")
            for name, share in settings.acquisition.boundaries.items()
        )
        features = features_in_words(settings)
        return f"{settings.classifier.name} on {features} features, {settings.acquisition.criterion} at {targets}"

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Titles and texts that `activefail status` prints."""
        settings = self.settings
        variables = sum(not isinstance(one, FixedVariable) for one in settings.space.values())
        done = f"{self.done} of {settings.sampling.budget} simulations"
        if self.done > settings.sampling.budget:
            done = f"{self.done} simulations, {settings.sampling.budget} planned"
        lines = [
            ("simulator", f"{simulator_in_words(settings)}, {variables} variables, seed {settings.seed}"),
            ("learner", self.learner),
            ("done", f"{done}, iteration {self.iteration}"),
        ]
        for title, counts in self.origins.items():
            if title != "given" or counts.any():
                lines.append((title, ", ".join(outcomes_in_words(counts.tolist(), self.outcomes))))
        corrected = counted(self.corrected, "correction") if self.corrected else ""
        more = [("corrected", corrected), ("in flight", self.flight_in_words)]
        return lines + [(title, text) for title, text in more if text]

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
        unseen = unseen_outcomes(self.outcomes, self.counts)
        if not (unseen and self.counts.any()):
            return ""
        # A numerical failure of the initial design may hide an unseen outcome.
        answered, unanswered = int(self.initial[:-1].sum()), int(self.initial[-1])
        bound = percent(upper_bound(unanswered, answered + unanswered, _CONFIDENCE))
        hidden = f" and {counted(unanswered, 'numerical failure')}" if unanswered else ""
        names, is_one = " or ".join(unseen), len(unseen) == 1
        return (
            f"None of the campaign's {self.counts[:-1].sum()} simulations ended in {names}. "
            f"{'Its probability' if is_one else 'The probability of each'} over the design space may be as large as "
            f"{bound} ({100 * _CONFIDENCE:g} % confidence, from {answered} initial designs without "
            f"{'it' if is_one else 'them'}{hidden}). Until one of them does, no classifier can know where {names} "
            "begins."
        )

    @property
    def flag_warning(self) -> str:
        """The warning about a margin that may be a flag, whose 1 would mean safety; empty if there is none."""
        return self.flag and (
            f"All margins {visible(self.flag)} are 0 or 1, like a flag. A margin at its level or below fails, so 0 is "
            "not safety; return the outcome in place of a flag."
        )

    @classmethod
    def of_run(cls, run: "Session", history: History | None = None) -> Self:
        """The summary of an open run folder, or of its first simulations."""
        return cls.of(run.settings, run.campaign.schema, run.history if history is None else history, run.store.asked)

    @classmethod
    def of(cls, settings: CampaignSettings, schema: Schema, history: History, asked: Asked, corrected: int = 0) -> Self:
        """The summary of a campaign's simulations and the designs that were handed out.

        Args:
            settings: of the campaign.
            schema, history, asked: of the record.
            corrected: number of its corrections.
        """
        flight, outcomes = asked.in_flight(history.id), len(schema.outcomes)
        is_flag = len(schema.margins) == 1 and {*history.margins[history.outcome >= 0].ravel().tolist()} == {0.0, 1.0}
        return cls(
            settings,
            tuple(map(visible, schema.outcomes)),
            history.last_iteration,
            _counts(history[history.initial], outcomes),
            _counts(history[history.chosen], outcomes),
            _counts(history[history.given], outcomes),
            tuple(flight.id.tolist()),
            int((flight.loop == 0).sum()),
            corrected,
            schema.margins[0] if is_flag else "",
        )


def _counts(history: History, outcomes: int) -> NDArray[np.int64]:
    """Simulations by outcome, then the numerical failures, (outcomes + 1,)."""
    return np.append(history.counts(outcomes), len(history.failed_designs))
