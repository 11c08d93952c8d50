"""How often the interval of a verified error covers the true error, and the error at which a stop rule ends campaigns.

    python studies/verification.py parts --repetitions 4000
    python studies/verification.py rare --campaigns 20
    python studies/verification.py bearing --campaigns 20 --budget 350 --simulations 100 200 --stop 0.03

`parts` draws answers for parts of a design space with known volumes and known shares of errors: true errors from 0.05
to 20 %, 10 to 1,000 simulations, with and without an initial design, compared with the former bounds. `rare` verifies
classifiers of a reliability problem whose failure 30 simulations seldom show, so most errors are unseen failures.
`bearing` runs campaigns on the bearing, each with its own seed; the true error is measured on separate fresh designs.
Campaigns with a stop rule run until it ends them, or to 600 simulations, and are scored in the same way.
"""

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
from problems import BENCHMARK
from study import asked, campaign_of, in_memory

from activefail.estimates.confidence_bounds import StratifiedCount
from activefail.estimates.error import allotted, verify
from activefail.estimates.probability_estimator import Estimator
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import accuracy
from activefail.simulators.interface import NUMERICAL_FAILURE

FIRST_SEED, MOST = 4000, 600

EXPECTED = np.array([0.001, 0.01, 0.04, 0.15, 0.37])
"""What a classifier expects in each part, by which simulations are shared out."""

VOLUMES = {
    "all in the surest part": (1.0, 0.0, 0.0, 0.0, 0.0),
    "failure is rare": (0.97, 0.01, 0.01, 0.005, 0.005),
    "a good classifier": (0.9, 0.04, 0.03, 0.02, 0.01),
    "a fair classifier": (0.7, 0.1, 0.1, 0.06, 0.04),
    "a poor classifier": (0.3, 0.2, 0.2, 0.15, 0.15),
}
ERRORS = (0.0005, 0.002, 0.008, 0.02, 0.05, 0.1, 0.2)
SIMULATIONS = (10, 30, 100, 300, 1000)
INITIAL = (0, 30, 250)


def shares_of(where, volumes, error):
    """Shares of errors in the parts that give an error over the space; None if the parts cannot hold it."""
    match where:
        case "as expected":
            p = EXPECTED * error / (volumes @ EXPECTED)
        case "even":
            p = np.full(5, error)
        case "in the surest part":
            p = np.array([error / volumes[0], 0.0, 0.0, 0.0, 0.0])
        case _:
            p, left = np.zeros(5), error
            for part in (4, 3, 2, 1, 0):
                p[part] = min(left / volumes[part], 0.6) if volumes[part] else 0.0
                left -= p[part] * volumes[part]
    fits = np.isclose(volumes @ np.clip(p, 0.0, 1.0), error) and p[volumes > 0].max() <= 0.95
    return np.clip(p, 0.0, 1.0) if fits else None


def bounds_before(volumes, n, x, rng):
    """The former 90 % interval: a posterior with the classifier's expectation as its prior."""
    shares = rng.beta(0.1 + EXPECTED + x, 0.5 + 1.0 - EXPECTED + n - x, size=(2000, 5))
    low, high = np.quantile(shares @ volumes, [0.05, 0.95])
    return float(low), float(high)


