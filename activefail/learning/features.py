"""The classifier's features of a design: the variables, those of a plug-in, formulas, or custom ones."""

import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError, description_of, place_of
from activefail.learning.names import FEATURE_SETS
from activefail.plugins import brought
from activefail.space.expressions import Expression, check_no_texts, parse_expression
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace
from activefail.text.quantities import Quantity

_EQUAL = 1e-3
"""Standard deviation of the logarithm of an intensity below which all records count as equally intense."""

FARTHEST = 1e9
"""Most standard deviations from its mean of a feature of a design to learn from: beyond, squares lose the space."""


@dataclass(frozen=True)
class FeatureMap:
    """Maps designs to features, in standard units over the design space.

    Attributes:
        names: names of the features.
        raw: function of designs, (n, d), to unscaled features, (n, m).
        logarithmic: (m,) whether a feature enters as its logarithm.
        space: the design space.
        known: `scaling`, if it is known; it is computed at first use otherwise.
        harmless: which designs, (n, d) -> (n,), have the least severe outcome for certain, as the simulator's physics
            says; None if that is known of none.
        quantities: symbols, units and meanings of features, by name; those of others are not known.
    """

    names: tuple[str, ...]
    raw: Callable[[Array], Array]
    logarithmic: np.ndarray
    space: DesignSpace
    known: tuple[Array, Array] | None = None
    harmless: Callable[[Array], NDArray[np.bool_]] | None = None
    quantities: Mapping[str, Quantity] = field(default_factory=dict)

    def certain(self, X: Array) -> NDArray[np.bool_]:
        """Which designs, (n, d), have the least severe outcome for certain, (n,)."""
        return np.zeros(len(X), dtype=bool) if self.harmless is None else self.harmless(X)

    def __call__(self, X: Array) -> Array:
        """Scaled features of designs, (n, d) -> (n, m)."""
        center, spread = self.scaling
        return (self._transformed(X) - center) / spread

    def to_learn(self, X: Array) -> Array:
        """Scaled features of designs to learn from, (n, d) -> (n, m).

        Raises:
            InputError: if one is not finite, or is more than `FARTHEST` standard deviations from the mean.
        """
        with np.errstate(all="ignore"):  # reported below
            F = self(X)
            bad = ~(np.abs(F) <= FARTHEST)
        if bad.any():
            row, column = np.argwhere(bad)[0].tolist()
            raise InputError(
                f"classifier.features: {self.names[column]} must be finite, and at most {FARTHEST:g} standard "
                f"deviations from its mean, got {F[row, column]:g} standard deviations for {self.space.row(X[row])}."
            )
        return F

    @cached_property
    def scaling(self) -> tuple[Array, Array]:
        """Mean and standard deviation of the (logarithms of) features over the design measure, each (m,).

        Raises:
            InputError: if a feature is not finite over the space, or constant, or varies too little or too much.
        """
        return self._scaling_over_space() if self.known is None else self.known

    def _transformed(self, X: Array) -> Array:
        F = self.raw(X)
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, F, 1.0)), F)

    def _scaling_over_space(self) -> tuple[Array, Array]:
        # A fixed sample: the scaling belongs to the feature set's definition and must not depend on a campaign's seed.
        X = self.space.sobol(4096, np.random.default_rng(0))
        F = self._transformed(X)
        payloads = (one.payload for one in self.space.parameters)
        of_sets = {name for payload in payloads if payload is not None for name in payload.feature_names}
        for column, name in enumerate(self.names):
            bad = np.flatnonzero(~np.isfinite(F[:, column]))
            if len(bad):
                raise InputError(
                    f"classifier.features: {name} must be finite over the space, got {F[bad[0], column]} "
                    f"for {self.space.written(dict(zip(self.space.names, X[bad[0]].tolist(), strict=True)))}."
                )
            if np.ptp(F[:, column]) == 0.0 and name not in of_sets:
                raise InputError(
                    f"classifier.features: {name} must vary over the space, got {F[0, column]} everywhere."
                )
        with np.errstate(all="ignore"):  # reported below
            center, spread = F.mean(axis=0), F.std(axis=0)
            # Records may have been scaled to one intensity, which then says nothing: unscaled, it stays so.
            spread[np.isin(self.names, [*of_sets]) & (spread < _EQUAL)] = 1.0
            scaled = (F - center) / spread
        for column, name in enumerate(self.names):
            # Squares of tiny differences underflow, and those of huge ones overflow.
            if not (np.finfo(np.float64).tiny <= spread[column] < np.inf and np.isfinite(scaled[:, column]).all()):
                raise InputError(
                    f"classifier.features: {name} must have a standard deviation over the space that fits a "
                    f"float64, got values from {F[:, column].min()} to {F[:, column].max()}. Use other units."
                )
        return center, spread


