"""Failure probabilities of reliability problems: simulations to a campaign's own stop, and what it then says.

    python benchmarks/reliability.py                                  all problems, 20 seeds, margins
    python benchmarks/reliability.py --problems RP22 --seeds 3        a quick look
    python benchmarks/reliability.py --batch 10 --out batch.jsonl     ten simulations at a time
    python benchmarks/reliability.py --truncated                      simulations that end at failure
    python benchmarks/reliability.py --references 100000000           the probabilities by plain Monte Carlo

Each campaign has the defaults of `stop = { probability = "failure" }` and a budget of 200 simulations. The table gives,
for each problem,

    calls      simulations to the stop: median and range over the seeds
    P/P_ref    the classifier's probability at the stop over the true one: median and range
    wrong      seeds in which it is more than 20 % off
    no stop    seeds that reached the budget
    coverage   share of 90 % intervals that contain the true probability, from 25 and from 50 fresh simulations, over
               all seeds and --repeats estimates each, and the median root mean square error of the estimates
    variance   the variance of plain Monte Carlo with as many simulations, learning included, over that of the estimates
               from 50
    ms         processor time of the loop for each simulation

Each finished campaign is a line of --out; a repeated command continues where it stopped.
"""

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from reliability_problems import PROBLEMS

from activefail.campaign.assembly import Campaign
from activefail.campaign.settings import CampaignSettings
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.estimate import estimated, integrated, plan_estimate
from activefail.surrogate.threads import one_thread

FRESH = (25, 50)


def campaign_on(name, seed, batch, budget, truncated):
    problem = replace(PROBLEMS[name], truncated=truncated)
    settings = CampaignSettings().changed(
        {
            "seed": seed,
            "space": problem.space,
            "sampling.initial": max(12, 2 * len(problem.variables)),
            "sampling.batch": batch,
            "sampling.budget": budget,
            "classifier.features": "design",
            "stop": {"probability": "failure"},
        }
    )
    return Campaign.of(settings, simulator=problem)


def score(name, seed, batch, budget, truncated, repeats):
    campaign = campaign_on(name, seed, batch, budget, truncated)
    problem, store = PROBLEMS[name], MemoryStore(campaign.schema)
    began = time.process_time()
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, budget)
    seconds = time.process_time() - began
    learned, history = current(campaign, store, write=False), History.of(store.batches)
    latent = learned.classifier.latent("failure")
    rng = np.random.default_rng([seed, 1])
    row = {
        "problem": name,
        "seed": seed,
        "calls": len(history),
        "stopped": bool(len(learned.looks.table)) and learned.looks.is_known,
        "failures": int((history.outcome == 1).sum()),
        "margin": bool(learned.classifier.choices) and learned.classifier.choices[0].margin >= 0,
        "ms": 1e3 * seconds / max(1, len(history) - campaign.settings.sampling.initial),
    }
    with one_thread():
        row["probability"], _ = integrated(latent, campaign.features, campaign.space, rng)
        for m in FRESH:
            estimates = []
            for _ in range(repeats):
                plan = plan_estimate(latent, campaign.features, campaign.space, m, rng)
                beyond = problem.limit(plan.designs) <= 0.0
                estimate = estimated(plan, beyond, np.ones(m, dtype=bool), 0.9)
                estimates.append((estimate.probability, estimate.low, estimate.high))
            row[f"estimates {m}"] = estimates
    return row


def table(rows):
    print(
        f"{'problem':14} {'P':>8} {'calls':>15} {'P/P_ref':>18} {'wrong':>7} {'no stop':>7} "
        f"{'coverage 25':>12} {'50':>5} {'rmse 25':>8} {'50':>5} {'variance':>9} {'ms':>5}"
    )
    calls, wrong = [], 0
    for name, problem in PROBLEMS.items():
        own = [row for row in rows if row["problem"] == name]
        if not own:
            continue
        true = problem.probability
        n, ratio = np.array([row["calls"] for row in own]), np.array([row["probability"] / true for row in own])
        covered, errors = {}, {}
        for m in FRESH:
            all_estimates = np.array([row[f"estimates {m}"] for row in own])
            covered[m] = np.mean((all_estimates[..., 1] <= true) & (true <= all_estimates[..., 2]))
            errors[m] = np.sqrt(np.median(np.mean((all_estimates[..., 0] / true - 1.0) ** 2, axis=1)))
        plain = (1.0 - true) / (true * (np.median(n) + 50))
        calls.extend(n)
        wrong += int((np.abs(ratio - 1.0) > 0.2).sum())
        print(
            f"{name:14} {true:8.2g} {np.median(n):5.0f} ({n.min():3d}-{n.max():3d}) "
            f"{np.median(ratio):5.2f} ({ratio.min():4.2f}-{ratio.max():4.2f}) "
            f"{(np.abs(ratio - 1.0) > 0.2).sum():3d}/{len(own):<3d} {sum(not row['stopped'] for row in own):7d} "
            f"{covered[25]:12.3f} {covered[50]:5.3f} {errors[25]:8.3f} {errors[50]:5.3f} "
            f"{plain / errors[50] ** 2:9.0f} "
            f"{np.median([row['ms'] for row in own]):5.0f}"
        )
    print(f"all: median {np.median(calls):.0f} calls, {wrong} of {len(rows)} wrong by more than 20 %")


def references(designs):
    for name, problem in PROBLEMS.items():
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
    parser.add_argument("--truncated", action="store_true")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--references", type=int, metavar="DESIGNS")
    options = parser.parse_args()
    if options.references:
        references(options.references)
        return
    rows = (
        [json.loads(line) for line in options.out.read_text().splitlines()]
        if options.out and options.out.exists()
        else []
    )
    known = {(row["problem"], row["seed"]) for row in rows}
    open_tasks = [
        (name, seed)
        for seed in range(options.seeds)
        for name in options.problems.split(",")
        if (name, seed) not in known
    ]
    terms = options.batch, options.budget, options.truncated, options.repeats
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        for row in pool.map(score, *zip(*((*task, *terms) for task in open_tasks), strict=True)) if open_tasks else ():
            rows.append(row)
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    table(rows)


if __name__ == "__main__":
    main()
