"""Conversion of a trained classifier to named arrays and back."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from activefail.errors import DamagedError
from activefail.features import FeatureMap
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Kernel, Latent, LearnableMargins, learned_with, level_of
from activefail.surrogate.covariance import Hyperparameters, SavedHyperparameters
from activefail.surrogate.fitting import EXACT, Fit
from activefail.surrogate.inducing import MOST
from activefail.surrogate.margin import WARPINGS, CensoredSites, MarginFit, MarginLatent
from activefail.surrogate.margin_choice import OUTCOMES, Choice, defined, usable
from activefail.surrogate.saved import SavedClassifier, SavedLatent
from activefail.surrogate.sites import Sites

if TYPE_CHECKING:
    import torch
else:
    from activefail.surrogate import lazy_torch as torch

AnyLatent = TypeVar("AnyLatent", Latent, SavedLatent, MarginLatent)
OutcomeLatent = TypeVar("OutcomeLatent", Latent, SavedLatent)

State = Mapping[str, NDArray[Any]]

_LARGEST_LOGARITHM = 100.0
"""Largest magnitude of a learned scale's logarithm: the priors keep it far lower, and its square does not overflow."""


_SCALING = ("features/center", "features/spread")
"""The scaling of the features, for predictions alone."""


def classifier_state(classifier: Classifier) -> dict[str, NDArray[Any]]:
    """The learned quantities of a classifier, and the scaling of its features, as named arrays."""
    state: dict[str, Any] = dict(zip(_SCALING, classifier.features.scaling, strict=True))
    for name, latent in zip(classifier.outcomes[1:], classifier.latents, strict=True):
        trained = latent.trained
        state |= {
            f"{name}/mean": np.float64(trained.hyperparameters.mean),
            f"{name}/log_outputscale": np.float64(trained.hyperparameters.log_outputscale),
            f"{name}/log_lengthscale": trained.hyperparameters.log_lengthscale,
            f"{name}/learned_on": np.int64(trained.learned_on),
        }
        if isinstance(trained, MarginFit):
            state |= {
                f"{name}/site_linear": trained.sites.linear,
                f"{name}/site_precision": trained.sites.precision,
                f"{name}/unit": np.float64(trained.unit),
                f"{name}/warping": np.int64(list(WARPINGS).index(trained.warping)),
                f"{name}/truncated": np.int64(trained.truncated),
            }
            if trained.is_clipped:
                # For readers without the margins.
                state[f"{name}/clipped"] = np.int64(1)
            if trained.size_of_support:
                state[f"{name}/support"] = np.int64(trained.size_of_support)
            continue
        state |= {
            f"{name}/site_linear": trained.sites.linear.numpy(),
            f"{name}/site_precision": trained.sites.precision.numpy(),
            f"{name}/elbo": np.float64(trained.elbo),
            f"{name}/evaluations": np.int64(trained.evaluations),
        }
        if trained.inducing is not None:
            state[f"{name}/inducing"] = trained.inducing.numpy()
    for name, choice in zip(classifier.outcomes[1:], classifier.choices, strict=False):
        state[f"{name}/choice"] = np.array(choice, dtype=np.float64)
    return {name: np.asarray(array) for name, array in state.items()}


