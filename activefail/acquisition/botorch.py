"""The criteria as BoTorch acquisition functions of a design, with gradients for BoTorch's optimisers.

A design is a point of the unit cube over the physical variables (`DesignSpace.from_unit`). The features are computed in
torch, which needs a feature map with a `formula`. The values are those of `criteria`.

The campaign's loop does not use this module: it proposes designs with `activefail.acquisition.batch`, which needs no
gradients. The module is for users of BoTorch. The model is `Latent.model`, a BoTorch `ApproximateGPyTorchModel`.
"""

import math
from abc import abstractmethod
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.utils.transforms import t_batch_mode_transform
from torch import Tensor

from activefail.acquisition.batch import REFERENCES, fantasised
from activefail.acquisition.bivariate import label_covariance
from activefail.acquisition.criteria import Criterion
from activefail.errors import InputError
from activefail.features import FeatureMap
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Latent

_C2 = 0.5 * math.pi * math.log(2.0)
_LEAST = 1e-12


class TorchFeatures(torch.nn.Module):
    """A differentiable feature map on points of the unit cube, (..., d) -> (..., m).

    Raises:
        InputError: if the map has no formula.
    """

    def __init__(self, features: FeatureMap, space: DesignSpace) -> None:
        super().__init__()
        if features.formula is None:
            raise InputError(
                f"Gradients need features with a formula; {', '.join(features.names)} are defined by a function only."
            )
        self._formula = features.formula
        self._logarithmic = torch.from_numpy(np.asarray(features.logarithmic, dtype=bool))
        self._center, self._spread = torch.from_numpy(features.center), torch.from_numpy(features.spread)
        self._space = space

    def forward(self, U: Tensor) -> Tensor:
        """Scaled features."""
        columns = [
            parameter.quantile(u, torch.special.ndtri)
            for parameter, u in zip(self._space.parameters, U.unbind(-1), strict=True)
        ]
        F = torch.stack(self._formula(columns), dim=-1)
        F = torch.where(self._logarithmic, torch.where(self._logarithmic, F, 1.0).log(), F)
        return (F - self._center) / self._spread


