"""The prior of a latent in GPyTorch: a constant mean, a kernel and a likelihood, with priors of their parameters."""

import math
from collections.abc import Callable
from typing import Any

import gpytorch
import numpy as np
import torch
from botorch.optim.closures.core import NdarrayOptimizationClosure
from botorch.optim.utils import get_bounds_as_ndarray
from scipy.optimize import minimize
from torch import Tensor

from activefail.learning.model.covariance import correlation

LEARNED_ON = 1000
"""Most points for learning hyperparameters: a step of the search costs the cube of their number."""

MakeKernel = Callable[[int], gpytorch.kernels.Kernel]
"""Number of features -> kernel: what a user's `classifier.kernel` is."""

POSITIVE = {"transform": torch.exp, "inv_transform": torch.log}
"""exp, not softplus: L-BFGS then steps in the logarithm of each scale."""

Bounds = dict[str, tuple[float | None, float | None]]


class _Correlation(torch.autograd.Function):
    """`covariance.correlation` of features, with its closed derivative by the length scales."""

    @staticmethod
    def forward(ctx: Any, F: Tensor, G: Tensor, lengthscale: Tensor, kernel: str) -> Tensor:
        A, B = (F / lengthscale).numpy(), (G / lengthscale).numpy()
        K, slope = correlation(kernel, A, B, with_slope=ctx.needs_input_grad[2])
        if slope is not None:
            ctx.save_for_backward(torch.from_numpy(A), torch.from_numpy(B), lengthscale, torch.from_numpy(slope))
        return torch.from_numpy(K)

    @staticmethod
    def backward(ctx: Any, *by_value: Tensor) -> tuple[None, None, Tensor, None]:
        A, B, lengthscale, slope = ctx.saved_tensors
        H = by_value[0] * slope
        by_logarithm = H.sum(1) @ A.square() + H.sum(0) @ B.square() - 2.0 * torch.einsum("im,im->m", A, H @ B)
        return None, None, by_logarithm.unsqueeze(0) / lengthscale, None


class _BuiltIn(gpytorch.kernels.Kernel):
    """A kernel of GPyTorch, faster where no derivative by the features is needed."""

    name: str

    def forward(self, x1: Tensor, x2: Tensor, diag: bool = False, **params: Any) -> Tensor:
        """Correlations of features, (..., n, m) and (..., l, m) -> (..., n, l)."""
        if diag or x1.dim() > 2 or x2.dim() > 2 or x1.requires_grad or x2.requires_grad:
            return torch.as_tensor(super().forward(x1, x2, diag=diag, **params))
        return torch.as_tensor(_Correlation.apply(x1, x2, self.lengthscale, self.name))


class Matern52(_BuiltIn, gpytorch.kernels.MaternKernel):
    """Matérn-5/2, whose smoothness is GPyTorch's default."""

    name = "matern52"


class SquaredExponential(_BuiltIn, gpytorch.kernels.RBFKernel):
    """The squared exponential."""

    name = "rbf"


def scaled_kernel(
    kernel: str, dimension: int, of_lengthscale: tuple[float, float], of_outputscale: tuple[float, float] | None
) -> gpytorch.kernels.ScaleKernel:
    """An ARD kernel with a free output scale, in double precision.

    Args:
        kernel: "rbf" or "matern52".
        dimension: number of features.
        of_lengthscale, of_outputscale: mean and standard deviation of the logarithms' normal priors.
    """
    positive, log_normal = gpytorch.constraints.Positive(**POSITIVE), gpytorch.priors.LogNormalPrior
    base = (SquaredExponential if kernel == "rbf" else Matern52)(
        ard_num_dims=dimension, lengthscale_constraint=positive, lengthscale_prior=log_normal(*of_lengthscale)
    )
    prior = None if of_outputscale is None else log_normal(*of_outputscale)
    return gpytorch.kernels.ScaleKernel(base, outputscale_constraint=positive, outputscale_prior=prior).double()


class Sloped(gpytorch.kernels.ScaleKernel):
    """A scaled kernel plus the kernel of a linear trend, whose slopes have one variance: that of `slope`."""

    def __init__(self, of: gpytorch.kernels.ScaleKernel) -> None:
        super().__init__(of.base_kernel, outputscale_constraint=of.raw_outputscale_constraint)
        self.register_parameter("raw_slope", torch.nn.Parameter(torch.zeros(())))
        self.register_constraint("raw_slope", gpytorch.constraints.Positive(**POSITIVE))
        self.double()

    @property
    def slope(self) -> Tensor:
        """Variance of the slopes."""
        return torch.as_tensor(self.raw_slope_constraint.transform(self.raw_slope))

    @slope.setter
    def slope(self, value: float) -> None:
        self.initialize(raw_slope=self.raw_slope_constraint.inverse_transform(torch.as_tensor(value).double()))

    def forward(self, x1: Tensor, x2: Tensor, diag: bool = False, **params: Any) -> Tensor:
        """Covariances of features, (..., n, m) and (..., l, m) -> (..., n, l)."""
        linear = (x1 * x2).sum(-1) if diag else x1 @ x2.mT
        return torch.as_tensor(super().forward(x1, x2, diag=diag, **params) + self.slope * linear)


