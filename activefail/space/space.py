"""The design space: named variables with their joint distribution, and samples of it."""

import math
import signal
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.space.parameter import Parameter

Array = NDArray[np.float64]


LEAST_SHARE = 2.0**-53
"""Least distance from a face of the unit cube at which standard normal values are taken."""


LEAST_FEASIBLE = 1e-3
"""Least share of feasible designs: each sample draws until it has enough."""

_POINTS, _MORE_POINTS, _SMALL = 2**16, 2**19, 0.05
"""Points that estimate this share, and if it is small."""

_COUNTED = 2**18
"""Most designs that are counted one by one."""

_ROUNDING = 1e-12
"""Rounding error of both sides of a constraint, relative to their sizes."""

_ROUNDS = 100
"""Most attempts to replace repeated designs of a Latin hypercube."""

_FARTHEST = 1e9
"""Most half widths of the bounds between their middle and a recorded design: beyond, no axis shows both."""

_NEAR_BOUND = 0.01
"""Largest distance of a quantile from a bound, in shares of the range, at which the bound takes its place."""

REACH = 1e-8
"""Probability outside the ball in standard normal space in which failure is searched and integrated."""


def radius(outside: float, dimension: int) -> float:
    """Radius of the ball in standard normal space outside which the probability is `outside`."""
    from scipy.stats import chi

    return float(chi.isf(outside, dimension))


@cache
def _read_direction_numbers() -> None:
    """Have SciPy read the direction numbers of Sobol' sequences, once, before the first sample.

    SciPy loses a Ctrl-C that arrives meanwhile, and that sample is wrong. So it arrives afterwards.
    """
    from scipy.stats import qmc

    missed: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    # Only the main thread handles signals.
    defers = threading.current_thread() is threading.main_thread() and callable(before)
    if defers:
        signal.signal(signal.SIGINT, lambda number, _: missed.append(number))
    try:
        qmc.Sobol(1)
    finally:
        if defers:
            signal.signal(signal.SIGINT, before)
    if missed:
        signal.raise_signal(signal.SIGINT)


