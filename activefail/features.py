"""What the classifier sees of a design: the paper's six features or the variables themselves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from activefail.bearing.design import GRAVITY, TABLE_1
from activefail.errors import InputError
from activefail.space import Array, DesignSpace

FeatureSet = Literal["paper", "design"]

PAPER_FEATURES = ("D_ratio", "T_b/T_p", "mu/A_p", "h_sl/D_sl", "h_rim/D_sl", "k_norm")
"""Names of the paper's features, in the order of its section 3.1."""


def _paper_formula(columns: Sequence[Any]) -> list[Any]:
    T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k, T_p, A_p = columns
    pulse_displacement = A_p * GRAVITY * (T_p / (2.0 * np.pi)) ** 2
    return [
        pulse_displacement / D_tot,
        T_b / T_p,
        mu / A_p,
        h_sl_ratio,
        h_rim_ratio,
        k / (p * 1e6 * pulse_displacement**0.5),
    ]


def paper_features(X: Array) -> Array:
    """The paper's six features (section 3.1) of designs in Table 1's order and units, (n, 9) -> (n, 6), SI units."""
    return np.column_stack(_paper_formula(list(np.asarray(X).T)))


@dataclass(frozen=True)
class FeatureMap:
    """From designs to what the classifier sees, in standard units over the design space.

    Attributes:
        names: of the features.
        raw: the features of designs, (n, d) -> (n, m), before scaling.
        logarithmic: (m,) whether a feature enters by its logarithm.
        center: (m,) subtracted from the (logarithms of) features.
        spread: (m,) then divided by.
        formula: `raw` as arithmetic on the columns of a design array of any library, list of d -> list of m, which
            automatic differentiation follows; None where there is no such formula.
    """

    names: tuple[str, ...]
    raw: Callable[[Array], Array]
    logarithmic: np.ndarray
    center: Array
    spread: Array
    formula: Callable[[Sequence[Any]], list[Any]] | None = None

    def __call__(self, X: Array) -> Array:
        """Scaled features of designs, (n, d) -> (n, m)."""
        return (self._transformed(X) - self.center) / self.spread

    def _transformed(self, X: Array) -> Array:
        F = self.raw(X)
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, F, 1.0)), F)


def feature_map(name: FeatureSet, space: DesignSpace) -> FeatureMap:
    """The named feature set on a design space, scaled by its mean and standard deviation over the design measure.

    Scaling by the design measure, not by the training points, keeps the features of a design the same all through a
    campaign. Ratios enter by their logarithm: over Table 1 they span up to three decades.

    Raises:
        InputError: if the paper's features are asked of a space without the paper's nine variables.
    """
    match name:
        case "design":
            names, logarithmic = space.names, np.zeros(space.dimension, dtype=bool)

            def raw(X: Array) -> Array:
                return np.asarray(X)

            def formula(columns: Sequence[Any]) -> list[Any]:
                return list(columns)

        case "paper":
            own = space.select(TABLE_1.names)
            if np.any(space.low[own] <= 0.0):
                raise InputError("The paper's features need positive variables; a lower bound of the space is not.")
            names, logarithmic = PAPER_FEATURES, np.array([True, True, True, False, False, True])

            def raw(X: Array) -> Array:
                return paper_features(np.asarray(X)[:, own])

            def formula(columns: Sequence[Any]) -> list[Any]:
                return _paper_formula([columns[i] for i in own])

        case _:
            raise InputError(f"`features` must be paper or design, got {name!r}.")

    unscaled = FeatureMap(names, raw, logarithmic, np.zeros(len(names)), np.ones(len(names)))
    # A fixed sample: the scaling is part of the feature set's definition, not a random choice of a campaign.
    F = unscaled(space.sobol(4096, np.random.default_rng(0)))
    return FeatureMap(names, raw, logarithmic, F.mean(axis=0), F.std(axis=0), formula)