@dataclass(frozen=True)
class CustomFeatures:
    """Custom features from a user's function.

    Attributes:
        name: name of the function, for the features' names and for messages.
        function: takes designs, (n, d) in the variables' units, and their design space; returns features, (n, m). Each
            row must depend on its design alone.
        variables: whether the variables are features too, before the function's.
    """

    name: str
    function: Callable[[Array, DesignSpace], Array]
    variables: bool = True

    def __call__(self, X: Array, space: DesignSpace) -> Array:
        """The function's features of designs, (n, d) -> (n, m), checked for type and shape.

        Raises:
            InputError: if the function raises or does not return (n, m) numbers.
        """
        try:
            with redirect_stdout(sys.stderr):
                returned = self.function(X.copy(), space)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a cancelled task and a panic of Rust code are no Exception
            raised = f"{description_of(error)}{place_of(error)}"
            raise InputError(f"classifier.features: {self.name} raised {raised}.") from error
        try:
            F = np.asarray(returned, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"classifier.features: {self.name} must return an (n, m) array of numbers; NumPy reports: {error}."
            ) from None
        if F.ndim != 2 or len(F) != len(X) or F.shape[1] == 0:
            raise InputError(
                f"classifier.features: {self.name} must return one row of features per design, "
                f"shape ({len(X)}, m); got shape {F.shape}."
            )
        return F


@dataclass(frozen=True)
class ExpressionFeatures:
    """Features as arithmetic on the variables and the fixed quantities.

    Attributes:
        expressions: feature names -> expressions (`activefail.space.expressions`).
        variables: whether the variables are features too, before the expressions.
    """

    expressions: Mapping[str, str]
    variables: bool = True


def feature_map(
    features: str | CustomFeatures | ExpressionFeatures,
    space: DesignSpace,
    physics: Any = None,
    check: bool = True,
) -> FeatureMap:
    """A feature set on a design space, scaled by its mean and standard deviation over the design measure.

    Scaling by the design measure, not by the training points, keeps a design's features constant throughout a campaign.
    Ratios enter as logarithms: over Table 1 they span up to three decades.

    Args:
        features: "design", the variables; "decorrelated", each variable without what correlated ones before it say;
            the name of a plug-in's features; or custom features. Log-uniform and lognormal variables enter as
            logarithms.
        space: the design space.
        physics: settings of the campaign's simulator that a plug-in's features share.
        check: whether to compute, and so to check, the scaling now; at its first use otherwise.

    Raises:
        InputError: if no features have this name or the space does not suit them, or if a feature is not finite over
            the space, or constant, or varies too little or too much to be scaled.
    """
    mapped = _mapped(features, space, physics)
    if check:
        _ = mapped.scaling
    return mapped


def _mapped(features: str | CustomFeatures | ExpressionFeatures, space: DesignSpace, physics: Any) -> FeatureMap:
    match features:
        case "design":
            return _of_variables(space)
        case "decorrelated":
            return _decorrelated(space)
        case CustomFeatures():
            return _custom(features, space)
        case ExpressionFeatures():
            return _of_expressions(features, space)
        case _:
            known = brought("features")
            if features not in known:
                raise InputError(f"`features` must be one of {', '.join((*FEATURE_SETS, *known))}, got {features!r}.")
            named: FeatureMap = known[features](space, physics)
            return named


def _of_variables(space: DesignSpace) -> FeatureMap:
    names = tuple(name for parameter in space.parameters for name in _names_of(parameter))
    return scaled(names, lambda X: variable_columns(space, X), space, logarithms(space))


def _decorrelated(space: DesignSpace) -> FeatureMap:
    """w = L⁻¹ z of the design set's scaled features z, with the lower factor L of the copula's correlation matrix.

    w is linear in the variables (or their logarithms), so a smooth margin remains smooth. The standard normal values of
    the copula are not: those of a uniform variable go to infinity at its bounds.
    """
    design = _of_variables(space)
    if space.factor is None:
        return design
    from scipy.linalg import solve_triangular

    # Columns of one variable's choices are not correlated with each other, nor with other variables.
    of = np.repeat(np.arange(space.dimension), [len(_names_of(parameter)) for parameter in space.parameters])
    L = np.where((of[:, None] == of) & ~np.eye(len(of), dtype=bool), 0.0, space.factor[np.ix_(of, of)])

    names = tuple(
        f"{name}_given_{'_'.join(design.names[j] for j in np.flatnonzero(L[i, :i]))}" if L[i, :i].any() else name
        for i, name in enumerate(design.names)
    )
    return scaled(names, lambda X: solve_triangular(L, design(X).T, lower=True).T, space)


