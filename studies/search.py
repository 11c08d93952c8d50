"""How soon a campaign finds a failure that its initial design lacks, with its search and by its criterion alone.

    python studies/search.py --campaigns 20

Each campaign begins with 30 designs without a failure (initial designs with one are skipped) and then proposes 30 more,
five at a time. The campaign's own proposals are compared with the same criterion without the search, as the program
formerly worked, and with a Latin hypercube of the same size.
"""

from dataclasses import replace

import numpy as np
from problems import BENCHMARK
from study import asked

from activefail.campaign.random_streams import stream
from activefail.learning.criteria.batch_proposal import propose_shared
from activefail.learning.criteria.criteria import criterion as criterion_of
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.threads import one_thread
from activefail.learning.model.training import train
from activefail.loop.history import History
from activefail.loop.initial import initial_designs
from activefail.loop.proposing import next_designs

INITIAL, BATCH, BATCHES = 30, 5, 6


def first_failure(campaign, searching):
    """Number of designs after the initial ones until the first failure; None without a failure."""
    X, problem, settings = initial_designs(campaign), campaign.simulator, campaign.settings.acquisition
    for iteration in range(1, BATCHES + 1):
        outcome = problem.run(X).outcome
        classifier = train(X, outcome, problem.outcomes, campaign.features, VariationalGP("rbf"))
        chosen, rng = (iteration - 1) * BATCH, stream(campaign.settings.seed, "propose", iteration)
        if searching:
            known = History.of_sample(X, problem.run(X))
            proposed = next_designs(campaign, classifier, known, rng, q=BATCH, chosen=chosen)
        else:
            proposed = propose_shared(
                classifier,
                campaign.space,
                criterion_of(settings.criterion),
                boundaries=settings.boundaries,
                exploration=settings.exploration,
                first=chosen,
                q=BATCH,
                rng=rng,
            )
        if (failed := problem.limit(proposed) <= 0.0).any():
            return chosen + int(np.argmax(failed)) + 1
        X = np.concatenate([X, proposed])
    return None


def main():
    options = asked(__doc__, campaigns=20)
    for name in ("four-branch", "RP38"):
        problem = replace(BENCHMARK[name], shown=None)
        for criterion in ("eavc", "globalmi", "entropy"):
            firsts = {"with the search": [], "criterion alone": [], "hypercube": []}
            seed = 0
            while len(firsts["hypercube"]) < options.campaigns:
                seed += 1
                campaign = problem.campaign(
                    seed=seed, sampling__initial=INITIAL, sampling__batch=BATCH, acquisition__criterion=criterion
                )
                if problem.run(initial_designs(campaign)).outcome.any():
                    continue
                with one_thread():
                    firsts["with the search"].append(first_failure(campaign, True))
                    firsts["criterion alone"].append(first_failure(campaign, False))
                X = campaign.space.latin_hypercube(BATCH * BATCHES, np.random.default_rng([seed, 1]))
                failed = problem.limit(X) <= 0.0
                firsts["hypercube"].append(int(np.argmax(failed)) + 1 if failed.any() else None)
            for way, numbers in firsts.items():
                seen = [number for number in numbers if number is not None]
                middle = f", in the median of these after {np.median(seen):g}" if seen else ""
                saw = f"{len(seen)} of {len(numbers)} campaigns saw a failure within {BATCH * BATCHES} designs"
                print(f"{name}, {criterion:<8} {way:<15}: {saw}{middle}", flush=True)


if __name__ == "__main__":
    main()
