"""The paper's statistics over many draws of its design: what `activefail paper` computes.

One draw is a Latin hypercube of 250 simulations over Table 1, as the paper had one. Every figure of the paper is then a
distribution over draws, and what the paper could only judge on about 62 held-out points is judged on fresh designs.
"""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from activefail.bearing.design import GRAVITY, TABLE_1, Model
from activefail.bearing.simulation import simulate
from activefail.features import PAPER_FEATURES, feature_map, paper_features
from activefail.space import Array
from activefail.surrogate.classifier import Latent
from activefail.surrogate.fitting import fit
from activefail.surrogate.reference import expectation_propagation, laplace, logistic_regression

SIZE = 250
"""Simulations of one draw, as in the paper."""

BOUNDARIES = {"impact": 1, "failure": 2}
"""The paper's two questions, and the least label that answers yes."""

METHODS = ("laplace", "ep", "variational", "variational_log")
"""Gaussian processes compared: the paper's Laplace, its expectation propagation, and variational ones,
on the features as the paper has them and with their logarithms, as the campaign takes them."""

SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class Logistic:
    """A logistic regression on all six features of one draw."""

    in_sample: float
    fresh: float
    p_values: Array  # (6,); NaN when the classes separate
    separated: bool


@dataclass(frozen=True)
class Process:
    """A Gaussian process classifier of failure, trained on three quarters of one draw."""

    held_out: float  # accuracy on the other quarter
    fresh: float  # accuracy on fresh designs
    log_score: float  # mean log probability of the true class on fresh designs [nat]
    length_scales: Array  # (6,) over the features' ranges
    probability: Array  # (n_fresh,) of failure


@dataclass(frozen=True)
class Draw:
    """Everything computed from one draw."""

    logistic: dict[str, Logistic]
    processes: dict[str, Process]


@dataclass(frozen=True)
class Data:
    """Simulated designs: draws, (draws, 250, 9), fresh ones, (n, 9), and their labels."""

    X: Array
    label: NDArray[np.int8]
    X_fresh: Array
    label_fresh: NDArray[np.int8]


@dataclass(frozen=True)
class Variant:
    """What one choice of the bearing model moves.

    Attributes:
        name: of the choice.
        moved: share of labels that differ from the default model's.
        shares: (3,) of the labels.
        logistic: accuracy in sample, mean over draws, by boundary.
        p_values: (6,) medians over draws, by boundary.
        process: fresh accuracy of the Laplace GP, mean over its draws.
        numerical_failures: among all simulations of the variant.
    """

    name: str
    moved: float
    shares: Array
    logistic: dict[str, float]
    p_values: dict[str, Array]
    process: float
    numerical_failures: int


VARIANTS: dict[str, Model] = {
    "as described": Model(),
    'restitution "assembly"': Model(restitution="assembly"),
    "D_sl = 0.15 m": Model(slider_diameter=0.15),
    "D_sl = 0.60 m": Model(slider_diameter=0.60),
    "v_r = 0.01 m/s": Model(friction_velocity=0.01),
    "failure without loss of confinement": Model(loss_of_confinement=False),
}
"""The choices whose influence is measured, the default first."""


def designs(draws: int, fresh: int, seed: int) -> tuple[Array, Array]:
    """The draws, (draws, 250, 9), and independent uniform fresh designs, (fresh, 9)."""
    X = np.stack([TABLE_1.latin_hypercube(SIZE, np.random.default_rng([seed, 0, draw])) for draw in range(draws)])
    return X, TABLE_1.from_unit(np.random.default_rng([seed, 1]).random((fresh, TABLE_1.dimension)))


def simulated(X: Array, X_fresh: Array, model: Model) -> Data:
    """Labels of draws and fresh designs under a model; numerical failures stay -1."""
    label = simulate(X.reshape(-1, TABLE_1.dimension), model).label.reshape(X.shape[:2])
    return Data(X, label, X_fresh, simulate(X_fresh, model).label)


def _answered(X: Array, label: NDArray[np.int8]) -> tuple[Array, NDArray[np.int8]]:
    return X[label >= 0], label[label >= 0]


