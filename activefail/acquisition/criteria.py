"""Criteria that rank candidates by what their simulation would teach: one function each, larger is better.

Failure is f > 0, with a probit likelihood for the next label. Pointwise criteria take the latent's mean and standard
deviation at candidates, arrays of one shape, and return an array of that shape.

Look-ahead criteria also take the latent at R reference points, drawn from the design measure, and the covariance
between both. They average, over the references, the expected information of a candidate's label about each reference's
side of the boundary. The label is 1 with probability π = Φ(a), a = μ_*/√(1+σ_*²); a reference is safe with probability
P = Φ(b), b = −μ_q/σ_q. After a label 1 or 0 it is safe with probability

    P¹ = Z/π,  P⁰ = (P − Z)/(1 − π),  Z = BVN(a, b; ρ),  ρ = −Σ_q*/(σ_q √(1+σ_*²))

[LethamEtAl2022]. In terms of the covariance D = Z − πP: P¹ = P + D/π, P⁰ = P − D/(1 − π).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import ndtr, xlogy

from activefail.acquisition.bivariate import label_covariance
from activefail.space import Array

Criterion = Literal["entropy", "u", "straddle", "bald", "eavc", "globalmi", "sur"]

Pointwise: TypeAlias = Callable[[Array, Array], Array]
"""(mean, sd) -> value."""

_C2 = 0.5 * np.pi * np.log(2.0)
"""C² of the Gaussian that approximates the entropy of a probit likelihood [HoulsbyEtAl2011, section 4]."""

_LEAST = 1e-12
"""Lower bound for divisors: probabilities of labels and standard deviations of references."""

_PAIRS_AT_ONCE = 1 << 15
"""Candidates times references per evaluation, so that intermediate arrays stay in the processor's cache."""


def binary_entropy(p: Array) -> Array:
    """h(p) = −p log₂ p − (1−p) log₂(1−p) [bit]."""
    return np.asarray(-(xlogy(p, p) + xlogy(1.0 - p, 1.0 - p)) / np.log(2.0))


def misclassification(p: Array) -> Array:
    """min(p, 1 − p): the probability that the more probable side is wrong."""
    return np.minimum(p, 1.0 - p)


def entropy(mean: Array, sd: Array) -> Array:
    """−|μ|/√(1+σ²), with the same ranking as the entropy h(Φ(μ/√(1+σ²))) of the next label.

    Far from the boundary h underflows and would rank all points equally.
    """
    return np.asarray(-np.abs(mean) / np.sqrt(1.0 + sd**2))


def u(mean: Array, sd: Array) -> Array:
    """−|μ|/σ, with the same ranking as the probability of the latent's less probable sign.

    Source: [EchardEtAl2011, eq. 12] (U, which is minimised there).
    """
    return np.asarray(-np.abs(mean) / np.maximum(sd, _LEAST))


def straddle(mean: Array, sd: Array) -> Array:
    """1.96 σ − |μ|: how far the latent's 95 % interval extends across the boundary.

    Source: [BryanEtAl2005, eq. 3].
    """
    return np.asarray(1.96 * sd - np.abs(mean))


def bald(mean: Array, sd: Array) -> Array:
    """h(p) − C/√(σ²+C²)·exp(−μ²/(2(σ²+C²))): mutual information of the label and the latent [bit].

    Source: [HoulsbyEtAl2011, eq. 4].
    """
    variance = sd**2 + _C2
    expected = np.sqrt(_C2 / variance) * np.exp(-(mean**2) / (2.0 * variance))
    return np.asarray(binary_entropy(ndtr(mean / np.sqrt(1.0 + sd**2))) - expected)


