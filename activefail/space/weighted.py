"""A distribution that is given by weighted rows, such as the pulses of a deaggregation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.space.space import Array

BLOCKS = 8
"""Blocks of rows that are a sample."""


@dataclass(frozen=True, eq=False)
class WeightedRows:
    """A discrete distribution of several variables.

    Attributes:
        names: (k,) of the variables.
        X: (n, k) their values.
        weight: (n,) relative to the mean weight, so that weighted means are means.
        is_sample: whether the rows are a sample that stands for a continuous distribution, in `BLOCKS` blocks each of
            which stands for it too; otherwise they are the distribution itself.
    """

    names: tuple[str, ...]
    X: Array
    weight: Array
    is_sample: bool = False

    # It has no variables with distributions of their own, nor what depends on them (see `space.DesignSpace`).
    parameters: ClassVar = ()
    correlation: ClassVar = ()
    constraints: ClassVar = ()
    feasible_share: ClassVar = 1.0

    def __post_init__(self) -> None:
        if self.X.shape != (len(self.weight), len(self.names)):
            raise InputError(
                f"X: must have the shape (rows, names) = {(len(self.weight), len(self.names))}, got {self.X.shape}."
            )
        bad = np.flatnonzero(~np.isfinite(self.X).all(axis=1))
        if len(bad):
            raise InputError(f"row {bad[0] + 1}: must be finite, got {self.X[bad[0]].tolist()}.")
        bad = np.flatnonzero(~(np.isfinite(self.weight) & (self.weight >= 0.0)))
        if len(bad):
            raise InputError(f"row {bad[0] + 1}, column weight: must be at least 0, got {self.weight[bad[0]]}.")
        if not self.weight.sum() > 0.0:
            raise InputError("column weight: at least one weight must be positive.")
        object.__setattr__(self, "weight", self.weight / self.weight.mean())

    @property
    def dimension(self) -> int:
        """Number of variables k."""
        return len(self.names)

    @property
    def outside(self) -> float:
        """The probability of rows that are left out: none is."""
        return 0.0

    def column(self, name: str) -> Array:
        """Values of one variable, (n,)."""
        return self.X[:, self.names.index(name)]

    def holding(self, name: str, value: float) -> "WeightedRows":
        """The distribution of the other variables, whatever the value."""
        kept = [column for column, other in enumerate(self.names) if other != name]
        return replace(self, names=tuple(self.names[column] for column in kept), X=self.X[:, kept])

    def thinned(self, n: int) -> "WeightedRows":
        """At most n rows that stand for all: of more, a stratified sample by their weights, in n equal weights.

        The strata are equal parts of the weight, in the order of the last variable, the size of a pulse. Each gives one
        row at random, and rows of equal size are in random order: tables are often regular, such as each size with
        several periods, and a regular choice would miss a part of them. The random numbers are always the same.
        """
        if len(self.X) <= n:
            return self
        rng = np.random.default_rng(0)
        order = np.lexsort((rng.random(len(self.X)), self.X[:, -1]))
        below = np.cumsum(self.weight[order])
        at = (np.arange(n) + rng.random(n)) / n
        places = np.minimum(np.searchsorted(below, at * below[-1]), len(order) - 1)
        by_block = np.argsort(np.arange(n) % BLOCKS, kind="stable")
        return WeightedRows(self.names, self.X[order[places[by_block]]], np.ones(n), is_sample=True)

    def standard_error(self, values: Array | NDArray[np.bool_]) -> Array:
        """Standard error of the weighted mean over the rows, which blocks of a sample differ by; 0 without a sample.

        Args:
            values: (n, ...) of the rows.
        """
        if not self.is_sample:
            return np.zeros(values.shape[1:])
        parts: list[Array] = np.array_split(np.asarray(values, dtype=np.float64), BLOCKS)
        weights: list[Array] = np.array_split(self.weight, BLOCKS)
        means = [np.tensordot(weight / weight.sum(), part, axes=1) for weight, part in zip(weights, parts, strict=True)]
        return np.asarray(np.std(means, axis=0, ddof=1) / np.sqrt(BLOCKS))


def weighted_quantiles(values: Array, weight: Array, shares: Sequence[float]) -> Array:
    """The least values at or below which these shares of the weight lie, (len(shares),).

    Args:
        values, weight: (n,) each.
        shares: between 0 and 1.
    """
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weight[order]) / weight.sum()
    # Rounding may leave the last sum below 1.
    places = np.minimum(np.searchsorted(below, np.asarray(shares) * (1.0 - 1e-12)), len(order) - 1)
    return np.asarray(values[order][places])


def clopper_pearson(hits: float, values: float, tail: float) -> tuple[float, float]:
    """The interval of a share by hits among values, whole numbers or not, each end with this one-sided confidence."""
    from scipy.stats import beta

    low = float(beta.ppf(1.0 - tail, hits, values - hits + 1.0)) if hits > 0.0 else 0.0
    return low, float(beta.ppf(tail, hits + 1.0, values - hits)) if hits < values else 1.0
