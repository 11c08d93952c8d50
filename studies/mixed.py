"""Spaces with steps and choices: activefail, static designs, and BoTorch's mixed models with the straddle.

    python studies/mixed.py                                            all problems, ten seeds
    python studies/mixed.py --problems column --seeds 2                a quick look
    python studies/mixed.py --methods botorch-mixed --seeds 1          BoTorch's optimiser of mixed spaces: slow
    python studies/mixed.py --table --write docs/distributions.md      the table of the finished campaigns

All methods get the margin. `active` is a campaign with the default criterion and classifier, `static` the same
classifier of a Latin hypercube of the same size, `botorch` a MixedSingleTaskGP whose next design has the least
|mean| − 1.96 sd in a pool of 4,096. With `botorch-mixed`, optimize_acqf_mixed_alternating finds it, in seconds.
`active` and `botorch` start from the same Latin hypercube of 20 designs, and simulate one design at a time; `botorch`
fits its hyperparameters after every ten, by at most 100 steps of L-BFGS. Problems:

    column     a steel column: profile (8), ends (3), grade (3), length in steps, load
    waves      which of six waves a point lies above; its height has steps
    bearings   a catalogue of bearings: displacement capacity and rims in steps, three liners; pulse
    records    the same bearings under the far-field records of FEMA P695, by name and peak ground velocity

A cell has the share of 2,000 fresh designs on the right side of the boundary: the median over the seeds (least ..
greatest) [%]; the mean difference to `active` of the same seed with its 95 % interval [points]; the number of seeds.
Finished campaigns are lines of --out and are not run again.
"""

import warnings
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AnalyticAcquisitionFunction
from botorch.fit import fit_gpytorch_mll
from botorch.models import MixedSingleTaskGP
from botorch.optim.optimize_mixed import optimize_acqf_mixed_alternating
from botorch.utils.transforms import t_batch_mode_transform
from gpytorch.mlls import ExactMarginalLogLikelihood
from numpy.typing import NDArray
from peers import failure_margin
from problems import Problem, Variables
from study import Rows, asked, in_memory, markdown, timed, write_between

from activefail.campaign.random_streams import stream
from activefail.learning.criteria.batch_proposal import POOL
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import accuracy, learn_from
from activefail.seismic.bearing import TABLE_1, simulate, simulate_records
from activefail.seismic.bearing.outcome import CAUSES, NO_TOUCH
from activefail.seismic.ida.sample_mean import Estimate
from activefail.space.space import Array, DesignSpace

SIZES, INITIAL, FRESH, REFITTED = (30, 40, 60), 20, 2_000, 10
METHODS = ("active", "static", "botorch")
BEGIN, END = "<!-- table of studies/mixed.py -->", "<!-- end of the table of studies/mixed.py -->"

_PROFILES = {
    "HEA120": (25.3, 3.02),
    "HEA160": (38.8, 3.98),
    "HEA200": (53.8, 4.98),
    "HEA240": (76.8, 6.00),
    "IPE200": (28.5, 2.24),
    "IPE240": (39.1, 2.69),
    "IPE300": (53.8, 3.35),
    "SHS120": (27.2, 4.73),
}
"""Area [cm²] and least radius of gyration [cm]."""

_ENDS = {"pinned": 1.0, "fixed_pinned": 0.7, "cantilever": 2.0}


def _column(space: DesignSpace, X: Array) -> Array:
    """Logarithm of the resistance, by Perry and Robertson with an imperfection of 0.34, over the load."""
    profile, ends = (column.astype(int) for column in (X[:, 0], X[:, 1]))
    area, gyration = np.array([*_PROFILES.values()]).T[:, profile]
    strength, length, load = space.table(X, ("grade", "length", "load")).T
    slender = length * 100.0 * np.array([*_ENDS.values()])[ends] / gyration / (np.pi * np.sqrt(210e3 / strength))
    phi = 0.5 * (1.0 + 0.34 * np.maximum(slender - 0.2, 0.0) + slender**2)
    reduction = np.minimum(1.0, 1.0 / (phi + np.sqrt(np.maximum(phi**2 - slender**2, 0.0))))
    return np.asarray(np.log(reduction * area * strength * 0.1 / load))


