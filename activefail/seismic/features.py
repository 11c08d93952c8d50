"""Features of a bearing: the paper's six, those of the sliding block, and those of the reduced collision model."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from activefail.errors import InputError
from activefail.learning.features import (
    FeatureMap,
    feature_map,
    joined,
    logarithms,
    quantities_of,
    scaled,
    variable_columns,
)
from activefail.seismic.bearing.collision import COLLISION_FEATURES, collision_features
from activefail.seismic.bearing.design import GRAVITY, TABLE_1, Model
from activefail.seismic.bearing.record_features import RECORD_FEATURES, record_features
from activefail.seismic.bearing.sliding import SLIDING_FEATURES, sliding_features
from activefail.seismic.quantities import QUANTITIES
from activefail.space.parameter import Payload
from activefail.space.space import Array, DesignSpace

PAPER_FEATURES = ("D_ratio", "T_b/T_p", "mu/A_p", "h_sl/D_sl", "h_rim/D_sl", "k_norm")
"""Names of the paper's features, in the order of its section 3.1."""

PAPER_LOGARITHMIC = (True, True, True, False, False, True)
"""Whether each enters as its logarithm: the ratios that span decades over Table 1."""


def paper_features(X: Array) -> Array:
    """The paper's six features (section 3.1) of designs in Table 1's order and units, (n, 9) -> (n, 6), SI units."""
    T_b, mu, D_tot, h_sl_ratio, h_rim_ratio, p, k, T_p, A_p = np.asarray(X).T
    pulse_displacement = A_p * GRAVITY * (T_p / (2.0 * np.pi)) ** 2
    stiffness = k / (p * 1e6 * pulse_displacement**0.5)
    return np.column_stack([pulse_displacement / D_tot, T_b / T_p, mu / A_p, h_sl_ratio, h_rim_ratio, stiffness])


_LEAST_PART = 64
"""Fewest designs per thread: computing their features takes about 10 ms."""


def _on_all_cores(function: Callable[[Array], Array], X: Array) -> Array:
    """function(X) in parallel on parts of X, for compiled kernels that hold no lock and treat rows independently."""
    cores = os.cpu_count() or 1
    if cores == 1 or len(X) < 2 * _LEAST_PART:
        return function(X)
    parts = np.array_split(X, min(len(X) // _LEAST_PART, 4 * cores))
    with ThreadPoolExecutor(cores) as pool:
        return np.concatenate(list(pool.map(function, parts)))


def _check_bearing(features: str, space: DesignSpace, names: Sequence[str] = TABLE_1.names) -> None:
    for name in names:
        if name not in space.known:
            raise InputError(
                f"classifier.features: {features!r} requires the variables of a bearing, but space lacks the variable "
                f"{name!r}; its variables are {', '.join(space.known)}."
            )


def of_paper(space: DesignSpace, _model: Model | None) -> FeatureMap:
    """The paper's features on a design space.

    Raises:
        InputError: if it lacks a variable of the paper, or one may not be positive.
    """
    _check_bearing("paper", space)
    if min(space.range_of(name)[0] for name in TABLE_1.names) <= 0.0:
        raise InputError("The paper's features require positive variables, but a lower bound is not positive.")
    return _described(
        scaled(PAPER_FEATURES, lambda X: paper_features(space.table(X, TABLE_1.names)), space, PAPER_LOGARITHMIC)
    )


def _described(features: FeatureMap) -> FeatureMap:
    return replace(features, quantities=QUANTITIES)


def of_sliding(space: DesignSpace, model: Model | None) -> FeatureMap:
    """The variables and the sliding block's features.

    Raises:
        InputError: if the space lacks a variable of a bearing or a pulse.
    """
    _check_bearing("sliding", space)
    return _with_physics(SLIDING_FEATURES, lambda table: sliding_features(table, model), space)


def of_collision(space: DesignSpace, model: Model | None) -> FeatureMap:
    """The same and the features of the reduced collision model; under records their counterparts.

    Raises:
        InputError: if the space lacks a variable of a bearing, or of a pulse where it has no records.
    """
    for column, one in enumerate(space.parameters):
        if one.payload is not None:
            return _under_records(space, one.payload, column, model)
    _check_bearing("collision", space)
    return _with_physics(
        (*SLIDING_FEATURES, *COLLISION_FEATURES),
        lambda table: np.column_stack([sliding_features(table, model), collision_features(table, model)]),
        space,
    )


def _with_physics(names: tuple[str, ...], physics: Callable[[Array], Array], space: DesignSpace) -> FeatureMap:
    """The variables and features of the physics, a function of designs in Table 1's order and units."""
    return _described(joined(names, lambda X: _on_all_cores(physics, space.table(X, TABLE_1.names)), space))


def _under_records(space: DesignSpace, payload: Payload, column: int, model: Model | None) -> FeatureMap:
    """The other variables, and the features of the bearing's cheap models under the scaled records of a variable."""
    of_bearing = TABLE_1.names[:7]
    _check_bearing("collision", space, of_bearing)
    others = DesignSpace((*space.parameters[:column], *space.parameters[column + 1 :]), space.fixed)

    def raw(X: Array) -> Array:
        # A question about one bearing repeats few designs.
        rows, place = np.unique(X, axis=0, return_inverse=True)
        which = rows[:, column].astype(np.intp)
        motions = [record.motion for record in payload()]
        factors = payload.factors(which, quantities_of(space, rows))
        physics = record_features(space.table(rows, of_bearing), motions, which, factors, model)
        return np.column_stack([variable_columns(others, np.delete(X, column, axis=1)), physics[place]])

    names = (*feature_map("design", others, check=False).names, *RECORD_FEATURES)
    return _described(scaled(names, raw, space, logarithms(others)))