@dataclass(frozen=True)
class Constraint:
    """A condition that designs meet: `left` is at most `right`, or less.

    Attributes:
        text: as a user writes it.
        names: of the quantities; of a feature of choices that of its variable.
        left, right: of quantities by name, numbers or arrays.
        is_strict: whether equality breaks it.
    """

    text: str
    names: frozenset[str]
    left: Callable[[Mapping[str, Any]], Any] = field(compare=False, repr=False)
    right: Callable[[Mapping[str, Any]], Any] = field(compare=False, repr=False)
    is_strict: bool = field(compare=False, repr=False)

    def holds(self, quantities: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Whether it is met; not where a side is infinite or undefined."""
        with np.errstate(all="ignore"):
            left, right = self.left(quantities), self.right(quantities)
            # The margin forgives the rounding of decimal numbers: 0.1 + 0.2 <= 0.3.
            margin = _ROUNDING * (np.abs(left) + np.abs(right))
            met = left < right - margin if self.is_strict else left <= right + margin
            return np.asarray(met & np.isfinite(left) & np.isfinite(right))


@dataclass(frozen=True)
class DesignSpace:
    """Named variables and their joint distribution, which is the design measure.

    The variables are independent, or correlated by a Gaussian copula. With constraints, the design measure is
    conditional on them: samples have feasible designs alone. `from_unit` and `from_normal` know of no constraints.

    Attributes:
        parameters: the variables.
        fixed: values of further quantities that a simulator needs, the same for every design.
        correlation: pairs of variables and the correlation coefficient of their values.
        constraints: conditions that all designs meet, of variables and fixed quantities.
        factor: (d, d) the lower Cholesky factor of the copula's correlation matrix; None without correlations.

    Raises:
        InputError: if there is no variable, a name occurs twice or is not an identifier, a value is not finite, or the
            correlations do not define a joint distribution. Samples raise it if hardly any design is feasible.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    correlation: tuple[tuple[str, str, float], ...] = ()
    constraints: tuple[Constraint, ...] = ()
    factor: Array | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError("A design space needs at least one variable that is not fixed.")
        for name, count in Counter(self.names).items():
            if count > 1 or name in self.fixed:
                raise InputError(f"The variable {name!r} is defined twice.")
        for name, value in self.fixed.items():
            if not name.isidentifier():
                raise InputError(f"A variable's name must be an identifier, got {name!r}.")
            if not np.isfinite(value):
                raise InputError(f"The value of {name!r} must be finite, got {value}.")
        if self.correlation:
            object.__setattr__(self, "factor", nataf_factor(self.parameters, self.correlation))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def by_name(self) -> dict[str, Parameter]:
        """The variables by their names."""
        return {parameter.name: parameter for parameter in self.parameters}

    @property
    def texts(self) -> tuple[str, ...]:
        """Names of the variables whose choices are texts."""
        return tuple(parameter.name for parameter in self.parameters if parameter.has_texts)

    @property
    def dimension(self) -> int:
        """Number of variables d."""
        return len(self.parameters)

    @property
    def low(self) -> Array:
        """Lower bounds, shape (d,), in the variables' units."""
        return np.array([parameter.low for parameter in self.parameters])

    @property
    def high(self) -> Array:
        """Upper bounds, shape (d,), in the variables' units."""
        return np.array([parameter.high for parameter in self.parameters])

    @property
    def usual(self) -> tuple[Array, Array]:
        """Lower and upper ends, (d,) each, of the ranges that pictures show: without the long tails of distributions.

        They are the 0.1 and 99.9 % quantiles, or bounds that are near them.
        """
        ends = [self._each(Parameter.quantile, np.full(self.dimension, share)) for share in (0.001, 0.999)]
        width = self.high - self.low
        low, high = (np.array(end, dtype=float) for end in ends)
        return (
            np.where(low - self.low <= _NEAR_BOUND * width, self.low, low),
            np.where(self.high - high <= _NEAR_BOUND * width, self.high, high),
        )

    @property
    def middle(self) -> Array:
        """The design, (d,), of the medians and the most probable choices."""
        # Without the digits that are the rounding of a sum: 0.07, not 0.06999999999999999.
        medians = [float(f"{one.quantile(np.array(0.5)):.12g}") for one in self.parameters]
        for column, one in enumerate(self.parameters):
            medians[column] = float(np.argmax(one.probabilities)) if one.choices else medians[column]
        return np.asarray(self.nearest(np.array([medians]))[0])

    def _each(self, of: Callable[[Parameter, Array], Any], X: Array) -> list[Any]:
        """What follows from each variable and its column of X, shape (..., d)."""
        return [of(one, x) for one, x in zip(self.parameters, np.moveaxis(np.asarray(X), -1, 0), strict=True)]

    def from_unit(self, U: Array) -> Array:
        """Points of the unit cube, shape (..., d), as designs in the variables' units."""
        # Imported here, as below: importing SciPy takes longer than simulating a bearing.
        from scipy.special import ndtri

        if self.correlation:
            # Infinite values on a face of the cube would mix to NaN.
            return self.from_normal(ndtri(np.clip(U, LEAST_SHARE, 1.0 - LEAST_SHARE)))
        return self._within(self._each(Parameter.quantile, U))

    def to_unit(self, X: Array) -> Array:
        """Designs, shape (..., d), as points of the unit cube."""
        from scipy.special import ndtr

        return np.asarray(ndtr(self.to_normal(X)) if self.correlation else np.stack(self._each(Parameter.share, X), -1))

    def from_normal(self, Z: Array) -> Array:
        """Points of standard normal space, shape (..., d), as designs in the variables' units."""
        mixed = np.asarray(Z) if self.factor is None else Z @ self.factor.T
        return self._within(self._each(Parameter.from_normal, mixed))

    def _within(self, columns: list[Array]) -> Array:
        # Clipped: low + u (high - low) can leave the box by one rounding.
        return np.clip(np.stack(columns, axis=-1), self.low, self.high)

    def to_normal(self, X: Array) -> Array:
        """Designs, shape (..., d), as points of standard normal space, where the variables are independent."""
        Z = np.stack(self._each(Parameter.to_normal, X), axis=-1)
        if self.factor is None:
            return Z
        from scipy.linalg import solve_triangular

        flat = Z.reshape(-1, self.dimension)
        return np.asarray(solve_triangular(self.factor, flat.T, lower=True).T.reshape(Z.shape))

    @property
    def outside(self) -> float:
        """A bound on the probability of designs outside the bounds: the sum over the variables."""
        return sum(parameter.outside for parameter in self.parameters)

    def holding(self, name: str, value: float) -> "DesignSpace":
        """The space of the other variables, where this one has a value."""
        kept = tuple(parameter for parameter in self.parameters if parameter.name != name)
        pairs = tuple(pair for pair in self.correlation if name not in pair[:2])
        return DesignSpace(kept, self.quantities({name: value}), pairs, self.constraints)

    def quantities(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values of variables by name, as expressions and formulas take them, with features and fixed quantities."""
        known, carried = self.by_name, dict[str, Any]()
        taken = {name: known[name].quantities(x) if name in known else x for name, x in values.items()}
        for name in filter(known.__contains__, values):
            carried |= known[name].carried(values[name])
        return {**taken, **carried, **self.fixed}

    @property
    def carriers(self) -> dict[str, str]:
        """By the name of each feature of choices, the name of its variable."""
        return {feature: one.name for one in self.parameters for feature, _ in one.features}

    @property
    def known(self) -> tuple[str, ...]:
        """Names of all quantities of a design: variables, features of choices, and fixed ones."""
        return (*self.names, *self.carriers, *self.fixed)

    def range_of(self, name: str) -> tuple[float, float]:
        """The least and the largest value of a quantity; see `pick`."""
        ends = [one.values if one.choices else np.array([one.low, one.high]) for one in self.parameters]
        most = max(map(len, ends))
        (x,) = self.pick([np.resize(one, most) for one in ends], (name,))
        return float(np.min(x)), float(np.max(x))

    def written(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Values of variables by name, as people see them: choices, and whole numbers as integers."""
        known = self.by_name
        return {name: known[name].written(x) if name in known else x for name, x in values.items()}

    def objects(self, X: Array, name: str) -> tuple[Sequence[Any], NDArray[np.intp]]:
        """What the choices of a variable stand for, such as the records of a set, and which of them designs have, (n,).

        Raises:
            InputError: if its choices stand for nothing, or it is no variable; or as reading them does.
        """
        one = self.by_name.get(name)
        if one is None or one.payload is None:
            raise InputError(f"space: {name!r} is no variable with a `set`.")
        return one.payload(), np.asarray(X)[:, self.names.index(name)].astype(np.intp)

    def row(self, x: Array) -> list[Any]:
        """A design, (d,), as people see it (see `written`)."""
        return self._each(lambda one, value: one.written(float(value)), x)

    def meets_constraints(self, X: Array) -> NDArray[np.bool_]:
        """Which designs, (n, d), meet all constraints, (n,)."""
        quantities = self.quantities(dict(zip(self.names, np.asarray(X).T, strict=True)))
        met = np.ones(len(X), dtype=bool)
        for constraint in self.constraints:
            met &= constraint.holds(quantities)
        return met

    @cached_property
    def feasible_share(self) -> float:
        """The probability of a feasible design before it is conditional, by a Sobol' sequence."""
        return self._feasible_points[0]

    @property
    def feasible_error(self) -> float:
        """A bound on the standard error of `feasible_share`: that of independent points."""
        share, points = self._feasible_points
        return math.sqrt(share * (1.0 - share) / points)

    @cached_property
    def _feasible_points(self) -> tuple[float, int]:
        from scipy.stats import qmc

        if not self.constraints:
            return 1.0, 1
        _read_direction_numbers()
        sequence, feasible, drawn = qmc.Sobol(self.dimension, rng=np.random.default_rng(0)), 0, 0
        while drawn < _POINTS or (drawn < _MORE_POINTS and feasible < _SMALL * drawn):
            feasible += int(self.meets_constraints(self.from_unit(sequence.random(_POINTS))).sum())
            drawn += _POINTS
        return feasible / drawn, drawn

    def check_feasible(self) -> None:
        """Check that enough designs are feasible for samples."""
        if self.feasible_share < LEAST_FEASIBLE:
            raise InputError(
                f"constraints: at least {100 * LEAST_FEASIBLE:g} % of the variables' distribution must meet "
                f"{' and '.join(repr(one.text) for one in self.constraints)}, got {100 * self.feasible_share:.2g} %."
            )

    def _feasible(self, draw: Callable[[int], Array], n: int) -> Array:
        """n feasible designs from the points of the unit cube that a sampler draws.

        Raises:
            InputError: if hardly any design is feasible.
        """
        X = self.from_unit(draw(n))
        if not self.constraints:
            return X
        self.check_feasible()
        kept = X[self.meets_constraints(X)]
        while len(kept) < n:
            X = self.from_unit(draw(n))
            kept = np.concatenate([kept, X[self.meets_constraints(X)]])
        return kept[:n]

    def standardised(self, X: Array) -> Array:
        """Designs, shape (n, d), in standard deviations of each variable from its middle."""
        return np.stack(self._each(Parameter.standardised, X), axis=1)

    def positions(self, X: Array) -> Array:
        """Designs, (n, d), as points whose distances say how different designs are; choices are equally far apart."""
        return np.column_stack(self._each(lambda p, x: p.indicators(x) if p.choices else p.standardised(x), X))

    def swapped(self, X: Array, share: float, rng: np.random.Generator) -> Array:
        """Designs, (n, d), with a share of all choices drawn again."""
        is_choice = np.array([bool(parameter.choices) for parameter in self.parameters])
        if not is_choice.any():
            return X
        drawn = self.from_unit(rng.random(X.shape))
        return np.where(is_choice & (rng.random(X.shape) < share), drawn, X)

    def widened(self, X: Array, factor: float) -> Array:
        """Designs, shape (n, d), with the normal variables stretched by `factor` (see Parameter.widened)."""
        return np.stack(self._each(lambda p, x: p.widened(x, factor), X), axis=1)

    def contains(self, X: Array) -> NDArray[np.bool_]:
        """Which rows of X, shape (n, d), are designs of this space; shape (n,)."""
        return np.asarray(np.all(self._each(Parameter.contains, X), axis=0)) & self.meets_constraints(X)

    def spans(self, X: Array) -> NDArray[np.bool_]:
        """Which rows of X, (n, d), lie between the bounds, also between steps, and meet the constraints, (n,).

        A property bound of a hazard leads between the steps, where the classifier does not extrapolate.
        """
        return np.asarray(np.all(self._each(Parameter.spans, X), axis=0)) & self.meets_constraints(X)

    def reaches(self, X: Array) -> NDArray[np.bool_]:
        """Which rows of X, (n, d), may be recorded, also outside the space: not too far, and of known choices, (n,)."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        near = np.all(np.abs(X - middle) <= _FARTHEST * half, axis=1)
        chosen = [one.contains(x) for one, x in zip(self.parameters, np.asarray(X).T, strict=True) if one.choices]
        return np.asarray(np.all([near, *chosen], axis=0))

    def broken_rule(self, design: Array) -> tuple[str, str, Any] | None:
        """The variable, rule and value that keep a design, (d,), out of this space; None if it belongs to it."""
        values = dict(zip(self.names, design.tolist(), strict=True))
        for one in self.parameters:
            if not one.contains(values[one.name]):
                return one.name, one.rule, values[one.name]
        for constraint in self.constraints:
            if not constraint.holds(self.quantities(values)):
                name = next(name for name in self.names if name in constraint.names)
                return name, f"the constraint {constraint.text!r} must hold", self.written(values)[name]
        return None

    def columns(self, X: Array) -> dict[str, NDArray[Any]]:
        """The variables of designs, (n, d), by name, (n,) each, as people see them (see Parameter.column)."""
        columns = self._each(Parameter.column, np.reshape(X, (-1, self.dimension)))
        return dict(zip(self.names, columns, strict=True))

    def rounded(self, X: Array) -> Array:
        """Designs, (n, d), whose values are those of variables with steps, where they differ by rounding alone."""
        return np.stack(self._each(lambda p, x: np.where(p.contains(x), p.rounded(x), x), X), axis=-1)

    def nearest(self, X: Array) -> Array:
        """Designs, (n, d), with the nearest of the values of variables with steps or choices."""
        return np.stack(self._each(Parameter.rounded, X), axis=-1)

    @cached_property
    def design_count(self) -> float:
        """Number of designs; infinite if a variable is continuous, and without constraints if there are very many."""
        number = math.prod(len(parameter.values) or math.inf for parameter in self.parameters)
        if not self.constraints or number > _COUNTED:
            return number
        grid = np.meshgrid(*(parameter.values for parameter in self.parameters), indexing="ij")
        return int(self.meets_constraints(np.stack([values.ravel() for values in grid], axis=1)).sum())

    def latin_hypercube(self, n: int, rng: np.random.Generator) -> Array:
        """A Latin hypercube of n designs, shape (n, d) ([McKayEtAl1979]; scipy.stats.qmc).

        Where all variables have a step, other designs take the place of repeated ones as long as there are any.
        """
        from scipy.stats import qmc

        X = self._feasible(qmc.LatinHypercube(self.dimension, rng=rng).random, n)
        for _ in range(_ROUNDS):
            again = np.delete(np.arange(n), np.unique(X, axis=0, return_index=True)[1])
            if self.design_count == math.inf or not len(again):
                break
            X[again] = self.random(len(again), rng)
        return X

    def sobol(self, n: int, rng: np.random.Generator) -> Array:
        """n designs of a scrambled Sobol' sequence, shape (n, d); n is a power of two."""
        from scipy.stats import qmc

        _read_direction_numbers()
        return self._feasible(qmc.Sobol(self.dimension, rng=rng).random, n)

    def random(self, n: int, rng: np.random.Generator) -> Array:
        """n independent designs, (n, d)."""
        return self._feasible(lambda number: rng.random((number, self.dimension)), n)

    def pick(self, columns: Sequence[Any], names: Sequence[str]) -> list[Any]:
        """The columns of the named quantities, in the order of `names`, from d columns; fixed quantities as numbers.

        Raises:
            InputError: if a name is neither a variable nor a fixed quantity of this space.
        """
        known = self.quantities(dict(zip(self.names, columns, strict=True)))
        for name in names:
            if name not in known:
                raise InputError(f"space: lacks the variable {name!r}; its variables are {', '.join(known)}.")
            if name in self.texts:
                raise InputError(f"space.{name}: must have numbers here, but has texts as choices.")
        return [known[name] for name in names]

    def table(self, X: Array, names: Sequence[str]) -> Array:
        """The named quantities of designs, (n, d) -> (n, len(names)), fixed ones included."""
        X = np.asarray(X)
        return np.column_stack([np.broadcast_to(column, len(X)) for column in self.pick(list(X.T), names)])


_NODES = 64
"""Nodes of Gauss–Hermite quadrature, of each variable of a pair."""


def nataf_factor(parameters: Sequence[Parameter], correlation: Sequence[tuple[str, str, float]]) -> Array:
    """The lower Cholesky factor L of the copula's correlation matrix, (d, d): L z are correlated standard normals.

    The joint distribution is a Gaussian copula with the variables' own distributions (the Nataf transformation). The
    copula's coefficient ρ₀ of a pair follows from the coefficient ρ of their values: ρ is the covariance of F₁⁻¹(Φ(z₁))
    and F₂⁻¹(Φ(ρ₀ z₁ + √(1 − ρ₀²) z₂)) divided by both standard deviations [LiuDerKiureghian1986, eq. 12].
    Values are those before they are rounded to a step.
    """
    choices = {parameter.name for parameter in parameters if parameter.choices}
    parameters = [parameter.continuous for parameter in parameters]
    names = [parameter.name for parameter in parameters]
    R, pairs = np.eye(len(names)), list[set[str]]()
    for number, (one, other, rho) in enumerate(correlation):
        entry = f"correlation[{number}]"
        for name in (one, other):
            if name not in names:
                raise InputError(f"{entry}: {name!r} is not a variable; the variables are {', '.join(names)}.")
            if name in choices:
                raise InputError(f"{entry}: {name!r} has choices, which have no order and so no correlation.")
        i, j = names.index(one), names.index(other)
        if i == j:
            raise InputError(f"{entry}: names {one!r} twice.")
        if {one, other} in pairs:
            raise InputError(f"{entry}: {one!r} and {other!r} already have a correlation.")
        if not -1.0 < rho < 1.0:
            raise InputError(f"{entry}: the correlation must lie between -1 and 1, got {rho}.")
        pairs.append({one, other})
        R[i, j] = R[j, i] = _copula_coefficient(parameters[i], parameters[j], rho, entry)
    try:
        return np.asarray(np.linalg.cholesky(R))
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(R)[0]
        raise InputError(
            f"correlation: no joint distribution has all these correlations; the smallest eigenvalue of their matrix "
            f"in standard normal space is {least:.2g} and must be positive."
        ) from None


def correlation_of_values(one: Parameter, other: Parameter, rho_0: float) -> float:
    """Correlation of two variables' values, by the coefficient of their copula."""
    z, w = np.polynomial.hermite_e.hermegauss(_NODES)
    w = w / w.sum()
    x = one.from_normal(z)
    y = other.from_normal(z)
    (mean_x, mean_y), (sd_x, sd_y) = (w @ x, w @ y), (np.sqrt(w @ (x - w @ x) ** 2), np.sqrt(w @ (y - w @ y) ** 2))
    Y = other.from_normal(rho_0 * z[:, None] + np.sqrt(1.0 - rho_0**2) * z[None, :])
    return float(w @ ((x - mean_x)[:, None] * (Y - mean_y)) @ w / (sd_x * sd_y))


def _copula_coefficient(one: Parameter, other: Parameter, rho: float, entry: str) -> float:
    if rho == 0.0:
        return 0.0
    from scipy.optimize import brentq

    def coefficient(rho_0: float) -> float:
        return correlation_of_values(one, other, rho_0)

    least, largest = coefficient(-1.0), coefficient(1.0)
    if not least < rho < largest:
        raise InputError(
            f"{entry}: these distributions of {one.name!r} and {other.name!r} allow correlations between {least:.3f} "
            f"and {largest:.3f}, got {rho}."
        )
    return float(brentq(lambda rho_0: coefficient(rho_0) - rho, -1.0, 1.0, xtol=1e-12))
