"""The arrays that a classifier's learning comes to, and the classifier in them again."""

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
"""Of a learned scale: the priors keep it far below, and its square can be computed with."""


def classifier_state(classifier: Classifier) -> dict[str, NDArray[Any]]:
    """All that a classifier has learned, as named arrays."""
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
    """Check what a state holds of one boundary's latent, trained on n designs of m features.

    Raises:
        DamagedError: if an array has a type, a shape or a value that no training gives.
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
            raise DamagedError(f"holds a {key} that is not of finite numbers of shape {shape}")
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
    """The classifier that `classifier_state` described.

    Args:
        state: its arrays.
        X: (n, d) designs that it was trained on.
        outcome: (n,) their outcomes.
        outcomes, features, kernel: as in its training.

    Raises:
        KeyError: if an array is missing.
        DamagedError: if the arrays are none that a training gives, or predict nothing: a file may be whole, and of a
            stranger's making.
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
        latents.append(_predicting(Latent(trained)))
    return Classifier(tuple(outcomes), features, tuple(latents))


def _predicting(latent: Latent) -> Latent:
    """A latent, once it has predicted something.

    Raises:
        DamagedError: if it cannot.
    """
    try:
        with np.errstate(all="ignore"):
            moments = latent.moments(latent.trained.features[:1].numpy())
    # Numbers may be finite each and still give a covariance that has no factor.
    except (ArithmeticError, LookupError, RuntimeError, ValueError) as error:
        raise DamagedError(f"cannot be used ({type(error).__name__})") from error
    if not (np.isfinite(moments.mean).all() and np.isfinite(moments.sd).all()):
        raise DamagedError("predicts no finite numbers")
    return latent
