"""The design space: named variables with ranges, distributions and units, and samples of it."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from activefail.correlation import nataf_factor
from activefail.distributions import BOUNDED, Distribution, frozen, parameters_fault
from activefail.errors import InputError

if TYPE_CHECKING:
    from scipy.stats.distributions import rv_frozen

Array = NDArray[np.float64]


_LEAST_MASS = 1e-6
"""Least probability of a distribution between its bounds: far out in a tail, rounding destroys its quantiles."""


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
    numbers = {name: number for name, number in (("mean", mean), ("sd", sd)) if number is not None}
    if fault := parameters_fault(distribution, low, high, numbers):
        return fault
    if mean is not None and distribution != "beta":
        _, mass, _ = _masses(distribution, low, high, mean, sd)
        if not mass >= _LEAST_MASS:
            return (
                f"{low} to {high} must contain at least {_LEAST_MASS:g} of the {distribution.replace('_', ' ')} "
                f"distribution, got {mass:.1g}"
            )
    return ""


def _masses(
    distribution: Distribution, low: float, high: float, mean: float, sd: float | None
) -> tuple[float, float, float]:
    """Mass of a distribution below the lower bound, between the bounds, and above the upper bound."""
    if distribution in ("truncated_normal", "normal"):
        assert sd is not None
        normal = NormalDist(mean, sd)
        below = normal.cdf(low)
        return below, normal.cdf(high) - below, NormalDist(-mean, sd).cdf(-high)
    law = frozen(distribution, low, high, mean, mean if sd is None else sd)
    below, above = float(law.cdf(low)), float(law.sf(high))
    return below, 1.0 - below - above, above


@dataclass(frozen=True)
class Parameter:
    """One variable of the design space, between `low` and `high` (in `unit`).

    Its distribution is the named one conditional on these bounds.

    Attributes:
        distribution: name of the distribution.
        mean, sd: mean and standard deviation of the unbounded distribution, or of a beta distribution; None for uniform
            and log-uniform variables. The sd of an exponential variable is None.

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

    def _masses(self) -> tuple[float, float, float]:
        assert self.mean is not None
        return _masses(self.distribution, self.low, self.high, self.mean, self.sd)

    @property
    def _law(self) -> "rv_frozen":
        assert self.mean is not None
        return frozen(self.distribution, self.low, self.high, self.mean, self.mean if self.sd is None else self.sd)

    @property
    def outside(self) -> float:
        """The probability of the unbounded distribution outside the bounds; 0 for a distribution that has bounds."""
        if self.distribution in BOUNDED:
            return 0.0
        below, _, above = self._masses()
        return below + above

    def quantile(self, u: Any, ndtri: Callable[[Any], Any]) -> Any:
        """Quantiles of the distribution.

        Args:
            u: probabilities, an array of any library if `has_formula`, else of NumPy.
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
                below, mass, _ = self._masses()
                return self.mean + self.sd * ndtri(below + u * mass)
            case _:
                return self._between(u, 1.0 - u)

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
                below, mass, _ = self._masses()
                return np.asarray((ndtr((x - self.mean) / self.sd) - below) / mass)
            case _:
                below, mass, _ = self._masses()
                return np.asarray((self._law.cdf(x) - below) / mass)

    @property
    def has_formula(self) -> bool:
        """Whether `quantile` is arithmetic on arrays of any library."""
        return self.distribution in ("uniform", "log_uniform", "truncated_normal")

    def density(self, x: Array) -> Array:
        """The probability density of the distribution, per unit of the variable."""
        match self.distribution:
            case "uniform":
                return np.full(np.shape(x), 1.0 / (self.high - self.low))
            case "log_uniform":
                return np.asarray(1.0 / (x * np.log(self.high / self.low)))
            case _:
                return np.asarray(self._law.pdf(x) / self._masses()[1])

    def _between(self, p: Array, q: Array) -> Array:
        """Values with probability p below and q = 1 − p above them; both are used, for accuracy in either tail."""
        below, mass, above = self._masses()
        law = self._law
        x = np.where(p <= 0.5, law.ppf(below + p * mass), law.isf(above + q * mass))
        return np.asarray(np.clip(x, self.low, self.high))

    def from_normal(self, z: Array) -> Array:
        """Values of the variable at standard normal values: F⁻¹(Φ(z)), accurate in both tails."""
        from scipy.special import ndtr, ndtri

        if self.distribution in ("uniform", "log_uniform"):
            return np.asarray(self.quantile(ndtr(z), ndtri))
        return self._between(ndtr(z), ndtr(-z))

    def to_normal(self, x: Array) -> Array:
        """Standard normal values of the variable's values: Φ⁻¹(F(x)), the inverse of `from_normal`."""
        from scipy.special import ndtri

        if self.distribution in ("uniform", "log_uniform"):
            return np.asarray(ndtri(self.share(x)))
        below, mass, above = self._masses()
        law = self._law
        p, q = (law.cdf(x) - below) / mass, (law.sf(x) - above) / mass
        return np.asarray(np.where(p <= 0.5, ndtri(np.clip(p, 0.0, 1.0)), -ndtri(np.clip(q, 0.0, 1.0))))

    def standardised(self, x: Array) -> Array:
        """Values in standard deviations from the middle: of a normal before truncation, of a log-uniform variable's
        logarithm; standard normal values for other distributions without bounds of their own.
        """
        if self.distribution == "truncated_normal":
            assert self.mean is not None
            assert self.sd is not None
            return (x - self.mean) / self.sd
        if self.distribution in BOUNDED:
            return np.asarray(np.sqrt(12.0) * (self.share(x) - 0.5))
        return self.to_normal(x)

    def widened(self, x: Array, factor: float) -> Array:
        """Values stretched about the middle and clipped to the bounds; those between bounds of their own do not change.

        A normal variable is stretched about its mean, another in standard normal values.

        Args:
            x: values.
            factor: factor of the standard deviation.
        """
        if self.distribution in ("truncated_normal", "normal"):
            assert self.mean is not None
            return np.asarray(np.clip(self.mean + factor * (x - self.mean), self.low, self.high))
        if self.distribution in BOUNDED:
            return np.asarray(x)
        return self.from_normal(factor * self.to_normal(x))

    @property
    def label(self) -> str:
        """The name with its unit, for tables and axes."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def radius(outside: float, dimension: int) -> float:
    """Radius of the ball in standard normal space outside which the probability is `outside`."""
    from scipy.stats import chi

    return float(chi.isf(outside, dimension))


@dataclass(frozen=True)
class DesignSpace:
    """Named variables and their joint distribution, which is the design measure.

    The variables are independent, or correlated by a Gaussian copula (`activefail.correlation`).

    Attributes:
        parameters: the variables.
        fixed: values of further quantities that a simulator needs, the same for every design.
        correlation: pairs of variables and the correlation coefficient of their values.
        factor: (d, d) the lower Cholesky factor of the copula's correlation matrix; None without correlations.

    Raises:
        InputError: if there is no variable, a name occurs twice or is not an identifier, a value is not finite, or the
            correlations do not define a joint distribution.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    correlation: tuple[tuple[str, str, float], ...] = ()
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

        if self.correlation:
            return self.from_normal(ndtri(np.asarray(U)))
        columns = np.moveaxis(np.asarray(U), -1, 0)
        X = np.stack([p.quantile(u, ndtri) for p, u in zip(self.parameters, columns, strict=True)], axis=-1)
        # Clipped: low + u (high - low) can leave the box by one rounding.
        return np.asarray(np.clip(X, self.low, self.high))

    def to_unit(self, X: Array) -> Array:
        """Designs, shape (..., d), as points of the unit cube."""
        from scipy.special import ndtr

        if self.correlation:
            return np.asarray(ndtr(self.to_normal(X)))
        columns = np.moveaxis(np.asarray(X), -1, 0)
        return np.stack([p.share(x) for p, x in zip(self.parameters, columns, strict=True)], axis=-1)

    def from_normal(self, Z: Array) -> Array:
        """Points of standard normal space, shape (..., d), as designs in the variables' units."""
        Z = np.asarray(Z)
        if self.factor is not None:
            Z = Z @ self.factor.T
        columns = np.moveaxis(Z, -1, 0)
        X = np.stack([p.from_normal(z) for p, z in zip(self.parameters, columns, strict=True)], axis=-1)
        return np.asarray(np.clip(X, self.low, self.high))

    def to_normal(self, X: Array) -> Array:
        """Designs, shape (..., d), as points of standard normal space, where the variables are independent."""
        columns = np.moveaxis(np.asarray(X), -1, 0)
        Z = np.stack([p.to_normal(x) for p, x in zip(self.parameters, columns, strict=True)], axis=-1)
        if self.factor is None:
            return Z
        from scipy.linalg import solve_triangular

        flat = Z.reshape(-1, self.dimension)
        return np.asarray(solve_triangular(self.factor, flat.T, lower=True).T.reshape(Z.shape))

    @property
    def outside(self) -> float:
        """A bound on the probability of designs outside the bounds: the sum over the variables."""
        return sum(parameter.outside for parameter in self.parameters)

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