def _waves(space: DesignSpace, X: Array) -> Array:
    x, y, kind = X[:, 0], X[:, 1], X[:, 2].astype(int)
    cycles, phase = np.array([1.0, 1.0, 2.0, 2.0, 3.0, 0.5])[kind], np.array([0.0, 0.5, 0.1, 0.6, 0.3, 0.2])[kind]
    return np.asarray(y - 0.5 - 0.3 * np.sin(2.0 * np.pi * (cycles * x + phase)))


def _bearings(space: DesignSpace, X: Array) -> Array:
    table = space.table(X, TABLE_1.names)
    return -failure_margin(table, simulate(table, threads=1))


def _records(space: DesignSpace, X: Array) -> Array:
    (records,) = (one.payload for one in space.parameters if one.payload is not None)
    quantities, bearings = dict(zip(space.names, X.T, strict=True)), space.table(X, TABLE_1.names[:7])
    which = quantities["record"].astype(int)
    pairs = zip(which, records.factors(which, quantities), strict=True)
    responses = simulate_records(bearings, [records()[i].motion.scaled(factor) for i, factor in pairs], threads=1)
    # Under strong records a plate can lift off before the slider touches a rim (docs/records.md).
    lifted = responses.cause_name == CAUSES[NO_TOUCH]
    assert (lifted | (responses.outcome >= 0)).all()
    return -np.where(lifted, 0.05, failure_margin(bearings, responses))


_CATALOGUE: Variables = {
    "D_tot": {"low": 0.45, "high": 0.85, "step": 0.05},
    "mu": {"choices": [0.04, 0.07, 0.1]},
    "h_rim_ratio": {"low": 0.05, "high": 0.2, "step": 0.05},
    "T_b": {"low": 2.5, "high": 5.5},
    "h_sl_ratio": {"low": 0.33, "high": 1.3},
    "p": {"value": 45.0},
    "k": {"value": 2e9},
}

PROBLEMS: dict[str, tuple[Callable[[DesignSpace, Array], Array], Variables]] = {
    "column": (
        _column,
        {
            "profile": {"choices": [*_PROFILES]},
            "ends": {"choices": [*_ENDS]},
            "grade": {"choices": [235, 275, 355]},
            "length": {"low": 2.0, "high": 8.0, "step": 0.25},
            "load": {"low": 50.0, "high": 1500.0, "distribution": "log_uniform"},
        },
    ),
    "waves": (
        _waves,
        {
            "x": {"low": 0.0, "high": 1.0},
            "y": {"low": 0.0, "high": 1.0, "step": 0.05},
            "kind": {"choices": [*"abcdef"]},
        },
    ),
    "bearings": (_bearings, _CATALOGUE | {"T_p": {"low": 0.25, "high": 5.0}, "A_p": {"low": 0.1, "high": 0.8}}),
    "records": (
        _records,
        _CATALOGUE
        | {
            "record": {"set": "farfield", "scaled_to": {"PGV": "pgv"}},
            "PGV": {"low": 0.3, "high": 3.0, "distribution": "log_uniform"},
        },
    ),
}
"""Limit states, of a space and designs, (n, d) -> (n,), and the variables."""


@cache
def problem_of(name: str) -> Problem:
    """The problem of a name, as a simulator."""
    limit, variables = PROBLEMS[name]
    space = Problem(partial(limit, None), variables).campaign().space
    return Problem(partial(limit, space), variables)


