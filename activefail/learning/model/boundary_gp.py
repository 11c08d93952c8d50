"""A boundary's latent as a GPyTorch variational GP in a BoTorch model, whose posterior is read off the sites."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from typing import Any, NamedTuple, Never, Self

import gpytorch
import numpy as np
import torch
from botorch.exceptions.errors import UnsupportedError
from botorch.models.approximate_gp import ApproximateGPyTorchModel
from botorch.models.model import Model
from botorch.posteriors import GPyTorchPosterior
from gpytorch.distributions import MultivariateNormal
from linear_operator.operators import DiagLinearOperator, MatmulLinearOperator
from torch import Tensor

from activefail.learning.model.covariance import JITTER
from activefail.learning.model.kernels import Prior
from activefail.learning.model.likelihoods import expected_precision
from activefail.learning.model.moments import LARGEST_FEATURE, in_parts
from activefail.learning.model.readout import Readout, Trend
from activefail.space.space import Array
from activefail.space.systems import System


class Seen(NamedTuple):
    """What the support says of points, (...,): the covariance is K − (root k)ᵀ (root k) + e eᵀ."""

    mean: Tensor  # (...,)
    shrunk: Tensor  # (..., M), root k
    trend: Tensor | None  # (...,), e; None if the mean is known

    def reshape(self, shape: torch.Size) -> "Seen":
        """The same for a batch of points."""
        trend = None if self.trend is None else self.trend.reshape(shape)
        return Seen(self.mean.reshape(shape), self.shrunk.reshape(*shape, -1), trend)


class SiteStrategy(torch.nn.Module):
    """The posterior at the optimal sites, in place of GPyTorch's whitened strategy.

    That gives the same numbers in 3.5 times the time, and repeats the support points for each entry of a batch
    (..., 1, m).

    Args:
        prior: of the latent.
        support: (M, m) features of its support points.
        readout: the matrices of predictions.
        trend: of a mean that is estimated.
        added: to the variance of a point, and its least value: the jitter, or the noise of a margin.
    """

    support: Tensor
    weights: Tensor
    root: Tensor

    def __init__(self, prior: Prior, support: Tensor, readout: Readout, trend: Trend | None, added: float) -> None:
        super().__init__()
        self.prior, self.added = prior, added
        self.register_buffer("support", support)
        self.register_buffer("weights", torch.from_numpy(readout.weights))
        self.register_buffer("root", torch.from_numpy(readout.root))
        self._trend = trend
        self._kept: list[tuple[Tensor, Seen]] = []

    @contextmanager
    def keeping(self, *points: Tensor) -> Iterator[None]:
        """The context in which what the support says of points, (n, m), that do not change is kept.

        The choices of a batch read the same pool and references again and again.
        """
        with torch.no_grad():
            self._kept = [(x, self._seen(x)) for x in points]
        try:
            yield
        finally:
            self._kept = []

    def seen(self, x: Tensor) -> Seen:
        """What the support says of points, (..., m)."""
        flat = x.reshape(-1, x.shape[-1])
        for points, kept in self._kept:
            if points.data_ptr() == flat.data_ptr() and points.shape == flat.shape and not x.requires_grad:
                return kept.reshape(x.shape[:-1])
        return self._seen(flat).reshape(x.shape[:-1])

    def _seen(self, x: Tensor) -> Seen:
        k = self.prior.covariance(x, self.support)
        mean = self.prior.mean_module(x) + k @ self.weights
        if self._trend is None:
            return Seen(mean, k @ self.root.mT, None)
        ones, total = self._trend
        return Seen(mean, k @ self.root.mT, (1.0 - k @ torch.from_numpy(ones)) / total**0.5)

    def marginals(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Means and variances of points, (..., m), each (...,)."""
        mean, shrunk, trend = self.seen(x)
        prior = self.prior.variance(x.reshape(-1, x.shape[-1])).reshape(mean.shape)
        variance = prior + self.added - _squares(shrunk)
        if trend is not None:
            variance = variance + trend.square()
        return mean, variance.clamp_min(self.added)

    def forward(self, x: Tensor, prior: bool = False) -> MultivariateNormal:
        """The posterior of points, (..., q, m), or their prior."""
        if prior:
            return MultivariateNormal(self.prior.mean_module(x), self.prior.covar_module(x))
        if x.shape[-2] == 1:  # single points need no matrices
            mean, variance = self.marginals(x)
            return MultivariateNormal(mean, DiagLinearOperator(variance))
        mean, shrunk, trend = self.seen(x)
        K = self.prior.covar_module(x).add_jitter(self.added) + MatmulLinearOperator(-shrunk, shrunk.mT)
        if trend is not None:
            K = K + MatmulLinearOperator(trend.unsqueeze(-1), trend.unsqueeze(-2))
        return MultivariateNormal(mean, K)


