"""Conversion of a trained classifier to named arrays and back."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from activefail.features import FeatureMap
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Kernel, Latent, LearnableMargins, learned_with, level_of
from activefail.surrogate.covariance import Hyperparameters, SavedHyperparameters
from activefail.surrogate.fitting import Fit
from activefail.surrogate.margin import WARPINGS, CensoredSites, MarginFit, MarginLatent
from activefail.surrogate.margin_choice import OUTCOMES, Choice, defined
from activefail.surrogate.saved import SavedClassifier, SavedLatent
from activefail.surrogate.sites import Sites

if TYPE_CHECKING:
    import torch
else:
    from activefail.surrogate import lazy_torch as torch

AnyLatent = TypeVar("AnyLatent", Latent, SavedLatent, MarginLatent)
OutcomeLatent = TypeVar("OutcomeLatent", Latent, SavedLatent)

State = Mapping[str, NDArray[Any]]

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
        ArithmeticError, LookupError, RuntimeError, TypeError, ValueError: if training cannot produce the arrays, or
            they give no predictions: an intact file may still come from someone else.
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
    features = _scaled(features, state)
    latents, _ = _restored(state, X, outcome, outcomes, features, kernel, margins, _saved_latent, SavedHyperparameters)
    return SavedClassifier(tuple(outcomes), features, latents)


def _scaled(features: FeatureMap, state: State) -> FeatureMap:
    """The features with the scaling in a state."""
    center, spread = (state[name] for name in _SCALING)
    return replace(features, known=(center, spread))


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
    choices = () if margins is None else tuple(_choice(state[f"{name}/choice"]) for name in outcomes[1:])
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


def _choice(array: NDArray[Any]) -> Choice:
    margin, simulations, margin_score, outcome_score, one_sided = array.tolist()
    return Choice(int(margin), int(simulations), margin_score, outcome_score, bool(one_sided))


AnyPrior = TypeVar("AnyPrior", bound=Hyperparameters)


def _hyperparameters(state: State, name: str, kind: type[AnyPrior]) -> AnyPrior:
    mean, output, length = (state[f"{name}/{key}"] for key in ("mean", "log_outputscale", "log_lengthscale"))
    with np.errstate(over="raise"):
        np.exp(2.0 * np.append(length, output))  # every scale is a number
    return kind(float(mean), float(output), length)


def _saved_latent(state: State, name: str, F: Array, beyond: NDArray[np.bool_], kernel: Kernel) -> SavedLatent:
    return SavedLatent(
        kernel,
        F,
        _hyperparameters(state, name, SavedHyperparameters),
        state[f"{name}/site_linear"],
        state[f"{name}/site_precision"],
        state.get(f"{name}/inducing"),
    )


def _latent(state: State, name: str, F: Array, beyond: NDArray[np.bool_], kernel: Kernel) -> Latent:
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
    values, _ = defined(margin)
    truncated, warping, learned_on = (int(state[f"{name}/{key}"]) for key in ("truncated", "warping", "learned_on"))
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
        ArithmeticError: if it is not finite.
    """
    with np.errstate(all="raise", under="ignore"):
        moments = latent.moments(latent.features[:1])
    if not (np.isfinite(moments.mean).all() and np.isfinite(moments.sd).all()):
        raise ArithmeticError
    return latent
