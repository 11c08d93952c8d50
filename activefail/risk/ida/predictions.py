"""Outcomes at the levels of records as predicted without a simulation: by a classifier, or by the reduced models."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from activefail.bearing.accelerogram import Accelerogram
from activefail.bearing.design import GRAVITY, TABLE_1, Model
from activefail.bearing.outcome import OUTCOMES
from activefail.bearing.record_features import RECORD_FEATURES, record_features
from activefail.campaign.assembly import Campaign
from activefail.errors import InputError
from activefail.space import Array

if TYPE_CHECKING:
    from activefail.surrogate.classifier import Classifier


@dataclass(frozen=True)
class Agreement:
    """Numbers of levels by their predicted and their simulated outcome."""

    both_fail: int
    both_survive: int
    missed: int  # failures that were not predicted
    false: int  # predicted failures that did not occur

    @classmethod
    def of(cls, fails: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> "Agreement":
        """Of simulated and predicted failures, (n,) each."""
        pairs = (fails & predicted, ~fails & ~predicted, fails & ~predicted, ~fails & predicted)
        return cls(*(int(pair.sum()) for pair in pairs))

    @property
    def same(self) -> int:
        """Levels with the same outcome."""
        return self.both_fail + self.both_survive

    @property
    def levels(self) -> int:
        """All levels."""
        return self.same + self.missed + self.false


@dataclass(frozen=True)
class Prediction:
    """What predicts the outcomes, and how often it is right."""

    by: str
    levels: Agreement
    outside: float | None = None  # share of the levels outside the campaign's design space, if there is one

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
    model: Model,
) -> NDArray[np.bool_]:
    """Whether the reduced models expect the outcome under scaled records, (n,): m* > 0 for failure, v* > 0 for impact.

    Args:
        bearing: (7,).
        which, factors: (n,) record and factor of each level.
        motions, severity, model: the records, the severity of the outcome, and as for `record_features`.
    """
    features = record_features(np.tile(bearing, (len(which), 1)), motions, which, factors, model)
    column = RECORD_FEATURES.index("m*" if severity == len(OUTCOMES) - 1 else "v*")
    return np.asarray(features[:, column] > 0.0)


def check_campaign(campaign: Campaign, values: Mapping[str, float], model: Model) -> None:
    """Check that a campaign is one of this bearing under pulses.

    Raises:
        InputError: naming what differs.
    """
    if campaign.settings.bearing.model() != model:
        raise InputError(
            "--campaign: its [bearing] settings differ from this command's options. Give this command the same values."
        )
    space, outcomes = campaign.space, tuple(campaign.simulator.outcomes)
    known = (*space.names, *space.fixed)
    if set(known) != set(TABLE_1.names) or not {"T_p", "A_p"} <= set(space.names) or outcomes != OUTCOMES:
        raise InputError(
            f"--campaign: must be a campaign under pulses, with the variables {', '.join(TABLE_1.names)} and the "
            f"outcomes {', '.join(OUTCOMES)}; got {', '.join(known)} and {', '.join(outcomes)}."
        )
    for name, fixed in space.fixed.items():
        if values[name] != fixed:
            raise InputError(f"--campaign: fixes {name} to {fixed:g}, but the bearing has {values[name]:g}.")


def predicted_by_classifier(
    campaign: Campaign,
    classifier: "Classifier",
    values: Mapping[str, float],
    period: Array,
    amplitude: Array,
    severity: int,
) -> tuple[NDArray[np.bool_], float]:
    """Whether an outcome, or a worse one, is predicted under pulses, (n,); the share outside the design space.

    Args:
        campaign, classifier: under pulses.
        values: of the bearing's variables.
        period, amplitude: (n,) T_p [s] and A_p [m/s2], of either sign: the model is symmetric.
        severity: of the outcome.
    """
    space = campaign.space
    columns: dict[str, Any] = {**values, "T_p": period, "A_p": np.abs(amplitude) / GRAVITY}
    X = np.column_stack([np.broadcast_to(columns[name], len(period)) for name in space.names])
    beyond = classifier.probabilities(X)[:, severity:].sum(axis=1)
    return beyond >= 0.5, float(np.mean(~space.contains(X)))