class _Fantasy(SiteStrategy):
    """Another strategy after observations at p points whose values are not known: its covariance shrinks.

    They explain e(x)ᵀ e(x), e(x) = L⁻¹ Σ(P, x), with LLᵀ = Σ(P, P) + their noise: p more columns of `shrunk`.
    """

    def __init__(self, before: SiteStrategy, P: Tensor, noise: Tensor) -> None:
        super().__init__(before.prior, P, Readout(np.zeros(0), np.zeros((0, 0))), None, before.added)
        self.before, self.noise, self._at_P = before, noise, before.seen(P)
        S = covariance_between(self.prior, self._at_P, self._at_P, P, P)
        S.diagonal().add_(self.added + noise)
        self._inverse = torch.linalg.inv(torch.linalg.cholesky(S))

    def _seen(self, x: Tensor) -> Seen:
        before = self.before.seen(x)
        more = covariance_between(self.prior, before, self._at_P, x, self.support) @ self._inverse.mT
        return Seen(before.mean, torch.cat([before.shrunk, more], dim=-1), before.trend)


def covariance_between(prior: Prior, seen_F: Seen, seen_G: Seen, F: Tensor, G: Tensor) -> Tensor:
    """Σ(F, G), (n, l), of features, (n, m) and (l, m), and what the support says of them."""
    K = prior.covariance(F, G) - seen_F.shrunk @ seen_G.shrunk.mT
    if seen_F.trend is not None and seen_G.trend is not None:
        K = K + torch.outer(seen_F.trend, seen_G.trend)
    return K


def _squares(T: Tensor) -> Tensor:
    """Row sums of squares; torch's take several times as long as NumPy's."""
    if T.requires_grad:
        return T.square().sum(-1)
    return torch.from_numpy(np.einsum("...ij,...ij->...i", T.numpy(), T.numpy()))


class BoundaryGP(gpytorch.models.ApproximateGP):
    """A latent with any GPyTorch mean and kernel: those of its strategy's prior."""

    def __init__(self, strategy: SiteStrategy) -> None:
        super().__init__(strategy)
        # GPyTorch's hook refers to its module, so that only the garbage collector would free the matrices.
        self._load_state_dict_pre_hooks.clear()

    def forward(self, x: Tensor) -> MultivariateNormal:
        """The prior of points, (..., q, m)."""
        prior: MultivariateNormal = self(x, prior=True)
        return prior


