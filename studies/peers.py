"""Other libraries that learn a boundary and choose designs, as methods of criteria.py (docs/peers.md).

Features are not independent variables over which a library's optimiser could run, so peers choose from a fresh Sobol'
pool of designs (AEPsych from its first quarter). A library that is not installed (studies/requirements-peers.txt)
raises ImportError.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.learning.criteria.batch_proposal import POOL
from activefail.learning.features import FeatureMap
from activefail.seismic.bearing import TABLE_1
from activefail.seismic.bearing.outcome import FAILURE
from activefail.space.space import Array, DesignSpace


class Answers(NamedTuple):
    """Simulated designs without numerical failures."""

    X: Array  # (n, d)
    failed: NDArray[np.bool_]  # (n,)
    margin: Array  # (n,), positive where the design failed; NaN where there is none


def failure_margin(X: Array, responses: Any) -> Array:
    """max(gap/h_rim − 1, tilt/tilt of overturning − 1): the limit state of the two causes that have a margin, (n,).

    An escape over the rim (one failure in a hundred) keeps no margin: it counts as failed by a twentieth.
    """
    overturning = np.arctan2(1.0, X[:, TABLE_1.names.index("h_sl_ratio")])
    g = np.maximum(responses.margin("peak_gap_ratio"), responses.margin("peak_tilt") / overturning) - 1.0
    return np.where(responses.outcome == FAILURE, np.where(g > 0.0, g, 0.05), np.minimum(g, 0.0))


class Peer(Protocol):
    """A method that learns a boundary and chooses the next designs."""

    def learn(self, F: Array, answers: Answers, last: bool) -> None:
        """Learn from scaled features, (n, m), and answers; `last` after the last batch."""

    def choose(self, space: DesignSpace, features: FeatureMap, q: int, rng: np.random.Generator) -> Array:
        """The q designs, (q, d), to simulate next."""

    def probability(self, F: Array) -> Array:
        """Of failure at scaled features, (n, m) -> (n,)."""


def pool(space: DesignSpace, features: FeatureMap, rng: np.random.Generator) -> tuple[Array, Array]:
    """The candidates, common to all peers, and their features."""
    X = space.sobol(POOL, rng)
    return X, features(X)


@dataclass
class AEPsych:
    """GPClassificationModel with its default inducing points and priors, EAVC at the level 0.5.

    Attributes:
        scaled: whether the kernel's amplitude is learned (`fixed_kernel_amplitude = False`); by default it is 1.
        fit_seconds: `max_fit_time` of the fits between batches, which start from the hyperparameters before; the last
            fit starts afresh and has no limit.
        candidates, references: sizes of the grid that is searched and of EAVC's query set; the library's defaults are
            1,000 and 256.
    """

    scaled: bool = False
    fit_seconds: float = 1.0
    candidates: int = 1024
    references: int = 256
    bounds: tuple[Array, Array] | None = None
    model: Any = None

    def _fresh(self, m: int) -> Any:
        from aepsych.config import Config
        from aepsych.factory.default import default_mean_covar_factory
        from aepsych.models import GPClassificationModel

        torch.set_default_dtype(torch.float64)
        logging.disable(logging.INFO)  # it logs each fit
        if not self.scaled:
            return GPClassificationModel(dim=m)
        box = {"lb": str([0] * m), "ub": str([1] * m), "fixed_kernel_amplitude": "False"}
        mean, covariance = default_mean_covar_factory(Config(config_dict={"default_mean_covar_factory": box}), m)
        return GPClassificationModel(dim=m, mean_module=mean, covar_module=covariance)

    def _unit(self, F: Array) -> torch.Tensor:
        low, high = self.bounds
        return torch.from_numpy((F - low) / (high - low))

    def learn(self, F: Array, answers: Answers, last: bool) -> None:
        # The library's priors are for variables between 0 and 1: the features' ranges over the first designs.
        if self.bounds is None:
            self.bounds = F.min(axis=0), F.max(axis=0)
        y = torch.from_numpy(answers.failed.astype(float))
        if last or self.model is None:
            self.model = self._fresh(F.shape[1])
            self.model.fit(self._unit(F), y)
        else:
            self.model.fit(self._unit(F), y, warmstart_hyperparams=True, max_fit_time=self.fit_seconds)

    def choose(self, space: DesignSpace, features: FeatureMap, q: int, rng: np.random.Generator) -> Array:
        from aepsych.acquisition import EAVC

        X, F = pool(space, features, rng)
        unit = self._unit(F)
        # The rest of a Sobol' sequence is one too, so no reference is a candidate.
        some, query = unit[: self.candidates], unit[self.candidates : self.candidates + self.references]
        cube = torch.zeros(unit.shape[1]), torch.ones(unit.shape[1])
        eavc = EAVC(*cube, model=self.model, target=0.5, query_set_size=len(query), Xq=query)
        with torch.no_grad():
            value = torch.cat([eavc(rows[:, None, :]) for rows in some.split(64)])
        return X[torch.topk(value, q).indices.numpy()]  # as its AcqfGridSearchGenerator does

    def probability(self, F: Array) -> Array:
        mean, _ = self.model.predict(self._unit(F), probability_space=True)
        return mean.numpy()


@dataclass
class UncertaintySampling:
    """A scikit-learn classifier with scikit-activeml's entropy sampling, q of the most uncertain of the pool.

    Attributes:
        classifier: (seed, number of features, the estimator before or None) -> estimator.
    """

    seed: int
    classifier: Callable[[int, int, Any], Any]
    learned: Any = None
    seen: tuple[Array, Array] | None = None

    def learn(self, F: Array, answers: Answers, last: bool) -> None:
        from skactiveml.classifier import SklearnClassifier

        before = None if self.learned is None else self.learned.estimator_
        estimator = self.classifier(self.seed, F.shape[1], before)
        self.learned = SklearnClassifier(estimator, classes=[0, 1], random_state=self.seed)
        self.seen = F, answers.failed.astype(int)
        self.learned.fit(*self.seen)

    def choose(self, space: DesignSpace, features: FeatureMap, q: int, rng: np.random.Generator) -> Array:
        from skactiveml.pool import UncertaintySampling as Strategy

        X, F = pool(space, features, rng)
        strategy = Strategy(method="entropy", random_state=self.seed)
        rows = strategy.query(*self.seen, clf=self.learned, fit_clf=False, candidates=F, batch_size=q)
        return X[rows]

    def probability(self, F: Array) -> Array:
        return self.learned.predict_proba(F)[:, 1]


def laplace_classifier(seed: int, m: int, before: Any) -> Any:
    from sklearn.gaussian_process import GaussianProcessClassifier
    from sklearn.gaussian_process.kernels import RBF

    kernel = 1.0 * RBF(np.ones(m)) if before is None else before.kernel_
    return GaussianProcessClassifier(kernel, random_state=seed)


def boosted_trees(seed: int, m: int, before: Any) -> Any:
    from sklearn.ensemble import HistGradientBoostingClassifier

    return HistGradientBoostingClassifier(random_state=seed)


@dataclass
class AdaptiveKriging:
    """AK-MCS (Echard et al. 2011): a kriging of the failure margin, UQpy's U function over the pool.

    With a nugget that is learned: the paper's six features do not determine what happens, so that the interpolation of
    the original would follow noise. The margin is divided, on either side of zero, by its mean size there over the
    first designs: a simulation ends at failure, which leaves failures margins of a few hundredths, and a mean of both
    sides would otherwise be negative nearly everywhere.
    """

    seed: int
    surrogate: Any = None
    sizes: tuple[float, float] | None = None  # of the margins of survival and of failure
    margin_sd: float = 1.0

    def learn(self, F: Array, answers: Answers, last: bool) -> None:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import Matern, WhiteKernel

        m = F.shape[1]
        fresh = 1.0 * Matern(np.ones(m), nu=2.5) + WhiteKernel(0.1)
        kernel = fresh if self.surrogate is None else self.surrogate.kernel_
        self.surrogate = GaussianProcessRegressor(kernel, normalize_y=True, random_state=self.seed)
        if self.sizes is None:
            by_side = answers.margin[~answers.failed], answers.margin[answers.failed]
            self.sizes = float(np.abs(by_side[0]).mean()), float(np.abs(by_side[1]).mean())
        margin = answers.margin / np.where(answers.failed, self.sizes[1], self.sizes[0])
        self.surrogate.fit(F, margin)
        self.margin_sd = float(margin.std())

    def choose(self, space: DesignSpace, features: FeatureMap, q: int, rng: np.random.Generator) -> Array:
        from UQpy.sampling import UFunction

        X, F = pool(space, features, rng)
        # UQpy returns rows, not their indices, so a last column holds the indices.
        numbered = np.column_stack([F, np.arange(len(F))])
        rows, _, _ = UFunction().evaluate_function(None, q, self, numbered)
        return X[rows[:, -1].astype(int)]

    def predict(self, numbered: Array, return_std: bool) -> tuple[Array, Array]:
        """Mean and standard deviation for UQpy, without the nugget's."""
        mean, sd = self.surrogate.predict(numbered[:, :-1], return_std=True)
        nugget = self.surrogate.kernel_.k2.noise_level * self.margin_sd**2
        return mean, np.sqrt(np.maximum(sd**2 - nugget, 1e-12))

    def probability(self, F: Array) -> Array:
        mean, sd = self.surrogate.predict(F, return_std=True)
        return ndtr(mean / np.maximum(sd, 1e-12))


