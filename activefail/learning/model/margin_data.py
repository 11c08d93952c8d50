"""The margins that a regression learns from: warped, with those that say no more than their sign, and the support."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from activefail.learning.model.censored import CensoredSites
from activefail.learning.model.readout import EXACT
from activefail.space.space import Array

KERNEL = "matern52"
"""The kernel of every regression."""

NOISE = "likelihood.noise_covar.raw_noise"
"""The parameter of a prior that is the logarithm of the noise's variance, where the simulator does not repeat."""

SLOPE = "covar_module.raw_slope"
"""The parameter of a prior that is the logarithm of the variance of its linear trend's slopes."""

WARPINGS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "none": (lambda g: g, np.zeros_like),
    "asinh": (np.arcsinh, lambda g: -0.5 * np.log1p(g * g)),
    "asinh5": (lambda g: np.arcsinh(5.0 * g), lambda g: math.log(5.0) - 0.5 * np.log1p(25.0 * g * g)),
}
"""Each warping of g/q and the logarithm of its derivative."""

Moments = Callable[[Array], tuple[Array, Array]]
"""Means and standard deviations of points, (n, m) -> (n,) each."""

_CENSORED_SPREAD = 0.01
"""Largest range of the failed designs' margins, in standard deviations of the others', that is taken as truncation."""

_TIED = 3
"""Fewest different designs with the largest margin that show that it is clipped."""


MOST = 20_000
"""Most points in a posterior."""

MOST_CENSORED = 300
"""Most censored points in the posterior of many: a step of expectation propagation costs the cube of their number."""


def is_truncated(margin: Array) -> bool:
    """Whether margins, (n,), end at failure, so that those at most 0 say no more than their sign.

    They do if the failed designs' margins differ by at most 1 % of the standard deviation of the others. A single
    failed design counts as truncated if its margin is that close to 0.
    """
    failed, others = margin[margin <= 0.0], margin[margin > 0.0]
    if len(failed) == 0 or len(others) < 2:
        return False
    # In units of the largest: squares of huge margins would overflow.
    largest = others.max()
    reach = np.ptp(failed / largest) if len(failed) > 1 else -failed[0] / largest
    return bool(reach <= _CENSORED_SPREAD * (others / largest).std())


def informative(margin: Array, truncated: bool) -> NDArray[np.intp]:
    """Rows of points that stand for all, in order.

    Up to `EXACT` points all do. Of more, censored ones stand for each other, evenly spread, and of the others half of
    the rows are nearest the boundary, half evenly spread.

    Args:
        margin: (n,) of all points.
        truncated: whether margins at most 0 are censored.
    """
    if len(margin) <= EXACT:
        return np.arange(len(margin))
    is_censored = truncated & (margin <= 0.0)
    exact, censored = np.flatnonzero(~is_censored), np.flatnonzero(is_censored)
    order = exact[np.argsort(np.abs(margin[exact]), kind="stable")]
    nearest, others = order[: MOST // 2], np.sort(order[MOST // 2 :])
    parts = nearest, spread(others, MOST - MOST // 2), spread(censored, MOST_CENSORED)
    return np.sort(np.concatenate(parts))


def spread(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """At most so many of rows, evenly spread."""
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]


@dataclass(frozen=True)
class MarginData:
    """Margins, and what a regression takes from them.

    Attributes:
        features: (n, m) scaled features.
        margin: (n,) margins, in relation to `level`.
        truncated: whether margins at most 0 are censored.
        warping: name of the warping.
        unit: q, the unit of the margins before warping.
        sites: of the censored points; 0 outside `rows`.
        inducing: which of the points of the posterior are inducing points; None if it is that of all.
        level: of the simulator's margin at which `margin` is 0. Above 0, the boundary is known to lie below it alone.
    """

    features: Array
    margin: Array
    truncated: bool
    warping: str
    unit: float
    sites: CensoredSites
    inducing: NDArray[np.intp] | None = None
    level: float = 0.0

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Rows of the points of the posterior, (r,), by `informative`."""
        return informative(self.margin, self.truncated)

    @cached_property
    def points(self) -> Array:
        """Scaled features of the points of the posterior, (r, m)."""
        return self.features[self.rows]

    @property
    def support(self) -> Array:
        """Scaled features of the support points, (s, m)."""
        return self.points if self.inducing is None else self.points[self.inducing]

    @property
    def size_of_support(self) -> int:
        """Number of support points; 0 if all points are."""
        return 0 if self.inducing is None else len(self.inducing)

    def observed(self, noise_variance: float) -> tuple[Array, Array]:
        """Means and variances of the points' sites, each (r,): the warped margins where they are not censored.

        Args:
            noise_variance: of a warped margin.
        """
        margin = self.margin[self.rows]
        target, noise = self.warped(margin), np.full(len(margin), noise_variance)
        if self.truncated:
            failed = margin <= 0.0
            taken = np.isin(np.flatnonzero(self.margin <= 0.0), self.rows)
            precision = np.maximum(self.sites.precision[taken], 1e-12)
            noise[failed] += 1.0 / precision
            target[failed] = self.sites.linear[taken] / precision
        return target, noise

    @cached_property
    def is_clipped(self) -> bool:
        """Whether the margin is clipped: three or more different designs have the largest one, which is positive.

        A repeated design has the same margin again, which shows nothing.
        """
        top = self.margin.max()
        return bool(top > 0.0 and len(np.unique(self.features[self.margin == top], axis=0)) >= _TIED)

    def gap(self, moments: Moments, of_exact: Moments) -> tuple[float, float]:
        """How far below and above the level the boundary may lie, in the units of `warped`.

        Below, it is the way to the nearest failure. It is above where a failure has a larger margin, by the others
        alone: then no single level separates.

        Args:
            moments: of the warped margin at scaled features, (l, m) -> (l,) each.
            of_exact: the same from the points with a margin alone.
        """
        if not self.level:
            return 0.0, 0.0
        failed = self.features[self.margin <= 0.0]
        below, (mean, sd) = -moments(failed)[0], of_exact(failed)
        return float(np.maximum(below, 0.0).min()), float(np.maximum(mean - sd, 0.0).max())

    def warped(self, margin: Array) -> Array:
        """Margins, (l,), in the units of `moments`."""
        return WARPINGS[self.warping][0](margin / self.unit)