def _average_over_references(
    gain: Callable[[Array, Array, Array], Array],
    mean: Array,
    sd: Array,
    reference_mean: Array,
    reference_sd: Array,
    covariance: Array,
) -> Array:
    """Average of gain(π, P, D) over the references, shapes (rows, 1), (R,), (rows, R) -> (rows, R); shape (n,)."""
    label_sd = np.sqrt(1.0 + sd**2)
    a = mean / label_sd
    reference_sd = np.maximum(reference_sd, _LEAST)
    b = -reference_mean / reference_sd
    probability, safe = np.clip(ndtr(a), _LEAST, 1.0 - _LEAST), ndtr(b)
    value = np.empty(len(mean))
    rows = max(1, _PAIRS_AT_ONCE // len(b))
    for first in range(0, len(mean), rows):
        some = slice(first, first + rows)
        rho = -covariance[some] / (label_sd[some, None] * reference_sd)
        D = label_covariance(a[some, None], b, rho)
        value[some] = gain(probability[some, None], safe, D).mean(axis=1)
    return value


def _expected_fall(uncertainty: Callable[[Array], Array]) -> Callable[[Array, Array, Array], Array]:
    """H(P) − π·H(P¹) − (1−π)·H(P⁰) of an uncertainty H; not negative where H is concave."""

    def fall(probability: Array, safe: Array, D: Array) -> Array:
        one = np.clip(safe + D / probability, 0.0, 1.0)
        zero = np.clip(safe - D / (1.0 - probability), 0.0, 1.0)
        return uncertainty(safe) - probability * uncertainty(one) - (1.0 - probability) * uncertainty(zero)

    return fall


def eavc(mean: Array, sd: Array, reference_mean: Array, reference_sd: Array, covariance: Array) -> Array:
    """π·|E_q[P − P¹]| + (1−π)·|E_q[P − P⁰]| = 2·|E_q[D]|: expected absolute change of the safe share of the space.

    Source: [LethamEtAl2022] (EAVC); the second form follows from P − P¹ = −D/π, P − P⁰ = D/(1−π).

    Args:
        mean, sd: (n,) moments of the latent at candidates.
        reference_mean, reference_sd: (R,) moments at references.
        covariance: (n, R) covariance between both.
    """
    average = _average_over_references(lambda _, __, D: D, mean, sd, reference_mean, reference_sd, covariance)
    return np.asarray(2.0 * np.abs(average))


def globalmi(mean: Array, sd: Array, reference_mean: Array, reference_sd: Array, covariance: Array) -> Array:
    """E_q[h(P) − π·h(P¹) − (1−π)·h(P⁰)]: information of the label about the side of a random design [bit].

    Source: [LethamEtAl2022] (GlobalMI). Arguments as for `eavc`.
    """
    fall = _expected_fall(binary_entropy)
    return _average_over_references(fall, mean, sd, reference_mean, reference_sd, covariance)


def sur(mean: Array, sd: Array, reference_mean: Array, reference_sd: Array, covariance: Array) -> Array:
    """E_q[m(P) − π·m(P¹) − (1−π)·m(P⁰)], m(p) = min(p, 1−p): expected decrease of the misclassified share.

    Source: [BectEtAl2012], stepwise uncertainty reduction with the probability of misclassification. It is exactly zero
    where neither label would change a reference's side. Arguments as for `eavc`.
    """
    fall = _expected_fall(misclassification)
    return _average_over_references(fall, mean, sd, reference_mean, reference_sd, covariance)


@dataclass(frozen=True)
class LookAhead:
    """A criterion that needs reference points.

    Attributes:
        gain: (mean, sd, reference_mean, reference_sd, covariance) -> value, such as `eavc`.
    """

    gain: Callable[[Array, Array, Array, Array, Array], Array]


def criterion(name: Criterion) -> Pointwise | LookAhead:
    """The named criterion.

    Raises:
        ValueError: if the name is unknown.
    """
    match name:
        case "entropy":
            return entropy
        case "u":
            return u
        case "straddle":
            return straddle
        case "bald":
            return bald
        case "eavc":
            return LookAhead(eavc)
        case "globalmi":
            return LookAhead(globalmi)
        case "sur":
            return LookAhead(sur)
        case _:
            raise ValueError(f"The criterion must be entropy, u, straddle, bald, eavc, globalmi or sur, got {name!r}.")