PEERS: dict[str, Callable[[int], Peer]] = {
    "boosting": lambda seed: UncertaintySampling(seed, boosted_trees),
    "gpc": lambda seed: UncertaintySampling(seed, laplace_classifier),
    "ak": AdaptiveKriging,
    "aepsych": lambda seed: AEPsych(),
    "aepsych-scale": lambda seed: AEPsych(scaled=True),
}
"""By name: gradient boosting and a Laplace GP by entropy, AK-MCS on the margin by U, AEPsych by EAVC (twice)."""


def learned(name: str, campaign: Campaign, simulated: Callable[[Array], Answers]) -> Peer:
    """A peer that has spent a campaign's budget, from the campaign's initial design on."""
    seed, sampling, features = campaign.settings.seed, campaign.settings.sampling, campaign.features
    torch.manual_seed(seed)  # AEPsych draws from torch's generator
    peer, answers = (
        PEERS[name](seed),
        simulated(campaign.space.latin_hypercube(sampling.initial, stream(seed, "initial"))),
    )
    done, iteration = sampling.initial, 0
    while True:
        peer.learn(features(answers.X), answers, done >= sampling.budget)
        if done >= sampling.budget:
            return peer
        q, iteration = min(sampling.batch, sampling.budget - done), iteration + 1
        more = simulated(peer.choose(campaign.space, features, q, stream(seed, "propose", iteration)))
        answers, done = Answers(*map(np.concatenate, zip(answers, more, strict=True))), done + q
