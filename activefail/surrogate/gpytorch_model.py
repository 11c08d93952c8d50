"""The trained posterior of a latent, of outcomes or of a margin, as a BoTorch model around a GPyTorch model.

Only BoTorch's acquisition functions (`activefail.acquisition.botorch`) need it. Training and prediction use the
matrices of `fitting` and `margin`: GPyTorch takes five times as long for the same numbers. Tests compare covariance,
posterior and bound. `Latent.model` and `MarginLatent.model` import this module when they are first read; the commands
load neither GPyTorch nor BoTorch.
"""

import math
from typing import Any

import gpytorch
import torch
from botorch.exceptions.errors import UnsupportedError
from botorch.models.approximate_gp import ApproximateGPyTorchModel
from botorch.models.gpytorch import GPyTorchModel
from botorch.models.model import Model
from torch import Tensor

from activefail.surrogate.covariance import (
    JITTER,
    OUTPUTSCALE_PRIOR,
    Hyperparameters,
    check_kernel,
    length_scale_prior,
)
from activefail.surrogate.fitting import Fit
from activefail.surrogate.margin import KERNEL as MARGIN_KERNEL
from activefail.surrogate.margin import LARGEST_FEATURE, NUGGET, MarginFit
from activefail.surrogate.sites import Projection


def covariance_module(kernel: str, dimension: int) -> gpytorch.kernels.Kernel:
    """An ARD covariance with a free output scale and the priors that the training uses, in double precision.

    Args:
        kernel: as for `covariance`.
        dimension: number of features.

    Raises:
        ValueError: if the kernel is unknown.
    """
    check_kernel(kernel)
    # exp, not softplus: L-BFGS then steps in the logarithm of each scale.
    positive = gpytorch.constraints.Positive(transform=torch.exp, inv_transform=torch.log)
    common = {
        "ard_num_dims": dimension,
        "lengthscale_constraint": positive,
        "lengthscale_prior": gpytorch.priors.LogNormalPrior(*length_scale_prior(dimension)),
    }
    base = gpytorch.kernels.RBFKernel(**common) if kernel == "rbf" else gpytorch.kernels.MaternKernel(nu=2.5, **common)
    outputscale_prior = gpytorch.priors.LogNormalPrior(*OUTPUTSCALE_PRIOR)
    return gpytorch.kernels.ScaleKernel(
        base, outputscale_constraint=positive, outputscale_prior=outputscale_prior
    ).double()


def set_hyperparameters(covariance: gpytorch.kernels.Kernel, hyperparameters: Hyperparameters) -> None:
    """Write the scales into a covariance from `covariance_module`."""
    with torch.no_grad():
        covariance.raw_outputscale.fill_(hyperparameters.log_outputscale)
        covariance.base_kernel.raw_lengthscale.copy_(torch.from_numpy(hyperparameters.log_lengthscale).reshape(1, -1))


class _VariationalGP(gpytorch.models.ApproximateGP):
    """The trained posterior in GPyTorch's whitened form. Without inducing points, all training points serve as such."""

    def __init__(self, trained: Fit) -> None:
        Z = trained.features if trained.inducing is None else trained.features[trained.inducing]
        n, m = Z.shape
        distribution = gpytorch.variational.CholeskyVariationalDistribution(n).double()
        strategy = gpytorch.variational.VariationalStrategy(
            self, Z, distribution, learn_inducing_locations=False, jitter_val=JITTER
        )
        super().__init__(strategy)
        self.mean_module = gpytorch.means.ConstantMean().double()
        self.covar_module = covariance_module(trained.kernel, m)
        self._load(trained, distribution, strategy)
        self.eval()
        # GPyTorch keeps what its first prediction computes. Kept with its graph, it can be differentiated only once.
        with torch.no_grad():
            self(Z[:1])

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    def _load(
        self,
        trained: Fit,
        distribution: gpytorch.variational.CholeskyVariationalDistribution,
        strategy: gpytorch.variational.VariationalStrategy,
    ) -> None:
        """Whiten the posterior of the sites: precision W, linear term b about the prior mean, at the training points X.

        With LLᵀ = k(Z, Z) and V = L⁻¹ k(Z, X), u ~ N(A⁻¹ V b, A⁻¹), where A = I + V W Vᵀ; V = Lᵀ if Z = X.
        """
        set_hyperparameters(self.covar_module, trained.hyperparameters)
        linear, precision = trained.sites
        with torch.no_grad():
            self.mean_module.constant.fill_(trained.hyperparameters.mean)
            prior = trained.prior
            V = prior.whitened if isinstance(prior, Projection) else torch.linalg.cholesky(prior).mT
            A = V @ (precision.unsqueeze(1) * V.mT)
            A.diagonal().add_(1.0)
            R = torch.linalg.cholesky(A)
            right = V @ (linear - precision * trained.hyperparameters.mean)
            distribution.variational_mean.copy_(torch.cholesky_solve(right.unsqueeze(1), R).squeeze(1))
            distribution.chol_variational_covar.copy_(torch.linalg.cholesky(torch.cholesky_inverse(R)))
            strategy.variational_params_initialized.fill_(1)
        self.requires_grad_(False)


