"""The latent of a boundary that is learned from outcomes, by the variational classifier or by a model of the user's."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import torch
from botorch.models.model import Model
from botorch.settings import validate_input_scaling
from numpy.typing import NDArray
from torch import Tensor

from activefail.errors import InputError
from activefail.learning.model.boundary_gp import moments
from activefail.learning.model.fitting import Fit, fit, leave_one_out, outcome_prior
from activefail.learning.model.kernels import MakeKernel, Prior
from activefail.learning.model.likelihoods import Probit, probability
from activefail.learning.model.moments import LinkedMoments, MarginMoments, Moments
from activefail.space.space import Array


@dataclass(frozen=True)
class Latent:
    """The latent of one boundary: positive where the outcome is probably at least that severe.

    Attributes:
        trained: the fit to labels 1 for outcomes at least as severe as the boundary's, 0 for the others.
    """

    trained: Fit

    margin_data = None
    """It is learned from no margin (see `margin.MarginLatent`)."""

    @property
    def model(self) -> Model:
        """The posterior as a BoTorch model over the scaled features, (..., q, m)."""
        return self.trained.model

    @property
    def features(self) -> Array:
        """Scaled features of the training points, (n, m)."""
        return self.trained.features.numpy()

    @property
    def length_scales(self) -> Array | None:
        """Length scales of a built-in kernel, (m,)."""
        return self.trained.prior.length_scales

    @property
    def prior_sd(self) -> float:
        """Of `moments` where no simulation is near."""
        return self.trained.prior.sd

    @property
    def is_one_sided(self) -> bool:
        """Whether all training points are on one side of the boundary."""
        labels = self.trained.labels
        return bool((labels == labels[0]).all())

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        return self._linked(*moments(self.model, F))

    def left_out(self) -> Moments:
        """Moments at each training point without its own label, with hyperparameters unchanged, (n,)."""
        return self._linked(*leave_one_out(self.trained))

    def _linked(self, mean: Array, sd: Array) -> Moments:
        likelihood = self.trained.prior.likelihood
        if type(likelihood) is Probit:
            return Moments(mean, sd)
        return LinkedMoments.of(mean, sd, partial(probability, likelihood))


@dataclass(frozen=True)
class CustomLatent:
    """The latent of a boundary by a model of the user's; it has the methods of `Latent`.

    A model with a Bernoulli likelihood says how probable a label is. Of any other the sign is the side of the boundary.

    Attributes:
        make: (features, labels) -> BoTorch model.
        features: (n, m) scaled features of the training points.
        labels: (n,), 1 for outcomes at least as severe as the boundary's, 0 for the others.
    """

    make: Callable[[Tensor, Tensor], Model]
    features: Array
    labels: Array

    margin_data = None
    length_scales = None
    prior_sd = math.inf
    """It is not known."""

    @cached_property
    def model(self) -> Model:
        """The user's model over the scaled features, (..., q, m)."""
        return self._of(np.ones(len(self.labels), dtype=bool))

    def _of(self, rows: NDArray[np.bool_]) -> Model:
        # Features are scaled over the design space, not over the data: BoTorch's warnings of it say nothing.
        with torch.random.fork_rng(), validate_input_scaling(False):
            torch.manual_seed(0)  # the same data give the same model
            model = self.make(torch.from_numpy(self.features[rows]), torch.from_numpy(self.labels[rows]))
        if not isinstance(model, Model):
            raise InputError(f"classifier.model: must return a BoTorch model, got {type(model).__name__}.")
        model.eval()
        return model

    @property
    def is_one_sided(self) -> bool:
        """Whether all training points are on one side of the boundary."""
        return bool((self.labels == self.labels[0]).all())

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        return self._linked(self.model, *moments(self.model, F))

    def left_out(self) -> Moments:
        """Moments at each training point of a model without it and a tenth of the others, (n,)."""
        mean, sd = np.empty(len(self.labels)), np.empty(len(self.labels))
        tenths = np.arange(len(self.labels)) % 10
        for tenth in np.unique(tenths):
            rows = tenths == tenth
            mean[rows], sd[rows] = moments(self._of(~rows), self.features[rows])
        return self._linked(self.model, mean, sd)

    def _linked(self, model: Model, mean: Array, sd: Array) -> Moments:
        if not (np.isfinite(mean).all() and np.isfinite(sd).all()):
            raise InputError("classifier.model: its posterior must be finite at every design, got one that is not.")
        likelihood = getattr(model, "likelihood", None)
        if isinstance(likelihood, Probit):
            return LinkedMoments.of(mean, sd, partial(probability, likelihood))
        return MarginMoments(mean, sd)


@dataclass(frozen=True)
class VariationalGP:
    """Learns latents as variational GPs.

    Attributes:
        kernel: "rbf" or "matern52", or the user's function of the number of features.
        likelihood: makes a GPyTorch likelihood of labels 0 and 1.
        repeatable: whether equal designs have equal results; otherwise regressions of margins learn their noise.
    """

    kernel: str | MakeKernel = "rbf"
    likelihood: Callable[[], Any] = Probit
    repeatable: bool = True

    def default_prior(self, dimension: int) -> Prior:
        """The prior of features with this dimension, with its default parameters."""
        return outcome_prior(self.kernel, dimension, self.likelihood)

    def learned(self, F: Array, beyond: NDArray[np.bool_], warm: object = None) -> Latent:
        """The latent of scaled features, (n, m), and sides of the boundary, (n,), from an earlier one of the first."""
        start = warm.trained if isinstance(warm, Latent) else None
        return Latent(fit(torch.from_numpy(F), torch.from_numpy(beyond.astype(float)), self.default_prior, start))


@dataclass(frozen=True)
class CustomModel:
    """Learns latents by models of the user's.

    Attributes:
        make: (features, labels) -> BoTorch model, of tensors (n, m) and (n,) of 0 and 1.
        repeatable: as for `VariationalGP`.
    """

    make: Callable[[Tensor, Tensor], Model]
    repeatable: bool = True

    def learned(self, F: Array, beyond: NDArray[np.bool_], warm: object = None) -> CustomLatent:
        """As `VariationalGP.learned`; nothing is taken from an earlier latent."""
        latent = CustomLatent(self.make, F, beyond.astype(float))
        latent.moments(F[:1])  # it is made here, where errors of custom code are caught
        return latent


Learner = VariationalGP | CustomModel
