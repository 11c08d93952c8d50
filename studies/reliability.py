"""Failure probabilities: simulations until a campaign stops, its estimate then, and the intervals of fresh simulations.

    python studies/reliability.py                                     the twelve problems, 20 seeds, margins
    python studies/reliability.py --problems RP22 --seeds 3           a quick look
    python studies/reliability.py --batch 10 --out batch.jsonl        ten simulations at a time
    python studies/reliability.py --asynchronous --batch 5            five simulations in flight
    python studies/reliability.py --truncated                         simulations that end at failure
    python studies/reliability.py --labels --budget 100               outcomes alone
    python studies/reliability.py --references 100000000              the probabilities by plain Monte Carlo
    python studies/reliability.py --problems held-out                 problems on which nothing was chosen
    python studies/reliability.py --problems misleading --budget 100  27 limit states that are made to mislead
    python studies/reliability.py --problems saturated --budget 100   margins that saturate away from failure

Each campaign has the defaults of `stop = { probability = "failure" }`. A static Latin hypercube of the same size is
learned from in the same way. Problems are in problems.py. With --asynchronous, simulations take virtual time; those
that fail take --slower times as long as others. In the saturated problems failure is a half-plane, and a disc of radius
0.1 to 0.4 on its other side that has 20 to 90 % of the probability; both are drawn by the seed. A question of a problem
has a row of its own, and its own true probability. The table gives, for each problem,

    P          the true probability
    calls      simulations to the stop: median and range over the seeds
    P/P_ref    the classifier's probability at the stop over the true one: median and range
    wrong      seeds in which it is more than 20 % off; in brackets, of those whose campaign the rule ended
    no stop    seeds that reached the budget
    missed     share of the failure probability that the classifier misses at the stop: median, and largest
    static     the same with the static hypercube: median
    better     seeds in which the classifier puts less probability on the wrong side than the static one
    coverage   share of 90 % intervals that contain the true probability, from 25 and from 50 fresh simulations, over
               all seeds and --repeats estimates each; of the latter in the campaigns that the rule ended; and if
               intervals did not grow with the deviation of the fresh margins
    told       share of the estimates from 50 with the sentence that fresh simulations contradict the classifier where
               it was sure, or that their margins deviate
    recall     share of the lower ends of the recall, from 50 fresh simulations, that are below the true recall
    rmse       median root mean square error of the estimates over the true probability
    variance   the variance of plain Monte Carlo with as many simulations, learning included, over that of the estimates
               from 50
    ms         processor time of the loop for each simulation
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from problems import SETS, problem_of, true_probability
from study import Rows, VirtualTime, asked, head, in_memory, line, parallel, spread, timed

from activefail.estimates.estimate import deviation_of_margins, plan_estimate
from activefail.estimates.integral import boundary_of, integrate
from activefail.learning.criteria.population import population
from activefail.learning.model.margin import MarginLatent
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import learn_from

FRESH = (25, 50)

WEIGHED = 100_000
"""Designs that weigh what a classifier puts on the wrong side."""


def stopping_campaign(problem, seed, *, batch=1, budget=200, asynchronous=False):
    """A campaign with the default stop rule for a probability."""
    return problem.campaign(
        seed=seed,
        sampling__initial=max(12, 2 * len(problem.space)),
        sampling__batch=batch,
        sampling__budget=budget,
        sampling__asynchronous=asynchronous,
        acquisition__criterion="eavc",
        stop={"probability": "failure"},
    )


def wrong_shares(problem, space, standardised, rng):
    """Probability that a classifier misses, and that it wrongly counts as failure, in units of the true probability."""
    drawn = population(space, WEIGHED, lambda X: (problem.limit(X) <= 0.0).astype(float), rng)
    fails, predicted = problem.limit(drawn.X) <= 0.0, standardised(drawn.X) > 0.0
    total = drawn.weight[fails].sum()
    return float(drawn.weight[fails & ~predicted].sum() / total), float(drawn.weight[~fails & predicted].sum() / total)


def estimated(problem, classifier, features, space, repeats, rng):
    """The classifier's probability, and estimates from fresh simulations."""
    latent, standardised = classifier.latent("failure"), boundary_of(classifier, features, "failure")
    found = {"probability": integrate(lambda X: standardised(X)[:, None], space).of(0).probability}
    for m in FRESH:
        estimates = []
        for _ in range(repeats):
            plan = plan_estimate(standardised, space, m, rng)
            results, answered = problem.run(plan.designs), np.ones(m, dtype=bool)
            plain = plan.estimate(results.outcome == 1, answered, 0.9)
            if isinstance(latent, MarginLatent):
                plan = plan.deviating(deviation_of_margins(latent, features, plan.designs, results.margins[:, 0]))
            one = plan.estimate(results.outcome == 1, answered, 0.9)
            told = one.deviation > 2.0 or one.surprising > 0
            estimates.append((one.probability, one.low, one.high, one.recall_low, plain.low, plain.high, told))
        found[f"estimates {m}"] = estimates
    return found