def logistic_of_draw(X: Array, y: NDArray[np.bool_], F_fresh: Array, y_fresh: NDArray[np.bool_]) -> Logistic:
    """Logistic regression of a draw's yes-or-no labels on the paper's features."""
    F = paper_features(X)
    fitted = logistic_regression(F, y)
    return Logistic(fitted.accuracy(F, y), fitted.accuracy(F_fresh, y_fresh), fitted.p_values, fitted.separation)


def _paper_scaling() -> tuple[Array, Array]:
    """Mean and standard deviation of the paper's features over the design space, each (6,)."""
    F = paper_features(TABLE_1.sobol(4096, np.random.default_rng(0)))
    return F.mean(axis=0), F.std(axis=0)


def _scaled_features(logarithmic: bool) -> Callable[[Array], Array]:
    """The paper's features in standard units over the design space, ratios as they are or by their logarithm."""
    if logarithmic:
        return feature_map("paper", TABLE_1)
    center, spread = _paper_scaling()
    return lambda X: (paper_features(X) - center) / spread


def process_of_draw(
    method: str,
    X: Array,
    failed: NDArray[np.bool_],
    rng: np.random.Generator,
    X_fresh: Array,
    y_fresh: NDArray[np.bool_],
) -> Process:
    """A GP classifier trained on a random three quarters of a draw and judged on the rest and on fresh designs."""
    order = rng.permutation(len(X))
    train, held_out = np.split(order, [round(0.75 * len(X))])
    features = _scaled_features(method == "variational_log")
    F, F_fresh = features(X), features(X_fresh)
    match method:
        case "laplace" | "ep":
            infer = laplace if method == "laplace" else expectation_propagation
            trained = infer(F[train], failed[train])
            probability, at_fresh = trained.probability(F[held_out]), trained.probability(F_fresh)
            length_scales = trained.hyperparameters.length_scales
        case _:
            labels = torch.from_numpy(np.where(failed[train], 1.0, -1.0))
            latent = Latent(fit(torch.from_numpy(F[train]), labels, "rbf"))
            probability = latent.moments(F[held_out]).probability
            at_fresh = latent.moments(F_fresh).probability
            length_scales = np.exp(latent.trained.hyperparameters.log_lengthscale.numpy())
    sure = np.clip(np.where(y_fresh, at_fresh, 1.0 - at_fresh), 1e-12, None)
    return Process(
        held_out=float(np.mean((probability > 0.5) == failed[held_out])),
        fresh=float(np.mean((at_fresh > 0.5) == y_fresh)),
        log_score=float(np.mean(np.log(sure))),
        length_scales=length_scales / np.ptp(F_fresh, axis=0),
        probability=at_fresh,
    )


def study_draw(
    X: Array,
    label: NDArray[np.int8],
    X_fresh: Array,
    label_fresh: NDArray[np.int8],
    seed: int,
    draw: int,
    methods: tuple[str, ...],
) -> Draw:
    """All that the paper computed, for one draw; runs in a worker process."""
    torch.set_num_threads(1)
    with threadpool_limits(1):
        X, label = _answered(X, label)
        X_fresh, label_fresh = _answered(X_fresh, label_fresh)
        F_fresh = paper_features(X_fresh)
        logistic = {
            name: logistic_of_draw(X, label >= least, F_fresh, label_fresh >= least)
            for name, least in BOUNDARIES.items()
        }
        processes = {
            method: process_of_draw(
                # The same split for every method.
                method,
                X,
                label == 2,
                np.random.default_rng([seed, 2, draw]),
                X_fresh,
                label_fresh == 2,
            )
            for method in methods
        }
        return Draw(logistic, processes)


def study_draws(pool: Executor, data: Data, seed: int, methods: tuple[str, ...]) -> list[Draw]:
    """`study_draw` of every draw, side by side; the results do not depend on the pool's size."""
    futures = [
        pool.submit(study_draw, X, label, data.X_fresh, data.label_fresh, seed, draw, methods)
        for draw, (X, label) in enumerate(zip(data.X, data.label, strict=True))
    ]
    return [future.result() for future in futures]


def median_p_values(draws: list[Draw], boundary: str) -> Array:
    """Median Wald p-values over the draws whose classes did not separate, (6,)."""
    return np.nanmedian([draw.logistic[boundary].p_values for draw in draws], axis=0)


