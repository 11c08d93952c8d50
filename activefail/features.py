"""What the classifier sees of a design: the paper's six features, the variables themselves, or physics beside them."""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from activefail.bearing.collision import COLLISION_FEATURES, collision_features
from activefail.bearing.design import GRAVITY, TABLE_1, Model
from activefail.bearing.sliding import SLIDING_FEATURES, sliding_features
from activefail.errors import InputError, description_of, place_of
from activefail.expressions import parse_expression
from activefail.space import Array, DesignSpace
from activefail.visible import visible

FeatureSet = Literal["paper", "design", "sliding", "collision"]

PAPER_FEATURES = ("D_ratio", "T_b/T_p", "mu/A_p", "h_sl/D_sl", "h_rim/D_sl", "k_norm")
"""Names of the paper's features, in the order of its section 3.1."""

PAPER_LOGARITHMIC = (True, True, True, False, False, True)
"""Which of them enter by their logarithm: the ratios that span decades over Table 1."""


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


_LEAST_PART = 64
"""Designs below which their features are not worth a thread: some 10 ms."""


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


@dataclass(frozen=True)
class OwnFeatures:
    """Features by a user's own function.

    Attributes:
        name: of the function, for the features' names and for messages.
        function: designs, (n, d) in the variables' units, and their design space -> features, (n, m). Each row depends
            on its own design alone.
        variables: whether the variables themselves come before them.
    """

    name: str
    function: Callable[[Array, DesignSpace], Array]
    variables: bool = True

    def __call__(self, X: Array, space: DesignSpace) -> Array:
        """The function's features of designs, (n, d) -> (n, m), with its answer's type and shape checked.

        Raises:
            InputError: if it raises, or they are no (n, m) numbers.
        """
        try:
            answer = self.function(X.copy(), space)
        except Exception as error:
            raise InputError(
                visible(f"classifier.features: {self.name} raised {description_of(error)}{place_of(error)}.")
            ) from error
        try:
            F = np.asarray(answer, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"classifier.features: {self.name} must return numbers: {error}.") from None
        if F.ndim != 2 or len(F) != len(X) or F.shape[1] == 0:
            raise InputError(
                f"classifier.features: {self.name} must return one row of features a design, "
                f"shape ({len(X)}, m); got shape {F.shape}."
            )
        return F


@dataclass(frozen=True)
class ExpressionFeatures:
    """Features as arithmetic on the variables and the fixed quantities.

    Attributes:
        expressions: by the features' names (`activefail.expressions`).
        variables: whether the variables themselves come before them.
    """

    expressions: Mapping[str, str]
    variables: bool = True


