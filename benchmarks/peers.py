"""Compares activefail with other libraries: the same bearing simulations, the same budget, the same scores.

Every peer starts from the same Latin hypercube of a seed and requests the rest in batches. Scores are on the same fresh
designs: the share on the right side of the failure boundary, and the mean log probability [nat] of the true side. All
use the same scaled features. Features are not independent variables over which a peer's optimiser could run, so all
peers choose from the same fresh Sobol' pool of designs (AEPsych from its first quarter); only activefail searches the
design space. activefail's EAVC does not use this search and also chooses from the pool.

    python benchmarks/peers.py --seeds 3 --cache fresh.npz --results peers.jsonl
    python benchmarks/peers.py --peers activefail,activefail-eavc --features collision --results peers.jsonl

Peers are optional (benchmarks/requirements-peers.txt): one that is not installed is skipped. Finished campaigns are
lines of the results file and are not run again, so an interrupted run continues where it stopped.
"""

import argparse
import json
import logging
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtr

from activefail.acquisition.batch_proposal import POOL, propose
from activefail.acquisition.criteria import criterion
from activefail.bearing import TABLE_1, simulate
from activefail.bearing.outcome import FAILURE, NUMERICAL_FAILURE
from activefail.campaign.random_streams import stream
from activefail.features import FeatureMap, feature_map
from activefail.sample_mean import Estimate
from activefail.space import Array, DesignSpace
from activefail.surrogate.classifier import Latent
from activefail.surrogate.fitting import fit
from activefail.surrogate.threads import one_thread

FIRST_SEED = 2000
REFERENCE = "activefail-eavc"
"""What the others are compared with, seed by seed."""
FRESH = (778, 1)
"""Key of the random numbers behind the fresh designs."""


class Answers(NamedTuple):
    """Simulated designs without numerical failures."""

    X: Array  # (n, 9)
    failed: NDArray[np.bool_]  # (n,)
    margin: Array  # (n,), positive where the bearing failed


def failure_margin(X: Array, responses: Any) -> Array:
    """max(gap/h_rim − 1, tilt/tilt of overturning − 1): the limit state of the two causes that have a margin, (n,).

    An escape over the rim (one failure in a hundred) keeps no margin: it counts as failed by a twentieth.
    """
    overturning = np.arctan2(1.0, X[:, TABLE_1.names.index("h_sl_ratio")])
    g = np.maximum(responses.margin("peak_gap_ratio"), responses.margin("peak_tilt") / overturning) - 1.0
    return np.where(responses.outcome == FAILURE, np.where(g > 0.0, g, 0.05), np.minimum(g, 0.0))


def simulated(X: Array) -> Answers:
    responses = simulate(X, threads=1)
    kept = responses.outcome != NUMERICAL_FAILURE
    return Answers(X[kept], responses.outcome[kept] == FAILURE, failure_margin(X, responses)[kept])


