"""The paper's statistics over many draws of its design, as computed by `activefail paper`.

A draw is a Latin hypercube of 250 simulations over Table 1, like the paper's. Every number of the paper becomes a
distribution over draws, and accuracy is measured on fresh designs instead of about 62 held-out points."""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logit
from threadpoolctl import threadpool_limits

from activefail.analyses.sensitivity.logistic import logistic_regression
from activefail.estimates.scores import log_score, probability_of_truth
from activefail.execution.pool import ProcessPool
from activefail.learning.features import feature_map
from activefail.learning.model.fitting import fit, outcome_prior
from activefail.learning.model.latent import Latent
from activefail.seismic.bearing.design import TABLE_1, Model
from activefail.seismic.bearing.simulation import simulate
from activefail.seismic.features import paper_features
from activefail.seismic.paper import published
from activefail.seismic.paper.methods import LENGTH_SCALE, train
from activefail.seismic.paper.published import tilted
from activefail.space.space import Array

SIZE = 250
"""Simulations of one draw, as in the paper."""

TRAINING_SHARE = 0.75
"""Share of a draw's points that train a process; the others test it, as in the paper."""

SPLITS = 5
"""Random splits of each draw for the held-out accuracy of the Laplace process: a quarter is only about 62 points."""

BOUNDARIES = {"impact": 1, "failure": 2}
"""The paper's two boundaries, with the least severe outcome beyond each."""

METHODS = ("laplace", "ep", "variational", "variational_log")
"""The Gaussian processes: the paper's Laplace and expectation propagation, and variational ones on the paper's features
and on their logarithms, as in a campaign."""

SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class Logistic:
    """A logistic regression on all six features of one draw."""

    in_sample: float
    fresh: float
    p_values: Array  # (6,); NaN without a maximum
    separated: bool


@dataclass(frozen=True)
class Process:
    """A Gaussian process classifier of failure, trained on three quarters of one draw."""

    held_out: float  # accuracy on the other quarter
    fresh: float  # accuracy on fresh designs
    log_score: float  # mean log probability of the true class on fresh designs [nat]
    calibration_error: float  # mean distance of predicted from observed shares on fresh designs, over ten bins
    calibration_slope: (
        float  # of observed on predicted log odds of failure: above 1 underconfident, below overconfident
    )
    length_scales: Array  # (6,) over the features' ranges
    switched_off: NDArray[np.bool_]  # (6,) whether a length scale reached its upper bound
    converged: bool
    probability: Array  # (n_fresh,) of failure


@dataclass(frozen=True)
class Draw:
    """Everything computed from one draw.

    Attributes:
        logistic: of the whole draw, by boundary.
        three_quarters: fresh accuracy for failure of a logistic regression on the processes' training points.
        processes: by method, on the first split.
        held_out: (splits,) accuracy of the Laplace process on the held-out quarter, the first split first.
    """

    logistic: dict[str, Logistic]
    three_quarters: float
    processes: dict[str, Process]
    held_out: Array


@dataclass(frozen=True)
class Data:
    """Simulated designs: draws, (draws, 250, 9), fresh ones, (n, 9), and their outcomes."""

    X: Array
    outcome: NDArray[np.int8]
    X_fresh: Array
    outcome_fresh: NDArray[np.int8]

    @property
    def simulations(self) -> int:
        """How many designs were simulated."""
        return self.outcome.size + self.outcome_fresh.size

    @property
    def numerical_failures(self) -> int:
        """How many of them failed numerically."""
        return int(np.sum(self.outcome < 0) + np.sum(self.outcome_fresh < 0))

    @property
    def shares(self) -> Array:
        """Shares of the three outcomes in the draws, (3,)."""
        answered = self.outcome[self.outcome >= 0]
        return np.asarray(np.bincount(answered, minlength=3) / len(answered))


@dataclass(frozen=True)
class Variant:
    """The study with one choice changed.

    Attributes:
        name: of the choice.
        moved: share of the draws' outcomes that differ from the default model's; None if the designs differ.
        data: its designs and outcomes.
        draws: of the Laplace process alone, on one split.
    """

    name: str
    moved: float | None
    data: Data
    draws: list[Draw]


