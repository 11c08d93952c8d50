"""Conversion of a trained classifier to named arrays and back."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from activefail.learning.features import FeatureMap
from activefail.learning.model.classifier import Classifier
from activefail.learning.model.fitting import Fit
from activefail.learning.model.kernels import Prior
from activefail.learning.model.latent import CustomLatent, CustomModel, Latent, Learner, VariationalGP
from activefail.learning.model.margin import MarginFit, MarginLatent, margin_prior
from activefail.learning.model.margin_choice import LearnableMargins
from activefail.learning.model.margin_data import SLOPE, WARPINGS
from activefail.learning.model.saved import (
    SCALING,
    State,
    check,
    choices_of,
    margin_data_of,
    mode_name,
    of_any_version,
    sources,
)
from activefail.learning.model.sites import Sites
from activefail.learning.model.system import AnyLatent, SystemLatent
from activefail.space.space import Array

_FLAT = np.array(-np.inf)
"""Logarithm of the variance of a trend's slopes, without a trend."""


def classifier_state(classifier: Classifier) -> dict[str, NDArray[Any]]:
    """The learned quantities of a classifier, and the scaling of its features, as named arrays."""
    state: dict[str, Any] = dict(zip(SCALING, classifier.features.scaling, strict=True))
    for name, trained in _trained(classifier):
        if isinstance(trained, MarginFit):
            data = trained.data
            own: dict[str, Any] = {
                "unit": data.unit,
                "warping": list(WARPINGS).index(data.warping),
                "truncated": int(data.truncated),
            }
            (linear, precision), inducing = data.sites, data.inducing
            if data.is_clipped:
                own["clipped"] = 1  # for readers without the margins
            if data.level:
                own["gap"] = trained.gap  # for readers without torch
            if trained.noise:
                own["normality"] = trained.normality  # for readers without torch
        else:
            linear, precision = (site.numpy() for site in trained.sites)
            own = {"elbo": trained.elbo}
            inducing = None if trained.inducing is None else trained.inducing.numpy()
        if inducing is not None:
            own["inducing"] = inducing
        own |= {"site_linear": linear, "site_precision": precision, "learned_on": trained.learned_on}
        state |= {f"{name}/{key}": np.asarray(value) for key, value in (own | trained.prior.arrays).items()}
    for name, choice in zip(classifier.outcomes[1:], classifier.choices, strict=False):
        state[f"{name}/choice"] = np.array(choice, dtype=np.float64)
    return state


def _trained(classifier: Classifier) -> Iterator[tuple[str, Fit | MarginFit]]:
    """What is saved, by the name of its arrays; custom latents are learned again from the record."""
    for name, latent in zip(classifier.outcomes[1:], classifier.latents, strict=True):
        if isinstance(latent, SystemLatent):
            yield from ((mode_name(name, number), mode.trained) for number, mode in enumerate(latent.modes))
        elif not isinstance(latent, CustomLatent):
            yield name, latent.trained


def classifier_from_state(
    state: State,
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    learner: Learner,
    margins: LearnableMargins | None = None,
) -> Classifier:
    """The classifier from its `classifier_state`.

    Args:
        state: the arrays.
        X: (n, d) training designs.
        outcome: (n,) their outcomes.
        outcomes, features, learner, margins: as in training.

    Raises:
        ArithmeticError, LookupError, RuntimeError, TypeError, ValueError: if training cannot produce the arrays, or
            they give no predictions: an intact file may still come from someone else.
    """
    state, F = of_any_version(state), features.to_learn(X)
    regressions = dict[str, MarginFit]()
    latents: list[AnyLatent] = []
    for severity, source in enumerate(sources(state, outcomes, margins), start=1):
        name = source.name
        if source.margin is None:
            if isinstance(learner, CustomModel):
                latents.append(learner.learned(F, outcome >= severity))
            else:
                latents.append(Latent(_fit(state, name, learner, F, outcome >= severity)))
            continue

        def regression(name: str, F: Array, margin: Array) -> MarginFit:
            if name not in regressions:
                prior = _set(margin_prior(F.shape[1], learner.repeatable), state, name)
                learned_on = int(state[f"{name}/learned_on"])
                regressions[name] = MarginFit(margin_data_of(state, name, F, margin), prior, math.nan, learned_on)
            return regressions[name]

        if source.system is None:
            latents.append(MarginLatent(regression(name, F, source.margin), source.level))
        else:
            modes = (MarginLatent(regression(*of_mode)) for of_mode in source.modes(F))
            latents.append(SystemLatent(tuple(modes), ~np.isnan(source.margin), F, source.system))
    for latent in latents:
        check(latent, F)
    choices = choices_of(state, outcomes, margins)
    return Classifier(tuple(outcomes), features, tuple(latents), choices, repeatable=learner.repeatable)


def _fit(state: State, name: str, learner: VariationalGP, F: Array, beyond: NDArray[np.bool_]) -> Fit:
    inducing = state.get(f"{name}/inducing")
    return Fit(
        _set(learner.default_prior(F.shape[1]), state, name),
        torch.from_numpy(F),
        torch.from_numpy(beyond.astype(float)),
        Sites(*(torch.from_numpy(state[f"{name}/{key}"]) for key in ("site_linear", "site_precision"))),
        float(state[f"{name}/elbo"]),
        int(state[f"{name}/learned_on"]),
        None if inducing is None else torch.from_numpy(inducing),
    )


def _set(prior: Prior, state: State, name: str) -> Prior:
    """The prior with the parameters of a state."""
    with torch.no_grad():
        for key, parameter in prior.named_parameters():
            # A regression of a former version has no trend.
            value = state.get(f"{name}/{key}", _FLAT) if key == SLOPE else state[f"{name}/{key}"]
            parameter.copy_(torch.from_numpy(value))
    prior.requires_grad_(False)
    if prior.length_scales is not None:
        scales = np.append(prior.length_scales, prior.covar_module.outputscale.numpy())
        if not (np.isfinite(scales**2).all() and scales.min() > 0.0):
            raise ArithmeticError
    return prior