def significant_share(draws: list[Draw], boundary: str) -> Array:
    """Share of draws in which each feature is significant at 5 %, (6,); a separated draw counts as not."""
    p = np.array([draw.logistic[boundary].p_values for draw in draws])
    return np.asarray(np.mean(np.where(np.isnan(p), 1.0, p) < SIGNIFICANCE, axis=0))


def study_variant(pool: Executor, name: str, base: Data, seed: int) -> Variant:
    """What a variant of the model moves, on the designs of the base data."""
    data = simulated(base.X, base.X_fresh, VARIANTS[name])
    both = (data.label >= 0) & (base.label >= 0)
    answered = data.label[data.label >= 0]
    draws = study_draws(pool, data, seed, ("laplace",))
    return Variant(
        name,
        moved=float(np.mean(data.label[both] != base.label[both])),
        shares=np.bincount(answered, minlength=3) / len(answered),
        logistic={boundary: float(np.mean([d.logistic[boundary].in_sample for d in draws])) for boundary in BOUNDARIES},
        p_values={boundary: median_p_values(draws, boundary) for boundary in BOUNDARIES},
        process=float(np.mean([draw.processes["laplace"].fresh for draw in draws])),
        numerical_failures=int(np.sum(data.label < 0) + np.sum(data.label_fresh < 0)),
    )


@dataclass(frozen=True)
class Table2Row:
    """Range and median of one feature: as the formulas give it, and as the paper seems to have computed it."""

    name: str
    low: float
    high: float
    median: float
    medians: Array  # (draws,)
    medians_in_papers_units: Array  # (draws,), the same where the formula alone gives the size of Table 2


def table_2(X: Array) -> list[Table2Row]:
    """Ours of the paper's Table 2 over draws, (draws, 250, 9).

    The paper's D_ratio fits a pulse displacement of A_p·(T_p/2π)² with A_p in g but without g's 9.81, and its k_norm
    that displacement in millimetres: constant factors, which no classifier notices.
    """
    F = paper_features(X.reshape(-1, TABLE_1.dimension))
    medians = np.median(F.reshape(*X.shape[:2], -1), axis=1)
    # k_norm goes with the inverse root of the displacement.
    factor = np.array([1.0 / GRAVITY, 1.0, 1.0, 1.0, 1.0, np.sqrt(GRAVITY / 1000.0)])
    return [
        Table2Row(
            name, F[:, i].min(), F[:, i].max(), float(np.median(F[:, i])), medians[:, i], factor[i] * medians[:, i]
        )
        for i, name in enumerate(PAPER_FEATURES)
    ]


@dataclass(frozen=True)
class Study:
    """All that the reproduction reports."""

    data: Data
    draws: list[Draw]
    variants: list[Variant]
    variant_draws: int  # of the draws, how many each variant was given


def run_study(draws: int, fresh: int, seed: int, stage: Callable[[str], None] = lambda _: None) -> Study:
    """Simulate and compute everything; some minutes on two cores for 20 draws and 4,000 fresh designs."""
    X, X_fresh = designs(draws, fresh, seed)
    stage(f"simulating {draws} draws of {SIZE} and {fresh} fresh designs")
    data = simulated(X, X_fresh, Model())
    # A quarter of the draws for each variant: enough to see which conclusions move, within minutes.
    few = max(2, draws // 4)
    base = Data(data.X[:few], data.label[:few], X_fresh, data.label_fresh)
    variants = []
    with ProcessPoolExecutor(os.cpu_count(), mp_context=multiprocessing.get_context("spawn")) as pool:
        stage(f"regressions and Gaussian processes of {draws} draws")
        studied = study_draws(pool, data, seed, METHODS)
        for name in VARIANTS:
            stage(f"what depends on the model: {name}")
            variants.append(study_variant(pool, name, base, seed))
    return Study(data, studied, variants, few)


def failure_moments(X: Array, failed: NDArray[np.bool_]) -> Callable[[Array], tuple[Array, Array]]:
    """Latent mean and standard deviation of the paper's process, as a function of the paper's features, (n, 6)."""
    center, spread = _paper_scaling()
    trained = laplace((paper_features(X) - center) / spread, failed)
    return lambda F: trained.moments((F - center) / spread)
