"""Sobol' indices of a function of independent variables, by SALib, and the order of the variables by them."""

import importlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from activefail.errors import InputError
from activefail.space.space import Array

LEAST_SAMPLES = 16
"""Least number of points of the sample."""

RESAMPLES = 200
"""Resamples of the bootstrap."""

_FLAT = 0.01
"""Range of a function, over its mean or 1 − its mean, up to which it counts as constant."""

SEED = 1
"""Of the sample and the bootstrap. SALib takes 0 for no seed."""


class Estimate(NamedTuple):
    """A number with its interval."""

    value: float
    low: float
    high: float


class Index(NamedTuple):
    """The Sobol' indices of one variable."""

    name: str
    first: Estimate  # share of the variance that the variable explains alone
    total: Estimate  # that remains if all other variables are known


class Decomposition(NamedTuple):
    """The variance of a function over a sample, by its variables."""

    mean: float
    sd: float
    rarer: float  # the smaller of Σ y and Σ (1 − y): for a probability, the designs on the rarer side
    indices: tuple[Index, ...]  # of the variables, in order; empty if the function is almost constant

    @property
    def by_total(self) -> tuple[Index, ...]:
        """The indices by decreasing total index."""
        return tuple(sorted(self.indices, key=lambda index: -index.total.value))


NOTHING = Decomposition(math.nan, math.nan, math.nan, ())
"""Of a function without variables."""


def _salib() -> tuple[Any, Any]:
    """SALib's modules for the sample and the analysis."""
    try:
        return importlib.import_module("SALib.sample.sobol"), importlib.import_module("SALib.analyze.sobol")
    except ImportError:
        raise InputError(
            "sensitivity: requires the package SALib; install it with `pip install 'activefail[sensitivity]'`."
        ) from None


def checked_samples(samples: int) -> int:
    """The number of points of a sample, before any work.

    Raises:
        InputError: if it is no power of two of at least 16, or SALib is not installed.
    """
    _salib()
    if samples < LEAST_SAMPLES or samples & (samples - 1):
        raise InputError(f"samples: must be a power of two of at least {LEAST_SAMPLES}, got {samples}.")
    return samples


def decomposed(
    function: Callable[[Array], Array], names: Sequence[str], samples: int, confidence: float, seed: int = SEED
) -> Decomposition:
    """The Sobol' indices of a function of independent variables, uniform on the unit cube.

    Two samples A and B of a scrambled Sobol' sequence, and d samples that have one column of B and the others of A. The
    estimators are those of [SaltelliEtAl2010, table 2, (b) and (f)]: V(E(y | xⱼ)) from mean y_B (y_ABj − y_A), and
    E(V(y | all but xⱼ)) from mean (y_A − y_ABj)²/2. The interval is ± the normal quantile times the standard deviation
    of a bootstrap over the points, which treats them as independent.

    Args:
        function: points of the unit cube, (n, d) -> values, (n,); evaluated at `samples` · (d + 2) points.
        names: of the d variables.
        samples: points of A; a power of two.
        confidence: of the intervals.
        seed: of the sample and the bootstrap; positive.

    Raises:
        InputError: if SALib is not installed.
    """
    sampling, analysis = _salib()
    d = len(names)
    problem = {"num_vars": d, "names": list(names), "bounds": [[0.0, 1.0]] * d}
    U = sampling.sample(problem, samples, calc_second_order=False, seed=np.random.default_rng(seed))
    y = function(U)
    # A and B alone are a sample of the cube.
    plain = np.concatenate([y[:: d + 2], y[d + 1 :: d + 2]])
    mean, sd, rarer = float(plain.mean()), float(plain.std()), float(min(plain.sum(), (1.0 - plain).sum()))
    # Beyond rounding errors and the ripples of a surrogate there must be something to explain.
    if np.ptp(plain) <= max(1e-9, _FLAT * min(abs(mean), abs(1.0 - mean))):
        return Decomposition(mean, sd, rarer, ())
    analysed = analysis.analyze(
        problem, y, calc_second_order=False, num_resamples=RESAMPLES, conf_level=confidence, seed=seed
    )

    def estimate(kind: str, column: int) -> Estimate:
        value, half = float(analysed[kind][column]), float(analysed[f"{kind}_conf"][column])
        return Estimate(value, value - half, value + half)

    indices = (Index(name, estimate("S1", column), estimate("ST", column)) for column, name in enumerate(names))
    return Decomposition(mean, sd, rarer, tuple(indices))
