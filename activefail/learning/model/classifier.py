"""The campaign's classifier: a latent for each boundary between outcomes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from activefail.learning.features import FeatureMap
from activefail.learning.model.margin_choice import Choice
from activefail.learning.model.moments import Predicted, predicted
from activefail.space.space import Array

if TYPE_CHECKING:
    from activefail.learning.model.latent import Latent
    from activefail.learning.model.system import AnyLatent


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
        repeatable: whether equal designs have equal results; otherwise the boundary is where the probability is ½.
    """

    outcomes: tuple[str, ...]
    features: FeatureMap
    latents: "tuple[AnyLatent, ...]"
    choices: tuple[Choice, ...] = ()
    unknown: "Latent | None" = None
    impossible: "Latent | None" = None
    repeatable: bool = True

    @property
    def loses(self) -> bool:
        """Whether any simulation gave no result."""
        return self.unknown is not None or self.impossible is not None

    @property
    def expected_losses(self) -> int:
        """How many simulations gave no result where the others lead one to expect that: near others that gave none."""
        if self.unknown is None:
            return 0
        lost = self.unknown.trained.labels.numpy() > 0.5
        return int((lost & (self.unknown.left_out().mean > 0.0)).sum())

    def answers(self, F: Array) -> Array:
        """Probability of a result at scaled features, (n, m) -> (n,)."""
        lost = [latent.moments(F).probability for latent in (self.unknown, self.impossible) if latent is not None]
        return np.asarray(np.prod([np.ones(len(F)), *(1.0 - p for p in lost)], axis=0))

    def existence(self, X: Array) -> Array:
        """Probability that designs, (n, d), exist, (n,)."""
        if self.impossible is None:
            return np.ones(len(X))
        return np.asarray(1.0 - self.impossible.moments(self.features(X)).probability)

    def latent(self, outcome: str) -> "AnyLatent":
        """The latent of the boundary below the named outcome."""
        return self.latents[self.outcomes.index(outcome) - 1]

    def predicted(self, X: Array) -> Predicted:
        """Probabilities of designs, (n, d)."""
        return predicted(self, X)

    def probabilities(self, X: Array) -> Array:
        """Probabilities of the outcomes of designs, (n, d) -> (n, number of outcomes); rows sum to 1."""
        return self.predicted(X).probabilities
