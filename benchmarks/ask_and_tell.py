"""The cost of one `run.ask(1)` and `run.tell(...)`, beside the loop's own cost of a simulation and other libraries'.

    python benchmarks/ask_and_tell.py --sizes 500 4000 --pairs 60 --repeats 3
    python benchmarks/ask_and_tell.py --sizes 500 --pairs 1000 --peers ""

The problem is whether the bearing fails, over the nine variables of Table 1 in standard units. A record of n designs, a
Latin hypercube of each seed, is there before the clock starts; simulations are outside the clock. Each side then takes
the same number of steps: it proposes one design, gets its outcome and keeps it.

    pairs         `run.ask(1)` and `run.tell(table)` on a run folder. The design and its outcome are durable when the
                  calls return. Each `ask` learns from all outcomes and saves the classifier. It learns hyperparameters
                  again whenever the record has grown by a twentieth, and otherwise keeps them.
    loop          what `activefail run` spends between two simulations, in batches of one, on a run folder. It learns,
                  saves and proposes the same, which is checked. It does not record designs in flight, since the record
                  gives them again.
    asynchronous  the same with ten simulations in flight.
    aepsych       AEPsych's Strategy with GPClassificationModel and OptimizeAcqfGenerator by EAVC, and the library's
                  defaults. It learns all hyperparameters anew for each design, within --limit seconds, with 100
                  inducing points. Nothing is durable.
    botorch       as in BoTorch's tutorials: SingleTaskVariationalGP with a Bernoulli likelihood and 100 inducing
                  points, fit_gpytorch_mll, and optimize_acqf of the straddle, 1.96 sd − |mean|. It learns all
                  hyperparameters anew for each design, within --limit seconds. Nothing is durable.

activefail's first step learns from nothing, on 250 designs and then on all, and is reported apart. Times are processor
time of this process over all its threads, and wall time, which depends on the machine's other work. Linear algebra uses
one thread. A library that is not installed is left out (benchmarks/requirements-peers.txt).
"""

import argparse
import logging
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

import activefail as af
from activefail.bearing import TABLE_1, simulate
from activefail.bearing.outcome import FAILURE, NUMERICAL_FAILURE
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.loop.batches import run as run_loop
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE
from activefail.simulators.interface import Results
from activefail.space import Array
from activefail.surrogate.threads import one_thread

INITIAL, FLIGHT, ROWS_OF_A_TABLE = 250, 10, 10
FIRST_SEED = 7000


class Failing:
    """Whether a bearing fails, as a simulator of two outcomes without margins."""

    outcomes, causes, margins, releases_gil = ("survival", "failure"), ("",), (), True

    def run(self, X: Array) -> Results:
        responses = simulate(X, threads=1)
        outcome = np.where(responses.outcome == FAILURE, 1, np.where(responses.outcome == NUMERICAL_FAILURE, -1, 0))
        n = len(X)
        return Results(outcome.astype(np.int8), np.zeros(n, dtype=np.int8), np.empty((n, 0)), np.zeros(n))


class Step(NamedTuple):
    """Seconds of one step."""

    processor: float
    wall: float