def joined(*parts: Answers) -> Answers:
    return Answers(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


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
class Activefail:
    """Matérn-5/2 classifier; designs as `activefail` chooses them by a criterion.

    Attributes:
        criterion: by its name in a campaign file.
    """

    criterion: str = "entropy"
    latent: Latent | None = None

    def learn(self, F: Array, answers: Answers, last: bool) -> None:
        y = torch.from_numpy(np.where(answers.failed, 1.0, -1.0))
        start = None if self.latent is None else self.latent.trained
        self.latent = Latent(fit(torch.from_numpy(F), y, "matern52", start))

    def choose(self, space: DesignSpace, features: FeatureMap, q: int, rng: np.random.Generator) -> Array:
        return propose(self.latent, features, space, criterion(self.criterion), q, rng)

    def probability(self, F: Array) -> Array:
        return self.latent.moments(F).probability


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

    scaled: bool
    fit_seconds: float
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


@dataclass(frozen=True)
class Entry:
    """A peer of the comparison.

    Attributes:
        title: what it is, for the table.
        make: seed -> peer.
        needs: modules.
        static: how all designs are drawn at once; None where they are chosen.
    """

    title: str
    make: Callable[[int], Peer]
    needs: Sequence[str] = ()
    static: Callable[[int, np.random.Generator], Array] | None = None


def uniform(n: int, rng: np.random.Generator) -> Array:
    """n independent designs."""
    return TABLE_1.from_unit(rng.random((n, TABLE_1.dimension)))


def sobol(n: int, rng: np.random.Generator) -> Array:
    """The first n of a scrambled Sobol' sequence."""
    return TABLE_1.sobol(1 << (n - 1).bit_length(), rng)[:n]


def entries(fit_seconds: float) -> dict[str, Entry]:
    """All peers by name, in the order in which they are run."""

    def ours(seed: int) -> Peer:
        return Activefail()

    skl = ("skactiveml", "sklearn")
    return {
        "activefail": Entry("activefail, entropy", ours),
        "activefail-eavc": Entry("activefail, EAVC", lambda seed: Activefail("eavc")),
        "random": Entry("random designs, activefail's classifier", ours, static=uniform),
        "lhs": Entry("static LHS, activefail's classifier", ours, static=TABLE_1.latin_hypercube),
        "sobol": Entry("static Sobol', activefail's classifier", ours, static=sobol),
        "boosting": Entry("gradient boosting, entropy", lambda seed: UncertaintySampling(seed, boosted_trees), skl),
        "gpc": Entry("Laplace GP, entropy", lambda seed: UncertaintySampling(seed, laplace_classifier), skl),
        "ak": Entry("AK-MCS on the margin, U", AdaptiveKriging, ("UQpy", "sklearn")),
        "aepsych": Entry("AEPsych, EAVC", lambda seed: AEPsych(False, fit_seconds), ("aepsych",)),
        "aepsych-scale": Entry("AEPsych, output scale, EAVC", lambda seed: AEPsych(True, fit_seconds), ("aepsych",)),
    }


def missing(entry: Entry) -> str | None:
    """Why a peer cannot be run here; None if it can."""
    for module in entry.needs:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                __import__(module)
        except ImportError as error:
            return f"{module}: {error}"
    return None


@dataclass
class Clock:
    """Seconds of learning and choosing, without those of simulating."""

    seconds: float = 0.0
    _began: float = field(default=0.0, repr=False)

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._began


@dataclass(frozen=True)
class Sizes:
    """Numbers of simulations: initial, total and per batch."""

    initial: int
    budget: int
    batch: int


def campaign(
    entry: Entry,
    space: DesignSpace,
    features: FeatureMap,
    simulated: Callable[[Array], Answers],
    seed: int,
    sizes: Sizes,
) -> tuple[Peer, float]:
    """A peer that has spent its budget, and the seconds that it took itself."""
    torch.manual_seed(seed)  # AEPsych draws from torch's generator
    peer, clock = entry.make(seed), Clock()
    if entry.static is not None:
        answers = simulated(entry.static(sizes.budget, stream(seed, "static", sizes.budget)))
        with clock:
            peer.learn(features(answers.X), answers, True)
        return peer, clock.seconds
    answers = simulated(space.latin_hypercube(sizes.initial, stream(seed, "initial")))
    done, iteration = sizes.initial, 0
    while True:
        with clock:
            peer.learn(features(answers.X), answers, done >= sizes.budget)
        if done >= sizes.budget:
            return peer, clock.seconds
        q, iteration = min(sizes.batch, sizes.budget - done), iteration + 1
        with clock:
            X = peer.choose(space, features, q, stream(seed, "propose", iteration))
        answers, done = joined(answers, simulated(X)), done + q


def fresh_answers(n: int, cache: Path | None) -> Answers:
    """n uniform designs and their answers, kept in a file between runs if one is named."""
    if cache is not None and cache.exists():
        with np.load(cache) as saved:
            if saved["asked"] == n:
                return Answers(saved["X"], saved["failed"], saved["margin"])
    answers = simulated(uniform(n, np.random.default_rng(FRESH)))
    if cache is not None:
        np.savez(cache, asked=n, **answers._asdict())
    return answers


def judged(peer: Peer, F: Array, failed: NDArray[np.bool_]) -> dict[str, float]:
    p = peer.probability(F)
    own_side = np.where(failed, p, 1.0 - p)
    return {
        "accuracy": float(np.mean((p > 0.5) == failed)),
        "log_score": float(np.mean(np.log(np.clip(own_side, 1e-12, None)))),
    }


def table(lines: list[dict[str, Any]], named: dict[str, Entry]) -> str:
    """Means over seeds with their ranges, the most accurate first, and paired differences, in Markdown."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for line in lines:
        groups.setdefault((line["peer"], line["features"]), []).append(line)

    def ahead(group: list[dict[str, Any]], key: str, factor: float, digits: int) -> str:
        """How far the reference is ahead on the seeds that both have, with the 95 % interval of the mean."""
        other = {line["seed"]: line[key] for line in group}
        reference = groups.get((REFERENCE, group[0]["features"]), [])
        pairs = [factor * (line[key] - other[line["seed"]]) for line in reference if line["seed"] in other]
        if group[0]["peer"] == REFERENCE or len(pairs) < 2:
            return ""
        difference = Estimate.over(np.array(pairs))
        low, high = difference.of_mean
        return f"{difference.mean:+.{digits}f} ({low:+.{digits}f} .. {high:+.{digits}f})"

    def span(group: list[dict[str, Any]], key: str, factor: float, digits: int) -> str:
        values = factor * np.array([line[key] for line in group])
        return f"{values.mean():.{digits}f} ({values.min():.{digits}f} .. {values.max():.{digits}f})"

    rows = [
        f"| peer | features | seeds | failure accuracy [%] | {named[REFERENCE].title} ahead by | log score [nat] "
        f"| {named[REFERENCE].title} ahead by | own time [s] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (peer, features), group in sorted(groups.items(), key=lambda g: -np.mean([x["accuracy"] for x in g[1]])):
        title = named[peer].title if peer in named else peer
        rows.append(
            f"| {title} | {features} | {len(group)} | {span(group, 'accuracy', 100.0, 2)} "
            f"| {ahead(group, 'accuracy', 100.0, 2)} | {span(group, 'log_score', 1.0, 3)} "
            f"| {ahead(group, 'log_score', 1.0, 3)} | {np.mean([x['seconds'] for x in group]):.0f} |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", default=",".join(entries(0.0)), help="names, in the order in which they are run")
    parser.add_argument("--features", default="paper,collision", help="feature sets of activefail.features")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--initial", type=int, default=250)
    parser.add_argument("--budget", type=int, default=500)
    parser.add_argument("--batch", type=int, default=10)
    parser.add_argument("--fresh", type=int, default=5000, help="fresh designs for the scores")
    parser.add_argument("--fit-seconds", type=float, default=5.0, help="limit of AEPsych's fits between batches")
    parser.add_argument("--cache", type=Path, help="file (.npz) that keeps the fresh designs")
    parser.add_argument("--results", type=Path, default=Path("peers.jsonl"), help="file of finished campaigns")
    parser.add_argument("--table", action="store_true", help="only print the table of the results file")
    arguments = parser.parse_args()
    named, sizes = entries(arguments.fit_seconds), Sizes(arguments.initial, arguments.budget, arguments.batch)
    setting = {"initial": sizes.initial, "budget": sizes.budget, "batch": sizes.batch, "fresh": arguments.fresh}

    def finished() -> list[dict[str, Any]]:
        if not arguments.results.exists():
            return []
        lines = [json.loads(line) for line in arguments.results.read_text().splitlines()]
        return [line for line in lines if setting.items() <= line.items()]

    if not arguments.table:
        run(arguments, named, sizes, setting, {(x["peer"], x["features"], x["seed"]) for x in finished()})
    print(table(finished(), named))


def run(
    arguments: argparse.Namespace,
    named: dict[str, Entry],
    sizes: Sizes,
    setting: dict[str, int],
    done: set[tuple[str, str, int]],
) -> None:
    """Every campaign that is not done yet; each appends its line to the results file."""
    requested = arguments.peers.split(",")
    if unknown := [name for name in requested if name not in named]:
        raise SystemExit(f"--peers: must be of {', '.join(named)}, got {unknown[0]!r}.")
    reasons = {name: missing(named[name]) for name in requested}
    for name, reason in reasons.items():
        if reason is not None:
            print(f"{name} is left out: {reason}")
    maps = {name: feature_map(name, TABLE_1) for name in arguments.features.split(",")}
    fresh = fresh_answers(arguments.fresh, arguments.cache)
    F = {name: features(fresh.X) for name, features in maps.items()}
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        for name in (name for name in requested if reasons[name] is None):
            for features in maps:
                if (name, features, seed) in done:
                    continue
                with one_thread(), warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # warnings of the peers' optimisers; only their results count
                    peer, seconds = campaign(named[name], TABLE_1, maps[features], simulated, seed, sizes)
                    verdict = judged(peer, F[features], fresh.failed)
                line = {"peer": name, "features": features, "seed": seed, **setting, **verdict, "seconds": seconds}
                with arguments.results.open("a") as file:
                    file.write(json.dumps(line) + "\n")
                print(
                    f"{name:<14} {features:<10} seed {seed}  accuracy {verdict['accuracy']:.4f}  "
                    f"log score {verdict['log_score']:.3f}  {seconds:.0f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