def botorch_model(trained: Fit) -> ApproximateGPyTorchModel:
    """The posterior of a fit as a BoTorch model over the scaled features, (..., q, m)."""
    return ApproximateGPyTorchModel(
        model=_VariationalGP(trained), likelihood=gpytorch.likelihoods.BernoulliLikelihood()
    )


class MarginModel(gpytorch.models.ExactGP, GPyTorchModel):
    """The posterior of a margin's regression: a threshold minus the warped margin, so positive beyond the boundary.

    It has no training data of its own: its mean and covariance are those of the posterior, in closed form
    [RasmussenWilliams2006, eqs. 2.25, 2.26 and 2.42], with the variance of the estimated constant mean.
    """

    _num_outputs = 1

    def __init__(self, trained: MarginFit, threshold: float = 0.0) -> None:
        # BoTorch adds a likelihood's noise only on request; a margin has no more than its nugget.
        likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=gpytorch.constraints.Positive()).double()
        super().__init__(None, None, likelihood)
        self.covar_module = covariance_module(MARGIN_KERNEL, trained.features.shape[1])
        set_hyperparameters(self.covar_module, trained.hyperparameters)
        self.mean = trained.hyperparameters.mean - threshold
        self.nugget = NUGGET * math.exp(trained.hyperparameters.log_outputscale)
        likelihood.noise = self.nugget
        solved = trained.solved
        for name, array in (
            ("X", trained.support),
            ("L", solved.L),
            ("weights", solved.weights),
            ("ones", solved.ones),
        ):
            self.register_buffer(name, torch.tensor(array))
        self.total = solved.total
        self.eval()
        self.requires_grad_(False)

    @property
    def batch_shape(self) -> torch.Size:
        """The model is one Gaussian process."""
        return torch.Size()

    def condition_on_observations(self, X: Tensor, Y: Tensor, **options: Any) -> Model:
        """Refused: what a margin's observations are worth is more than a Gaussian likelihood can say.

        Raises:
            UnsupportedError: always.
        """
        raise UnsupportedError(
            "This model cannot be conditioned on observations: it is a posterior, without training data. "
            "`tell` or `add` the results, then `model` has learned from them."
        )

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        """The joint distribution at scaled features, (..., q, m)."""
        x = x.clamp(-LARGEST_FEATURE, LARGEST_FEATURE)
        k = self.covar_module(x, self.X).to_dense()  # (..., q, n)
        explained = torch.linalg.solve_triangular(self.L, k.mT, upper=False)
        left = 1.0 - k @ self.ones  # (..., q)
        covariance = self.covar_module(x).to_dense() - explained.mT @ explained
        covariance = covariance + left.unsqueeze(-1) * left.unsqueeze(-2) / self.total
        covariance = covariance + self.nugget * torch.eye(x.shape[-2], dtype=x.dtype)
        return gpytorch.distributions.MultivariateNormal(-(self.mean + k @ self.weights), covariance)
