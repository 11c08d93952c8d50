"""Could fresh simulations end a campaign that learns a failure probability from outcomes alone?

    python studies/outcome_checks.py                             the twelve problems, two seeds
    python studies/outcome_checks.py --problems RP22 --seeds 1   a quick look
    python studies/outcome_checks.py --batch 5                   five simulations at a time, in a fifth of the time
    python studies/outcome_checks.py --table                     the tables of the finished campaigns

At each of --sizes a campaign from outcomes, otherwise as in reliability.py, gives its classifier's probability and the
posterior's standard deviation of it. Then it is checked in two ways by simulations that it does not learn from:

    far      4 + 2d designs far from all others, as the stop rule for a margin has them
    fresh    --fresh designs by the plan of `activefail probability`, --repeats times; their estimate counts as known if
             half of its 90 % interval is at most 1.645 --cov of it

The table has, for each size: seeds with a failure; classifiers that are more than 20 % off; how many of their errors
are above two posterior standard deviations; of the classifiers that the posterior calls known (its standard deviation
is at most half of --cov) those that are more than 20 % off; far checks that contradict, of all and of the wrong ones;
sets of fresh simulations that were expected to know, and did; of these the estimates that are more than 20 % off; and
intervals that cover. "ended" is a rule: the first size at which the plan is expected to know is checked, and further
ones if it does not, each at the cost of its simulations; how many end within --budget, and of these the wrong ones.
Finished campaigns are lines of --out and are not run again.
"""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from problems import SETS, problem_of, true_probability
from reliability import is_wrong, stopping_campaign
from study import Rows, asked, head, in_memory, line, timed

from activefail.estimates.estimate import plan_estimate
from activefail.estimates.integral import boundary_of, integrate
from activefail.estimates.model_probability import _paths
from activefail.learning.criteria.by_margin import LEAST, POINTS, SIZE, doubt, doubtful_population
from activefail.learning.model.threads import one_thread
from activefail.loop.learning import learn_from
from activefail.loop.probability_rule import Looks, check_designs

HALF = 1.645
"""Standard deviations in half of a 90 % interval."""


def posterior_sd(latent, campaign, rng):
    """Of the probability, from joint paths of the latent, whose sign is the side."""
    drawn, F, z = doubtful_population(latent.model, campaign.features, campaign.space, SIZE, rng)
    part = drawn.weight * doubt(z) + LEAST
    rows = rng.choice(len(F), POINTS, p=part / part.sum())
    beyond = _paths(latent, F[rows], rng) > 0.0
    deviations = (beyond - beyond.mean(axis=0)) / np.maximum(doubt(z[rows]), LEAST)
    return float(part.mean() * deviations.mean(axis=1).std())


def checked(problem, campaign, history, m, repeats, rng):
    """What a classifier of these simulations says, and what simulations say of it."""
    found = {"n": len(history), "failures": int(history.outcome.sum())}
    if not 0 < found["failures"] < len(history):
        return found
    classifier = learn_from(campaign, history)
    standardised = boundary_of(classifier, campaign.features, "failure")
    P = integrate(lambda X: standardised(X)[:, None], campaign.space).of(0).probability
    found |= {"probability": P, "sd": posterior_sd(classifier.latent("failure"), campaign, rng)}
    looks = Looks(np.array([[len(history), P, 0.0, 0.0]]))
    far = check_designs(campaign, history.designs, looks, classifier, rng)
    found["contradictions"] = int(((standardised(far) > 0.0) != (problem.run(far).outcome == 1)).sum())
    fresh = []
    for _ in range(repeats):
        plan = plan_estimate(standardised, campaign.space, m, rng)
        beyond = problem.run(plan.designs).outcome == 1
        one = plan.estimate(beyond, np.ones(len(beyond), dtype=bool), 0.9)
        fresh.append((plan.expected_half_width(0.9, rng), one.probability, one.low, one.high))
    return found | {"fresh": fresh}


def campaign_checked(name, seed, sizes, m, repeats, batch):
    """A campaign's row."""
    problem = replace(problem_of(name, seed), shown=None)
    campaign = stopping_campaign(problem, seed, batch=batch, budget=max(sizes))
    history, rng = in_memory(campaign).history, np.random.default_rng([seed, 3])
    checks = [checked(problem, campaign, history[:n], m, repeats, rng) for n in sizes]
    return {"true": problem.probability or true_probability(name), "checks": checks}