class BoundaryModel(ApproximateGPyTorchModel):
    """The posterior of a boundary's latent over scaled features, (..., q, m): what criteria and predictions use."""

    @classmethod
    def of(cls, strategy: SiteStrategy) -> Self:
        """The model of a strategy."""
        model = cls(model=BoundaryGP(strategy), likelihood=strategy.prior.likelihood)
        model.eval().requires_grad_(False)
        return model

    @property
    def batch_shape(self) -> torch.Size:
        """The model is one, not a batch of models."""
        return torch.Size()

    def condition_on_observations(self, *args: Any, **options: Any) -> Never:
        """Refused: criteria that fantasise observations need a custom model.

        Raises:
            UnsupportedError: always.
        """
        raise UnsupportedError(
            "the classifier cannot be conditioned on observations, as by `fantasize`; use a criterion that reads the "
            "posterior alone, or a classifier.model that can"
        )

    fantasize = condition_on_observations

    @property
    def strategy(self) -> SiteStrategy:
        """Computes the posterior."""
        strategy: SiteStrategy = self.model.variational_strategy
        return strategy

    def moments(self, F: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of single points, (n, m) -> (n,)."""
        mean, variance = self.strategy.marginals(F)
        return mean, variance.sqrt()

    def covariance(self, F: Tensor, G: Tensor) -> Tensor:
        """Covariance between features, (n, m) and (l, m) -> (n, l)."""
        seen = self.strategy.seen
        return covariance_between(self.strategy.prior, seen(F), seen(G), F, G)

    def joint(self, F: Tensor) -> tuple[Tensor, Tensor]:
        """Mean, (n,), and covariance, (n, n), of features, (n, m)."""
        with torch.no_grad():
            seen = self.strategy.seen(F)
            K = covariance_between(self.strategy.prior, seen, seen, F, F)
        K.diagonal().add_(self.strategy.added)
        return seen.mean, K

    def keeping(self, *points: Tensor) -> AbstractContextManager[None]:
        """The context in which what is known of points, (n, m), that do not change is kept."""
        strategy = self.strategy
        return (strategy.before if isinstance(strategy, _Fantasy) else strategy).keeping(*points)

    @torch.no_grad()
    def fantasised(self, P: Tensor) -> "BoundaryModel":
        """The model after observations at features P, (p, m), one after another, whose values are not known.

        Each observation has the present mean as its value: means stay, covariances shrink.
        """
        mean, rest = self.joint(P)
        noise = torch.empty(len(P), dtype=torch.float64)
        for i in range(len(P)):
            noise[i] = 1.0 / expected_precision(self.likelihood, mean[i], rest[i, i].clamp_min(JITTER))
            column = rest[:, i].clone()
            rest -= torch.outer(column, column) / (column[i] + noise[i])
        before = self.strategy
        if isinstance(before, _Fantasy):  # one level, however many observations
            P, noise = torch.cat([before.support, P]), torch.cat([before.noise, noise])
            before = before.before
        # The prior's modules, which take a millisecond to visit, are in evaluation mode already.
        return BoundaryModel(model=BoundaryGP(_Fantasy(before, P, noise)), likelihood=self.likelihood)


class SystemModel(Model):
    """The models of a system's modes as one, whose mean is the probit of the system's failure and whose sd is 1.

    Modes are independent given the simulations.

    Args:
        modes: models of the modes' latents.
        system: of these.
    """

    num_outputs = 1

    def __init__(self, modes: Sequence[BoundaryModel], system: System) -> None:
        super().__init__()
        self.modes, self.system = tuple(modes), system

    def sides(self, F: Tensor) -> Array:
        """The probits that each mode has failed at features, (n, m) -> (n, k)."""
        return np.column_stack([(mean / sd).numpy() for mean, sd in (mode.moments(F) for mode in self.modes)])

    @torch.no_grad()
    def moments(self, F: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation at features, (n, m) -> (n,)."""
        probit = torch.from_numpy(self.system.probit(self.sides(F)))
        return probit, torch.ones_like(probit)

    def posterior(self, X: Tensor, *args: Any, **options: Any) -> GPyTorchPosterior:
        """The posterior of designs with scaled features (..., q, m), as if they were independent."""
        mean, sd = (of.reshape(X.shape[:-1]) for of in self.moments(X.reshape(-1, X.shape[-1])))
        return GPyTorchPosterior(MultivariateNormal(mean, DiagLinearOperator(sd)))

    def keeping(self, *points: Tensor) -> AbstractContextManager[None]:
        """As of `BoundaryModel`."""
        kept = ExitStack()
        for mode in self.modes:
            kept.enter_context(mode.keeping(*points))
        return kept  # type: ignore[return-value]

    def fantasised(self, P: Tensor) -> "SystemModel":
        """As of `BoundaryModel`: a simulation yields the margins of all modes."""
        return SystemModel([mode.fantasised(P) for mode in self.modes], self.system)


def parts_of(model: Model, F: Tensor) -> list[tuple[Model, Tensor]]:
    """The models that decide the side of the boundary at features, (n, m), and where each does, (n,) of 0 and 1."""
    if not isinstance(model, SystemModel):
        return [(model, torch.ones(len(F), dtype=torch.float64))]
    deciding = torch.from_numpy(model.system.deciding(model.sides(F)))
    return [(mode, (deciding == position).double()) for position, mode in enumerate(model.modes)]


@torch.no_grad()
def moments(model: Model, F: Array) -> tuple[Array, Array]:
    """Marginal mean and standard deviation of a model at scaled features, (n, m), each (n,)."""

    def of_rows(rows: Array) -> tuple[Array, Array]:
        mean, sd = marginal(model, torch.from_numpy(rows))
        return mean.numpy(), sd.numpy()

    return in_parts(F, of_rows)


def joint(model: Model, F: Array) -> tuple[Array, Array]:
    """Joint mean, (n,), and covariance, (n, n), of a model at scaled features, (n, m)."""
    mean, covariance = together(model, torch.from_numpy(np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE)))
    return mean.numpy(), covariance.numpy()


