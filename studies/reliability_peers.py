"""Other libraries on the problems of reliability.py: simulations until they stop by themselves, and their estimate.

    pip install -c constraints.txt -e . -r studies/requirements-peers.txt
    python studies/reliability_peers.py --seeds 5 --out peers.jsonl

    ak-mcs     UQpy: active learning and kriging with the U function, which stops by min U >= 2; a Latin hypercube of
               12 or 2d designs first, 10,000 candidates in each step, scikit-learn's regression with a Gaussian kernel,
               a budget of 200. The final surrogate is integrated by 1,000,000 designs.
    form-is    OpenTURNS: the design point by the first-order method (gradients by differences), then importance
               sampling around it until the coefficient of variation is 0.1, at most 10,000 simulations.
    subset     OpenTURNS: subset simulation with 1,000 simulations a level.

All work in standard normal space. The evaluations of gradients count. The table gives, for each problem and peer, the
median of the simulations, the median and range of the estimate over the true probability, and how many estimates are
more than 20 % off. A peer that fails counts as off, with a probability of 0. A library that is not installed is
skipped. SMT has kriging but no reliability method, so it is not here.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from problems import BENCHMARK, problem_of
from reliability import is_wrong
from study import Rows, asked, head, line, spread

BUDGET = 200
CANDIDATES = 10_000
DESIGNS = 1_000_000


class Limit:
    """A problem's limit state in standard normal space, which counts its evaluations."""

    def __init__(self, name):
        self.problem = problem_of(name)
        self.space = self.problem.campaign().space
        self.calls = 0

    def __call__(self, Z):
        Z = np.atleast_2d(np.asarray(Z, dtype=np.float64))
        self.calls += len(Z)
        return self.problem.limit(self.space.from_normal(Z))


class Kriging:
    """scikit-learn's regression as UQpy calls a surrogate; UQpy's own fails on some of the problems."""

    def __init__(self, dimension, seed):
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel

        kernel = ConstantKernel(1.0, (1e-3, 1e4)) * RBF(np.ones(dimension), (1e-2, 1e3))
        self.model = GaussianProcessRegressor(
            kernel, alpha=1e-8, normalize_y=True, n_restarts_optimizer=2, random_state=seed
        )

    def fit(self, samples, values, optimizations_number=None):
        self.model.fit(samples, np.ravel(values))

    def predict(self, points, return_std=False):
        return self.model.predict(np.atleast_2d(points), return_std=return_std)


def ak_mcs(limit, seed):
    from UQpy.distributions import Normal
    from UQpy.run_model.RunModel import RunModel
    from UQpy.sampling.adaptive_kriging_functions.UFunction import UFunction
    from UQpy.sampling.AdaptiveKriging import AdaptiveKriging

    class Simulations(RunModel):
        """A run model that calls the limit state."""

        def __init__(self):
            self.qoi_list = []

        def run(self, samples=None, append_samples=True):
            self.qoi_list = [*(self.qoi_list if append_samples else []), *limit(samples).tolist()]

    d, rng = limit.space.dimension, np.random.default_rng(seed)
    surrogate = Kriging(d, seed)
    space = limit.space
    Z = space.to_normal(space.latin_hypercube(max(12, 2 * d), rng))
    search = AdaptiveKriging(
        distributions=[Normal(0.0, 1.0)] * d,
        runmodel_object=Simulations(),
        surrogate=surrogate,
        learning_function=UFunction(u_stop=2),
        learning_nsamples=CANDIDATES,
        random_state=seed,
    )
    search.run(nsamples=BUDGET, samples=Z)
    failures = 0
    for _ in range(100):
        mean = np.ravel(surrogate.predict(rng.standard_normal((DESIGNS // 100, d))))
        failures += int((mean <= 0.0).sum())
    return failures / DESIGNS


def _event(limit):
    import openturns as ot

    d = limit.space.dimension
    function = ot.PythonFunction(d, 1, func=lambda z: [float(limit(z)[0])], func_sample=lambda Z: limit(Z)[:, None])
    vector = ot.RandomVector(ot.Normal(d))
    return ot.ThresholdEvent(ot.CompositeRandomVector(function, vector), ot.LessOrEqual(), 0.0), d


def form_is(limit, seed):
    import openturns as ot

    ot.RandomGenerator.SetSeed(seed)
    event, d = _event(limit)
    first_order = ot.FORM(ot.AbdoRackwitz(), event, [0.1] * d)
    first_order.run()
    point = first_order.getResult().getStandardSpaceDesignPoint()
    around = ot.Normal(point, ot.CovarianceMatrix(d))
    sampling = ot.ProbabilitySimulationAlgorithm(ot.StandardEvent(event), ot.ImportanceSamplingExperiment(around))
    sampling.setMaximumCoefficientOfVariation(0.1)
    sampling.setBlockSize(1)
    sampling.setMaximumOuterSampling(10_000)
    sampling.run()
    return sampling.getResult().getProbabilityEstimate()


def subset(limit, seed):
    import openturns as ot

    ot.RandomGenerator.SetSeed(seed)
    event, _ = _event(limit)
    simulation = ot.SubsetSampling(event)
    simulation.setBlockSize(1)
    simulation.setMaximumOuterSampling(1000)
    simulation.run()
    return simulation.getResult().getProbabilityEstimate()


PEERS = {"ak-mcs": ak_mcs, "form-is": form_is, "subset": subset}


def table(rows, names):
    head("problem", "peer", "calls", "P/P_ref", "wrong")
    every = {peer: ([], []) for peer in PEERS}
    for name in names:
        for peer, (calls, ratios) in every.items():
            own = rows.of(problem=name, peer=peer)
            if not own:
                continue
            ratio = np.array([row.get("probability", 0.0) for row in own]) / problem_of(name).probability
            calls += (n := [row["calls"] for row in own])
            ratios += ratio.tolist()
            failed = next((row["error"] for row in own if "error" in row), "")
            line(name, peer, spread(n, 0), failed or spread(ratio), f"{is_wrong(ratio).sum()}/{len(own)}")
    for peer, (calls, ratios) in every.items():
        if calls:
            wrong = is_wrong(np.array(ratios)).sum()
            print(f"{peer}: median {np.median(calls):.0f} calls, {wrong} of {len(calls)} wrong by more than 20 %")


def main():
    options = asked(__doc__, problems=list(BENCHMARK), peers=list(PEERS), seeds=5, out=Path)
    rows = Rows(options.out)
    warnings.simplefilter("ignore")
    cases = [(seed, name, peer) for seed in range(options.seeds) for name in options.problems for peer in options.peers]
    for seed, name, peer in cases:
        row = {"problem": name, "peer": peer, "seed": seed}
        if not rows.lack(**row):
            continue
        limit = Limit(name)
        try:
            row["probability"] = PEERS[peer](limit, seed)
        except ImportError as error:
            print(f"{peer} is skipped: {error}", file=sys.stderr)
            continue
        except Exception as error:  # a peer that fails has no estimate
            row["error"] = f"{type(error).__name__}: {error}"[:80]
        rows.add(**row, calls=limit.calls)
    table(rows, options.problems)


if __name__ == "__main__":
    main()
