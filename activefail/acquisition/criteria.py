"""Criteria that rank candidates by what their simulation would teach: one function each, larger is better.

Failure is f > 0, with a probit likelihood for the next label. Pointwise criteria take the latent's mean and standard
deviation at candidates, arrays of one shape, and return an array of that shape. They take NumPy arrays
(in the loop) or torch tensors (for BoTorch's optimisers, with gradients).

Look-ahead criteria also take the latent at R reference points, drawn from the design measure, and the covariance
between both. They average, over the references, the expected information of a candidate's label about each reference's
side of the boundary. The label is 1 with probability π = Φ(a), a = μ_*/√(1+σ_*²); a reference is safe with probability
P = Φ(b), b = −μ_q/σ_q. After a label 1 or 0 it is safe with probability

    P¹ = Z/π,  P⁰ = (P − Z)/(1 − π),  Z = BVN(a, b; ρ),  ρ = −Σ_q*/(σ_q √(1+σ_*²))

[LethamEtAl2022]. In terms of the covariance D = Z − πP: P¹ = P + D/π, P⁰ = P − D/(1 − π).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr, xlogy

from activefail.acquisition.bivariate import label_covariance
from activefail.acquisition.functions import Functions, Numbers
from activefail.names import Criterion

Pointwise: TypeAlias = Callable[[Numbers, Numbers], Numbers]
"""(mean, sd) -> value."""

_C2 = 0.5 * math.pi * math.log(2.0)
"""C² of the Gaussian that approximates the entropy of a probit likelihood [HoulsbyEtAl2011, section 4]."""

_LEAST = 1e-12
"""Lower bound for divisors: probabilities of labels and standard deviations of references."""

_PAIRS_AT_ONCE = 1 << 15
"""Candidates times references per evaluation, so that intermediate arrays stay in the processor's cache."""


_ON_ARRAYS = Functions(np.sqrt, np.exp, np.minimum, np.concatenate, ndtr, lambda x: xlogy(x, x), label_covariance)


def _functions(numbers: Numbers) -> Functions:
    """The functions for these numbers."""
    if isinstance(numbers, np.ndarray):
        return _ON_ARRAYS
    from activefail.acquisition.differentiable import ON_TENSORS

    return ON_TENSORS


def binary_entropy(p: Numbers) -> Numbers:
    """h(p) = −p log₂ p − (1−p) log₂(1−p) [bit]."""
    x_log_x = _functions(p).x_log_x
    return -(x_log_x(p) + x_log_x(1.0 - p)) / math.log(2.0)


def misclassification(p: Numbers) -> Numbers:
    """min(p, 1 − p): the probability that the more probable side is wrong."""
    return _functions(p).minimum(p, 1.0 - p)


def entropy(mean: Numbers, sd: Numbers) -> Numbers:
    """−|μ|/√(1+σ²), with the same ranking as the entropy h(Φ(μ/√(1+σ²))) of the next label.

    Far from the boundary h underflows and would rank all points equally.
    """
    return -abs(mean) / _functions(sd).sqrt(1.0 + sd**2)


def u(mean: Numbers, sd: Numbers) -> Numbers:
    """−|μ|/σ, with the same ranking as the probability of the latent's less probable sign.

    Source: [EchardEtAl2011, eq. 12] (U, which is minimised there).
    """
    return -abs(mean) / sd.clip(_LEAST)


def straddle(mean: Numbers, sd: Numbers) -> Numbers:
    """1.96 σ − |μ|: how far the latent's 95 % interval extends across the boundary.

    Source: [BryanEtAl2005, eq. 3].
    """
    return 1.96 * sd - abs(mean)


def bald(mean: Numbers, sd: Numbers) -> Numbers:
    """h(p) − C/√(σ²+C²)·exp(−μ²/(2(σ²+C²))): mutual information of the label and the latent [bit].

    Source: [HoulsbyEtAl2011, eq. 4].
    """
    on = _functions(mean)
    variance = sd**2 + _C2
    expected = on.sqrt(_C2 / variance) * on.exp(-(mean**2) / (2.0 * variance))
    return binary_entropy(on.ndtr(mean / on.sqrt(1.0 + sd**2))) - expected


def _average_over_references(
    gain: Callable[[Numbers, Numbers, Numbers], Numbers],
    mean: Numbers,
    sd: Numbers,
    reference_mean: Numbers,
    reference_sd: Numbers,
    covariance: Numbers,
) -> Numbers:
    """Average of gain(π, P, D) over the references, shapes (rows, 1), (R,), (rows, R) -> (rows, R); shape (n,)."""
    on = _functions(mean)
    label_sd = on.sqrt(1.0 + sd**2)
    a = mean / label_sd
    reference_sd = reference_sd.clip(_LEAST)
    b = -reference_mean / reference_sd
    probability, safe = on.ndtr(a).clip(_LEAST, 1.0 - _LEAST), on.ndtr(b)
    values = []
    rows = max(1, _PAIRS_AT_ONCE // len(b))
    for first in range(0, len(mean), rows):
        some = slice(first, first + rows)
        rho = -covariance[some] / (label_sd[some, None] * reference_sd)
        D = on.label_covariance(a[some, None], b, rho)
        values.append(gain(probability[some, None], safe, D).mean(1))
    return on.concatenate(values)


def _expected_fall(uncertainty: Callable[[Numbers], Numbers]) -> Callable[[Numbers, Numbers, Numbers], Numbers]:
    """H(P) − π·H(P¹) − (1−π)·H(P⁰) of an uncertainty H; not negative where H is concave."""

    def fall(probability: Numbers, safe: Numbers, D: Numbers) -> Numbers:
        one = (safe + D / probability).clip(0.0, 1.0)
        zero = (safe - D / (1.0 - probability)).clip(0.0, 1.0)
        return uncertainty(safe) - probability * uncertainty(one) - (1.0 - probability) * uncertainty(zero)

    return fall


def eavc(mean: Numbers, sd: Numbers, reference_mean: Numbers, reference_sd: Numbers, covariance: Numbers) -> Numbers:
    """π·|E_q[P − P¹]| + (1−π)·|E_q[P − P⁰]| = 2·|E_q[D]|: expected absolute change of the safe share of the space.

    Source: [LethamEtAl2022] (EAVC); the second form follows from P − P¹ = −D/π, P − P⁰ = D/(1−π).

    Args:
        mean, sd: (n,) moments of the latent at candidates.
        reference_mean, reference_sd: (R,) moments at references.
        covariance: (n, R) covariance between both.
    """
    average = _average_over_references(lambda _, __, D: D, mean, sd, reference_mean, reference_sd, covariance)
    return 2.0 * abs(average)


def globalmi(
    mean: Numbers, sd: Numbers, reference_mean: Numbers, reference_sd: Numbers, covariance: Numbers
) -> Numbers:
    """E_q[h(P) − π·h(P¹) − (1−π)·h(P⁰)]: information of the label about the side of a random design [bit].

    Source: [LethamEtAl2022] (GlobalMI). Arguments as for `eavc`.
    """
    fall = _expected_fall(binary_entropy)
    return _average_over_references(fall, mean, sd, reference_mean, reference_sd, covariance)


def sur(mean: Numbers, sd: Numbers, reference_mean: Numbers, reference_sd: Numbers, covariance: Numbers) -> Numbers:
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

    gain: Callable[[Numbers, Numbers, Numbers, Numbers, Numbers], Numbers]


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
