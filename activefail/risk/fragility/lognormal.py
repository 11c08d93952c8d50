"""The lognormal curve nearest to a curve, and how far it misses it."""

import math
from typing import NamedTuple

import numpy as np

from activefail.risk.fragility.curve import Curve
from activefail.space import Array

_LEAST, _MOST = 0.1, 0.5
"""A curve that stays above the first or below the second has no median to fit."""

_STARTS = (0.1, 0.3, 0.8)
"""Dispersions from which the fit begins."""


class Lognormal(NamedTuple):
    """A lognormal curve beside another curve."""

    median: float
    dispersion: float  # β, the standard deviation of the level's logarithm
    misfit: float  # largest difference to the curve at a level of the ladder
    misfit_at: float  # this level
    rises: bool

    def at(self, levels: Array | float) -> Array:
        """Probabilities at levels."""
        from scipy.special import ndtr

        z = np.log(np.asarray(levels) / self.median) / self.dispersion
        return np.asarray(ndtr(z if self.rises else -z))


def why_not_fitted(curve: Curve) -> str:
    """Why no lognormal curve is fitted; empty if one is."""
    if curve.ladder.levels[0] <= 0.0:
        return "some levels of the curve are not positive"
    if curve.probability.max() < _MOST or curve.probability.min() > _LEAST:
        return f"the curve does not cover {100.0 * _LEAST:g} % to {100.0 * _MOST:g} %"
    return ""


def fit_lognormal(curve: Curve) -> Lognormal | None:
    """The lognormal curve with the least integral of the squared difference over the logarithm of the level.

    Returns:
        None if `why_not_fitted` gives a reason.
    """
    from scipy.optimize import least_squares
    from scipy.special import ndtr

    if why_not_fitted(curve):
        return None
    logarithms, sign = np.log(curve.ladder.levels), 1.0 if curve.rises else -1.0

    root_width = np.sqrt(np.gradient(logarithms))

    def differences(numbers: Array) -> Array:
        return np.asarray(ndtr(sign * (logarithms - numbers[0]) * math.exp(-numbers[1])) - curve.probability)

    def weighted(numbers: Array) -> Array:
        return np.asarray(root_width * differences(numbers))

    middle = curve.capacity(_MOST).level or float(curve.ladder.levels[np.argmax(curve.probability)])
    fits = [least_squares(weighted, [math.log(middle), math.log(start)]) for start in _STARTS]
    best = min(fits, key=lambda fit: float(fit.cost))
    missed = np.abs(differences(best.x))
    worst = int(np.argmax(missed))
    return Lognormal(
        median=math.exp(best.x[0]),
        dispersion=math.exp(best.x[1]),
        misfit=float(missed[worst]),
        misfit_at=float(curve.ladder.levels[worst]),
        rises=curve.rises,
    )