def _is_built_in(kernel: gpytorch.kernels.Kernel) -> bool:
    return isinstance(kernel, gpytorch.kernels.ScaleKernel) and isinstance(kernel.base_kernel, _BuiltIn)


class Prior(gpytorch.Module):
    """Mean, kernel and likelihood of a latent; their parameters are the hyperparameters.

    Attributes:
        bounds: of parameters in L-BFGS, by name.
    """

    def __init__(self, covar_module: gpytorch.kernels.Kernel, likelihood: Any, bounds: Bounds) -> None:
        super().__init__()
        self.mean_module = gpytorch.means.ConstantMean().double()
        self.covar_module, self.likelihood, self.bounds = covar_module, likelihood, bounds
        self._learned = [name for name, parameter in self.named_parameters() if parameter.requires_grad]

    @property
    def learned(self) -> dict[str, torch.nn.Parameter]:
        """The parameters that are learned: those that required gradients when the prior was made."""
        parameters = dict(self.named_parameters())
        return {name: parameters[name] for name in self._learned}

    def log_density(self) -> Tensor:
        """Log density of the registered priors, a scalar.

        Log-normal priors count as densities of the logarithms, whose mode does not depend on the parameters' units.
        """
        total = torch.zeros((), dtype=torch.float64)
        for _, module, density, value_of, _ in self.named_priors():
            value = value_of(module)
            total = total + density.log_prob(value).sum()
            if isinstance(density, gpytorch.priors.LogNormalPrior):
                total = total + value.log().sum()
        return total

    def covariance(self, F: Tensor, G: Tensor | None = None) -> Tensor:
        """k(F, G), (n, l) of features, (n, m) and (l, m)."""
        G, kernel = F if G is None else G, self.covar_module
        if _is_built_in(kernel):  # without GPyTorch's lazy tensors, which take a third of a millisecond
            K = kernel.base_kernel.forward(F, G) * kernel.outputscale
            return torch.as_tensor(K + kernel.slope * (F @ G.mT) if isinstance(kernel, Sloped) else K)
        return torch.as_tensor(kernel(F, G).to_dense())

    def variance(self, F: Tensor) -> Tensor:
        """k(f, f), (n,)."""
        kernel = self.covar_module
        if not _is_built_in(kernel):
            return torch.as_tensor(kernel(F, diag=True))
        stationary = kernel.outputscale.expand(len(F))
        return torch.as_tensor(
            stationary + kernel.slope * F.square().sum(-1) if isinstance(kernel, Sloped) else stationary
        )

    @property
    def sd(self) -> float:
        """Standard deviation without a trend; infinite for a custom kernel, of which it is not known."""
        kernel = self.covar_module
        return math.sqrt(float(kernel.outputscale.detach())) if _is_built_in(kernel) else math.inf

    def typical_variance(self, dimension: int) -> Tensor:
        """k(f, f), a scalar, of a point whose features, (dimension,), all lie a standard deviation from their means."""
        return self.variance(torch.ones((1, dimension), dtype=torch.float64))[0]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The parameters by name."""
        return {name: parameter.detach().numpy().copy() for name, parameter in self.named_parameters()}

    @property
    def length_scales(self) -> np.ndarray | None:
        """Length scales of a built-in kernel, (m,)."""
        if not _is_built_in(self.covar_module):
            return None
        return np.asarray(self.covar_module.base_kernel.lengthscale.detach().numpy()[0])


def minimise(
    objective: Callable[[], tuple[Tensor, list[Tensor]]],
    parameters: dict[str, torch.nn.Parameter],
    bounds: Bounds,
    options: dict[str, Any],
) -> None:
    """Set parameters to those with the least value of an objective, by L-BFGS.

    As BoTorch's `scipy_minimize`, which also limits the threads of BLAS: that reads the map of the process each time.

    Args:
        objective: value and gradient, one for each parameter.
        parameters: by name.
        bounds: of some parameters.
        options: of SciPy's "L-BFGS-B".
    """
    closure = NdarrayOptimizationClosure(objective, parameters)
    within = get_bounds_as_ndarray(parameters, bounds)
    found = minimize(closure, closure.state, jac=True, bounds=within, method="L-BFGS-B", options=options)
    closure.state = found.x