class Clock:
    """Seconds between `start` and `stop`."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.start()

    def start(self) -> None:
        self._began = time.process_time(), time.perf_counter()

    def stop(self) -> None:
        self.steps.append(Step(time.process_time() - self._began[0], time.perf_counter() - self._began[1]))


class TimedExecutor:
    """Simulates at once; its clock runs while it does not."""

    def __init__(self) -> None:
        self.clock = Clock()
        self._answers: list[tuple[int, Results]] = []

    def run(self, simulator: Any, X: Array, progress: Any = None) -> Results:
        self.clock.stop()
        results = simulator.run(X)
        self.clock.start()
        return results

    def start(self, simulator: Any, ticket: int, x: Array) -> None:
        self._answers.append((ticket, x))

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        self.clock.stop()
        ticket, x = self._answers.pop(0)
        results = Failing().run(x[None])
        self.clock.start()
        return [(ticket, results)]

    def __enter__(self) -> "TimedExecutor":
        return self

    def __exit__(self, *exception: object) -> None: ...


def campaign_of(seed: int, **sampling: Any) -> Campaign:
    changes = {"seed": seed, "classifier.features": "design", "classifier.kernel": "matern52", "validation.size": 0}
    changes |= {"sampling.initial": INITIAL, "sampling.budget": 10**6, "sampling.batch": 1}
    changes |= {f"sampling.{name}": value for name, value in sampling.items()}
    return Campaign.of(CampaignSettings().changed(changes), simulator=Failing())


def filled(folder: Path, campaign: Campaign, n: int) -> af.Run:
    """A run whose n simulations were all asked for and told, in tables of ten."""
    run = af.create_run(folder, campaign, remember=False)
    tell(run, run.ask(min(n, INITIAL)))
    if n > INITIAL:
        rest = campaign.space.latin_hypercube(n - INITIAL, np.random.default_rng([campaign.settings.seed, n]))
        asked = run.store.asked
        run.store.write_asked(asked.and_then(Asked.of(np.arange(INITIAL, n), rest, ACTIVE, 0)))
        designs = run.in_flight
        for first in range(0, len(designs), ROWS_OF_A_TABLE):
            tell(run, designs[first : first + ROWS_OF_A_TABLE])
    return run


def tell(run: af.Run, designs: Any, clock: Clock | None = None) -> None:
    results = run.campaign.simulator.run(designs[list(run.space.names)].to_numpy())
    names = {-1: "numerical_failure", 0: "survival", 1: "failure"}
    if clock is not None:
        clock.start()
    run.tell(designs.assign(outcome=[names[code] for code in results.outcome.tolist()]))


def pairs(run: af.Run, steps: int) -> list[Step]:
    asking, telling = Clock(), Clock()
    for _ in range(steps):
        asking.start()
        designs = run.ask(1)
        asking.stop()
        tell(run, designs, telling)
        telling.stop()
    return [Step(*map(sum, zip(*both, strict=True))) for both in zip(asking.steps, telling.steps, strict=True)]


def loop(folder: Path, record: af.Run, n: int, steps: int, flight: int) -> tuple[list[Step], Array]:
    """The loop's steps on a copy of a record, and the designs that it chose."""
    asynchronous = flight > 1
    campaign = campaign_of(record.settings.seed, batch=flight, asynchronous=asynchronous)
    executor = TimedExecutor()
    with af.create_run(folder, campaign, remember=False) as run:
        for batch in record.store.batches:
            run.store.commit(batch)
        executor.clock = Clock()
        run_loop(campaign, run.store, executor, n + steps)
        executor.clock.stop()
        taken = executor.clock.steps
        # The first entry learns and proposes; the last only learns from the last result.
        return taken[:steps], run.history.designs[n:]


def straddle(model: Any) -> Any:
    from botorch.acquisition import AnalyticAcquisitionFunction
    from botorch.utils.transforms import t_batch_mode_transform

    class Straddle(AnalyticAcquisitionFunction):
        @t_batch_mode_transform(expected_q=1)
        def forward(self, X: torch.Tensor) -> torch.Tensor:
            posterior = self.model.posterior(X)
            mean, variance = posterior.mean.squeeze(-1).squeeze(-1), posterior.variance.squeeze(-1).squeeze(-1)
            return 1.96 * variance.sqrt() - mean.abs()

    return Straddle(model)


class BoTorchLoop:
    """Asks and tells as BoTorch's tutorials do, over the unit cube."""

    def __init__(self, U: torch.Tensor, y: torch.Tensor, limit: float) -> None:
        import botorch  # noqa: F401

        self.U, self.y, self.limit = U, y, limit

    def ask(self) -> torch.Tensor:
        from botorch.fit import fit_gpytorch_mll
        from botorch.models.approximate_gp import SingleTaskVariationalGP
        from botorch.optim import optimize_acqf
        from gpytorch.likelihoods import BernoulliLikelihood
        from gpytorch.mlls import VariationalELBO

        d = self.U.shape[1]
        model = SingleTaskVariationalGP(self.U, self.y[:, None], BernoulliLikelihood(), inducing_points=100)
        bound = VariationalELBO(model.likelihood, model.model, num_data=len(self.U))
        fit_gpytorch_mll(bound, optimizer_kwargs={"timeout_sec": self.limit})
        cube = torch.stack([torch.zeros(d), torch.ones(d)]).double()
        candidate, _ = optimize_acqf(straddle(model), cube, q=1, num_restarts=10, raw_samples=512)
        return candidate

    def tell(self, u: torch.Tensor, y: torch.Tensor) -> None:
        self.U, self.y = torch.cat([self.U, u]), torch.cat([self.y, y])


class AEPsychLoop:
    """AEPsych's Strategy."""

    def __init__(self, U: torch.Tensor, y: torch.Tensor, limit: float) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from aepsych.acquisition import EAVC
            from aepsych.generators import OptimizeAcqfGenerator
            from aepsych.models import GPClassificationModel
            from aepsych.strategy import Strategy

        logging.disable(logging.INFO)  # it logs each fit
        d = U.shape[1]
        low, high = torch.zeros(d).double(), torch.ones(d).double()
        generator = OptimizeAcqfGenerator(
            low, high, acqf=EAVC, acqf_kwargs={"target": 0.5, "lb": low, "ub": high}, restarts=10, samps=1000
        )
        model = GPClassificationModel(dim=d, max_fit_time=limit)
        self.strategy = Strategy(generator, low, high, ["binary"], model=model, min_asks=10**6)
        self.strategy.add_data(U, y)

    def ask(self) -> torch.Tensor:
        return self.strategy.gen(1)

    def tell(self, u: torch.Tensor, y: torch.Tensor) -> None:
        self.strategy.add_data(u, y)


