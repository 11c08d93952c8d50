"""Failure probabilities of reliability problems: simulations until a campaign stops, and its estimate then.

    python benchmarks/reliability.py                                  all problems, 20 seeds, margins
    python benchmarks/reliability.py --problems RP22 --seeds 3        a quick look
    python benchmarks/reliability.py --batch 10 --out batch.jsonl     ten simulations at a time
    python benchmarks/reliability.py --asynchronous --batch 5          five simulations in flight
    python benchmarks/reliability.py --truncated                      simulations that end at failure
    python benchmarks/reliability.py --labels --budget 100            outcomes alone
    python benchmarks/reliability.py --references 100000000           the probabilities by plain Monte Carlo
    python benchmarks/reliability.py --problems RP14,RP24             problems on which nothing was chosen

Each campaign has the defaults of `stop = { probability = "failure" }` and a budget of 200 simulations. A static Latin
hypercube of the same size is learned from in the same way. The table gives, for each problem,

    calls      simulations to the stop: median and range over the seeds
    P/P_ref    the classifier's probability at the stop over the true one: median and range
    wrong      seeds in which it is more than 20 % off
    no stop    seeds that reached the budget
    missed     share of the failure probability that the classifier misses at the stop: median, and largest
    static     the same with the static hypercube: median
    better     seeds in which the classifier puts less probability on the wrong side than the static one
    coverage   share of 90 % intervals that contain the true probability, from 25 and from 50 fresh simulations, over
               all seeds and --repeats estimates each, and the median root mean square error of the estimates
    recall     share of the lower ends of the recall, from 50 fresh simulations, that are below the true recall
    variance   the variance of plain Monte Carlo with as many simulations, learning included, over that of the estimates
               from 50
    ms         processor time of the loop for each simulation

Each finished campaign is a line of --out; a repeated command continues where it stopped.
"""

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from reliability_problems import HELD_OUT, PROBLEMS, problem_of

from activefail.acquisition.population import population
from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.asynchronous import learned_so_far
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import current, learn_from
from activefail.record.memory import MemoryStore
from activefail.reliability.estimate import baseline, deviation_of_margins, plan_estimate
from activefail.reliability.integral import boundary_of
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.threads import one_thread

FRESH = (25, 50)


WEIGHED = 100_000
"""Designs that weigh what a classifier puts on the wrong side."""


def campaign_on(problem, seed, batch, budget, asynchronous=False):
    settings = CampaignSettings().changed(
        {
            "seed": seed,
            "space": problem.space,
            "sampling.initial": max(12, 2 * len(problem.variables)),
            "sampling.batch": batch,
            "sampling.budget": budget,
            "sampling.asynchronous": asynchronous,
            "classifier.features": "design",
            "acquisition.criterion": "eavc",
            "stop": {"probability": "failure"},
        }
    )
    return Campaign.of(settings, simulator=problem)


def wrong_shares(problem, space, standardised, rng):
    """Probability that a classifier misses, and that it wrongly counts as failure, in units of the true probability."""
    drawn = population(space, WEIGHED, lambda X: (problem.limit(X) <= 0.0).astype(float), rng)
    fails, predicted = problem.limit(drawn.X) <= 0.0, standardised(drawn.X) > 0.0
    total = drawn.weight[fails].sum()
    return float(drawn.weight[fails & ~predicted].sum() / total), float(drawn.weight[~fails & predicted].sum() / total)


def static_classifier(campaign, problem, n, seed):
    """The classifier of a Latin hypercube of n designs."""
    X = campaign.space.latin_hypercube(n, np.random.default_rng([seed, 2]))
    history = History.of_sample(X, problem.run(X))
    return learn_from(campaign, history)


def score(name, seed, terms, repeats):
    problem = replace(problem_of(name), truncated=terms["truncated"], labels=terms["labels"])
    campaign = campaign_on(problem, seed, terms["batch"], terms["budget"], terms["asynchronous"])
    store = MemoryStore(campaign.schema)
    began = time.process_time()
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, terms["budget"])
    seconds = time.process_time() - began
    known = learned_so_far if terms["asynchronous"] else current
    learned, history = known(campaign, store, write=False), History.of(store.batches)
    latent = learned.classifier.latent("failure")
    standardised = boundary_of(learned.classifier, campaign.features, "failure")
    rng = np.random.default_rng([seed, 1])
    row = {
        "problem": name,
        "seed": seed,
        **terms,
        "calls": len(history),
        "stopped": bool(len(learned.looks.table)) and learned.looks.is_known,
        "failures": int((history.outcome == 1).sum()),
        "margin": bool(learned.classifier.choices) and learned.classifier.choices[0].margin >= 0,
        "ms": 1e3 * seconds / max(1, len(history) - campaign.settings.sampling.initial),
    }
    with one_thread():
        static = boundary_of(static_classifier(campaign, problem, len(history), seed), campaign.features, "failure")
        row["missed"], row["false"] = wrong_shares(problem, campaign.space, standardised, rng)
        row["static missed"], row["static false"] = wrong_shares(problem, campaign.space, static, rng)
        integral = baseline(standardised, campaign.space)
        row["probability"] = integral.probability
        for m in FRESH:
            estimates, recalls = [], []
            for _ in range(repeats):
                plan = plan_estimate(standardised, campaign.space, integral, m, rng)
                results = problem.run(plan.designs)
                if isinstance(latent, MarginLatent):
                    margin = results.margins[:, 0]
                    plan = plan.deviating(deviation_of_margins(latent, campaign.features, plan.designs, margin))
                beyond = results.outcome == 1
                estimate = plan.estimate(beyond, np.ones(m, dtype=bool), 0.9)
                estimates.append((estimate.probability, estimate.low, estimate.high))
                recalls.append(estimate.recall_low)
            row[f"estimates {m}"], row[f"recalls {m}"] = estimates, recalls
    return row