def parts(repetitions):
    rng = np.random.default_rng(1)
    rows, before = [], []
    places = ("as expected", "even", "in the surest part", "in the least sure parts")
    for volumes, where, error in itertools.product(VOLUMES.items(), places, ERRORS):
        name, V = volumes[0], np.array(volumes[1])
        p = shares_of(where, V, error)
        if p is None:
            continue
        for simulations, initial in itertools.product(SIMULATIONS, INITIAL):
            n = allotted(V, EXPECTED, simulations).astype(np.float64)
            n[0] += round(initial * V[0])
            drawn, times = np.unique(rng.binomial(n.astype(int), p, (repetitions, 5)), axis=0, return_counts=True)
            held = held_one_sided = 0
            for x, number in zip(drawn.astype(np.float64), times.tolist(), strict=True):
                count = StratifiedCount(V, n, x)
                held += number * (count.lower(0.95) <= error <= count.upper(0.95))
                held_one_sided += number * (error <= count.upper(0.9))
            rows.append((held / repetitions, held_one_sided / repetitions, name, where, error, simulations, initial))
            if len(drawn) <= 200:
                intervals = [bounds_before(V, n, x, rng) for x in drawn.astype(np.float64)]
                holds = [low <= error <= high for low, high in intervals]
                before.append(float(np.average(holds, weights=times)))
    print(
        f"{len(rows)} cases of {repetitions} draws; nominal 90 %, standard error {30 / np.sqrt(repetitions):.2f} points"
    )
    for title, column in (("interval", 0), ("upper bound", 1), ("interval before", None)):
        held = np.array(before if column is None else [row[column] for row in rows])
        print(
            f"{title:<16} least {100 * held.min():.1f} %, median {100 * np.median(held):.1f} %, "
            f"below 88 %: {int(np.sum(held < 0.88))} of {len(held)} cases"
        )
    for row in sorted(rows)[:5]:
        print("  {:.4f} {:.4f}  {}, errors {}, error {}, {} simulations, initial {}".format(*row))


def true_error(learned, n, seed):
    campaign = learned.campaign
    X = campaign.space.from_unit(np.random.default_rng([779, seed]).random((n, campaign.space.dimension)))
    outcome = campaign.simulator.run(X).outcome
    answered = outcome != NUMERICAL_FAILURE
    return 1.0 - accuracy(learned.classifier, campaign.severity, X[answered], outcome[answered])


def campaigns(make, options, fresh):
    """Campaigns of a seed, verified; then, with `options.stop`, those that a stop rule ends."""
    covered, good, stopped = dict.fromkeys(options.simulations, 0), 0, 0
    for seed in range(FIRST_SEED, FIRST_SEED + options.campaigns):
        with ThreadExecutor(1) as executor, one_thread():
            learned = in_memory(make(seed=seed))
            history, true = learned.history, true_error(learned, fresh, seed)
            text = (
                f"seed {seed}  {(history.outcome == learned.campaign.severity).sum()} failures  true {100 * true:.2f} %"
            )
            for n in options.simulations:
                given = learned.campaign, learned.store, executor, learned.classifier, history.last_iteration
                error = verify(Estimator(*given), n, 0.9)
                covered[n] += error.low <= true <= error.high
                text += f"  | {n}: {100 * error.error:.2f} ({100 * error.low:.2f} to {100 * error.high:.2f})"
            if options.stop:
                rule = {"error": options.stop, "confidence": 0.9}
                learned = in_memory(make(seed=seed, sampling__budget=MOST, stop=rule))
                done, true = len(learned.history), true_error(learned, fresh, seed)
                text += f"  | stop at {done}, true {100 * true:.2f}"
                stopped += done < MOST
                good += done < MOST and true <= options.stop
        print(text, flush=True)
    for n, number in covered.items():
        print(f"90 % interval from {n} fresh simulations: holds the true error in {number} of {options.campaigns}")
    if options.stop:
        rule = f"stop at an error of {100 * options.stop:g} % at confidence 0.9"
        print(f"{rule}: {good} of {stopped} that stopped have it")


def main():
    options = asked(
        __doc__,
        words="what",
        repetitions=4000,
        campaigns=20,
        features="paper",
        budget=350,
        simulations=[100, 200],
        stop=0.0,
        fresh=8000,
    )
    match options.what:
        case ["parts"]:
            parts(options.repetitions)
        case ["rare"]:
            problem = replace(BENCHMARK["RP38"], shown=None)
            campaigns(partial(problem.campaign, sampling__initial=30, sampling__budget=30), options, 200_000)
        case ["bearing"]:
            settings = {"classifier__kernel": "matern52", "classifier__features": options.features}
            campaigns(partial(campaign_of, sampling__budget=options.budget, **settings), options, options.fresh)


if __name__ == "__main__":
    main()
