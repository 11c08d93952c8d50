"""Criteria that rank candidates by what their simulation would teach, as BoTorch acquisition functions over features.

Failure is f > 0, with a probit likelihood for the next label. Pointwise criteria take the latent's mean and standard
deviation at candidates, (n,), and return (n,); larger is better.

Look-ahead criteria also take the latent at R reference points, drawn from the design measure, and the covariance
between both. They average, over the references, the expected information of a candidate's label about each reference's
side of the boundary. The label is 1 with probability π = Φ(a), a = μ_*/√(1+σ_*²); a reference is safe with probability
P = Φ(b), b = −μ_q/σ_q. After a label 1 or 0 it is safe with probability

    P¹ = Z/π,  P⁰ = (P − Z)/(1 − π),  Z = BVN(a, b; ρ),  ρ = −Σ_q*/(σ_q √(1+σ_*²))

[LethamEtAl2022]. In terms of the covariance D = Z − πP: P¹ = P + D/π, P⁰ = P − D/(1 − π).
"""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from botorch.acquisition import AcquisitionFunction
from botorch.models.model import Model
from scipy.special import owens_t
from torch import Tensor

from activefail.learning.model.boundary_gp import marginal, posterior_covariance, share_left
from activefail.learning.names import Criterion

REFERENCES = 1024
"""Designs in the Sobol' sample that represents the design measure in a look-ahead criterion; a power of two."""

Pointwise = Callable[[Tensor, Tensor], Tensor]
"""(mean, sd) -> value."""

Gain = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
"""(mean, sd, reference_mean, reference_sd, covariance) -> value."""

Make = Callable[[Model, Tensor], AcquisitionFunction]
"""(model, references) -> acquisition function; the references, (R, m), are scaled features of the design measure."""

_C2 = 0.5 * math.pi * math.log(2.0)
"""C² of the Gaussian that approximates the entropy of a probit likelihood [HoulsbyEtAl2011, section 4]."""

_SHARED = 0.125
"""Power of the share of a variance that counts as the share of an entropy (see `JointEntropy`). With 1/2, campaigns
learn less; 1/32 leaves more near neighbours in a batch."""

_LEAST = 1e-12
"""Lower bound for divisors: probabilities of labels and standard deviations of references."""

_FARTHEST = 38.0
"""Standard deviations beyond which Φ is 0 or 1 in double precision."""

_PAIRS_AT_ONCE = 1 << 15
"""Candidates times references per evaluation, so that intermediate arrays stay in the processor's cache."""


def _entropy_of(p: Tensor) -> Tensor:
    """h(p) = −p log₂ p − (1−p) log₂(1−p) [bit]."""
    # Off 0, where the slope of p log p is infinite.
    p, rest = p.clamp_min(1e-300), (1.0 - p).clamp_min(1e-300)
    return -(p * p.log() + rest * rest.log()) / math.log(2.0)


def _misclassification(p: Tensor) -> Tensor:
    """min(p, 1 − p): the probability that the more probable side is wrong."""
    return torch.minimum(p, 1.0 - p)


def entropy(mean: Tensor, sd: Tensor) -> Tensor:
    """−|μ|/√(1+σ²), with the same ranking as the entropy h(Φ(μ/√(1+σ²))) of the next label.

    Far from the boundary h underflows and would rank all points equally.
    """
    return -mean.abs() / (1.0 + sd**2).sqrt()


def u(mean: Tensor, sd: Tensor) -> Tensor:
    """−|μ|/σ, with the same ranking as the probability of the latent's less probable sign.

    Source: [EchardEtAl2011, eq. 12] (U, which is minimised there).
    """
    return -mean.abs() / sd.clamp_min(_LEAST)


def straddle(mean: Tensor, sd: Tensor) -> Tensor:
    """1.96 σ − |μ|: how far the latent's 95 % interval extends across the boundary.

    Source: [BryanEtAl2005, eq. 3].
    """
    return 1.96 * sd - mean.abs()


def bald(mean: Tensor, sd: Tensor) -> Tensor:
    """h(p) − C/√(σ²+C²)·exp(−μ²/(2(σ²+C²))): mutual information of the label and the latent [bit].

    Source: [HoulsbyEtAl2011, eq. 4].
    """
    variance = sd**2 + _C2
    expected = (_C2 / variance).sqrt() * torch.exp(-(mean**2) / (2.0 * variance))
    return _entropy_of(torch.special.ndtr(mean / (1.0 + sd**2).sqrt())) - expected


