"""Conversion of a trained classifier to named arrays and back."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from activefail.errors import DamagedError
from activefail.features import FeatureMap
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Kernel, Latent
from activefail.surrogate.covariance import Hyperparameters
from activefail.surrogate.fitting import EXACT, Fit
from activefail.surrogate.inducing import MOST
from activefail.surrogate.sites import Sites

_LARGEST_LOGARITHM = 100.0
"""Largest magnitude of a learned scale's logarithm: the priors keep it far lower, and its square does not overflow."""


def classifier_state(classifier: Classifier) -> dict[str, NDArray[Any]]:
    """The learned quantities of a classifier, as named arrays."""
    state: dict[str, Any] = {}
    for name, latent in zip(classifier.outcomes[1:], classifier.latents, strict=True):
        trained = latent.trained
        state |= {
            f"{name}/mean": np.float64(trained.hyperparameters.mean),
            f"{name}/log_outputscale": np.float64(trained.hyperparameters.log_outputscale),
            f"{name}/log_lengthscale": trained.hyperparameters.log_lengthscale.numpy(),
            f"{name}/site_linear": trained.sites.linear.numpy(),
            f"{name}/site_precision": trained.sites.precision.numpy(),
            f"{name}/elbo": np.float64(trained.elbo),
            f"{name}/evaluations": np.int64(trained.evaluations),
            f"{name}/learned_on": np.int64(trained.learned_on),
        }
        if trained.inducing is not None:
            state[f"{name}/inducing"] = trained.inducing.numpy()
    return {name: np.asarray(array) for name, array in state.items()}


def _check_state(state: Mapping[str, NDArray[Any]], name: str, n: int, m: int) -> None:
    """Check the arrays of one boundary's latent, trained on n designs with m features.

    Raises:
        DamagedError: if an array has a type, a shape or a value that training cannot produce.
    """
    number, count, reals = ("<f8", ()), ("<i8", ()), "<f8"
    expected = {
        "mean": number,
        "log_outputscale": number,
        "log_lengthscale": (reals, (m,)),
        "site_linear": (reals, (n,)),
        "site_precision": (reals, (n,)),
        "elbo": number,
        "evaluations": count,
        "learned_on": count,
    }
    for key, (dtype, shape) in expected.items():
        array = state[f"{name}/{key}"]
        if (array.dtype, array.shape) != (np.dtype(dtype), shape) or not np.isfinite(array).all():
            raise DamagedError(f"holds a {key} that is not an array of finite numbers of shape {shape}")
    for key in ("log_outputscale", "log_lengthscale"):
        if (np.abs(state[f"{name}/{key}"]) > _LARGEST_LOGARITHM).any():
            raise DamagedError(f"holds a {key} beyond ±{_LARGEST_LOGARITHM:g}")
    if (state[f"{name}/site_precision"] < 0.0).any():
        raise DamagedError("holds a site_precision below 0")
    inducing = state.get(f"{name}/inducing")
    if (inducing is None) != (n <= EXACT):
        raise DamagedError(f"was learned from {n} designs {'without' if inducing is None else 'with'} inducing points")
    if inducing is not None and (
        inducing.dtype != np.int64
        or inducing.ndim != 1
        or not 1 <= len(np.unique(inducing)) == len(inducing) <= MOST
        or not 0 <= inducing.min() <= inducing.max() < n
    ):
        raise DamagedError(f"holds inducing points that are not up to {MOST} different ones of {n} designs")


def classifier_from_state(
    state: Mapping[str, NDArray[Any]],
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: Kernel,
) -> Classifier:
    """The classifier from its `classifier_state`.

    Args:
        state: the arrays.
        X: (n, d) training designs.
        outcome: (n,) their outcomes.
        outcomes, features, kernel: as in training.

    Raises:
        KeyError: if an array is missing.
        DamagedError: if training cannot produce the arrays, or they give no predictions: an intact file may still come
            from someone else.
    """
    F = torch.from_numpy(features(X))
    latents = []
    for severity, name in enumerate(outcomes[1:], start=1):
        _check_state(state, name, *F.shape)
        inducing = state.get(f"{name}/inducing")
        trained = Fit(
            kernel,
            F,
            torch.from_numpy(np.where(outcome >= severity, 1.0, -1.0)),
            Hyperparameters(
                float(state[f"{name}/mean"]),
                float(state[f"{name}/log_outputscale"]),
                torch.from_numpy(state[f"{name}/log_lengthscale"]),
            ),
            Sites(torch.from_numpy(state[f"{name}/site_linear"]), torch.from_numpy(state[f"{name}/site_precision"])),
            float(state[f"{name}/elbo"]),
            int(state[f"{name}/evaluations"]),
            int(state[f"{name}/learned_on"]),
            None if inducing is None else torch.from_numpy(inducing),
        )
        latents.append(_checked(Latent(trained)))
    return Classifier(tuple(outcomes), features, tuple(latents))


def _checked(latent: Latent) -> Latent:
    """The latent, checked by a prediction.

    Raises:
        DamagedError: if it gives no finite prediction.
    """
    try:
        with np.errstate(all="ignore"):
            moments = latent.moments(latent.trained.features[:1].numpy())
    # Finite numbers may still give a covariance without a Cholesky factor.
    except (ArithmeticError, LookupError, RuntimeError, ValueError) as error:
        raise DamagedError(f"cannot be used ({type(error).__name__})") from error
    if not (np.isfinite(moments.mean).all() and np.isfinite(moments.sd).all()):
        raise DamagedError("predicts no finite numbers")
    return latent