def _check_arrays(state: State, name: str, expected: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Check the types and shapes of one boundary's arrays, that they are finite, and that scales are not extreme.

    Raises:
        DamagedError: if training cannot produce an array.
    """
    for key, (dtype, shape) in expected.items():
        array = state[f"{name}/{key}"]
        if (array.dtype, array.shape) != (np.dtype(dtype), shape) or not np.isfinite(array).all():
            raise DamagedError(f"holds a {key} that is not an array of finite numbers of shape {shape}")
    for key in ("log_outputscale", "log_lengthscale"):
        if (np.abs(state[f"{name}/{key}"]) > _LARGEST_LOGARITHM).any():
            raise DamagedError(f"holds a {key} beyond ±{_LARGEST_LOGARITHM:g}")
    if (state[f"{name}/site_precision"] < 0.0).any():
        raise DamagedError("holds a site_precision below 0")


def _check_state(state: State, name: str, n: int, m: int) -> None:
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
    _check_arrays(state, name, expected)
    inducing = state.get(f"{name}/inducing")
    if (inducing is None) != (n <= EXACT):
        what = "lacks inducing points, which" if inducing is None else "holds inducing points, although"
        raise DamagedError(f"{what} {n} designs {'need' if inducing is None else 'need none'}")
    if inducing is not None and (
        inducing.dtype != np.int64
        or inducing.ndim != 1
        or not 1 <= len(np.unique(inducing)) == len(inducing) <= MOST
        or not 0 <= inducing.min() <= inducing.max() < n
    ):
        raise DamagedError(f"holds inducing points that are not at most {MOST} distinct rows of {n} designs")


def classifier_from_state(
    state: State,
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: Kernel,
    margins: LearnableMargins | None = None,
) -> Classifier:
    """The classifier from its `classifier_state`.

    Args:
        state: the arrays.
        X: (n, d) training designs.
        outcome: (n,) their outcomes.
        outcomes, features, kernel, margins: as in training.

    Raises:
        KeyError: if an array is missing.
        DamagedError: if training cannot produce the arrays, or they give no predictions: an intact file may still come
            from someone else.
    """
    latents, choices = _restored(state, X, outcome, outcomes, features, kernel, margins, _latent, Hyperparameters)
    return Classifier(tuple(outcomes), features, latents, choices)


def saved_classifier(
    state: State,
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: Kernel,
    margins: LearnableMargins | None = None,
) -> SavedClassifier:
    """The classifier from its `classifier_state`, for predictions alone, with the scaling of the features in the state.

    Args and errors as for `classifier_from_state`.
    """
    features = _scaled(features, state, X)
    latents, _ = _restored(state, X, outcome, outcomes, features, kernel, margins, _saved_latent, SavedHyperparameters)
    return SavedClassifier(tuple(outcomes), features, latents)


def _scaled(features: FeatureMap, state: State, X: Array) -> FeatureMap:
    """The features with the scaling in a state, trained on designs X, (n, d); earlier versions saved none.

    Raises:
        DamagedError: if no features have this scaling.
    """
    if any(name not in state for name in _SCALING):
        return features
    center, spread = (state[name] for name in _SCALING)
    for name in _SCALING:
        array = state[name]
        if array.dtype != np.float64 or array.shape != features.logarithmic.shape or not np.isfinite(array).all():
            raise DamagedError(f"holds a {name} that is not an array of finite numbers, one for each feature")
    if not (spread > 0.0).all():
        raise DamagedError(f"holds a {_SCALING[1]} that is not positive")
    scaled = replace(features, known=(center, spread))
    with np.errstate(all="ignore"):
        if not np.isfinite(scaled(X)).all():
            raise DamagedError("holds a scaling that gives features that are not finite")
    return scaled


def _restored(
    state: State,
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: Kernel,
    margins: LearnableMargins | None,
    of_outcomes: Callable[[State, str, Array, NDArray[np.bool_], Kernel], OutcomeLatent],
    of_prior: type[Hyperparameters],
) -> tuple[tuple[OutcomeLatent | MarginLatent, ...], tuple[Choice, ...]]:
    """The latents and what they are learned from; `of_outcomes` and `of_prior` build them."""
    F = features(X)
    latents: list[OutcomeLatent | MarginLatent] = []
    choices = (
        ()
        if margins is None
        else tuple(
            _choice(state[f"{name}/choice"], values, margins.columns, outcome >= severity)
            for severity, (name, values) in enumerate(zip(outcomes[1:], margins.values, strict=True), start=1)
        )
    )
    regressions: dict[int, MarginFit] = {}
    for severity, name in enumerate(outcomes[1:], start=1):
        if margins is None or choices[severity - 1].margin == OUTCOMES:
            latents.append(_checked(of_outcomes(state, name, F, outcome >= severity, kernel)))
            continue
        shared = learned_with(choices, severity)
        if shared not in regressions:
            margin = margins.values[shared - 1][:, choices[severity - 1].margin]
            regressions[shared] = _margin_fit(state, outcomes[shared], F, margin, of_prior)
        latents.append(_checked(MarginLatent(regressions[shared], level_of(margins, choices, severity))))
    return tuple(latents), choices


def _choice(array: NDArray[Any], margins: Array, columns: Collection[int], beyond: NDArray[np.bool_]) -> Choice:
    """The choice in a state.

    Raises:
        DamagedError: if it is not one of these margins.
    """
    if array.dtype != np.float64 or array.shape != (len(Choice._fields),):
        raise DamagedError("holds a choice of margin of another type or shape")
    margin, simulations, margin_score, outcome_score, one_sided = array.tolist()
    if margin not in (OUTCOMES, *columns) or not 1 <= simulations <= len(beyond) or one_sided not in (0.0, 1.0):
        raise DamagedError("holds a choice of a margin that this campaign cannot have made")
    choice = Choice(int(margin), int(simulations), margin_score, outcome_score, bool(one_sided))
    if choice.margin != OUTCOMES and usable(margins[:, choice.margin], beyond):
        raise DamagedError("holds a choice of a margin that contradicts the outcomes")
    return choice


AnyPrior = TypeVar("AnyPrior", bound=Hyperparameters)


def _hyperparameters(state: State, name: str, kind: type[AnyPrior]) -> AnyPrior:
    return kind(
        float(state[f"{name}/mean"]),
        float(state[f"{name}/log_outputscale"]),
        state[f"{name}/log_lengthscale"],
    )


def _saved_latent(state: State, name: str, F: Array, beyond: NDArray[np.bool_], kernel: Kernel) -> SavedLatent:
    _check_state(state, name, *F.shape)
    return SavedLatent(
        kernel,
        F,
        _hyperparameters(state, name, SavedHyperparameters),
        state[f"{name}/site_linear"],
        state[f"{name}/site_precision"],
        state.get(f"{name}/inducing"),
    )


def _latent(state: State, name: str, F: Array, beyond: NDArray[np.bool_], kernel: Kernel) -> Latent:
    _check_state(state, name, *F.shape)
    inducing = state.get(f"{name}/inducing")
    return Latent(
        Fit(
            kernel,
            torch.from_numpy(F),
            torch.from_numpy(np.where(beyond, 1.0, -1.0)),
            _hyperparameters(state, name, Hyperparameters),
            Sites(torch.from_numpy(state[f"{name}/site_linear"]), torch.from_numpy(state[f"{name}/site_precision"])),
            float(state[f"{name}/elbo"]),
            int(state[f"{name}/evaluations"]),
            int(state[f"{name}/learned_on"]),
            None if inducing is None else torch.from_numpy(inducing),
        )
    )


def _margin_fit(state: State, name: str, F: Array, margin: Array, of_prior: type[Hyperparameters]) -> MarginFit:
    values, has_undefined = defined(margin)
    number, reals = ("<f8", ()), "<f8"
    for key in ("truncated", "warping", "learned_on"):
        array = state[f"{name}/{key}"]
        if array.dtype != np.int64 or array.shape != ():
            raise DamagedError(f"holds a {key} that is not a whole number")
    truncated, warping, learned_on = (int(state[f"{name}/{key}"]) for key in ("truncated", "warping", "learned_on"))
    censored = (int((values <= 0.0).sum()) if truncated else 0,)
    expected = {
        "mean": number,
        "log_outputscale": number,
        "log_lengthscale": (reals, (F.shape[1],)),
        "site_linear": (reals, censored),
        "site_precision": (reals, censored),
        "unit": number,
    }
    _check_arrays(state, name, expected)
    possible = truncated in (0, 1) and 0 <= warping < len(WARPINGS) and 1 <= learned_on <= len(F)
    if not possible or (has_undefined and not truncated) or not state[f"{name}/unit"] > 0.0:
        raise DamagedError("holds a regression of a margin that training cannot produce")
    return MarginFit(
        features=F,
        margin=values,
        truncated=bool(truncated),
        warping=list(WARPINGS)[warping],
        unit=float(state[f"{name}/unit"]),
        hyperparameters=_hyperparameters(state, name, of_prior),
        sites=CensoredSites(state[f"{name}/site_linear"], state[f"{name}/site_precision"]),
        log_likelihood=math.nan,
        learned_on=learned_on,
    )


def _checked(latent: AnyLatent) -> AnyLatent:
    """The latent, checked by a prediction.

    Raises:
        DamagedError: if it gives no finite prediction.
    """
    try:
        with np.errstate(all="ignore"):
            moments = latent.moments(latent.features[:1])
    # Finite numbers may still give a covariance without a Cholesky factor.
    except (ArithmeticError, LookupError, RuntimeError, ValueError) as error:
        raise DamagedError(f"cannot be used ({type(error).__name__})") from error
    if not (np.isfinite(moments.mean).all() and np.isfinite(moments.sd).all()):
        raise DamagedError("predicts numbers that are not finite")
    return latent
