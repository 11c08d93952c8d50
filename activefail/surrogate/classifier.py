"""The campaign's classifier: a variational GP for each boundary between outcomes, and their probabilities.

Training (`fitting`) and prediction (`Readout`) are implemented here, with dense matrices. `Latent.model` is the same
posterior as a BoTorch model around a GPyTorch model (`gpytorch_model`); tests compare the two. The campaign's loop does
not use it; BoTorch's acquisition functions do (`activefail.acquisition.botorch`).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.features import FeatureMap
from activefail.space import Array
from activefail.surrogate.fitting import Fit, Readout, fit, leave_one_out, predict, predict_jointly, readout
from activefail.surrogate.margin import LARGEST_FEATURE, ROWS_AT_ONCE, MarginFit, MarginLatent
from activefail.surrogate.margin_choice import OUTCOMES, Choice, choose, fit_defined, is_due, usable
from activefail.surrogate.moments import Moments as Moments
from activefail.surrogate.moments import nested_probits, outcome_probabilities

if TYPE_CHECKING:
    import torch
    from botorch.models.approximate_gp import ApproximateGPyTorchModel
    from torch import Tensor
else:
    from activefail.surrogate import lazy_torch as torch

Kernel = Literal["rbf", "matern52"]


def _bounded(F: Array) -> "Tensor":
    # Far outside the space nothing is known, and one huge number would dominate the sums of squares in the covariance
    # of the other rows.
    return torch.from_numpy(np.clip(F, -LARGEST_FEATURE, LARGEST_FEATURE))


@dataclass(frozen=True)
class Latent:
    """The latent of one boundary: positive where the outcome is probably at least that severe.

    Attributes:
        trained: the fit to labels 1 for outcomes at least as severe as the boundary's, -1 for the others.
    """

    trained: Fit

    @cached_property
    def model(self) -> "ApproximateGPyTorchModel":
        """The posterior as a BoTorch model over the scaled features, (..., q, m)."""
        from activefail.surrogate.gpytorch_model import botorch_model

        return botorch_model(self.trained)

    @property
    def features(self) -> Array:
        """Scaled features of the training points, (n, m)."""
        return self.trained.features.numpy()

    @property
    def is_one_sided(self) -> bool:
        """Whether all training points are on one side of the boundary."""
        labels = self.trained.labels
        return bool((labels == labels[0]).all())

    @cached_property
    def readout(self) -> Readout:
        """The same posterior as plain matrices, for faster predictions."""
        return readout(self.trained)

    def moments(self, F: Array) -> Moments:
        """Marginal mean and standard deviation at scaled features, (n, m)."""
        means, variances = zip(
            *(predict(self.trained, self.readout, rows) for rows in _bounded(F).split(ROWS_AT_ONCE)), strict=True
        )
        return Moments(torch.cat(means).numpy(), torch.cat(variances).sqrt().numpy())

    def joint(self, F: Array) -> tuple[Array, Array]:
        """Joint mean, (n,), and covariance, (n, n), at scaled features, (n, m)."""
        mean, covariance = predict_jointly(self.trained, self.readout, _bounded(F))
        return mean.numpy(), covariance.numpy()

    def left_out(self) -> Moments:
        """Moments at each training point without its own label, with hyperparameters unchanged, (n,)."""
        return Moments(*leave_one_out(self.trained))


def is_nested(latents: Sequence[object]) -> bool:
    """Whether all boundaries are levels of one margin's regression."""
    regressions = [latent.trained for latent in latents if isinstance(latent, MarginLatent)]
    return len(regressions) == len(latents) and all(trained is regressions[0] for trained in regressions)


CERTAIN = 38.0
"""Probit of what is certain: a probability of 10⁻³¹⁶, the least that a float holds."""


