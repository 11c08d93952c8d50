"""Other libraries on the problems of reliability.py: simulations until they stop by themselves, and their estimate.

    pip install -c constraints.txt -e . -r benchmarks/requirements-peers.txt
    python benchmarks/reliability_peers.py --seeds 5 --out peers.jsonl

    ak-mcs     UQpy: active learning and kriging with the U function, which stops by min U >= 2; a Latin hypercube of
               12 or 2d designs first, 10,000 candidates in each step, scikit-learn's regression with a Gaussian kernel,
               a budget of 200. The final surrogate is integrated by 1,000,000 designs.
    form-is    OpenTURNS: the design point by the first-order method (gradients by differences), then importance
               sampling around it until the coefficient of variation is 0.1, at most 10,000 simulations.
    subset     OpenTURNS: subset simulation with 1,000 simulations a level.

All work in standard normal space. The evaluations of gradients count. The table gives, for each problem and peer, the
median of the simulations, the median and range of the estimate over the true probability, and how many estimates are
more than 20 % off. A peer that fails counts as off. A library that is not installed is skipped. SMT has kriging but no
reliability method, so it is not here.
"""

import argparse
import json
import sys
import warnings
from pathlib import Path

import numpy as np
from reliability import campaign_on, is_wrong
from reliability_problems import HELD_OUT, PROBLEMS, problem_of

BUDGET = 200
CANDIDATES = 10_000
DESIGNS = 1_000_000


class Limit:
    """A problem's limit state in standard normal space, which counts its evaluations."""

    def __init__(self, name):
        self.problem = problem_of(name)
        self.space = campaign_on(self.problem, 0, 1, BUDGET).space
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


def table(rows):
    print(f"{'problem':14} {'peer':8} {'calls':>14}  {'P/P_ref':>18}  wrong")
    for name in (*PROBLEMS, *HELD_OUT):
        for peer in PEERS:
            own = [row for row in rows if (row["problem"], row["peer"]) == (name, peer)]
            solved = [row for row in own if "probability" in row]
            if not own:
                continue
            if not solved:
                print(f"{name:14} {peer:8} {'–':>14}  {own[0]['error']}")
                continue
            ratio = np.array([row["probability"] for row in solved]) / problem_of(name).probability
            n = np.array([row["calls"] for row in solved])
            wrong = int(is_wrong(ratio).sum()) + len(own) - len(solved)
            print(
                f"{name:14} {peer:8} {np.median(n):5.0f} ({n.min()}-{n.max()})".ljust(39)
                + f"  {np.median(ratio):.2f} ({ratio.min():.2f}-{ratio.max():.2f})".ljust(22)
                + f"{wrong}/{len(own)}"
            )
    for peer in PEERS:
        own = [row for row in rows if row["peer"] == peer]
        if own:
            ratios = [row.get("probability", 0.0) / problem_of(row["problem"]).probability for row in own]
            calls = np.median([row["calls"] for row in own])
            wrong = int(is_wrong(np.array(ratios)).sum())
            print(f"{peer}: median {calls:.0f} calls, {wrong} of {len(own)} wrong by more than 20 %")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = options.out.read_text().splitlines() if options.out and options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    known = {(row["problem"], row["peer"], row["seed"]) for row in rows}
    warnings.simplefilter("ignore")
    for seed in range(options.seeds):
        for name in options.problems.split(","):
            for peer in options.peers.split(","):
                if (name, peer, seed) in known:
                    continue
                limit = Limit(name)
                row = {"problem": name, "peer": peer, "seed": seed}
                try:
                    row["probability"] = PEERS[peer](limit, seed)
                except ImportError as error:
                    print(f"{peer} is skipped: {error}", file=sys.stderr)
                    continue
                except Exception as error:  # a peer that fails has no estimate
                    row["error"] = f"{type(error).__name__}: {error}"[:80]
                rows.append(row | {"calls": limit.calls})
                if options.out:
                    with options.out.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    table(rows)


if __name__ == "__main__":
    main()