class _LabelCovariance(torch.autograd.Function):
    """`bivariate.label_covariance` with its closed derivatives (those of BVN: [Genz2004, section 2])."""

    @staticmethod
    def forward(ctx: Any, a: Tensor, b: Tensor, rho: Tensor) -> Tensor:
        a, b, rho = torch.broadcast_tensors(a, b, rho)
        ctx.save_for_backward(a, b, rho)
        return torch.from_numpy(label_covariance(*(x.detach().numpy() for x in (a, b, rho))))

    @staticmethod
    def backward(ctx: Any, *by_value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        a, b, rho = ctx.saved_tensors
        rest = ((1.0 - rho) * (1.0 + rho)).clamp_min(1e-15)
        root = rest.sqrt()
        by_a = _density(a) * (torch.special.ndtr((b - rho * a) / root) - torch.special.ndtr(b))
        by_b = _density(b) * (torch.special.ndtr((a - rho * b) / root) - torch.special.ndtr(a))
        by_rho = torch.exp(-0.5 * (a * a + b * b - 2.0 * rho * a * b) / rest) / (2.0 * math.pi * root)
        (by,) = by_value
        return by * by_a, by * by_b, by * by_rho


def _density(x: Tensor) -> Tensor:
    return torch.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


def _binary_entropy(p: Tensor) -> Tensor:
    # At p = 0 and p = 1 the entropy is 0; its slope there is infinite and taken as 0.
    inside = (p > 0.0) & (p < 1.0)
    q = torch.where(inside, p, 0.5)
    return torch.where(inside, -(q * q.log2() + (1.0 - q) * (1.0 - q).log2()), 0.0)


def _misclassification(p: Tensor) -> Tensor:
    return torch.minimum(p, 1.0 - p)


class DesignAcquisition(AcquisitionFunction):
    """A criterion of single designs, points of the unit cube, (b, 1, d) -> (b,).

    Designs in flight (`set_X_pending`, also in the unit cube) are fantasised, so that BoTorch's sequential optimisation
    builds batches as `propose` does.

    Args:
        latent: latent of the boundary to learn.
        features: a map with a formula.
        space: the design space behind the unit cube.
        X_pending: (k, d) designs in flight.
    """

    def __init__(
        self, latent: Latent, features: FeatureMap, space: DesignSpace, X_pending: Tensor | None = None
    ) -> None:
        super().__init__(latent.model)
        self._latent = latent
        self._torch_features = TorchFeatures(features, space)
        self.set_X_pending(X_pending)

    def set_X_pending(self, X_pending: Tensor | None = None) -> None:
        """Fantasise designs, (k, d) in the unit cube, in place of earlier pending ones."""
        super().set_X_pending(X_pending)
        latent = self._latent
        if self.X_pending is not None and len(self.X_pending) > 0:
            latent = fantasised(latent, self._torch_features(self.X_pending).detach().numpy())
        self.model = latent.model
        self._condition(latent)

    def _condition(self, latent: Latent) -> None:
        """Prepare for a latent that includes the pending designs."""

    @t_batch_mode_transform(expected_q=1)
    def forward(self, X: Tensor) -> Tensor:
        """The criterion at designs, (b, 1, d) -> (b,)."""
        return self._value(self._torch_features(X.squeeze(-2)))

    @abstractmethod
    def _value(self, F: Tensor) -> Tensor:
        """The criterion at scaled features, (b, m) -> (b,)."""


class _Pointwise(DesignAcquisition):
    """Entropy, U, straddle or BALD (see `criteria`)."""

    def __init__(
        self,
        name: Criterion,
        latent: Latent,
        features: FeatureMap,
        space: DesignSpace,
        X_pending: Tensor | None = None,
    ) -> None:
        super().__init__(latent, features, space, X_pending)
        self._name = name

    def _value(self, F: Tensor) -> Tensor:
        # One joint posterior of all designs: a batch of posteriors would repeat the training points' covariance.
        distribution = self.model.posterior(F).distribution
        mean, variance = distribution.mean, distribution.variance
        sd = variance.sqrt()
        match self._name:
            case "entropy":
                value: Tensor = -mean.abs() / (1.0 + variance).sqrt()
            case "u":
                value = -mean.abs() / sd.clamp_min(_LEAST)
            case "straddle":
                value = 1.96 * sd - mean.abs()
            case _:
                p = torch.special.ndtr(mean / (1.0 + variance).sqrt())
                wide = variance + _C2
                value = _binary_entropy(p) - (_C2 / wide).sqrt() * torch.exp(-(mean**2) / (2.0 * wide))
        return value


class _LookAhead(DesignAcquisition):
    """EAVC, GlobalMI or SUR (see `criteria`).

    Args:
        references: (R, d) designs, in the variables' units, that represent the design measure.
    """

    def __init__(
        self,
        name: Criterion,
        latent: Latent,
        features: FeatureMap,
        space: DesignSpace,
        references: Array,
        X_pending: Tensor | None = None,
    ) -> None:
        self._name = name
        self._reference_features = torch.from_numpy(features(references))
        super().__init__(latent, features, space, X_pending)

    def _condition(self, latent: Latent) -> None:
        mean, sd = latent.moments(self._reference_features.numpy())
        self._reference_sd = torch.from_numpy(sd).clamp_min(_LEAST)
        self._b = -torch.from_numpy(mean) / self._reference_sd
        # Σ_xq = k(x, q) − k(x, Z) M, M = CᵀC k(Z, q), with the support points Z: a value costs k(x, Z) and k(x, q)
        # instead of a joint posterior of all references.
        readout, kernel = latent.readout, self.model.model.covar_module
        with torch.no_grad():
            self._explained = readout.root.T @ (
                readout.root @ kernel(readout.support, self._reference_features).to_dense()
            )
        self._support = readout.support

    def _covariance(self, F: Tensor) -> Tensor:
        """Σ between scaled features, (b, m), and the references, (b, R)."""
        kernel = self.model.model.covar_module
        covariance = kernel(F, self._reference_features).to_dense()
        covariance = covariance - kernel(F, self._support).to_dense() @ self._explained
        return torch.as_tensor(covariance)

    def _value(self, F: Tensor) -> Tensor:
        distribution = self.model.posterior(F).distribution
        label_sd = (1.0 + distribution.variance).sqrt()
        a = distribution.mean / label_sd
        rho = -self._covariance(F) / (label_sd.unsqueeze(-1) * self._reference_sd)
        D: Tensor = _LabelCovariance.apply(a.unsqueeze(-1), self._b, rho)  # b x R
        if self._name == "eavc":
            change: Tensor = 2.0 * D.mean(-1).abs()
            return change
        uncertainty = _binary_entropy if self._name == "globalmi" else _misclassification
        probability, safe = torch.special.ndtr(a).clamp(_LEAST, 1.0 - _LEAST).unsqueeze(-1), torch.special.ndtr(self._b)
        one = (safe + D / probability).clamp(0.0, 1.0)
        zero = (safe - D / (1.0 - probability)).clamp(0.0, 1.0)
        expected: Tensor = probability * uncertainty(one) + (1.0 - probability) * uncertainty(zero)
        fall: Tensor = (uncertainty(safe) - expected).mean(-1)
        return fall


def acquisition_function(
    name: Criterion,
    latent: Latent,
    features: FeatureMap,
    space: DesignSpace,
    rng: np.random.Generator,
    X_pending: Tensor | None = None,
) -> DesignAcquisition:
    """The named criterion as a BoTorch acquisition function over the unit cube.

    Args:
        rng: draws the reference points of a look-ahead criterion.
        X_pending: (k, d) designs in flight, in the unit cube.

    Raises:
        InputError: if the features have no formula.
        ValueError: if the name is unknown.
    """
    match name:
        case "entropy" | "u" | "straddle" | "bald":
            return _Pointwise(name, latent, features, space, X_pending)
        case "eavc" | "globalmi" | "sur":
            return _LookAhead(name, latent, features, space, space.sobol(REFERENCES, rng), X_pending)
        case _:
            raise ValueError(f"The criterion must be entropy, u, straddle, bald, eavc, globalmi or sur, got {name!r}.")