@dataclass(frozen=True)
class Predicted:
    """What a classifier says of n designs: the one source of every probability of an outcome.

    Attributes:
        moments: of each boundary's latent.
        is_nested: whether the boundaries are levels of one latent (see `outcome_probabilities`).
        harmless: (n,) which designs have the least severe outcome for certain, whatever the latents say.
    """

    moments: tuple[Moments, ...]
    is_nested: bool
    harmless: NDArray[np.bool_]

    @property
    def probabilities(self) -> Array:
        """Of each outcome of one simulation, (n, outcomes); rows sum to 1.

        The outcomes that a boundary is learned from count as noisy, which allows for structure too fine to learn: the
        probit is mean/√(1 + sd²). That of a margin's boundary is mean/sd.
        """
        return outcome_probabilities(self._probits([one.standardised for one in self.moments]), self.is_nested)

    def _probits(self, of_boundaries: Sequence[Array]) -> Array:
        z = np.column_stack(of_boundaries)
        z[self.harmless] = -CERTAIN
        return z

    @property
    def boundaries(self) -> Array:
        """The probits of P(at least as severe), without noise, (n, b): what is integrated over many designs.

        The simulator is deterministic, and the noise of labels would put a floor under a small probability.
        """
        return nested_probits(self._probits([one.side for one in self.moments]), self.is_nested)

    def beyond(self, severity: int, shift: float | None = None) -> Array:
        """P(at least as severe as outcome `severity`) of one simulation, (n,).

        Args:
            severity: number of the outcome.
            shift: of the boundary's latent from its mean, in standard deviations, if it were known.
        """
        one = self.moments[severity - 1]
        of_boundaries = [of.standardised for of in self.moments]
        if shift is not None:
            of_boundaries[severity - 1] = one.known(shift)
        z = self._probits(of_boundaries)
        return np.asarray(np.minimum(outcome_probabilities(z, self.is_nested)[:, severity:].sum(axis=1), 1.0))


def predicted(latents: Sequence[Any], features: FeatureMap, X: Array, F: Array | None = None) -> Predicted:
    """What latents say of designs, (n, d), whose scaled features, (n, m), are F if the caller has them already."""
    F = features(X) if F is None else F
    return Predicted(tuple(latent.moments(F) for latent in latents), is_nested(latents), features.certain(X))


@dataclass(frozen=True)
class Classifier:
    """Probabilities of outcomes in order of severity, from one latent per boundary.

    Attributes:
        outcomes: names, least severe first.
        features: map from designs to the latents' inputs.
        latents: one for each outcome but the first: "at least as severe as this one".
        choices: what each latent is learned from; empty if all are learned from the outcomes alone.
        unknown: positive where a simulation probably gives no result that is known; None if all gave one.
        impossible: positive where a design probably does not exist; None if all did.
    """

    outcomes: tuple[str, ...]
    features: FeatureMap
    latents: tuple[Latent | MarginLatent, ...]
    choices: tuple[Choice, ...] = ()
    unknown: Latent | None = None
    impossible: Latent | None = None

    @property
    def loses(self) -> bool:
        """Whether any simulation gave no result."""
        return self.unknown is not None or self.impossible is not None

    def answers(self, F: Array) -> Array:
        """Probability of a result at scaled features, (n, m) -> (n,)."""
        lost = [latent.moments(F).probability for latent in (self.unknown, self.impossible) if latent is not None]
        return np.asarray(np.prod([np.ones(len(F)), *(1.0 - p for p in lost)], axis=0))

    def latent(self, outcome: str) -> Latent | MarginLatent:
        """The latent of the boundary below the named outcome."""
        return self.latents[self.outcomes.index(outcome) - 1]

    def predicted(self, X: Array) -> "Predicted":
        """Probabilities of designs, (n, d)."""
        return predicted(self.latents, self.features, X)

    def probabilities(self, X: Array) -> Array:
        """Probabilities of the outcomes of designs, (n, d) -> (n, number of outcomes); rows sum to 1."""
        return self.predicted(X).probabilities


def _boundary_labels(outcome: NDArray[np.int8], severity: int) -> "Tensor":
    return torch.from_numpy(np.where(outcome >= severity, 1.0, -1.0))


def lost_latent(F: Array, lost: NDArray[np.bool_], kernel: Kernel) -> Latent:
    """The latent of simulations without a result: positive at scaled features, (n, m), like those that were lost."""
    return Latent(fit(torch.from_numpy(F), torch.from_numpy(np.where(lost, 1.0, -1.0)), kernel))