def _on_all_cores(function: Callable[[Array], Array], X: Array) -> Array:
    """function(X) of compiled kernels, which hold no lock and take each row for itself: X in parts, on all cores."""
    cores = os.cpu_count() or 1
    if cores == 1 or len(X) < 2 * _LEAST_PART:
        return function(X)
    parts = np.array_split(X, min(len(X) // _LEAST_PART, 4 * cores))
    with ThreadPoolExecutor(cores) as pool:
        return np.concatenate(list(pool.map(function, parts)))


def feature_map(
    features: FeatureSet | OwnFeatures | ExpressionFeatures, space: DesignSpace, model: Model | None = None
) -> FeatureMap:
    """A feature set on a design space, scaled by its mean and standard deviation over the design measure.

    Scaling by the design measure, not by the training points, keeps the features of a design the same all through a
    campaign. Ratios enter by their logarithm: over Table 1 they span up to three decades.

    Args:
        features: "paper"; "design", the variables themselves; "sliding", these and what the sliding block says;
            "collision", these and what the reduced model of the collision says; or a user's own.
            Variables with a uniform logarithm enter by it.
        space: the design space.
        model: settings of the bearing model that the sliding block and the reduced model share.

    Raises:
        InputError: if the paper's features or those of a bearing are asked of a space without the paper's nine
            variables, or if features are not finite, or constant, over the space.
    """
    if features in ("paper", "sliding", "collision"):
        for name in TABLE_1.names:
            if name not in (*space.names, *space.fixed):
                raise InputError(
                    f"classifier.features: {features!r} needs the variables of a bearing, and space lacks the variable "
                    f"{name!r}; it has {', '.join((*space.names, *space.fixed))}."
                )
    match features:
        case "design":
            return _scaled(space.names, np.asarray, space, _logarithms(space), list)

        case "paper":
            if np.any(space.table(space.low[None], TABLE_1.names) <= 0.0):
                raise InputError("The paper's features need positive variables; a lower bound of the space is not.")
            return _scaled(
                PAPER_FEATURES,
                lambda X: paper_features(space.table(X, TABLE_1.names)),
                space,
                PAPER_LOGARITHMIC,
                lambda variables: _paper_formula(space.pick(variables, TABLE_1.names)),
            )

        case "sliding":
            return _scaled(
                (*space.names, *SLIDING_FEATURES),
                lambda X: np.column_stack(
                    [X, _on_all_cores(lambda table: sliding_features(table, model), space.table(X, TABLE_1.names))]
                ),
                space,
                _logarithms(space),
            )

        case "collision":

            def physics(table: Array) -> Array:
                return np.column_stack([sliding_features(table, model), collision_features(table, model)])

            def with_collision(X: Array) -> Array:
                return np.column_stack([X, _on_all_cores(physics, space.table(X, TABLE_1.names))])

            names = (*space.names, *SLIDING_FEATURES, *COLLISION_FEATURES)
            return _scaled(names, with_collision, space, _logarithms(space))

        case OwnFeatures():
            return _own(features, space)

        case ExpressionFeatures():
            return _of_expressions(features, space)

        case _:
            raise InputError(f"`features` must be paper, design, sliding or collision, got {features!r}.")


def _own(own: OwnFeatures, space: DesignSpace) -> FeatureMap:
    width = own(space.sobol(8, np.random.default_rng(0)), space).shape[1]

    def raw(X: Array) -> Array:
        X = np.asarray(X, dtype=np.float64)
        F = own(X, space)
        if F.shape[1] != width:
            raise InputError(
                f"classifier.features: {own.name} must always return as many features; got {width}, then {F.shape[1]}."
            )
        return np.column_stack([X, F]) if own.variables else F

    names = tuple(f"{own.name}[{column}]" for column in range(width))
    if own.variables:
        scaled = _scaled((*space.names, *names), raw, space, _logarithms(space))
    else:
        scaled = _scaled(names, raw, space)
    # A function that normalises over the rows it is given would call one design by many names.
    X = space.sobol(64, np.random.default_rng(1))
    if not np.allclose(scaled(X)[:7], scaled(X[:7]), rtol=1e-9, atol=1e-9):
        raise InputError(
            f"classifier.features: {own.name} must give a design the same features whatever the designs beside it."
        )
    return scaled


def _of_expressions(given: ExpressionFeatures, space: DesignSpace) -> FeatureMap:
    known = (*space.names, *space.fixed)
    expressions = []
    for name, text in given.expressions.items():
        if name in space.names:
            raise InputError(f"classifier.features.expressions.{visible(name)}: is the name of a variable.")
        try:
            expressions.append(parse_expression(text, known))
        except ValueError as broken:
            raise InputError(visible(f"classifier.features.expressions.{name}: {broken}.")) from None

    def formula(variables: Sequence[Any]) -> list[Any]:
        quantities = dict(zip(known, space.pick(variables, known), strict=True))
        values = [expression(quantities) for expression in expressions]
        return [*variables, *values] if given.variables else values

    def raw(X: Array) -> Array:
        X = np.asarray(X, dtype=np.float64)
        with np.errstate(all="ignore"):  # what is not finite is told of with its design
            return np.column_stack([np.broadcast_to(column, len(X)) for column in formula(list(X.T))])

    names = tuple(given.expressions)
    if given.variables:
        return _scaled((*space.names, *names), raw, space, _logarithms(space), formula)
    return _scaled(names, raw, space, formula=formula)


def _logarithms(space: DesignSpace) -> tuple[bool, ...]:
    """Which variables the classifier sees by their logarithm."""
    return tuple(parameter.distribution == "log_uniform" for parameter in space.parameters)


def _scaled(
    names: tuple[str, ...],
    raw: Callable[[Array], Array],
    space: DesignSpace,
    logarithmic: tuple[bool, ...] = (),
    formula: Callable[[Sequence[Any]], list[Any]] | None = None,
) -> FeatureMap:
    # The first ones may be told alone.
    which = np.arange(len(names)) < 0
    which[: len(logarithmic)] = logarithmic
    unscaled = FeatureMap(names, raw, which, np.zeros(len(names)), np.ones(len(names)))
    # A fixed sample: the scaling is part of the feature set's definition, not a random choice of a campaign.
    X = space.sobol(4096, np.random.default_rng(0))
    F = unscaled(X)
    for column, name in enumerate(names):
        bad = np.flatnonzero(~np.isfinite(F[:, column]))
        if len(bad):
            raise InputError(
                f"classifier.features: {visible(name)} must be finite over the space, got {F[bad[0], column]} "
                f"for {dict(zip(space.names, X[bad[0]].tolist(), strict=True))}."
            )
        if np.ptp(F[:, column]) == 0.0:
            raise InputError(
                f"classifier.features: {visible(name)} must vary over the space, got {F[0, column]} everywhere."
            )
    return FeatureMap(names, raw, which, F.mean(axis=0), F.std(axis=0), formula)