VARIANTS: dict[str, Model] = {
    "as described": Model(),
    'restitution "assembly"': Model(restitution="assembly"),
    "D_sl = 0.15 m": Model(slider_diameter=0.15),
    "D_sl = 0.60 m": Model(slider_diameter=0.60),
    "v_r = 0.01 m/s": Model(friction_velocity=0.01),
    "failure without loss of confinement": Model(loss_of_confinement=False),
}
"""The model choices whose influence is measured, the default first."""

TILTED = "the sample tilted to the medians of Table 2"
"""The variant with `tilted` designs and the default model."""


def designs(draws: int, fresh: int, seed: int) -> tuple[Array, Array]:
    """The draws, (draws, 250, 9), and independent uniform fresh designs, (fresh, 9)."""
    X = np.stack([TABLE_1.latin_hypercube(SIZE, np.random.default_rng([seed, 0, draw])) for draw in range(draws)])
    return X, TABLE_1.from_unit(np.random.default_rng([seed, 1]).random((fresh, TABLE_1.dimension)))


def simulated(X: Array, X_fresh: Array, model: Model) -> Data:
    """Outcomes of draws and fresh designs under a model; -1 for numerical failures."""
    outcome = simulate(X.reshape(-1, TABLE_1.dimension), model).outcome.reshape(X.shape[:2])
    return Data(X, outcome, X_fresh, simulate(X_fresh, model).outcome)


def _answered(X: Array, outcome: NDArray[np.int8]) -> tuple[Array, NDArray[np.int8]]:
    return X[outcome >= 0], outcome[outcome >= 0]


def logistic_of_draw(X: Array, y: NDArray[np.bool_], F_fresh: Array, y_fresh: NDArray[np.bool_]) -> Logistic:
    """Logistic regression of a draw's binary labels on the paper's features."""
    F = paper_features(X)
    fitted = logistic_regression(F, y)
    return Logistic(fitted.accuracy(F, y), fitted.accuracy(F_fresh, y_fresh), fitted.p_values, fitted.separation)


def _paper_scaling() -> tuple[Array, Array]:
    """Mean and standard deviation of the paper's features over the design space, each (6,)."""
    F = paper_features(TABLE_1.sobol(4096, np.random.default_rng(0)))
    return F.mean(axis=0), F.std(axis=0)


def _scaled_features(logarithmic: bool) -> Callable[[Array], Array]:
    """The paper's features, standardised over the design space, optionally with logarithms of the ratios."""
    if logarithmic:
        return feature_map("paper", TABLE_1)
    center, spread = _paper_scaling()
    return lambda X: (paper_features(X) - center) / spread


