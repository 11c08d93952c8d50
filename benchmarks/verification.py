"""How often the interval of a campaign's verified error holds its true error, and what a stop by it leads to.

    python benchmarks/verification.py --campaigns 20 --budget 350 --simulations 100 200 --stop 0.03

Each campaign has its own seed; its true error is measured on fresh designs of its own. Campaigns with a stop rule run
until it ends them, or to 600 simulations; they are judged the same way.
"""

import argparse

import numpy as np

from activefail.campaign.campaign import Campaign
from activefail.campaign.config import CampaignSettings
from activefail.campaign.executor import ThreadExecutor
from activefail.campaign.learning import accuracy, current_classifier
from activefail.campaign.loop import one_thread, run, standing
from activefail.campaign.record import MemoryStore
from activefail.campaign.simulator import NUMERICAL_FAILURE
from activefail.campaign.verification import verify

FIRST_SEED, MOST = 4000, 600


def true_error(campaign, classifier, executor, n, seed) -> float:
    X = campaign.space.from_unit(np.random.default_rng([779, seed]).random((n, campaign.space.dimension)))
    outcome = executor.run(campaign.simulator, X).outcome
    answered = outcome != NUMERICAL_FAILURE
    return 1.0 - accuracy(classifier, campaign.severity, X[answered], outcome[answered])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--features", default="paper")
    parser.add_argument("--budget", type=int, default=350)
    parser.add_argument("--simulations", type=int, nargs="+", default=[100, 200])
    parser.add_argument("--stop", type=float, default=0.04, help="error of the stop rule; 0: no such campaigns")
    parser.add_argument("--fresh", type=int, default=8000)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    base = {"classifier.kernel": "matern52", "classifier.features": options.features}
    covered = dict.fromkeys(options.simulations, 0)
    good, stopped = 0, 0
    with ThreadExecutor(options.threads) as executor, one_thread():
        for seed in range(FIRST_SEED, FIRST_SEED + options.campaigns):
            campaign = Campaign.of(CampaignSettings().changed(base | {"seed": seed, "sampling.budget": options.budget}))
            store = MemoryStore(campaign.schema)
            run(campaign, store, executor, options.budget)
            classifier = current_classifier(campaign, store, write=False)
            true = true_error(campaign, classifier, executor, options.fresh, seed)
            text = f"seed {seed}  true {100 * true:.2f} %"
            iteration = standing(campaign, store.batches, 0).iteration
            for n in options.simulations:
                error = verify(campaign, store, executor, classifier, iteration, n, 0.9)
                covered[n] += error.low <= true <= error.high
                text += f"  | {n}: {100 * error.error:.2f} ({100 * error.low:.2f} to {100 * error.high:.2f})"
            if options.stop:
                rule = {"error": options.stop, "confidence": 0.9}
                campaign = Campaign.of(campaign.settings.changed({"sampling.budget": MOST, "stop": rule}))
                store = MemoryStore(campaign.schema)
                run(campaign, store, executor, MOST)
                done = standing(campaign, store.batches, MOST).done
                true = true_error(
                    campaign, current_classifier(campaign, store, write=False), executor, options.fresh, seed
                )
                text += f"  | stop at {done}, true {100 * true:.2f}"
                stopped += done < MOST
                good += done < MOST and true <= options.stop
            print(text, flush=True)
    for n, number in covered.items():
        print(f"90 % interval from {n} fresh simulations: holds the true error in {number} of {options.campaigns}")
    if options.stop:
        print(
            f"stop at an error of {100 * options.stop:g} % at confidence 0.9: {good} of {stopped} that stopped have it"
        )


if __name__ == "__main__":
    main()
