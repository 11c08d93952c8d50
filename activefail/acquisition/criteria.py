"""Where a simulation would teach most: one function a criterion, larger is better.

Every criterion takes the latent's mean and standard deviation at candidate points, arrays of one shape, and returns an
array of that shape. Failure is f > 0 under a probit likelihood.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.special import ndtr, xlogy

from activefail.space import Array

Criterion = Literal["entropy", "bald"]

_C2 = 0.5 * np.pi * np.log(2.0)
"""C² of the Gaussian that approximates the entropy of a probit likelihood (Houlsby et al. 2011, section 4)."""


def binary_entropy(p: Array) -> Array:
    """h(p) = −p log₂ p − (1−p) log₂(1−p) [bit]."""
    return np.asarray(-(xlogy(p, p) + xlogy(1.0 - p, 1.0 - p)) / np.log(2.0))


def entropy(mean: Array, sd: Array) -> Array:
    """−|μ|/√(1+σ²), which ranks as the entropy h(Φ(μ/√(1+σ²))) of the next label.

    The argument of Φ instead of h itself: far from the boundary h underflows and would rank all points alike.
    """
    return np.asarray(-np.abs(mean) / np.sqrt(1.0 + sd**2))


def bald(mean: Array, sd: Array) -> Array:
    """h(p) − C/√(σ²+C²)·exp(−μ²/(2(σ²+C²))): what the label tells about the latent [bit].

    Source: Houlsby et al. 2011, eq. 4.
    """
    variance = sd**2 + _C2
    expected = np.sqrt(_C2 / variance) * np.exp(-(mean**2) / (2.0 * variance))
    return np.asarray(binary_entropy(ndtr(mean / np.sqrt(1.0 + sd**2))) - expected)


def criterion(name: Criterion) -> Callable[[Array, Array], Array]:
    """The named criterion.

    Raises:
        ValueError: if there is none of that name.
    """
    match name:
        case "entropy":
            return entropy
        case "bald":
            return bald
        case _:
            raise ValueError(f"The criterion must be entropy or bald, got {name!r}.")