def split(rng: np.random.Generator, n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Split n rows at random into training and held-out rows."""
    training, held_out = np.split(rng.permutation(n), [round(TRAINING_SHARE * n)])
    return training, held_out


def calibration_slope(p: Array, y: NDArray[np.bool_]) -> float:
    """Cox's slope [Cox1958]: the coefficient of the predicted log odds in a logistic regression of outcomes, (n,)."""
    log_odds = logit(np.clip(p, 1e-12, 1.0 - 1e-12))
    return float(logistic_regression(log_odds[:, None], y).coefficients[0])


@dataclass(frozen=True)
class _Trained:
    """A trained classifier of failure."""

    probability: Callable[[Array], Array]  # of failure at scaled features
    length_scales: Array  # (6,)
    switched_off: NDArray[np.bool_]  # (6,)
    converged: bool


def _trained(method: str, F: Array, failed: NDArray[np.bool_]) -> _Trained:
    match method:
        case "laplace" | "ep":
            process = train(F, failed, method)
            scales = process.hyperparameters.length_scales
            return _Trained(process.probability, scales, scales > 0.99 * LENGTH_SCALE[1], process.converged)
        case _:
            latent = Latent(
                fit(torch.from_numpy(F), torch.from_numpy(failed.astype(float)), partial(outcome_prior, "rbf"))
            )
            assert latent.length_scales is not None
            scales = latent.length_scales
            # Its weak prior keeps length scales finite, and its search always ends at a minimum.
            return _Trained(lambda G: latent.moments(G).probability, scales, np.zeros(len(scales), dtype=bool), True)


def _trained_on_split(
    method: str, F: Array, failed: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[_Trained, float]:
    """A classifier of random three quarters, and its accuracy on the rest."""
    training, held_out = split(rng, len(F))
    trained = _trained(method, F[training], failed[training])
    return trained, float(np.mean((trained.probability(F[held_out]) > 0.5) == failed[held_out]))


def expected_calibration_error(p: Array, y: NDArray[np.bool_], bins: int = 10) -> float:
    """Σ (n_bin/n)·|mean p − share of y| of probabilities p, (n,), over bins of equal width."""
    bin_index = np.clip((p * bins).astype(int), 0, bins - 1)
    return float(np.abs(np.bincount(bin_index, weights=p - y, minlength=bins)).sum() / len(p))


def process_of_draw(
    method: str,
    X: Array,
    failed: NDArray[np.bool_],
    rng: np.random.Generator,
    X_fresh: Array,
    y_fresh: NDArray[np.bool_],
) -> Process:
    """Train a GP classifier on random three quarters of a draw; test it on the rest and on fresh designs."""
    features = _scaled_features(method == "variational_log")
    F_fresh = features(X_fresh)
    trained, held_out = _trained_on_split(method, features(X), failed, rng)
    p = trained.probability(F_fresh)
    return Process(
        held_out=held_out,
        fresh=float(np.mean((p > 0.5) == y_fresh)),
        log_score=log_score(probability_of_truth(p, y_fresh)),
        calibration_error=expected_calibration_error(p, y_fresh),
        calibration_slope=calibration_slope(p, y_fresh),
        length_scales=trained.length_scales / np.ptp(F_fresh, axis=0),
        switched_off=trained.switched_off,
        converged=trained.converged,
        probability=p,
    )


def study_draw(
    X: Array,
    outcome: NDArray[np.int8],
    X_fresh: Array,
    outcome_fresh: NDArray[np.int8],
    seed: int,
    draw: int,
    methods: tuple[str, ...],
    splits: int,
) -> Draw:
    """The paper's statistics for one draw; runs in a worker process.

    Args:
        X, outcome: the draw, (250, 9) and (250,).
        X_fresh, outcome_fresh: the fresh designs, (n, 9) and (n,).
        seed, draw: seed of the study and number of the draw.
        methods: subset of `METHODS`, including "laplace", for the first split.
        splits: number of splits for the Laplace process.
    """

    def of_split(number: int) -> np.random.Generator:
        return np.random.default_rng([seed, 2, draw, number])

    torch.set_num_threads(1)
    with threadpool_limits(1):
        X, outcome = _answered(X, outcome)
        X_fresh, outcome_fresh = _answered(X_fresh, outcome_fresh)
        F, F_fresh = paper_features(X), paper_features(X_fresh)
        failed, failed_fresh = outcome == 2, outcome_fresh == 2
        training, _ = split(of_split(0), len(X))
        processes = {
            method: process_of_draw(method, X, failed, of_split(0), X_fresh, failed_fresh) for method in methods
        }
        scaled = _scaled_features(False)(X)
        others = [_trained_on_split("laplace", scaled, failed, of_split(number))[1] for number in range(1, splits)]
        return Draw(
            logistic={
                name: logistic_of_draw(X, outcome >= least, F_fresh, outcome_fresh >= least)
                for name, least in BOUNDARIES.items()
            },
            three_quarters=logistic_regression(F[training], failed[training]).accuracy(F_fresh, failed_fresh),
            processes=processes,
            held_out=np.array([processes["laplace"].held_out, *others]),
        )


def study_draws(pool: ProcessPool, data: Data, seed: int, methods: tuple[str, ...], splits: int) -> list[Draw]:
    """`study_draw` for all draws in parallel; the results do not depend on the pool's size."""
    futures = [
        pool.submit(study_draw, X, outcome, data.X_fresh, data.outcome_fresh, seed, draw, methods, splits)
        for draw, (X, outcome) in enumerate(zip(data.X, data.outcome, strict=True))
    ]
    return [future.result() for future in futures]


def _p_values(draws: list[Draw], boundary: str) -> Array:
    """The p-values of each draw, (draws, 6)."""
    return np.array([draw.logistic[boundary].p_values for draw in draws])


def median_p_values(draws: list[Draw], boundary: str) -> Array:
    """Median Wald p-values over the draws that have them, (6,); NaN if none has."""
    p = _p_values(draws, boundary)
    defined = p[~np.isnan(p).any(axis=1)]
    return np.asarray(np.median(defined, axis=0)) if len(defined) else np.full(p.shape[1], np.nan)


def significant_share(draws: list[Draw], boundary: str) -> Array:
    """Share of draws in which each feature is significant at 5 %, (6,); never in a draw without p-values."""
    return np.asarray(np.mean(np.nan_to_num(_p_values(draws, boundary), nan=1.0) < SIGNIFICANCE, axis=0))


@dataclass(frozen=True)
class Study:
    """The results of the reproduction.

    Attributes:
        data: the designs and their outcomes.
        draws: the statistics of each draw.
        variants: the same under other choices; the first is the study itself.
        seed: of all random numbers.
        cores: of the machine.
        minutes: that the study took.
    """

    data: Data
    draws: list[Draw]
    variants: list[Variant]
    seed: int
    cores: int
    minutes: int

    @property
    def command(self) -> dict[str, int]:
        """Options of the command that runs the study again, and what it costs."""
        return {
            "draws": len(self.draws),
            "fresh": len(self.data.X_fresh),
            "seed": self.seed,
            "cores": self.cores,
            "minutes": self.minutes,
        }


def run_study(draws: int, fresh: int, seed: int, stage: Callable[[str], None] = lambda _: None) -> Study:
    """Run the study: some minutes on two cores for 20 draws and 4,000 fresh designs.

    Raises:
        SimulationError: if a worker process dies.
    """
    start, cores = time.monotonic(), os.cpu_count() or 1
    X, X_fresh = designs(draws, fresh, seed)
    stage(f"simulating {draws} draws of {SIZE} and {fresh} fresh designs")
    data = simulated(X, X_fresh, Model())
    with ProcessPool(cores, "nothing is kept") as pool:
        stage(f"regressions and Gaussian processes of {draws} draws")
        studied = study_draws(pool, data, seed, METHODS, SPLITS)
        default, *others = VARIANTS
        variants = [Variant(default, 0.0, data, studied)]
        for name in (*others, TILTED):
            stage(f"variant: {name}")
            if name == TILTED:
                varied, moved = simulated(tilted(X), tilted(X_fresh), Model()), None
            else:
                varied = simulated(X, X_fresh, VARIANTS[name])
                both_answered = (varied.outcome >= 0) & (data.outcome >= 0)
                moved = float(np.mean(varied.outcome[both_answered] != data.outcome[both_answered]))
            variants.append(Variant(name, moved, varied, study_draws(pool, varied, seed, ("laplace",), 1)))
    return Study(data, studied, variants, seed, cores, math.ceil((time.monotonic() - start) / 60.0))


@dataclass(frozen=True)
class PaperProcess:
    """The paper's Gaussian process on one draw's training points.

    Attributes:
        F: (n, 6) the paper's features of the training points.
        failed: (n,) bool.
        moments: gives latent mean and standard deviation, (l,) each, at features, (l, 6).
    """

    F: Array
    failed: NDArray[np.bool_]
    moments: Callable[[Array], tuple[Array, Array]]


def orders_as_the_paper(process: Process) -> bool:
    """Whether every feature significant in the paper has a shorter length scale than every other one."""
    significant = np.array(published.P_VALUES["failure"]) < SIGNIFICANCE
    return bool(process.length_scales[significant].max() < process.length_scales[~significant].min())


def typical_draw(study: Study) -> int:
    """The draw whose first split is shown in Figures 3 to 5.

    Its Laplace process has the median fresh accuracy among those with length scales ordered as in the paper (among all,
    if there are none).
    """
    processes = [draw.processes["laplace"] for draw in study.draws]
    similar = [i for i, process in enumerate(processes) if orders_as_the_paper(process)] or list(range(len(processes)))
    return sorted(similar, key=lambda i: processes[i].fresh)[len(similar) // 2]


def typical_process(study: Study) -> PaperProcess:
    """The Laplace process shown in Figures 3 to 5, of the typical draw."""
    draw = typical_draw(study)
    X, outcome = _answered(study.data.X[draw], study.data.outcome[draw])
    training, _ = split(np.random.default_rng([study.seed, 2, draw, 0]), len(X))
    F, failed = paper_features(X[training]), outcome[training] == 2
    center, spread = _paper_scaling()
    trained = train((F - center) / spread, failed, "laplace")
    return PaperProcess(F, failed, lambda G: trained.moments((G - center) / spread))
