"""The design space: named variables with ranges, distributions and units, and samples of it."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError

Array = NDArray[np.float64]


Distribution = Literal["uniform", "log_uniform", "truncated_normal"]

_LEAST_MASS = 1e-6
"""Least probability of a normal between its bounds: far out in a tail, rounding destroys its quantiles."""


_NARROWEST = 1e-9
"""Least width of a range relative to its larger bound: a narrower one contains too few numbers."""


def distribution_fault(
    low: float, high: float, distribution: Distribution, mean: float | None, sd: float | None
) -> str:
    """Why the numbers of a `Parameter` do not define a distribution; empty if they do."""
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        return f"`low < high` must hold, got {low} and {high}"
    if high - low < _NARROWEST * max(abs(low), abs(high)):
        return f"`high - low` must be at least {_NARROWEST:g} of the larger of the two, got {low} and {high}"
    if distribution == "log_uniform" and low <= 0.0:
        return f"`low > 0` must hold for log_uniform, got {low}"
    numbers = {"mean": mean, "sd": sd}
    rule = "a mean and an sd belong to a truncated normal, and to it alone"
    missing = [name for name, number in numbers.items() if number is None]
    if distribution == "truncated_normal" and missing:
        return f"{rule}; missing: {', '.join(missing)}"
    if distribution != "truncated_normal" and len(missing) < len(numbers):
        extra = " and ".join(f"{name} {number}" for name, number in numbers.items() if number is not None)
        return f"{rule}; got {distribution} with {extra}"
    if mean is not None and sd is not None:
        if not (np.isfinite(mean) and np.isfinite(sd) and sd > 0.0):
            return f"`sd > 0` must hold, got {sd}"
        _, mass = _truncated_mass(low, high, mean, sd)
        if not mass >= _LEAST_MASS:
            return f"{low} to {high} must contain at least {_LEAST_MASS:g} of the normal, got {mass:.1g}"
    return ""


def _truncated_mass(low: float, high: float, mean: float, sd: float) -> tuple[float, float]:
    """Mass of a normal below the lower bound, and between the bounds."""
    normal = NormalDist(mean, sd)
    return normal.cdf(low), normal.cdf(high) - normal.cdf(low)


@dataclass(frozen=True)
class Parameter:
    """One variable of the design space, between `low` and `high` (in `unit`).

    Attributes:
        distribution: uniform, log-uniform, or normal truncated at the bounds.
        mean, sd: mean and standard deviation of the normal before truncation; None for the others.

    Raises:
        InputError: if the name is not an identifier or the numbers do not define a distribution.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    distribution: Distribution = "uniform"
    mean: float | None = None
    sd: float | None = None

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(f"A variable's name must be an identifier, got {self.name!r}.")
        fault = distribution_fault(self.low, self.high, self.distribution, self.mean, self.sd)
        if fault:
            raise InputError(f"The variable {self.name!r}: {fault}.")

    def _normal(self) -> tuple[float, float]:
        assert self.mean is not None
        assert self.sd is not None
        return _truncated_mass(self.low, self.high, self.mean, self.sd)

    def quantile(self, u: Any, ndtri: Callable[[Any], Any]) -> Any:
        """Quantiles of the distribution.

        Args:
            u: probabilities, an array of any library.
            ndtri: that library's quantile function of the standard normal.
        """
        match self.distribution:
            case "uniform":
                return self.low + u * (self.high - self.low)
            case "log_uniform":
                return self.low * (self.high / self.low) ** u
            case "truncated_normal":
                assert self.mean is not None
                assert self.sd is not None
                below, mass = self._normal()
                return self.mean + self.sd * ndtri(below + u * mass)

    def share(self, x: Array) -> Array:
        """The distribution function, the inverse of `quantile`."""
        match self.distribution:
            case "uniform":
                return (x - self.low) / (self.high - self.low)
            case "log_uniform":
                return np.asarray(np.log(x / self.low) / np.log(self.high / self.low))
            case "truncated_normal":
                from scipy.special import ndtr

                assert self.mean is not None
                assert self.sd is not None
                below, mass = self._normal()
                return np.asarray((ndtr((x - self.mean) / self.sd) - below) / mass)

    def standardised(self, x: Array) -> Array:
        """Values in standard deviations from the middle: of a normal before truncation, of a log-uniform variable's
        logarithm.
        """
        if self.mean is not None and self.sd is not None:
            return (x - self.mean) / self.sd
        return np.asarray(np.sqrt(12.0) * (self.share(x) - 0.5))

    def widened(self, x: Array, factor: float) -> Array:
        """Values stretched about a normal's mean and clipped to its bounds; other distributions' values do not change.

        Args:
            x: values.
            factor: factor of the standard deviation.
        """
        if self.mean is None:
            return x
        return np.asarray(np.clip(self.mean + factor * (x - self.mean), self.low, self.high))

    @property
    def label(self) -> str:
        """The name with its unit, for tables and axes."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class DesignSpace:
    """A box of named variables, independent of each other; the design measure is their joint distribution.

    Attributes:
        parameters: the variables.
        fixed: values of further quantities that a simulator needs, the same for every design.

    Raises:
        InputError: if there is no variable, a name occurs twice or is not an identifier, or a value is not finite.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)

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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(parameter.name for parameter in self.parameters)

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

    def from_unit(self, U: Array) -> Array:
        """Points of the unit cube, shape (..., d), as designs in the variables' units."""
        # Imported here, as below: importing SciPy takes longer than simulating a bearing.
        from scipy.special import ndtri

        columns = np.moveaxis(np.asarray(U), -1, 0)
        X = np.stack([p.quantile(u, ndtri) for p, u in zip(self.parameters, columns, strict=True)], axis=-1)
        # Clipped: low + u (high - low) can leave the box by one rounding.
        return np.asarray(np.clip(X, self.low, self.high))

    def to_unit(self, X: Array) -> Array:
        """Designs, shape (..., d), as points of the unit cube."""
        columns = np.moveaxis(np.asarray(X), -1, 0)
        return np.stack([p.share(x) for p, x in zip(self.parameters, columns, strict=True)], axis=-1)

    def standardised(self, X: Array) -> Array:
        """Designs, shape (n, d), in standard deviations of each variable from its middle."""
        columns = [p.standardised(x) for p, x in zip(self.parameters, np.asarray(X).T, strict=True)]
        return np.stack(columns, axis=1)

    def widened(self, X: Array, factor: float) -> Array:
        """Designs, shape (n, d), with the normal variables stretched by `factor` (see Parameter.widened)."""
        columns = [p.widened(x, factor) for p, x in zip(self.parameters, np.asarray(X).T, strict=True)]
        return np.stack(columns, axis=1)

    def contains(self, X: Array) -> NDArray[np.bool_]:
        """Which rows of X, shape (n, d), lie in the box; shape (n,)."""
        return np.asarray(np.all((self.low <= X) & (self.high >= X), axis=1))

    def latin_hypercube(self, n: int, rng: np.random.Generator) -> Array:
        """A Latin hypercube of n designs, shape (n, d) ([McKayEtAl1979]; scipy.stats.qmc)."""
        from scipy.stats import qmc

        return self.from_unit(qmc.LatinHypercube(self.dimension, rng=rng).random(n))

    def sobol(self, n: int, rng: np.random.Generator) -> Array:
        """n designs of a scrambled Sobol' sequence, shape (n, d); n is a power of two."""
        from scipy.stats import qmc

        return self.from_unit(qmc.Sobol(self.dimension, rng=rng).random(n))

    def pick(self, columns: Sequence[Any], names: Sequence[str]) -> list[Any]:
        """The columns of the named quantities, in the order of `names`, from d columns; fixed quantities as numbers.

        Raises:
            InputError: if a name is neither a variable nor a fixed quantity of this space.
        """
        known: dict[str, Any] = {**dict(zip(self.names, columns, strict=True)), **self.fixed}
        for name in names:
            if name not in known:
                raise InputError(f"space: lacks the variable {name!r}; it has {', '.join(known)}.")
        return [known[name] for name in names]

    def table(self, X: Array, names: Sequence[str]) -> Array:
        """The named quantities of designs, (n, d) -> (n, len(names)), fixed ones included.

        Raises:
            InputError: as `pick` does.
        """
        X = np.asarray(X)
        return np.column_stack([np.broadcast_to(column, len(X)) for column in self.pick(list(X.T), names)])