@dataclass(frozen=True)
class LearnableMargins:
    """The margins that a classifier may learn from.

    Attributes:
        values: (b, n, k) float64, for each boundary one column for each of the simulator's margins, at most 0 beyond.
        levels: (b, k) at or below which a margin of the simulator is beyond each boundary.
        columns: those that may be chosen.
        required: whether the one column must be used, without a comparison.
    """

    values: Array
    levels: Array
    columns: tuple[int, ...]
    required: bool = False


def train(
    X: Array,
    outcome: NDArray[np.int8],
    outcomes: Sequence[str],
    features: FeatureMap,
    kernel: Kernel,
    warm: Classifier | None = None,
    margins: LearnableMargins | None = None,
) -> Classifier:
    """Train a classifier on designs, (n, d), and their outcomes, (n,), without numerical failures.

    Args:
        X, outcome: the designs, and indices into the outcomes.
        outcomes: names, least severe first.
        features: map from designs to the latents' inputs.
        kernel: kernel of the latents' covariance.
        warm: a classifier trained on the first of these points, as the starting point.
        margins: the margins of these designs; without them, boundaries are learned from outcomes alone.

    Raises:
        InputError: if there are no designs.
    """
    if len(X) == 0:
        raise InputError("None of the simulations gave an outcome, so there is nothing to learn from.")
    F = features(X)

    severities = range(1, len(outcomes))

    def chosen(severity: int) -> Choice:
        assert margins is not None
        previous = warm.choices[severity - 1] if warm is not None and warm.choices else None
        return _choice(F, outcome, severity, margins, kernel, previous)

    def learned(severity: int) -> Fit | MarginFit:
        own = warm is not None and learned_with(warm.choices, severity) == severity
        before = warm.latents[severity - 1].trained if warm is not None and own else None
        if margins is None or choices[severity - 1].margin == OUTCOMES:
            start = before if isinstance(before, Fit) else None
            return fit(torch.from_numpy(F), _boundary_labels(outcome, severity), kernel, start)
        margin = margins.values[severity - 1][:, choices[severity - 1].margin]
        return fit_defined(F, margin, before if isinstance(before, MarginFit) else None)

    # torch and LAPACK release the interpreter's lock, so boundaries train in parallel.
    with ThreadPoolExecutor(len(severities)) as pool:
        choices = () if margins is None else tuple(pool.map(chosen, severities))
        own = [severity for severity in severities if learned_with(choices, severity) == severity]
        trained = dict(zip(own, pool.map(learned, own), strict=True))
    latents = []
    for severity in severities:
        of_boundary = trained[learned_with(choices, severity)]
        latents.append(
            Latent(of_boundary)
            if isinstance(of_boundary, Fit)
            else MarginLatent(of_boundary, level_of(margins, choices, severity))
        )
    return Classifier(tuple(outcomes), features, tuple(latents), choices)


def learned_with(choices: Sequence[Choice], severity: int) -> int:
    """The boundary whose latent a boundary shares: the most severe one that is learned from the same margin."""
    if not choices or (margin := choices[severity - 1].margin) == OUTCOMES:
        return severity
    return max(other for other, choice in enumerate(choices, start=1) if choice.margin == margin)


def level_of(margins: "LearnableMargins | None", choices: Sequence[Choice], severity: int) -> float:
    """The level of a boundary's margin, in relation to the boundary whose latent it shares."""
    assert margins is not None
    levels = margins.levels[:, choices[severity - 1].margin]
    return float(levels[severity - 1] - levels[learned_with(choices, severity) - 1])


def _choice(
    F: Array,
    outcome: NDArray[np.int8],
    severity: int,
    margins: LearnableMargins,
    kernel: str,
    previous: Choice | None,
) -> Choice:
    """What a boundary is learned from: as before, unless the models must be compared again."""
    n, beyond, values = len(F), outcome >= severity, margins.values[severity - 1]
    if margins.required:
        column = margins.columns[0]
        return Choice(OUTCOMES if usable(values[:, column], beyond) else column, n)
    holds = previous is not None and (previous.margin == OUTCOMES or not usable(values[:, previous.margin], beyond))
    if previous is not None and holds and not is_due(previous, n, beyond):
        return previous
    return choose(F, beyond, values, margins.columns, kernel)
