"""The cost of one `run.ask(1)` and `run.tell(...)`, beside the loop's own cost of a simulation and other libraries'.

    python studies/ask_and_tell.py --sizes 500 4000 --pairs 60 --repeats 3
    python studies/ask_and_tell.py --sizes 500 --pairs 1000 --peers ""

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
one thread. A library that is not installed is left out (studies/requirements-peers.txt).
"""

import logging
import shutil
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import torch
from study import asked, campaign_of, head, line

import activefail as af
from activefail.learning.model.threads import one_thread
from activefail.loop.running import run as run_loop
from activefail.record.asked import Asked
from activefail.record.batch import ACTIVE
from activefail.seismic.bearing import TABLE_1, simulate
from activefail.seismic.bearing.outcome import FAILURE, NUMERICAL_FAILURE
from activefail.simulators.interface import Results

INITIAL, FLIGHT, ROWS_OF_A_TABLE = 250, 10, 10
FIRST_SEED = 7000
OUTCOMES = ("survival", "failure")


class Failing:
    """Whether a bearing fails, as a simulator of two outcomes without margins."""

    outcomes, causes, margins, releases_gil = OUTCOMES, ("",), (), True

    def run(self, X):
        code, nothing = simulate(X, threads=1).outcome, np.zeros(len(X))
        outcome = np.where(code == NUMERICAL_FAILURE, -1, code == FAILURE).astype(np.int8)
        return Results(outcome, nothing.astype(np.int8), np.empty((len(X), 0)), nothing)


class Clock:
    """Processor and wall time [s] of steps, each from `start`, or from the last `stop`, to `stop`."""

    def __init__(self):
        self.steps = []
        self.start()

    def start(self):
        self._began = np.array([time.process_time(), time.perf_counter()])

    def stop(self):
        self.steps.append(np.array([time.process_time(), time.perf_counter()]) - self._began)


class TimedExecutor:
    """Simulates at once; its clock runs while it does not."""

    def __init__(self):
        self.clock, self._designs = Clock(), []

    def run(self, simulator, X, arrived=None):
        self.clock.stop()
        results = simulator.run(X)
        self.clock.start()
        return results

    def start(self, simulator, ticket, x):
        self._designs.append((ticket, x))

    def answered(self, seconds):
        ticket, x = self._designs.pop(0)
        return [(ticket, self.run(Failing(), x[None]))]

    def __enter__(self):
        return self

    def __exit__(self, *exception): ...


def campaign_on(seed, batch=1, asynchronous=False):
    sampling = {"initial": INITIAL, "budget": 10**6, "batch": batch, "asynchronous": asynchronous}
    classifier = {"features": "design", "kernel": "matern52"}
    return campaign_of(Failing(), seed=seed, classifier=classifier, validation__size=0, sampling=sampling)


def filled(folder, campaign, n):
    """A run whose n simulations were all asked for and told, in tables of ten."""
    run = af.create_run(folder, campaign, remember=False)
    tell(run, run.ask(min(n, INITIAL)))
    if n > INITIAL:
        rest = campaign.space.latin_hypercube(n - INITIAL, np.random.default_rng([campaign.settings.seed, n]))
        run.store.hand_out(Asked.of(np.arange(INITIAL, n), rest, ACTIVE, 0))
        designs = run.in_flight
        for first in range(0, len(designs), ROWS_OF_A_TABLE):
            tell(run, designs[first : first + ROWS_OF_A_TABLE])
    return run


def tell(run, designs, clock=None):
    results = run.campaign.simulator.run(designs[list(run.space.names)].to_numpy())
    if clock is not None:
        clock.start()
    names = [OUTCOMES[code] if code >= 0 else "numerical_failure" for code in results.outcome.tolist()]
    run.tell(designs.assign(outcome=names))


def pairs(run, steps):
    asking, telling = Clock(), Clock()
    for _ in range(steps):
        asking.start()
        designs = run.ask(1)
        asking.stop()
        tell(run, designs, telling)
        telling.stop()
    return [one + other for one, other in zip(asking.steps, telling.steps, strict=True)]


def loop(folder, record, n, steps, flight=1):
    """The loop's steps on a copy of a record, and the designs that it chose."""
    campaign, executor = campaign_on(record.settings.seed, flight, flight > 1), TimedExecutor()
    with af.create_run(folder, campaign, remember=False) as run:
        for batch in record.store.batches:
            run.store.commit(batch)
        executor.clock = Clock()
        run_loop(campaign, run.store, executor, n + steps)
        # The first entry learns and proposes; one more would only learn from the last result.
        return executor.clock.steps[:steps], run.history.designs[n:]


