"""The criteria as BoTorch acquisition functions of a design, with gradients for BoTorch's optimisers.

A design is a point of the unit cube over the physical variables (`DesignSpace.from_unit`). The features are computed in
torch, which needs a feature map with a `formula`. The criteria are those of `criteria`, on tensors.

The campaign's loop does not use this module: it proposes designs with `batch_proposal`, which needs no
gradients. The module is for users of BoTorch. The model is `Latent.model`, a BoTorch `ApproximateGPyTorchModel`.
"""

from abc import abstractmethod

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.utils.transforms import t_batch_mode_transform
from torch import Tensor

from activefail.acquisition.batch_proposal import REFERENCES, fantasised
from activefail.acquisition.criteria import LookAhead, Pointwise, criterion
from activefail.acquisition.differentiable import columns
from activefail.errors import InputError
from activefail.features import FeatureMap
from activefail.names import Criterion
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Latent


class TorchFeatures(torch.nn.Module):
    """A differentiable feature map on points of the unit cube, (..., d) -> (..., m).

    Raises:
        InputError: if the map has no formula.
    """

    def __init__(self, features: FeatureMap, space: DesignSpace) -> None:
        super().__init__()
        if features.formula is None:
            raise InputError(
                f"Gradients require features that are expressions; {', '.join(features.names)} come from a Python "
                "function."
            )
        self._formula = features.formula
        self._logarithmic = torch.from_numpy(np.asarray(features.logarithmic, dtype=bool))
        self._center, self._spread = (torch.from_numpy(array) for array in features.scaling)
        self._space = space

    def forward(self, U: Tensor) -> Tensor:
        """Scaled features."""
        F = torch.stack(self._formula(columns(self._space, U)), dim=-1)
        F = torch.where(self._logarithmic, torch.where(self._logarithmic, F, 1.0).log(), F)
        return (F - self._center) / self._spread


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
        if not isinstance(latent, Latent):
            raise TypeError(
                "These criteria need a boundary that is learned from outcomes: set classifier.learns to "
                "'outcomes'. BoTorch's own acquisition functions also work on the model of a margin."
            )
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
        value: Pointwise,
        latent: Latent,
        features: FeatureMap,
        space: DesignSpace,
        X_pending: Tensor | None = None,
    ) -> None:
        super().__init__(latent, features, space, X_pending)
        self._criterion = value

    def _value(self, F: Tensor) -> Tensor:
        # One joint posterior of all designs: a batch of posteriors would repeat the training points' covariance.
        distribution = self.model.posterior(F).distribution
        value: Tensor = self._criterion(distribution.mean, distribution.variance.sqrt())
        return value


class _LookAhead(DesignAcquisition):
    """EAVC, GlobalMI or SUR (see `criteria`).

    Args:
        references: (R, d) designs, in the variables' units, that represent the design measure.
    """

    def __init__(
        self,
        value: LookAhead,
        latent: Latent,
        features: FeatureMap,
        space: DesignSpace,
        references: Array,
        X_pending: Tensor | None = None,
    ) -> None:
        self._criterion = value
        self._reference_features = torch.from_numpy(features(references))
        super().__init__(latent, features, space, X_pending)

    def _condition(self, latent: Latent) -> None:
        mean, sd = latent.moments(self._reference_features.numpy())
        self._reference_mean, self._reference_sd = torch.from_numpy(mean), torch.from_numpy(sd)
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
        sd = distribution.variance.sqrt()
        covariance = self._covariance(F)
        value: Tensor = self._criterion.gain(
            distribution.mean, sd, self._reference_mean, self._reference_sd, covariance
        )
        return value


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
    value = criterion(name)
    if isinstance(value, LookAhead):
        return _LookAhead(value, latent, features, space, space.sobol(REFERENCES, rng), X_pending)
    return _Pointwise(value, latent, features, space, X_pending)
