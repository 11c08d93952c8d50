"""Questions away from where a campaign learned: do the intervals from strata still cover?

    python experiments/questions.py --seeds 30

A beam with a load (normal, mean 3, sd 0.6) and a strength (lognormal, mean 12, cov 0.1) fails where its strength is at
most its effect: twice the load ("straight"), or that less 0.8 sin(2.5 load) ("wavy"). Campaigns learn it from 40
outcomes without a margin. Then two questions are asked of each campaign, 20 times with 50 fresh simulations:

    wider      twice the standard deviation of the load, and twice the coefficient of variation of the strength
    far        a load of mean 5.5 and sd 0.3, four standard deviations beyond the mean that was learned from

The true probability is a mean over four million designs. The table gives the share of 90 % intervals that contain it,
the shares that lie above and below it, and the median width of the intervals over the probability.
"""

import argparse

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.integral import boundary_of
from activefail.reliability.strata import plan_strata
from activefail.simulators.interface import Results
from activefail.surrogate.threads import one_thread

REPEATS, FRESH, TRUTH = 20, 50, 4_000_000


def space_of(load, sd, cov):
    return {
        "load": {"distribution": "normal", "mean": load, "sd": sd},
        "strength": {"distribution": "lognormal", "mean": 12.0, "cov": cov},
    }


LEARNED = space_of(3.0, 0.6, 0.1)
QUESTIONS = {"wider": space_of(3.0, 1.2, 0.2), "far": space_of(5.5, 0.3, 0.05)}


class Beam:
    """A beam without margins, whose boundary is straight or wavy."""

    outcomes = ("safe", "failure")
    causes = ("",)
    margins = ()
    releases_gil = True

    def __init__(self, wave):
        self.wave = wave

    def fails(self, X):
        load, strength = X.T
        return strength <= 2.0 * load - self.wave * np.sin(2.5 * load)

    def run(self, X):
        nothing = np.zeros(len(X))
        return Results(self.fails(X).astype(np.int8), nothing.astype(np.int8), np.empty((len(X), 0)), nothing)


def campaign_on(beam, seed, space):
    keys = {
        "seed": seed,
        "space": space,
        "sampling.initial": 12,
        "sampling.budget": 40,
        "classifier.features": "design",
    }
    return Campaign.of(CampaignSettings().changed(keys), simulator=beam)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    options = parser.parse_args()
    print("boundary  question  probability  intervals  cover  above  below  width")
    for name, wave in {"straight": 0.0, "wavy": 0.8}.items():
        beam, intervals = Beam(wave), {question: [] for question in QUESTIONS}
        spaces = {question: campaign_on(beam, 0, space).space for question, space in QUESTIONS.items()}
        for seed in range(options.seeds):
            campaign = campaign_on(beam, seed, LEARNED)
            store = MemoryStore(campaign.schema)
            with ThreadExecutor(1) as executor:
                run(campaign, store, executor, campaign.settings.sampling.budget)
            classifier = current(campaign, store, write=False).classifier
            standardised = boundary_of(classifier, campaign.features, "failure")
            with one_thread():
                for question, space in spaces.items():
                    for repeat in range(REPEATS):
                        plan = plan_strata(standardised, space, FRESH, np.random.default_rng([seed, repeat]))
                        if plan is not None:
                            found = plan.estimate(beam.fails(plan.designs), np.ones(FRESH, dtype=bool), 0.9)
                            intervals[question].append((found.low, found.high))
        for question, space in spaces.items():
            P = beam.fails(space.from_unit(np.random.default_rng(0).random((TRUTH, 2)))).mean()
            low, high = np.transpose(intervals[question])
            print(
                f"{name:9} {question:9} {P:11.4f} {len(low):10d} {np.mean((low <= P) & (high >= P)):6.3f} "
                f"{np.mean(low > P):6.3f} {np.mean(high < P):6.3f} {np.median(high - low) / P:6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