def cells(problem, rows):
    """The table's cells of one problem, by title."""
    true = problem.probability
    column = {key: np.array([row[key] for row in rows]) for key in rows[0] if key != "problem"}
    n, ratio = column["calls"], column["probability"] / true
    missed, static = column["missed"], column["static missed"]
    better = missed + column["false"] <= static + column["static false"]
    covered, errors = {}, {}
    for m in FRESH:
        middle, low, high = np.moveaxis(column[f"estimates {m}"], -1, 0)
        covered[m] = np.mean((low <= true) & (true <= high))
        errors[m] = np.sqrt(np.median(np.mean((middle / true - 1.0) ** 2, axis=1)))
    plain = (1.0 - true) / (true * (np.median(n) + 50))
    return {
        "P": f"{true:.2g}",
        "calls": f"{np.median(n):.0f} ({n.min()}-{n.max()})",
        "P/P_ref": f"{np.median(ratio):.2f} ({ratio.min():.2f}-{ratio.max():.2f})",
        "wrong": f"{is_wrong(ratio).sum()}/{len(rows)}",
        "no stop": f"{(~column['stopped']).sum()}",
        "missed": f"{np.median(missed):.3f} ({missed.max():.3f})",
        "static": f"{np.median(static):.3f}",
        "better": f"{better.sum()}/{len(rows)}",
        "coverage 25": f"{covered[25]:.3f}",
        "50": f"{covered[50]:.3f}",
        "recall 50": f"{np.mean(column['recalls 50'] <= 1.0 - missed[:, None]):.3f}" if "recalls 50" in column else "–",
        "rmse 25": f"{errors[25]:.3f}",
        "rmse 50": f"{errors[50]:.3f}",
        "variance": f"{plain / errors[50] ** 2:.0f}",
        "ms": f"{np.median(column['ms']):.0f}",
    }


def is_wrong(ratio):
    return np.abs(ratio - 1.0) > 0.2


def table(rows):
    by_problem = {name: [row for row in rows if row["problem"] == name] for name in (*PROBLEMS, *HELD_OUT)}
    lines = {name: cells(problem_of(name), own) for name, own in by_problem.items() if own}
    titles = list(next(iter(lines.values())))
    widths = [max(len(title), *(len(line[title]) for line in lines.values())) for title in titles]
    for name, line in {"problem": dict(zip(titles, titles, strict=True)), **lines}.items():
        print(f"{name:14} " + "  ".join(f"{line[title]:>{width}}" for title, width in zip(titles, widths, strict=True)))
    ratios = np.array([row["probability"] / problem_of(row["problem"]).probability for row in rows])
    calls = np.median([row["calls"] for row in rows])
    print(f"all: median {calls:.0f} calls, {is_wrong(ratios).sum()} of {len(rows)} wrong by more than 20 %")


def references(designs, names):
    for name in names:
        problem = problem_of(name)
        space = Campaign.of(
            CampaignSettings().changed({"space": problem.space, "classifier.features": "design"}), simulator=problem
        ).space
        rng, failures, part = np.random.default_rng(1), 0, 500_000
        for _ in range(designs // part):
            failures += int((problem.limit(space.from_unit(rng.random((part, space.dimension)))) <= 0.0).sum())
        share = failures / (designs // part * part)
        print(f"{name:14} {share:.4e} ± {1.96 * np.sqrt(share * (1 - share) / designs):.1e}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--asynchronous", action="store_true")
    parser.add_argument("--truncated", action="store_true")
    parser.add_argument("--labels", action="store_true")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--references", type=int, metavar="DESIGNS")
    options = parser.parse_args()
    if options.references:
        references(options.references, options.problems.split(","))
        return
    terms = {key: getattr(options, key) for key in ("batch", "budget", "asynchronous", "truncated", "labels")}
    names = options.problems.split(",")
    lines = options.out.read_text().splitlines() if options.out and options.out.exists() else []
    rows = [{"asynchronous": False} | json.loads(line) for line in lines]
    rows = [row for row in rows if row["problem"] in names and terms.items() <= row.items()]
    known = {(row["problem"], row["seed"]) for row in rows}
    tasks = [(name, seed) for seed in range(options.seeds) for name in names if (name, seed) not in known]
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        for future in as_completed([pool.submit(score, *task, terms, options.repeats) for task in tasks]):
            rows.append(future.result())
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    table(rows)


if __name__ == "__main__":
    main()
