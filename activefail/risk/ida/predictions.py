"""Outcomes at the levels of records as predicted without a simulation: by a classifier, or by the reduced models."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import GRAVITY, TABLE_1, Model
from activefail.bearing.outcome import OUTCOMES
from activefail.bearing.record_features import RECORD_FEATURES, record_features
from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.space import Array
from activefail.surrogate.classifier import Classifier


@dataclass(frozen=True)
class Agreement:
    """Predicted outcomes beside the simulated ones of the same levels.

    Attributes:
        both_fail, both_survive: levels with the same outcome.
        missed: failures that were not predicted.
        false: predicted failures that did not occur.
    """

    both_fail: int
    both_survive: int
    missed: int
    false: int

    @classmethod
    def of(cls, fails: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> "Agreement":
        """Of simulated and predicted failures, (n,) each."""
        return cls(
            int((fails & predicted).sum()),
            int((~fails & ~predicted).sum()),
            int((fails & ~predicted).sum()),
            int((~fails & predicted).sum()),
        )

    @property
    def same(self) -> int:
        """Levels with the same outcome."""
        return self.both_fail + self.both_survive

    @property
    def levels(self) -> int:
        """All levels."""
        return self.same + self.missed + self.false

    def as_json(self) -> dict[str, Any]:
        """The counts by name."""
        return {
            "both_fail": self.both_fail,
            "both_survive": self.both_survive,
            "missed": self.missed,
            "false": self.false,
        }


@dataclass(frozen=True)
class Prediction:
    """What predicts the outcomes, and how often it is right.

    Attributes:
        title: for a line on the terminal.
        by: what predicts.
        levels: predicted and simulated outcomes.
        outside: share of the levels outside the campaign's design space; None for a prediction without one.
    """

    title: str
    by: str
    levels: Agreement
    outside: float | None = None

    @property
    def text(self) -> str:
        """The counts in words."""
        counts = self.levels
        text = (
            f"the {self.by} predicts {counts.same} of {counts.levels} outcomes correctly; it misses {counts.missed} "
            f"failures, and predicts {counts.false} that did not happen"
        )
        if self.outside is None:
            return text
        return f"{text}; {100 * self.outside:.0f} % of these pulses lie outside the campaign's design space"


def predicted_by_reduced_model(
    bearing: Array,
    motions: Sequence[Accelerogram],
    which: NDArray[np.intp],
    factors: Array,
    severity: int,
    model: Model | None = None,
) -> NDArray[np.bool_]:
    """Whether the reduced models expect the outcome under scaled records, (n,): m* > 0 for failure, v* > 0 for impact.

    Args:
        bearing: (7,).
        motions: the records.
        which, factors: (n,) record and factor of each level.
        severity: of the outcome.
        model: as for `record_features`.
    """
    features = record_features(np.tile(bearing, (len(which), 1)), motions, which, factors, model)
    column = RECORD_FEATURES.index("m*" if severity == len(OUTCOMES) - 1 else "v*")
    return np.asarray(features[:, column] > 0.0)


class Learned(Protocol):
    """A campaign and what was learned in it: a `Run`."""

    @property
    def campaign(self) -> Campaign:
        """With its settings."""
        ...

    @property
    def classifier(self) -> Classifier:
        """Learned from its simulations."""
        ...


@dataclass(frozen=True)
class Surrogate:
    """The classifier of a campaign under pulses, asked about one bearing.

    Attributes:
        campaign, classifier: of a run folder.
        severity: of the outcome that is sought.

    """

    campaign: Campaign
    classifier: Classifier
    severity: int

    @classmethod
    def of(cls, run: Learned, severity: int, model: Model) -> Self:
        """Of what a run folder has learned.

        Raises:
            InputError: if its campaign is not one of a bearing under a pulse with this model.
        """
        if run.campaign.settings.bearing.model() != model:
            raise InputError(
                "--campaign: its [bearing] settings differ from this command's options. Give this command the same "
                "values."
            )
        space = run.campaign.space
        known = (*space.names, *space.fixed)
        if set(known) != set(TABLE_1.names) or not {"T_p", "A_p"} <= set(space.names):
            raise InputError(
                "--campaign: must be a campaign under pulses, with the variables "
                f"{', '.join(TABLE_1.names)}; got {', '.join(known)}."
            )
        outcomes = tuple(run.campaign.simulator.outcomes)
        if outcomes != OUTCOMES:
            raise InputError(f"--campaign: must have the outcomes {', '.join(OUTCOMES)}, got {', '.join(outcomes)}.")
        return cls(run.campaign, run.classifier, severity)

    def under_pulses(self, bearing: Array, period: Array, amplitude: Array) -> tuple[NDArray[np.bool_], float]:
        """Whether the outcome, or a worse one, is predicted under pulses, (n,); the share outside the design space.

        Args:
            bearing: (7,).
            period: (n,) T_p [s].
            amplitude: (n,) A_p [m/s2], of either sign: the model is symmetric.

        Raises:
            InputError: if the campaign fixes one of the bearing's values to another one.
        """
        space = self.campaign.space
        values = dict(zip(TABLE_1.names, bearing.tolist(), strict=False))
        for name, fixed in space.fixed.items():
            if values[name] != fixed:
                raise InputError(f"--campaign: fixes {name} to {fixed:g}, but the bearing has {values[name]:g}.")
        columns = values | {"T_p": period, "A_p": np.abs(amplitude) / GRAVITY}
        X = np.column_stack([np.broadcast_to(columns[name], len(period)) for name in space.names])
        beyond = self.classifier.probabilities(X)[:, self.severity :].sum(axis=1)
        return beyond >= 0.5, float(np.mean(~space.contains(X)))