class _LabelCovariance(torch.autograd.Function):
    """BVN(a, b; ρ) − Φ(a)·Φ(b): the covariance of the events x < a and y < b, by Owen's T function [Owen1956].

    With its closed derivatives (those of BVN: [Genz2004, section 2]).
    """

    @staticmethod
    def forward(ctx: Any, a: Tensor, b: Tensor, rho: Tensor) -> Tensor:
        ctx.save_for_backward(*torch.broadcast_tensors(a, b, rho))
        x, y = (_off_zero(z.clamp(-_FARTHEST, _FARTHEST)) for z in (a, b))
        root = ((1.0 - rho) * (1.0 + rho)).clamp_min(1e-15).sqrt()
        of_x, of_y = (owens_t(p.numpy(), ((q / p - rho) / root).numpy()) for p, q in ((x, y), (y, x)))
        P, Q = torch.special.ndtr(x), torch.special.ndtr(y)
        D: Tensor = 0.5 * (P + Q) - torch.from_numpy(of_x + of_y) - 0.5 * (x * y < 0.0) - P * Q
        return D

    @staticmethod
    def backward(ctx: Any, *by_value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        a, b, rho = ctx.saved_tensors
        rest = ((1.0 - rho) * (1.0 + rho)).clamp_min(1e-15)
        root, ndtr = rest.sqrt(), torch.special.ndtr
        by_a = _density(a) * (ndtr((b - rho * a) / root) - ndtr(b))
        by_b = _density(b) * (ndtr((a - rho * b) / root) - ndtr(a))
        by_rho = torch.exp(-0.5 * (a * a + b * b - 2.0 * rho * a * b) / rest) / (2.0 * math.pi * root)
        return by_value[0] * by_a, by_value[0] * by_b, by_value[0] * by_rho


def _off_zero(x: Tensor) -> Tensor:
    return torch.where(x == 0.0, 1e-300, x)


def _density(x: Tensor) -> Tensor:
    return torch.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


def _average_over_references(
    gain: Callable[[Tensor, Tensor, Tensor], Tensor],
    mean: Tensor,
    sd: Tensor,
    reference_mean: Tensor,
    reference_sd: Tensor,
    covariance: Tensor,
) -> Tensor:
    """Average of gain(π, P, D) over the references, shapes (rows, 1), (R,), (rows, R) -> (rows, R); shape (n,)."""
    label_sd = (1.0 + sd**2).sqrt()
    a = mean / label_sd
    reference_sd = reference_sd.clamp_min(_LEAST)
    b = -reference_mean / reference_sd
    probability, safe = torch.special.ndtr(a).clamp(_LEAST, 1.0 - _LEAST), torch.special.ndtr(b)
    values = []
    rows = max(1, _PAIRS_AT_ONCE // len(b))
    for first in range(0, len(mean), rows):
        some = slice(first, first + rows)
        rho = -covariance[some] / (label_sd[some, None] * reference_sd)
        D = torch.as_tensor(_LabelCovariance.apply(a[some, None], b, rho))
        values.append(gain(probability[some, None], safe, D).mean(1))
    return torch.cat(values)


def _expected_fall(uncertainty: Callable[[Tensor], Tensor]) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """H(P) − π·H(P¹) − (1−π)·H(P⁰) of an uncertainty H; not negative where H is concave."""

    def fall(probability: Tensor, safe: Tensor, D: Tensor) -> Tensor:
        one = (safe + D / probability).clamp(0.0, 1.0)
        zero = (safe - D / (1.0 - probability)).clamp(0.0, 1.0)
        return uncertainty(safe) - probability * uncertainty(one) - (1.0 - probability) * uncertainty(zero)

    return fall


def eavc(mean: Tensor, sd: Tensor, reference_mean: Tensor, reference_sd: Tensor, covariance: Tensor) -> Tensor:
    """π·|E_q[P − P¹]| + (1−π)·|E_q[P − P⁰]| = 2·|E_q[D]|: expected absolute change of the safe share of the space.

    Source: [LethamEtAl2022] (EAVC); the second form follows from P − P¹ = −D/π, P − P⁰ = D/(1−π).

    Args:
        mean, sd: (n,) moments of the latent at candidates.
        reference_mean, reference_sd: (R,) moments at references.
        covariance: (n, R) covariance between both.
    """
    average = _average_over_references(lambda _, __, D: D, mean, sd, reference_mean, reference_sd, covariance)
    return 2.0 * average.abs()


def globalmi(mean: Tensor, sd: Tensor, reference_mean: Tensor, reference_sd: Tensor, covariance: Tensor) -> Tensor:
    """E_q[h(P) − π·h(P¹) − (1−π)·h(P⁰)]: information of the label about the side of a random design [bit].

    Source: [LethamEtAl2022] (GlobalMI). Arguments as for `eavc`.
    """
    fall = _expected_fall(_entropy_of)
    return _average_over_references(fall, mean, sd, reference_mean, reference_sd, covariance)


def sur(mean: Tensor, sd: Tensor, reference_mean: Tensor, reference_sd: Tensor, covariance: Tensor) -> Tensor:
    """E_q[m(P) − π·m(P¹) − (1−π)·m(P⁰)], m(p) = min(p, 1−p): expected decrease of the misclassified share.

    Source: [BectEtAl2012], stepwise uncertainty reduction with the probability of misclassification. It is exactly zero
    where neither label would change a reference's side. Arguments as for `eavc`.
    """
    fall = _expected_fall(_misclassification)
    return _average_over_references(fall, mean, sd, reference_mean, reference_sd, covariance)


class PointwiseCriterion(AcquisitionFunction):
    """Entropy, U, straddle or BALD of single points of scaled features, (..., 1, m) -> (...)."""

    def __init__(self, model: Model, value: Pointwise) -> None:
        super().__init__(model)
        self._value = value

    def forward(self, X: Tensor) -> Tensor:
        """The criterion."""
        return self._value(*marginal(self.model, X.reshape(-1, X.shape[-1]))).reshape(X.shape[:-2])


class JointEntropy(AcquisitionFunction):
    """Entropy of the next label, which a batch shares, of single points of scaled features, (..., 1, m) -> (...).

    A candidate's label has less entropy, the more the designs chosen before it will tell of it. Where their latents'
    values would leave a share r of its variance, r^`_SHARED` of the entropy counts: nothing at a copy, also where
    labels are noise. The logarithms of both factors are added, as squares. The first design of a batch is that of
    `entropy`, to the last bit.
    """

    def forward(self, X: Tensor) -> Tensor:
        """The criterion."""
        F = X.reshape(-1, X.shape[-1])
        repelled = (-2.0 * _SHARED * _C2 * share_left(self.model, F).log()).sqrt()
        return -torch.hypot(entropy(*marginal(self.model, F)), repelled).reshape(X.shape[:-2])


class LookAheadCriterion(AcquisitionFunction):
    """EAVC, GlobalMI or SUR of single points of scaled features, (n, 1, m) -> (n,).

    Args:
        model: of the latent.
        gain: the criterion.
        references: (R, m) scaled features of designs that represent the design measure.
    """

    def __init__(self, model: Model, gain: Gain, references: Tensor) -> None:
        super().__init__(model)
        self._gain, self._references = gain, references
        with torch.no_grad():
            self._moments = marginal(model, references)

    def forward(self, X: Tensor) -> Tensor:
        """The criterion."""
        F = X.squeeze(-2)
        return self._gain(
            *marginal(self.model, F), *self._moments, posterior_covariance(self.model, F, self._references)
        )


@dataclass(frozen=True)
class Choosing:
    """How designs are chosen.

    Attributes:
        make: makes the acquisition function.
        references: number of designs that it needs to represent the design measure; a power of two, or 0.
        is_custom: whether it is the user's, also for boundaries that are learned from a margin.
    """

    make: Make
    references: int = 0
    is_custom: bool = False


_POINTWISE: dict[str, Pointwise] = {"entropy": entropy, "u": u, "straddle": straddle, "bald": bald}
_LOOK_AHEAD: dict[str, Gain] = {"eavc": eavc, "globalmi": globalmi, "sur": sur}


def criterion(name: Criterion) -> Choosing:
    """The named criterion."""
    if name == "joint_entropy":
        return Choosing(lambda model, references: JointEntropy(model))
    if name in _POINTWISE:
        return Choosing(lambda model, references: PointwiseCriterion(model, _POINTWISE[name]))
    return Choosing(lambda model, references: LookAheadCriterion(model, _LOOK_AHEAD[name], references), REFERENCES)


def custom_criterion(function: Callable[..., AcquisitionFunction]) -> Choosing:
    """The user's function of a BoTorch model, and of `references`, (R, m), if it has a parameter of that name."""
    if "references" not in inspect.signature(function).parameters:
        return Choosing(lambda model, references: function(model), 0, True)
    return Choosing(lambda model, references: function(model, references=references), REFERENCES, True)