def joined(
    names: tuple[str, ...], further: Callable[[Array], Array], space: DesignSpace, variables: bool = True
) -> FeatureMap:
    """Further features of designs, (n, d) -> (n, m), after the variables unless these are left out."""
    if not variables:
        return scaled(names, further, space)

    def raw(X: Array) -> Array:
        return np.column_stack([variable_columns(space, X), further(X)])

    return scaled((*_of_variables(space).names, *names), raw, space, logarithms(space))


def _names_of(parameter: Parameter) -> tuple[str, ...]:
    """The names of a variable's features: of choices theirs, or one for each, or for the second of two."""
    if parameter.payload is not None:
        return parameter.payload.feature_names
    if parameter.features:
        return tuple(name for name, _ in parameter.features)
    choices = parameter.choices[len(parameter.choices) == 2 :]
    return tuple(f"{parameter.name}={choice}" for choice in choices) if choices else (parameter.name,)


def variable_columns(space: DesignSpace, X: Array) -> Array:
    """The variables of designs, (n, d), as features, (n, m).

    Choices are their features, or else 0 and 1, one column for each; records are their intensities.
    """
    if not any(parameter.choices for parameter in space.parameters):
        return np.asarray(X)
    quantities = quantities_of(space, X)

    def columns_of(one: Parameter, x: Array) -> Array:
        if one.payload is not None:
            return one.payload.features(x.astype(np.intp), quantities)
        if one.features:
            return np.column_stack([*one.carried(x).values()])
        return one.indicators(x) if one.choices else x

    return np.column_stack([columns_of(one, x) for one, x in zip(space.parameters, np.asarray(X).T, strict=True)])


def quantities_of(space: DesignSpace, X: Array) -> dict[str, Any]:
    """The values, (n,), of variables, fixed quantities and features of choices of designs, (n, d), by name."""
    return space.quantities(dict(zip(space.names, np.asarray(X, dtype=np.float64).T, strict=True)))


def _custom(custom: CustomFeatures, space: DesignSpace) -> FeatureMap:
    width = custom(space.sobol(8, np.random.default_rng(0)), space).shape[1]

    def checked(X: Array) -> Array:
        F = custom(np.asarray(X, dtype=np.float64), space)
        if F.shape[1] != width:
            raise InputError(
                f"classifier.features: {custom.name} must always return the same number of features; got {width}, then "
                f"{F.shape[1]}."
            )
        return F

    names = tuple(f"{custom.name}[{column}]" for column in range(width))
    mapped = joined(names, checked, space, custom.variables)
    # A function that normalises over its rows would give one design different features.
    X = space.sobol(64, np.random.default_rng(1))
    if not np.allclose(mapped(X)[:7], mapped(X[:7]), rtol=1e-9, atol=1e-9):
        raise InputError(
            f"classifier.features: {custom.name} must return the same features for a design, "
            "regardless of the other designs."
        )
    return mapped


def _of_expressions(features: ExpressionFeatures, space: DesignSpace) -> FeatureMap:
    known = space.known
    expressions: list[Expression] = []
    for name, text in features.expressions.items():
        if name in known:
            raise InputError(f"classifier.features.expressions.{name}: must not have the name of another quantity.")
        try:
            expressions.append(parse_expression(text, known))
            check_no_texts(expressions[-1], space.texts)
        except ValueError as error:
            raise InputError(f"classifier.features.expressions.{name}: {error}.") from None

    def further(X: Array) -> Array:
        quantities = quantities_of(space, X)
        with np.errstate(all="ignore"):  # `scaling` reports values that are not finite
            return np.column_stack([np.broadcast_to(one(quantities), len(X)) for one in expressions])

    return joined(tuple(features.expressions), further, space, features.variables)


def logarithms(space: DesignSpace) -> tuple[bool, ...]:
    """Whether each variable, or each of its columns, enters as its logarithm."""
    names = ("log_uniform", "lognormal")
    return tuple(
        p.payload is not None or (p.distribution in names and p.low > 0.0)
        for p in space.parameters
        for _ in _names_of(p)
    )


def scaled(
    names: tuple[str, ...],
    raw: Callable[[Array], Array],
    space: DesignSpace,
    logarithmic: tuple[bool, ...] = (),
) -> FeatureMap:
    """Features by their names and a function of designs, (n, d) -> (n, m); `logarithmic` may cover only the first."""
    mask = np.arange(len(names)) < 0
    mask[: len(logarithmic)] = logarithmic
    return FeatureMap(names, raw, mask, space)
