"""Correlated variables: the copula that gives the variables' values the stated correlations."""

from collections.abc import Sequence

import numpy as np

from activefail.errors import InputError
from activefail.parameter import Array, Parameter

_NODES = 64
"""Nodes of Gauss–Hermite quadrature, of each variable of a pair."""


def nataf_factor(parameters: Sequence[Parameter], correlation: Sequence[tuple[str, str, float]]) -> Array:
    """The lower Cholesky factor L of the copula's correlation matrix, (d, d): L z are correlated standard normals.

    The joint distribution is a Gaussian copula with the variables' own distributions (the Nataf transformation). The
    copula's coefficient ρ₀ of a pair follows from the coefficient ρ of their values: ρ is the covariance of F₁⁻¹(Φ(z₁))
    and F₂⁻¹(Φ(ρ₀ z₁ + √(1 − ρ₀²) z₂)) divided by both standard deviations [LiuDerKiureghian1986, eq. 12].

    Raises:
        InputError: naming the entry of `correlation`.
    """
    names = [parameter.name for parameter in parameters]
    R, pairs = np.eye(len(names)), list[set[str]]()
    for number, (one, other, rho) in enumerate(correlation):
        entry = f"correlation[{number}]"
        for name in (one, other):
            if name not in names:
                raise InputError(f"{entry}: {name!r} is not a variable; the variables are {', '.join(names)}.")
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