def score(name, seed, terms, repeats):
    """The rows of a campaign: its problem's, and one for each question."""
    problem = problem_of(name, seed)
    if terms["truncated"]:
        problem = replace(problem, shown=lambda g: np.maximum(g, 0.0))
    if terms["labels"]:
        problem = replace(problem, shown=None)
    campaign = stopping_campaign(problem, seed, **{key: terms[key] for key in ("batch", "budget", "asynchronous")})
    arrivals = VirtualTime(terms["batch"], lambda x, results: terms["slower"] if results.outcome[0] else 1.0)
    learned, seconds = timed(in_memory, campaign, arrivals)
    n, features = len(learned.history), campaign.features
    row = {
        "problem": name,
        "seed": seed,
        "calls": n,
        "stopped": bool(len(learned.looks.table)) and learned.looks.is_known,
        "ms": 1e3 * seconds / max(1, n - campaign.settings.sampling.initial),
    }
    rng = np.random.default_rng([seed, 1])
    with one_thread():
        X = campaign.space.latin_hypercube(n, np.random.default_rng([seed, 2]))
        static = learn_from(campaign, History.of_sample(X, problem.run(X)))
        for who, classifier in (("", learned.classifier), ("static ", static)):
            shares = wrong_shares(problem, campaign.space, boundary_of(classifier, features, "failure"), rng)
            row |= dict(zip((f"{who}missed", f"{who}false"), shares, strict=True))
        row |= estimated(problem, learned.classifier, features, campaign.space, repeats, rng)
        rows = [{**row, "question": "", "true": problem.probability}]
        for title, variables in problem.questions.items():
            space = problem.campaign(variables).space
            found = estimated(problem, learned.classifier, features, space, repeats, rng)
            rows.append({**row, **found, "question": title, "true": None})
    return rows


def is_wrong(ratio):
    """Whether a probability is more than 20 % off."""
    return np.abs(ratio - 1.0) > 0.2


def cells(rows, true):
    """The table's cells of a problem or a question, by title."""
    column = {key: np.array([row[key] for row in rows]) for key in rows[0] if key not in ("problem", "question")}
    n, ratio, ended = column["calls"], column["probability"] / true, column["stopped"]
    missed, wrong = column["missed"], is_wrong(column["probability"] / true)
    better = missed + column["false"] <= column["static missed"] + column["static false"]
    covered, errors = {}, {}
    for m in FRESH:
        middle, low, high, recall, plain_low, plain_high, told = np.moveaxis(column[f"estimates {m}"], -1, 0)
        covered[m] = (low <= true[:, None]) & (true[:, None] <= high)
        errors[m] = np.sqrt(np.median(np.mean((middle / true[:, None] - 1.0) ** 2, axis=1)))
    plain = (plain_low <= true[:, None]) & (true[:, None] <= plain_high)
    variance = np.median((1.0 - true) / true) / (np.median(n) + 50) / errors[50] ** 2
    return {
        "P": f"{np.median(true):.2g}",
        "calls": spread(n, 0),
        "P/P_ref": spread(ratio),
        "wrong": f"{wrong.sum()}/{len(rows)} ({wrong[ended].sum()}/{ended.sum()})",
        "no stop": (~ended).sum(),
        "missed": f"{np.median(missed):.3f} ({missed.max():.3f})",
        "static": f"{np.median(column['static missed']):.3f}",
        "better": f"{better.sum()}/{len(rows)}",
        "coverage 25": f"{covered[25].mean():.3f}",
        "50": f"{covered[50].mean():.3f}",
        "50, ended": f"{covered[50][ended].mean():.3f}" if ended.any() else "–",
        "50, plain": f"{plain.mean():.3f}",
        "told": f"{told.mean():.2f}",
        "recall 50": f"{np.mean(recall <= 1.0 - missed[:, None]):.3f}",
        "rmse 25": f"{errors[25]:.3f}",
        "rmse 50": f"{errors[50]:.3f}",
        "variance": f"{variance:.0f}",
        "ms": f"{np.median(column['ms']):.0f}",
    }


def table(rows, names):
    """Print a row for each problem and each question, and a summary."""
    ratios = []
    for name in names:
        for title in dict.fromkeys(row["question"] for row in rows.of(problem=name)):
            own = rows.of(problem=name, question=title)
            true = np.array([row["true"] or true_probability(name, title) for row in own])
            found = cells(own, true)
            if not ratios:
                head("problem", *found)
            line(f"{name}: {title}" if title else name, *found.values())
            if not title:
                ratios += [row["probability"] / one for row, one in zip(own, true, strict=True)]
    calls = np.median([row["calls"] for row in rows.of(question="")])
    print(f"all: median {calls:.0f} calls, {is_wrong(np.array(ratios)).sum()} of {len(ratios)} wrong by more than 20 %")


def references(designs, names):
    """Print the probabilities by plain Monte Carlo."""
    for name in names:
        problem = problem_of(name)
        space, rng, failures, part = problem.campaign().space, np.random.default_rng(1), 0, 500_000
        for _ in range(designs // part):
            failures += int((problem.limit(space.from_unit(rng.random((part, space.dimension)))) <= 0.0).sum())
        share = failures / (designs // part * part)
        print(f"{name:14} {share:.4e} ± {1.96 * np.sqrt(share * (1 - share) / designs):.1e}", flush=True)


def main():
    options = asked(
        __doc__,
        problems=["benchmark"],
        seeds=20,
        batch=1,
        budget=200,
        asynchronous=False,
        slower=1.0,
        truncated=False,
        labels=False,
        repeats=10,
        processes=1,
        out=Path,
        references=int,
    )
    names = [name for word in options.problems for name in SETS.get(word, (word,))]
    if options.references:
        references(options.references, names)
        return
    terms = {key: getattr(options, key) for key in ("batch", "budget", "asynchronous", "slower", "truncated", "labels")}
    rows = Rows(options.out, **terms)
    cases = [(name, seed) for seed in range(options.seeds) for name in names if rows.lack(problem=name, seed=seed)]
    tasks = [(*case, terms, options.repeats) for case in cases]
    for new in parallel(score, tasks, options.processes):
        for row in new:
            rows.add(**row)
    table(rows, names)


if __name__ == "__main__":
    main()
