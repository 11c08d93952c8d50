"""Labelled points, priors with known hyperparameters, and numerical derivatives by them."""

import gpytorch
import numpy as np
import torch

from activefail.learning.model.fitting import outcome_prior
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.sites import Sites

RBF, MATERN52 = VariationalGP("rbf"), VariationalGP("matern52")


def points(n, m=2, seed=0, noise=0.3):
    """Features, (n, m), and their labels, (n,)."""
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, m))
    labels = X[:, 0] + 0.5 * X[:, 1] ** 2 + noise * rng.standard_normal(n) > 0.4
    return torch.from_numpy(X), torch.from_numpy(labels.astype(float))


def prior(kernel="rbf", m=2, mean=0.3, outputscale=9.0, lengthscale=1.3):
    made = outcome_prior(kernel, m)
    made.mean_module.initialize(constant=mean)
    made.covar_module.initialize(outputscale=outputscale)
    made.covar_module.base_kernel.initialize(lengthscale=lengthscale)
    return made.requires_grad_(False)


def two_scales(m):
    """A custom kernel: a rough one on top of a smooth one."""
    smooth, rough = gpytorch.kernels.RBFKernel(ard_num_dims=m), gpytorch.kernels.MaternKernel(nu=1.5)
    return gpytorch.kernels.ScaleKernel(smooth) + gpytorch.kernels.ScaleKernel(rough)


class Mislabelled(gpytorch.likelihoods.BernoulliLikelihood):
    """A probit likelihood of labels of which a share is wrong; the share is learned."""

    def __init__(self):
        super().__init__()
        self.register_parameter("raw_share", torch.nn.Parameter(torch.tensor(-2.0)))

    @property
    def share(self):
        return 0.5 * torch.sigmoid(self.raw_share)

    def probability(self, z):
        return self.share + (1.0 - 2.0 * self.share) * torch.special.ndtr(z)

    def marginal(self, function_dist, *args, **kwargs):
        z = function_dist.mean / (1.0 + function_dist.variance).sqrt()
        return torch.distributions.Bernoulli(probs=self.probability(z))

    def expected_log_prob(self, observations, function_dist, *args, **kwargs):
        return self.quadrature(lambda f: self.probability((2.0 * observations - 1.0) * f).log(), function_dist)


def first_sites(labels):
    return Sites(0.2 * labels - 0.1, torch.full_like(labels, 0.1))


def numerical_gradient(prior, value, step=1e-4):
    """Central differences of a value by each parameter of a prior."""
    differences = []
    for parameter in prior.parameters():
        flat = parameter.data.view(-1)
        for i in range(len(flat)):
            start, values = float(flat[i]), []
            for moved in (start + step, start - step):
                flat[i] = moved
                values.append(value())
            flat[i] = start
            differences.append((values[0] - values[1]) / (2.0 * step))
    return differences


def flattened(gradient):
    return torch.cat([of.reshape(-1) for of in gradient]).tolist()
