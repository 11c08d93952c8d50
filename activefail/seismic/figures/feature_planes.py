"""Planes of the paper's features: the designs that have them, and predictions at them."""

import numpy as np
from numpy.typing import NDArray

from activefail.analyses.findings.results import Findings, Prediction, predict
from activefail.pages.figures.outcome_planes import Coordinates
from activefail.seismic.bearing.design import GRAVITY, TABLE_1
from activefail.seismic.features import PAPER_FEATURES, paper_features
from activefail.seismic.figures.paper_planes import FIGURES, SLICE
from activefail.seismic.quantities import QUANTITIES
from activefail.space.space import Array

LOGARITHMIC = (0, 1, 2, 5, 6, 7, 8)
"""Columns of Table 1 in whose logarithms the log ratios of the paper are linear: T_b, mu, D_tot, p, k, T_p, A_p."""

_RATIOS = (0, 1, 2, 5)
EXPONENTS = np.array(
    [
        [0.0, 0.0, -1.0, 0.0, 0.0, 2.0, 1.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        [0.0, 0.0, 0.0, -1.0, 1.0, -1.0, -0.5],
    ]
)
"""Exponents of these columns in the ratios D_ratio, T_b/T_p, mu/A_p and k_norm, one row each."""

_PULSE = np.log(GRAVITY / (2.0 * np.pi) ** 2)
_CONSTANTS = np.array([_PULSE, 0.0, 0.0, -np.log(1e6) - 0.5 * _PULSE])


def designs_with(F: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Designs with given paper features, (n, 6) -> (n, 9), near the middle of a box, and whether the box has one, (n,).

    Six features leave three of nine variables free. The four ratios are linear in logarithms, so alternating
    projections between them and the box, from its middle, converge to a common point if there is one.

    Args:
        F: the features, all positive.
        low, high: (9,) the box, in Table 1's order and units.
    """
    columns = list(LOGARITHMIC)
    lower, upper = np.log(low[columns]), np.log(high[columns])
    half = 0.5 * (upper - lower)
    # In units of the ranges, so that all variables move alike.
    A = EXPONENTS * half
    inverse = np.linalg.pinv(A)
    b = np.log(F[:, list(_RATIOS)]) - _CONSTANTS - EXPONENTS @ (0.5 * (lower + upper))
    z = np.zeros((len(F), len(columns)))
    for _ in range(150):
        z = np.clip(z, -1.0, 1.0)
        z += (b - z @ A.T) @ inverse.T
    z = np.clip(z, -1.0, 1.0)
    residual = np.abs(b - z @ A.T).max(axis=1)
    X = np.empty((len(F), TABLE_1.dimension))
    X[:, columns] = np.exp(0.5 * (lower + upper) + half * z)
    X[:, 3], X[:, 4] = F[:, 3], F[:, 4]
    inside = np.all((F[:, 3:5] >= low[3:5]) & (F[:, 3:5] <= high[3:5]), axis=1)
    # Rounding of logarithm and exponential can leave the box.
    return np.clip(X, low, high), inside & (residual < 0.02)


def coordinates(findings: Findings) -> Coordinates | None:
    """The paper's planes, with its slices, for a campaign over the nine variables of Table 1; else None."""
    campaign, space = findings.campaign, findings.campaign.space
    if set(space.names) != set(TABLE_1.names) or not np.all(space.low > 0.0):
        return None
    columns = [space.names.index(name) for name in TABLE_1.names]
    F = paper_features(findings.history.designs[:, columns])

    def at(rows: Array) -> Prediction:
        table, exists = designs_with(rows, space.low[columns], space.high[columns])
        X = np.empty_like(table)
        X[:, columns] = table
        return predict(campaign, findings.classifier, X, exists)

    return Coordinates(
        [QUANTITIES[name] for name in PAPER_FEATURES],
        F,
        np.median(F, axis=0),
        at,
        [one.plane for one in FIGURES],
        lambda _, value: SLICE * value,
        are_features=True,
    )