PEERS: dict[str, Callable[[torch.Tensor, torch.Tensor, float], Any]] = {"aepsych": AEPsychLoop, "botorch": BoTorchLoop}


def peer_steps(name: str, record: af.Run, n: int, steps: int, limit: float) -> list[Step]:
    history = record.history.training
    U = torch.from_numpy(TABLE_1.to_unit(history.designs[:n]))
    y = torch.from_numpy(history.outcome[:n].astype(float))
    peer, clock = PEERS[name](U, y, limit), Clock()
    for _ in range(steps):
        clock.start()
        u = peer.ask()
        clock.stop()
        failed = Failing().run(TABLE_1.from_unit(u.detach().numpy())).outcome == 1
        clock.start()
        peer.tell(u.detach(), torch.from_numpy(failed.astype(float)))
        asked = clock.steps.pop()
        clock.stop()
        clock.steps[-1] = Step(*(np.add(asked, clock.steps[-1])))
    return clock.steps


def line(n: int, side: str, runs: list[list[Step]]) -> None:
    """Print the first step of each repeat apart from the later ones [ms]."""
    first = np.array([steps[0] for steps in runs]) * 1e3
    later = np.array([step for steps in runs for step in steps[1:]]) * 1e3
    quartiles = np.percentile(later, [25, 50, 75], axis=0)
    of_both = "  ".join(
        f"{np.median(first[:, k]):8.0f} {later[:, k].mean():8.1f} {quartiles[1, k]:8.1f}"
        f" ({quartiles[0, k]:.1f} .. {quartiles[2, k]:.1f})"
        for k in range(2)
    )
    print(f"{n:6} {side:13} {len(later):6}  {of_both}", flush=True)


def measure(n: int, options: argparse.Namespace, folder: Path) -> Iterator[tuple[str, list[list[Step]]]]:
    runs: dict[str, list[list[Step]]] = {}
    for repeat in range(options.repeats):
        place = folder / str(repeat)
        with filled(place / "pairs", campaign_of(FIRST_SEED + repeat), n) as record:
            before = loop(place / "loop", record, n, options.pairs, 1)
            runs.setdefault("loop", []).append(before[0])
            runs.setdefault("asynchronous", []).append(
                loop(place / "asynchronous", record, n, options.pairs, FLIGHT)[0]
            )
            for name in options.peers:
                try:
                    steps = peer_steps(name, record, n, options.peer_pairs, options.limit)
                except ImportError as error:
                    print(f"{n:6} {name:13} left out: {error}")
                    continue
                runs.setdefault(name, []).append(steps)
            runs.setdefault("pairs", []).append(pairs(record, options.pairs))
            if not np.array_equal(record.history.designs[n:], before[1]):
                raise SystemExit(f"n = {n}: the loop chose other designs.")
        shutil.rmtree(place)
    for side in ("pairs", "loop", "asynchronous", *options.peers):
        if side in runs:
            yield side, runs[side]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", type=int, default=[500, 4000], help="simulations in the record")
    parser.add_argument("--pairs", type=int, default=60, help="steps of activefail, at least 2")
    parser.add_argument("--repeats", type=int, default=3, help="seeds")
    parser.add_argument("--peers", default=",".join(PEERS), help="of aepsych,botorch; empty for none")
    parser.add_argument("--peer-pairs", type=int, default=3, help="steps of a peer, at least 2")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of a peer's fit")
    parser.add_argument("--folder", type=Path, help="where run folders are made; a temporary folder by default")
    options = parser.parse_args()
    options.peers = [name for name in options.peers.split(",") if name]
    if unknown := [name for name in options.peers if name not in PEERS]:
        parser.error(f"--peers must be of {', '.join(PEERS)}, got {unknown[0]!r}.")
    with tempfile.TemporaryDirectory(dir=options.folder) as folder, one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of the peers' optimisers; only their times count
        torch.manual_seed(0)
        with filled(Path(folder) / "warm", campaign_of(1), 300) as run:
            pairs(run, 2)  # everything is loaded and compiled before the clock runs
        print(f"{'':28}  {'processor time [ms]':40}  wall time [ms]")
        title = f"{'first':>8} {'mean':>8} {'median (quartiles)':<24}"
        print(f"{'n':>6} {'':13} {'steps':>6}  {title}  {title}")
        for n in options.sizes:
            for side, runs in measure(n, options, Path(folder) / str(n)):
                line(n, side, runs)


if __name__ == "__main__":
    main()
