"""The design space: named variables with ranges and units, and samples of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One variable of the design space, uniform between `low` and `high` (in `unit`).

    Raises:
        InputError: if the name is not an identifier or `low < high` does not hold.
    """

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(f"A variable's name must be an identifier, got {self.name!r}.")
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(f"`low < high` must hold for {self.name!r}, got {self.low} and {self.high}.")

    @property
    def label(self) -> str:
        """The name with its unit, for tables and axes."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class DesignSpace:
    """A box of named variables; the design measure is uniform on it.

    Raises:
        InputError: if there is no variable or a name comes twice.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError("A design space needs at least one variable.")
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(f"The variable {name!r} is defined twice.")

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
        """Points of the unit cube, shape (n, d), as designs in the variables' units."""
        # Clipped: low + u (high - low) can leave the box by one rounding.
        return np.clip(self.low + np.asarray(U) * (self.high - self.low), self.low, self.high)

    def to_unit(self, X: Array) -> Array:
        """Designs, shape (n, d), as points of the unit cube."""
        return (np.asarray(X) - self.low) / (self.high - self.low)

    def contains(self, X: Array) -> NDArray[np.bool_]:
        """Which rows of X, shape (n, d), lie in the box; shape (n,)."""
        return np.asarray(np.all((self.low <= X) & (self.high >= X), axis=1))

    def latin_hypercube(self, n: int, rng: np.random.Generator) -> Array:
        """A Latin hypercube of n designs, shape (n, d) (McKay 1979; scipy.stats.qmc)."""
        # Here: importing scipy.stats takes longer than simulating a bearing.
        from scipy.stats import qmc

        return self.from_unit(qmc.LatinHypercube(self.dimension, rng=rng).random(n))

    def sobol(self, n: int, rng: np.random.Generator) -> Array:
        """n designs of a scrambled Sobol' sequence, shape (n, d); n is a power of two."""
        from scipy.stats import qmc

        return self.from_unit(qmc.Sobol(self.dimension, rng=rng).random(n))

    def select(self, names: Sequence[str]) -> NDArray[np.intp]:
        """The columns of the named variables, in the order asked for.

        Raises:
            InputError: if a name is not a variable of this space.
        """
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InputError(f"space: lacks the variable {missing[0]!r}; it has {', '.join(self.names)}.")
        return np.array([self.names.index(name) for name in names], dtype=np.intp)
