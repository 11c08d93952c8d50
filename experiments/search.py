"""How soon a campaign finds a failure that its initial design lacks, with its search and by its criterion alone.

    python experiments/search.py --campaigns 20

Each campaign begins with 30 designs without a failure (initial designs with one are skipped) and then proposes 30 more,
five at a time. The campaign's own proposals are compared with the same criterion without the search, as the program
formerly worked, and with a Latin hypercube of the same size.
"""

import argparse

import numpy as np
from rare_problems import FOUR_BRANCH, RP38, RareProblem

from activefail.acquisition.batch_proposal import propose_shared
from activefail.acquisition.criteria import criterion as criterion_of
from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.loop.history import History
from activefail.loop.initial import initial_designs
from activefail.loop.proposing import next_designs
from activefail.surrogate.classifier import train
from activefail.surrogate.threads import one_thread

INITIAL, BATCH, BATCHES = 30, 5, 6


def first_failure(campaign: Campaign, problem: RareProblem, searching: bool) -> int | None:
    """Number of designs after the initial ones until the first failure; None without a failure."""
    X = initial_designs(campaign)
    for iteration in range(1, BATCHES + 1):
        outcome = problem.run(X).outcome
        classifier = train(X, outcome, problem.outcomes, campaign.features, "rbf")
        chosen, settings = (iteration - 1) * BATCH, campaign.settings.acquisition
        if searching:
            zeros = np.zeros(len(X), dtype=np.int8)
            known = History(X, outcome, zeros.astype(np.int64), zeros)
            proposed = next_designs(
                campaign,
                classifier,
                known,
                stream(campaign.settings.seed, "propose", iteration),
                q=BATCH,
                chosen=chosen,
            )
        else:
            proposed = propose_shared(
                classifier,
                campaign.space,
                criterion_of(settings.criterion),
                boundaries=settings.boundaries,
                exploration=settings.exploration,
                first=chosen,
                q=BATCH,
                rng=stream(campaign.settings.seed, "propose", iteration),
            )
        failed = problem.limit(proposed) <= 0.0
        if failed.any():
            return (iteration - 1) * BATCH + int(np.argmax(failed)) + 1
        X = np.concatenate([X, proposed])
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=20)
    options = parser.parse_args()
    with one_thread():
        for problem in (FOUR_BRANCH, RP38):
            for criterion in ("eavc", "globalmi", "entropy"):
                firsts: dict[str, list[int | None]] = {"with the search": [], "criterion alone": [], "hypercube": []}
                seed = 0
                while len(firsts["hypercube"]) < options.campaigns:
                    seed += 1
                    settings = problem.settings(
                        seed=seed, sampling__initial=INITIAL, acquisition__criterion=criterion, sampling__batch=BATCH
                    )
                    campaign = Campaign.of(settings, simulator=problem)
                    if problem.run(initial_designs(campaign)).outcome.any():
                        continue
                    firsts["with the search"].append(first_failure(campaign, problem, True))
                    firsts["criterion alone"].append(first_failure(campaign, problem, False))
                    failed = (
                        problem.limit(campaign.space.latin_hypercube(BATCH * BATCHES, np.random.default_rng([seed, 1])))
                        <= 0.0
                    )
                    firsts["hypercube"].append(int(np.argmax(failed)) + 1 if failed.any() else None)
                for way, numbers in firsts.items():
                    seen = sorted(number for number in numbers if number is not None)
                    middle = f", in the median of these after {np.median(seen):g}" if seen else ""
                    saw = f"{len(seen)} of {len(numbers)} campaigns saw a failure within {BATCH * BATCHES} designs"
                    print(f"{problem.name}, {criterion:<8} {way:<15}: {saw}{middle}", flush=True)


if __name__ == "__main__":
    main()
