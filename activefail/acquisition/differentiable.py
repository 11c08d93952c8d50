"""The functions of the criteria on torch tensors, with gradients."""

import math
from typing import Any

import torch
from torch import Tensor

from activefail.acquisition.bivariate import label_covariance
from activefail.acquisition.functions import Functions
from activefail.parameter import Parameter
from activefail.space import LEAST_SHARE, DesignSpace


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


def _x_log_x(x: Tensor) -> Tensor:
    # At x = 0 the value is 0; the slope there is infinite and taken as 0.
    positive = torch.where(x > 0.0, x, 1.0)
    return positive * positive.log()


class _FromNormal(torch.autograd.Function):
    """`Parameter.from_normal` on a tensor; dx/dz = φ(z)/f(x)."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, parameter: Parameter) -> Tensor:
        x = parameter.from_normal(z.detach().numpy())
        ctx.save_for_backward(_density(z) / torch.from_numpy(parameter.density(x)))
        return torch.from_numpy(x)

    @staticmethod
    def backward(ctx: Any, *by_value: Tensor) -> tuple[Tensor, None]:
        (slope,) = ctx.saved_tensors
        return by_value[0] * slope, None


def columns(space: DesignSpace, U: Tensor) -> list[Tensor]:
    """The variables' values, d tensors (...), at points of the unit cube, (..., d); as `DesignSpace.from_unit`."""
    if not space.correlation and all(parameter.has_formula for parameter in space.parameters):
        quantiles = zip(space.parameters, U.unbind(-1), strict=True)
        return [parameter.quantile(u, torch.special.ndtri) for parameter, u in quantiles]
    # Kept off the faces of the cube, where a standard normal value is infinite.
    Z = torch.special.ndtri(U.clamp(LEAST_SHARE, 1.0 - LEAST_SHARE))
    if space.factor is not None:
        Z = Z @ torch.from_numpy(space.factor.T)
    return [_FromNormal.apply(z, parameter) for parameter, z in zip(space.parameters, Z.unbind(-1), strict=True)]


ON_TENSORS = Functions(
    torch.sqrt, torch.exp, torch.minimum, torch.cat, torch.special.ndtr, _x_log_x, _LabelCovariance.apply
)