def is_known(check, cov):
    """Whether each set of fresh simulations was expected to know, and whether it knows, each (repeats,)."""
    expected, middle, low, high = np.array(check["fresh"]).T
    return expected <= HALF * cov * check["probability"], 0.5 * (high - low) <= HALF * cov * middle


def ended(row, repeat, m, cov, budget):
    """The simulations and the estimate at which a campaign ends by fresh simulations; None if it does not."""
    spent = 0
    for check in row["checks"]:
        if "fresh" not in check or check["n"] + spent + m > budget:
            continue
        expected, known = is_known(check, cov)
        if expected[repeat]:
            spent += m
            if known[repeat]:
                return check["n"] + spent, check["fresh"][repeat][1]
    return None


def table(rows, sizes, m, cov, budget, repeats):
    """Print what the checks show at each size, and what a rule would end."""
    head(
        "simulations",
        "failure seen",
        "wrong",
        "2 sd",
        "sure: wrong",
        "far",
        "far: wrong",
        "expected",
        "known",
        "wrong",
        "cover",
    )
    for n in sizes:
        of = [(row["true"], check) for row in rows for check in row["checks"] if check["n"] == n and "fresh" in check]
        true = np.array([one for one, _ in of])
        P, sd, far = (np.array([check[key] for _, check in of]) for key in ("probability", "sd", "contradictions"))
        wrong, sure = is_wrong(P / true), sd <= 0.5 * cov * P
        expected, known = np.array([is_known(check, cov) for _, check in of]).transpose(1, 0, 2)
        _, middle, low, high = np.array([check["fresh"] for _, check in of]).transpose(2, 0, 1)
        both, off = expected & known, is_wrong(middle / true[:, None])
        cover = (low <= true[:, None]) & (true[:, None] <= high)
        line(
            n,
            f"{len(of)}/{len(rows)}",
            wrong.sum(),
            (np.abs(P - true) > 2.0 * sd).sum(),
            f"{(wrong & sure).sum()}/{sure.sum()}",
            f"{(far > 0).sum()}/{len(of)}",
            f"{(wrong & (far > 0)).sum()}/{wrong.sum()}",
            f"{expected.sum()}/{expected.size}",
            both.sum(),
            (both & off).sum(),
            f"{cover.mean():.3f}",
        )
    print()
    head("problem", "ended", "simulations", "wrong")
    for name in dict.fromkeys(row["problem"] for row in rows):
        own = [(row, ended(row, r, m, cov, budget)) for row in rows if row["problem"] == name for r in range(repeats)]
        ends = [(end[0], end[1] / row["true"]) for row, end in own if end]
        calls, ratios = np.array(ends).reshape(-1, 2).T
        span = f"{np.median(calls):.0f} ({calls.min():.0f}-{calls.max():.0f})" if len(ends) else "–"
        line(name, f"{len(ends)}/{len(own)}", span, is_wrong(ratios).sum())


def main():
    options = asked(
        __doc__,
        problems=["benchmark"],
        seeds=2,
        first_seed=100,
        sizes=[50, 70, 90, 120],
        fresh=30,
        repeats=4,
        batch=1,
        cov=0.1,
        budget=150,
        table=False,
        out=Path("outcome_checks.jsonl"),
    )
    names = [name for word in options.problems for name in SETS.get(word, (word,))]
    rows = Rows(options.out, fresh=options.fresh, batch=options.batch)
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in () if options.table else range(options.first_seed, options.first_seed + options.seeds):
            for name in names:
                if rows.lack(problem=name, seed=seed):
                    arguments = name, seed, options.sizes, options.fresh, options.repeats, options.batch
                    row, seconds = timed(campaign_checked, *arguments)
                    rows.add(problem=name, seed=seed, seconds=seconds, **row)
                    print(name, seed, f"{seconds:.0f} s", flush=True)
    chosen = [row for row in rows.finished if row["problem"] in names]
    table(chosen, options.sizes, options.fresh, options.cov, options.budget, options.repeats)


if __name__ == "__main__":
    main()