def marginal(model: Model, F: Tensor) -> tuple[Tensor, Tensor]:
    """As `moments`, of tensors, with gradients."""
    if isinstance(model, BoundaryModel | SystemModel):
        return model.moments(F)
    posterior = model.posterior(F.unsqueeze(-2))
    return posterior.mean.reshape(len(F)), posterior.variance.reshape(len(F)).sqrt()


@torch.no_grad()
def together(model: Model, F: Tensor) -> tuple[Tensor, Tensor]:
    """As `joint`, of tensors."""
    if isinstance(model, BoundaryModel):
        return model.joint(F)
    distribution = model.posterior(F).distribution
    return distribution.mean.reshape(len(F)), distribution.covariance_matrix


def posterior_covariance(model: Model, F: Tensor, G: Tensor) -> Tensor:
    """Covariance of a model between scaled features, (n, m) and (l, m) -> (n, l)."""
    if isinstance(model, BoundaryModel):
        return model.covariance(F, G)
    both = model.posterior(torch.cat([F, G])).distribution.covariance_matrix
    return torch.as_tensor(both[: len(F), len(F) :])


def keeping(model: Model, *points: Tensor) -> AbstractContextManager[None]:
    """The context in which a model keeps what it says of points, (n, m), that do not change; a user's model may not."""
    return model.keeping(*points) if isinstance(model, BoundaryModel | SystemModel) else nullcontext()


def share_left(model: Model, F: Tensor) -> Tensor:
    """Share of the latent's variance at scaled features, (n, m), that its values at the fantasised points leave, (n,).

    It is 1 without such points, and for a model of the user's.
    """
    strategy = model.strategy if isinstance(model, BoundaryModel) else None
    if not isinstance(strategy, _Fantasy):
        return torch.ones(len(F), dtype=torch.float64)
    before, exact = strategy.before, _Fantasy(strategy.before, strategy.support, torch.zeros_like(strategy.noise))
    return (exact.marginals(F)[1] / before.marginals(F)[1]).clamp_max(1.0)


def fantasised(model: Model, P: Tensor) -> Model:
    """The model after observations at features P, (p, m), whose values are not known: of the means.

    A model of the user's that cannot be conditioned on observations stays as it is.
    """
    if isinstance(model, BoundaryModel | SystemModel):
        return model.fantasised(P)
    try:
        with torch.no_grad():
            return model.condition_on_observations(P, model.posterior(P).mean)
    except (AttributeError, NotImplementedError, RuntimeError, UnsupportedError):
        return model