class BoTorchLoop:
    """Asks and tells as BoTorch's tutorials do, over the unit cube."""

    def __init__(self, U, y, limit):
        import botorch  # noqa: F401

        self.U, self.y, self.limit = U, y, limit

    def ask(self):
        from botorch.acquisition import AnalyticAcquisitionFunction
        from botorch.fit import fit_gpytorch_mll
        from botorch.models.approximate_gp import SingleTaskVariationalGP
        from botorch.optim import optimize_acqf
        from botorch.utils.transforms import t_batch_mode_transform
        from gpytorch.likelihoods import BernoulliLikelihood
        from gpytorch.mlls import VariationalELBO

        class Straddle(AnalyticAcquisitionFunction):
            @t_batch_mode_transform(expected_q=1)
            def forward(self, X):
                posterior = self.model.posterior(X)
                mean, variance = posterior.mean.squeeze(-1).squeeze(-1), posterior.variance.squeeze(-1).squeeze(-1)
                return 1.96 * variance.sqrt() - mean.abs()

        d = self.U.shape[1]
        model = SingleTaskVariationalGP(self.U, self.y[:, None], BernoulliLikelihood(), inducing_points=100)
        bound = VariationalELBO(model.likelihood, model.model, num_data=len(self.U))
        fit_gpytorch_mll(bound, optimizer_kwargs={"timeout_sec": self.limit})
        cube = torch.stack([torch.zeros(d), torch.ones(d)]).double()
        candidate, _ = optimize_acqf(Straddle(model), cube, q=1, num_restarts=10, raw_samples=512)
        return candidate

    def tell(self, u, y):
        self.U, self.y = torch.cat([self.U, u]), torch.cat([self.y, y])


class AEPsychLoop:
    """AEPsych's Strategy."""

    def __init__(self, U, y, limit):
        from aepsych.acquisition import EAVC
        from aepsych.generators import OptimizeAcqfGenerator
        from aepsych.models import GPClassificationModel
        from aepsych.strategy import Strategy

        logging.disable(logging.INFO)  # it logs each fit
        d = U.shape[1]
        low, high = torch.zeros(d).double(), torch.ones(d).double()
        terms = {"target": 0.5, "lb": low, "ub": high}
        generator = OptimizeAcqfGenerator(low, high, acqf=EAVC, acqf_kwargs=terms, restarts=10, samps=1000)
        model = GPClassificationModel(dim=d, max_fit_time=limit)
        self.strategy = Strategy(generator, low, high, ["binary"], model=model, min_asks=10**6)
        self.tell(U, y)

    def ask(self):
        return self.strategy.gen(1)

    def tell(self, u, y):
        self.strategy.add_data(u, y)


PEERS = {"aepsych": AEPsychLoop, "botorch": BoTorchLoop}


def peer_steps(name, record, n, steps, limit):
    history = record.history.training
    U, y = TABLE_1.to_unit(history.designs[:n]), history.outcome[:n].astype(float)
    peer, clock, taken = PEERS[name](torch.from_numpy(U), torch.from_numpy(y), limit), Clock(), []
    for _ in range(steps):
        clock.start()
        u = peer.ask().detach()
        clock.stop()
        failed = Failing().run(TABLE_1.from_unit(u.numpy())).outcome == 1
        clock.start()
        peer.tell(u, torch.from_numpy(failed.astype(float)))
        clock.stop()
        taken.append(clock.steps[-2] + clock.steps[-1])
    return taken


def show(n, side, runs):
    """Print the first step of each repeat apart from the later ones [ms]."""
    first = np.array([steps[0] for steps in runs]) * 1e3
    later = np.array([step for steps in runs for step in steps[1:]]) * 1e3
    low, middle, high = np.percentile(later, [25, 50, 75], axis=0)
    cells = []
    for k in range(2):
        quartiles = f"{middle[k]:.1f} ({low[k]:.1f} .. {high[k]:.1f})"
        cells += [f"{np.median(first[:, k]):.0f}", f"{later[:, k].mean():.1f}", quartiles]
    line(n, side, len(later), *cells)


def measured(n, options, folder):
    """Steps of each side, in the repeats."""
    runs = {side: [] for side in ("pairs", "loop", "asynchronous", *options.peers)}
    for repeat in range(options.repeats):
        place = folder / f"{n}-{repeat}"
        with filled(place / "pairs", campaign_on(FIRST_SEED + repeat), n) as record:
            steps, chosen = loop(place / "loop", record, n, options.pairs)
            runs["loop"].append(steps)
            runs["asynchronous"].append(loop(place / "asynchronous", record, n, options.pairs, FLIGHT)[0])
            for name in options.peers:
                try:
                    runs[name].append(peer_steps(name, record, n, options.peer_pairs, options.limit))
                except ImportError as error:
                    print(f"{name} is left out: {error}")
            runs["pairs"].append(pairs(record, options.pairs))
            if not np.array_equal(record.history.designs[n:], chosen):
                raise SystemExit(f"n = {n}: the loop chose other designs.")
        shutil.rmtree(place)
    return runs


def main():
    options = asked(
        __doc__,
        sizes=[500, 4000],
        pairs=60,
        repeats=3,
        peers=list(PEERS),
        peer_pairs=3,
        limit=60.0,
        folder=Path,
    )
    with tempfile.TemporaryDirectory(dir=options.folder) as folder, one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of the peers' optimisers; only their times count
        torch.manual_seed(0)
        with filled(Path(folder) / "warm", campaign_on(1), 300) as run:
            pairs(run, 2)  # everything is loaded and compiled before the clock runs
        titles = "first", "mean", "median (quartiles)"
        head("n", "", "steps", *(f"{kind} [ms]: {title}" for kind in ("processor", "wall") for title in titles))
        for n in options.sizes:
            for side, runs in measured(n, options, Path(folder)).items():
                if runs:
                    show(n, side, runs)


if __name__ == "__main__":
    main()