@cache
def fresh(name: str) -> tuple[Array, NDArray[np.bool_]]:
    """Fresh designs of a problem, and which of them fail."""
    problem = problem_of(name)
    X = problem.campaign().space.random(FRESH, np.random.default_rng(777))
    return X, problem.limit(X) <= 0.0


class Straddle(AnalyticAcquisitionFunction):
    """1.96 sd − |mean|: large where the sign of the margin is in doubt."""

    @t_batch_mode_transform(expected_q=1)
    def forward(self, X: torch.Tensor) -> torch.Tensor:
        mean, sd = self._mean_and_sigma(X)
        return (1.96 * sd - mean.abs()).squeeze(-1)


class MixedModel:
    """BoTorch's regression of margins, over numbers in the unit interval and the codes of choices.

    Args:
        space: of the designs.
        g: (n,) the first margins. Margins of either side are divided by their mean size among these: where a
            simulation ends at failure, those beyond would otherwise be too small to count (as for AK-MCS in peers.py).
    """

    def __init__(self, space: DesignSpace, g: Array) -> None:
        self.space, self.sides = space, (g[g > 0.0].mean(), -g[g <= 0.0].mean())
        self.choices = [i for i, one in enumerate(space.parameters) if one.choices]
        self.low, self.width = space.low.copy(), space.high - space.low
        self.low[self.choices], self.width[self.choices] = 0.0, 1.0
        self.model: Any = None

    def _scaled(self, X: Array) -> torch.Tensor:
        return torch.from_numpy((X - self.low) / self.width)

    def learn(self, X: Array, g: Array) -> None:
        """Learn designs, (n, d), and their margins, (n,); hyperparameters are fitted afresh at every tenth."""
        y, before = torch.from_numpy(g / np.where(g > 0.0, *self.sides))[:, None], self.model
        self.model = MixedSingleTaskGP(self._scaled(X), y, cat_dims=self.choices)
        if len(X) % REFITTED == 0:
            search = {"options": {"maxiter": 100}}
            mll = ExactMarginalLogLikelihood(self.model.likelihood, self.model)
            fit_gpytorch_mll(mll, optimizer_kwargs=search)
            return
        for part in ("mean_module", "covar_module", "likelihood"):
            getattr(self.model, part).load_state_dict(getattr(before, part).state_dict())
        self.model.eval()

    def choose(self, rng: np.random.Generator) -> Array:
        """The next design, (1, d), of a pool."""
        X = self.space.sobol(POOL, rng)
        with torch.no_grad():
            return X[[int(Straddle(self.model)(self._scaled(X)[:, None, :]).argmax())]]

    def choose_anywhere(self, rng: np.random.Generator) -> Array:
        """The next design, (1, d), by BoTorch's optimiser of mixed spaces."""
        values = {
            i: ((one.values - self.low[i]) / self.width[i]).tolist()
            for i, one in enumerate(self.space.parameters)
            if len(one.values)
        }
        torch.manual_seed(int(rng.integers(1 << 31)))
        best, _ = optimize_acqf_mixed_alternating(
            Straddle(self.model),
            self._scaled(np.stack([self.space.low, self.space.high])),
            discrete_dims={i: at for i, at in values.items() if i not in self.choices},
            cat_dims={i: at for i, at in values.items() if i in self.choices},
            raw_samples=512,
            num_restarts=2,
        )
        return self.space.nearest(self.low + self.width * best.detach().numpy())

    def failed(self, X: Array) -> NDArray[np.bool_]:
        """Whether designs, (n, d), fail, (n,)."""
        with torch.no_grad():
            return (self.model.posterior(self._scaled(X)).mean[:, 0] <= 0.0).numpy()


def by_botorch(problem: Problem, space: DesignSpace, anywhere: bool, seed: int) -> Iterator[MixedModel]:
    """The models at each size."""
    X = space.latin_hypercube(INITIAL, stream(seed, "initial"))
    g, rng = problem.limit(X), stream(seed, "propose")
    model = MixedModel(space, g)
    choose = model.choose_anywhere if anywhere else model.choose
    for size in SIZES:
        while len(X) < size:
            model.learn(X, g)
            X = np.concatenate([X, choose(rng)])
            g = np.concatenate([g, problem.limit(X[-1:])])
        model.learn(X, g)
        yield model


