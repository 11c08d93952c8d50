"""The paper's published results, and what its Table 2 implies about its sample.

The numbers are from its Table 2 and section 3, in the order of its six features.
"""

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.optimize import brentq

from activefail.seismic.bearing.design import GRAVITY, TABLE_1
from activefail.seismic.features import PAPER_FEATURES, paper_features
from activefail.space.space import Array

TABLE_2: tuple[tuple[str, float], ...] = (
    ("0.0004 to 1.112", 0.14),
    ("0.5 to 22", 1.50),
    ("0.025 to 1.2", 0.12),
    ("0.33 to 1.3", 0.68),
    ("0.05 to 0.2", 0.13),
    ("0.30 to 102.05", 6.32),
)
"""Range and median of the six features."""

P_VALUES = {
    "impact": (0.012, 0.792, 0.028, 0.689, 0.204, 0.755),
    "failure": (0.011, 0.004, 7e-7, 0.20, 0.52, 0.24),
}
"""Wald p-values of logistic regression for the six features."""

LOGISTIC = {"impact": 0.98, "failure": 0.92}
"""In-sample accuracy of logistic regression."""

HELD_OUT = 0.97
"""Accuracy for failure of the Gaussian process on the held-out quarter."""

GAIN = HELD_OUT - LOGISTIC["failure"]
"""Held-out accuracy of the process minus in-sample accuracy of logistic regression."""

AMPLITUDE, SLIDER_HEIGHT = TABLE_1.names.index("A_p"), TABLE_1.names.index("h_sl_ratio")


@dataclass(frozen=True)
class Table2Row:
    """One feature over draws, (draws,) each, in the units that the paper seems to have used.

    Attributes:
        name: of the feature.
        factor: from SI units to the paper's units.
        low, high, median: of each draw, in the paper's units.
        attainable: least and largest value over Table 1, in the paper's units.
        tilted: medians of the `tilted` draws, in the paper's units.
    """

    name: str
    factor: float
    low: Array
    high: Array
    median: Array
    attainable: tuple[float, float]
    tilted: Array


def table_2(X: Array) -> list[Table2Row]:
    """Our version of the paper's Table 2 over draws, (draws, 250, 9).

    The paper's D_ratio is consistent with a pulse displacement A_p·(T_p/2π)² with A_p in g, without the factor 9.81,
    and its k_norm with that displacement in millimetres. Such constant factors do not affect a classifier.
    """
    # k_norm is proportional to displacement^-½.
    factor = np.array([1.0 / GRAVITY, 1.0, 1.0, 1.0, 1.0, np.sqrt(GRAVITY / 1000.0)])
    F = factor * paper_features(X.reshape(-1, TABLE_1.dimension)).reshape(*X.shape[:2], -1)
    # Features are monotone in every variable, so their extremes are at corners of the design space.
    corners = factor * paper_features(TABLE_1.from_unit(np.array(list(product((0.0, 1.0), repeat=TABLE_1.dimension)))))
    tilted_features = factor * paper_features(tilted(X).reshape(-1, TABLE_1.dimension)).reshape(F.shape)
    return [
        Table2Row(
            name,
            float(factor[i]),
            F[..., i].min(axis=1),
            F[..., i].max(axis=1),
            np.median(F[..., i], axis=1),
            (float(corners[:, i].min()), float(corners[:, i].max())),
            np.median(tilted_features[..., i], axis=1),
        )
        for i, name in enumerate(PAPER_FEATURES)
    ]


def _measure() -> Array:
    """A fixed Sobol' sample of the design measure, (2^15, 9)."""
    return TABLE_1.sobol(2**15, np.random.default_rng(0))


@cache
def _tilts() -> tuple[float, float]:
    """Powers of the unit variables of A_p and h_sl/D_sl that give μ/A_p and h_sl/D_sl the paper's medians."""
    unit = TABLE_1.to_unit(_measure())

    def excess(power: float) -> float:
        moved = unit.copy()
        moved[:, AMPLITUDE] **= power
        return float(np.median(paper_features(TABLE_1.from_unit(moved))[:, 2])) - TABLE_2[2][1]

    h_sl = TABLE_1.parameters[SLIDER_HEIGHT]
    share = (TABLE_2[3][1] - h_sl.low) / (h_sl.high - h_sl.low)
    return float(brentq(excess, 0.05, 1.0)), float(np.log(share) / np.log(0.5))


def tilted(X: Array) -> Array:
    """Designs, (..., 9), transformed so that μ/A_p and h_sl/D_sl have the medians of the paper's Table 2.

    A_p and h_sl/D_sl, scaled to 0…1, are each raised to a power: stronger pulses and flatter sliders in the same
    ranges.
    """
    unit = TABLE_1.to_unit(X)
    for column, power in zip((AMPLITUDE, SLIDER_HEIGHT), _tilts(), strict=True):
        unit[..., column] **= power
    return TABLE_1.from_unit(unit)
