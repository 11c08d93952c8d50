"""What a campaign has learned: trained from its record, saved beside it, and found again after an interruption."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from activefail.acquisition.batch import Search
from activefail.campaign.assembly import Campaign
from activefail.campaign.unseen import unseen_outcomes
from activefail.errors import DamagedError
from activefail.record.batch import SEED, Batch
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE
from activefail.space import Array
from activefail.surrogate.classifier import Classifier, Latent, train
from activefail.surrogate.covariance import Hyperparameters
from activefail.surrogate.fitting import EXACT, Fit
from activefail.surrogate.inducing import MOST
from activefail.surrogate.sites import Sites

_LARGEST_LOGARITHM = 100.0
"""Of a learned scale: the priors keep it far below, and its square can be computed with."""


def training_rows(batches: tuple[Batch, ...], through: int | None = None) -> tuple[Array, NDArray[np.int8]]:
    """Designs, (n, d), and outcomes, (n,), of the batches up to an iteration, without numerical failures."""
    kept = [batch for batch in batches if through is None or batch.iteration <= through]
    X = np.concatenate([batch.designs for batch in kept])
    outcome = np.concatenate([batch.results.outcome for batch in kept])
    answered = outcome != NUMERICAL_FAILURE
    return X[answered], outcome[answered]


def leading_failures(batches: tuple[Batch, ...]) -> int:
    """How many simulations of a record failed before the first that gave an answer."""
    failed = 0
    for batch in batches:
        answered = np.flatnonzero(batch.results.outcome != NUMERICAL_FAILURE)
        if len(answered):
            return failed + int(answered[0])
        failed += len(batch)
    return failed


def initial_sets(campaign: Campaign, batches: tuple[Batch, ...]) -> int:
    """How many initial sets of designs a record calls for: one, and one more for each that found no answer at all.

    There a campaign stops. When it goes on, the simulator was mended, and there is still nothing to learn from.
    """
    return 1 + leading_failures(batches) // campaign.settings.sampling.initial


def failed_designs(batches: tuple[Batch, ...]) -> Array:
    """Designs, (n, d), of the numerical failures of all batches."""
    return np.concatenate([batch.designs[batch.results.outcome == NUMERICAL_FAILURE] for batch in batches])


def search_for_unseen(campaign: Campaign, batches: tuple[Batch, ...]) -> Search | None:
    """What a search for the outcomes that no simulation of a record ended in starts from; None where all were seen."""
    outcomes = campaign.simulator.outcomes
    outcome = np.concatenate([batch.results.outcome for batch in batches])
    counts = np.bincount(outcome[outcome != NUMERICAL_FAILURE], minlength=len(outcomes))
    missing = unseen_outcomes(outcomes, counts)
    return Search(np.concatenate([batch.designs for batch in batches]), missing) if missing else None


def in_initial_design(batches: tuple[Batch, ...]) -> NDArray[np.bool_]:
    """Which rows of `training_rows` are of the initial hypercube: a sample of the design space, unlike chosen ones."""
    origin = np.concatenate([batch.origin for batch in batches])
    outcome = np.concatenate([batch.results.outcome for batch in batches])
    return np.asarray(origin[outcome != NUMERICAL_FAILURE] == SEED)


def first_rows(batches: tuple[Batch, ...], n: int) -> tuple[Array, NDArray[np.int8]]:
    """Designs and outcomes of the first n simulations, without numerical failures."""
    X = np.concatenate([batch.designs for batch in batches])[:n]
    outcome = np.concatenate([batch.results.outcome for batch in batches])[:n]
    answered = outcome != NUMERICAL_FAILURE
    return X[answered], outcome[answered]


def learn(campaign: Campaign, batches: tuple[Batch, ...], iteration: int, warm: Classifier | None) -> Classifier:
    """The classifier of an iteration: trained on the seed and the first `iteration` chosen batches."""
    X, outcome = training_rows(batches, iteration)
    return train(X, outcome, campaign.simulator.outcomes, campaign.features, campaign.settings.classifier.kernel, warm)


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


def _check_state(state: dict[str, NDArray[Any]], name: str, n: int, m: int) -> None:
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
    campaign: Campaign, state: dict[str, NDArray[Any]], X: Array, outcome: NDArray[np.int8]
) -> Classifier:
    """The classifier that `classifier_state` described, on the designs and outcomes it was trained on.

    Raises:
        KeyError: if an array is missing.
        DamagedError: if the arrays are none that a training gives, or predict nothing: a file may be whole, and of a
            stranger's making.
    """
    F = torch.from_numpy(campaign.features(X))
    latents = []
    for severity, name in enumerate(campaign.simulator.outcomes[1:], start=1):
        _check_state(state, name, *F.shape)
        inducing = state.get(f"{name}/inducing")
        trained = Fit(
            campaign.settings.classifier.kernel,
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
    return Classifier(campaign.simulator.outcomes, campaign.features, tuple(latents))


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


Saved = tuple[int, dict[str, NDArray[Any]], Classifier]
"""A saved state: its iteration, its arrays, and the classifier in it."""


def restore(
    campaign: Campaign,
    store: Store,
    through: int,
    check: Callable[[int, Mapping[str, NDArray[Any]]], None] = lambda iteration, state: None,
) -> Saved | None:
    """The newest saved state of at most iteration `through`; None when there is none.

    Args:
        campaign: that it belongs to.
        store: that holds it.
        through: the last iteration that is known.
        check: raises DamagedError where a state lacks something else that it must hold.
    """
    while (saved := store.latest_state()) is not None and saved[0] <= through:
        iteration, state = saved
        try:
            check(iteration, state)
            return iteration, state, classifier_from_state(campaign, state, *training_rows(store.batches, iteration))
        except KeyError:  # saved by a version that kept less: learned again from the record
            break
        except DamagedError as error:
            store.reject_state(iteration, str(error))
    return None


def current_classifier(campaign: Campaign, store: Store, write: bool) -> Classifier:
    """The classifier of all recorded batches, exactly as the running loop has it.

    What was saved is taken from there; what came since is learned again in the same order, from the same starts.

    Args:
        write: whether to save what was learned here.
    """
    last = store.batches[-1].iteration
    saved = restore(campaign, store, last)
    iteration, classifier = (-1, None) if saved is None else (saved[0], saved[2])
    for following in range(iteration + 1, last + 1):
        classifier = learn(campaign, store.batches, following, classifier)
        if write:
            store.write_state(following, classifier_state(classifier))
    assert classifier is not None
    return classifier


def accuracy(classifier: Classifier, severity: int, X: Array, outcome: NDArray[np.int8]) -> float:
    """Share of designs on the right side of the boundary below `severity`."""
    mean = classifier.latents[severity - 1].moments(classifier.features(X)).mean
    return float(np.mean((mean > 0.0) == (outcome >= severity)))