def accuracies(name: str, method: str, seed: int) -> list[float]:
    """The share of fresh designs on the right side, at each size."""
    problem, (X, failed) = problem_of(name), fresh(name)
    sizes = {"sampling__initial": INITIAL, "sampling__budget": SIZES[-1], "sampling__batch": 1}
    campaign = problem.campaign(seed=seed, **sizes)
    space = campaign.space
    if method.startswith("botorch"):
        models = by_botorch(problem, space, method == "botorch-mixed", seed)
        return [np.mean(model.failed(X) == failed) for model in models]
    if method == "static":
        samples = [space.latin_hypercube(n, stream(seed, "static", n)) for n in SIZES]
        histories = [History.of_sample(sample, problem.run(sample)) for sample in samples]
    else:
        history = in_memory(campaign).history
        histories = [history[:n] for n in SIZES]
    return [accuracy(learn_from(campaign, history), 1, X, failed) for history in histories]


def scored(name: str, method: str, seed: int) -> dict[str, Any]:
    """A campaign as a row, with its processor seconds."""
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of BoTorch's fits
        fresh(name)
        found, seconds = timed(accuracies, name, method, seed)
    return {"problem": name, "method": method, "seed": seed, "accuracies": found, "seconds": round(seconds, 1)}


def table(rows: Rows, problems: list[str], methods: list[str], seeds: range) -> str:
    """A row for each problem and size and a column for each method, in Markdown."""

    def by_seed(name: str, method: str, size: int) -> dict[int, float]:
        found = {row["seed"]: 100.0 * row["accuracies"][size] for row in rows.of(problem=name, method=method)}
        return {seed: found[seed] for seed in seeds if seed in found}

    def cell(name: str, method: str, size: int) -> str:
        of, base = by_seed(name, method, size), by_seed(name, METHODS[0], size)
        if not of:
            return ""
        values = np.array([*of.values()])
        text = f"{np.median(values):.1f} ({values.min():.1f} .. {values.max():.1f})"
        ahead = np.array([value - base[seed] for seed, value in of.items() if seed in base])
        if method != METHODS[0] and len(ahead) > 2:
            low, high = Estimate.over(ahead).of_mean
            text += f"; {ahead.mean():+.1f} ({low:+.1f} .. {high:+.1f})"
        return f"{text}; {len(values)}"

    lines = [
        [name, str(n), *(cell(name, method, size) for method in methods)]
        for name in problems
        for size, n in enumerate(SIZES)
    ]
    seconds = [f"{np.median([row['seconds'] for row in rows.of(method=m)] or [np.nan]):.0f}" for m in methods]
    return markdown(["problem", "simulations", *methods], [*lines, ["seconds of a campaign", "", *seconds]])


def main() -> None:
    options = asked(
        __doc__,
        problems=list(PROBLEMS),
        methods=list(METHODS),
        seeds=10,
        first_seed=4000,
        out=Path("mixed.jsonl"),
        table=False,
        write=Path,
    )
    rows, seeds = Rows(options.out), range(options.first_seed, options.first_seed + options.seeds)
    for seed in () if options.table else seeds:
        for name in options.problems:
            for method in options.methods:
                if rows.lack(problem=name, method=method, seed=seed):
                    rows.add(**(row := scored(name, method, seed)))
                    print(name, method, seed, *(f"{one:.4f}" for one in row["accuracies"]), row["seconds"], flush=True)
    text = table(rows, options.problems, options.methods, seeds)
    print(text)
    if options.write:
        write_between(options.write, BEGIN, END, text)


if __name__ == "__main__":
    main()
