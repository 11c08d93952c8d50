"""The mode check under a question: are wrong answers warned of, and how many false alarms does it cost?

    python experiments/mode_check.py --seeds 20

Campaigns with the defaults of `stop = { probability = "failure" }` learn a limit state from its margin. Then a question
is asked of each, 5 times with 50 fresh simulations, with and without the mode check. Two problems are those of
`wrong_numbers.py` whose second limit the campaign hardly meets. "lobe" (2 variables) and "behind 5" (5 variables) hide
a second region of failure from the campaign; "bowl 2" and "bowl 5" have none. The table gives

    P          the true probability: from a weighted sample
    ratio      the classifier's probability over the true one (median)
    cover      share of 90 % intervals that contain the true probability: without and with the check
    width      of the intervals over the probability (median): without and with the check
    warned     share of the intervals without the check that lack the true probability, with a warning: that fresh
               simulations contradict the classifier where it was sure, or that margins deviate, or (the second share)
               also by the check
    alarm      the same of the intervals that contain it, while the classifier's probability is at most 20 % off
    sides      share of all, of those that lack, and of those of "alarm", with a design of the check that ended on
               another side than predicted
    more       simulations of the check
"""

import argparse

import numpy as np
from wrong_numbers import PROBLEMS as OTHERS
from wrong_numbers import MadeUp, _normals, campaign_on, true_probability

from activefail.campaign.question import Question
from activefail.execution.local import ThreadExecutor
from activefail.loop.batches import run
from activefail.loop.learning import current
from activefail.record.memory import MemoryStore
from activefail.reliability.estimate import baseline, deviation_of_margins, plan_estimate
from activefail.reliability.integral import boundary_of
from activefail.surrogate.margin import MarginLatent
from activefail.surrogate.threads import one_thread
from activefail.verification.mode_check import check_of, places_of_check
from activefail.verification.probability_estimator import Sampled

FRESH, REPEATS = 50, 5


def _lobe(X):
    return np.minimum(3.2 - X[:, 0], 4.0 * (np.hypot(X[:, 0] + 1.0, X[:, 1] - 6.5) - 1.5))


def _behind(X):
    return np.minimum(3.0 - X.sum(axis=1) / 5**0.5, 4.0 * (5.5 - 0.8 * X[:, 4] + 0.6 * X[:, 0]))


def _bowl(X):
    return 3.0 - X[:, 0] - 0.15 * X[:, 1] ** 2


def _bowl_5(X):
    return 3.5 - X[:, :3].sum(axis=1) / 3**0.5 - 0.05 * X[:, 3] ** 2 + 0.1 * X[:, 4]


PROBLEMS = {name: OTHERS[name] for name in ("plane behind", "kink behind")} | {
    "lobe": MadeUp(
        _lobe, questions={"wider": _normals((0.0, 1.2), (1.0, 2.2)), "far": _normals((-1.0, 0.8), (4.0, 0.8))}
    ),
    "behind 5": MadeUp(
        _behind, d=5, questions={"wider": _normals((0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.5), (0.0, 2.0))}
    ),
    "bowl 2": MadeUp(
        _bowl, questions={"wider": _normals((0.0, 1.3), (0.0, 2.0)), "far": _normals((0.5, 0.7), (3.0, 0.7))}
    ),
    "bowl 5": MadeUp(
        _bowl_5,
        d=5,
        questions={
            "wider": _normals(*[(0.0, 1.4)] * 5),
            "far": _normals((1.0, 0.8), (1.0, 0.8), (0.0, 1.0), (3.0, 1.0), (-2.0, 1.0)),
        },
    ),
}


def learned_campaign(problem, seed, terms):
    campaign = campaign_on(problem, problem.variables, seed, terms)
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, terms["budget"])
    simulated = np.concatenate([batch.designs for batch in store.batches])
    return campaign, current(campaign, store, write=False).classifier, simulated


def answers(problem, campaign, classifier, simulated, space, seed):
    """(without the check, with it), REPEATS times; nothing if the boundary was learned from outcomes."""
    latent, question = classifier.latent("failure"), Question("asked", space.names, space)
    if not isinstance(latent, MarginLatent):
        return
    standardised, rng = boundary_of(classifier, campaign.features, "failure"), np.random.default_rng([seed, 1])
    integral, answered = baseline(standardised, space), np.ones(FRESH, dtype=bool)
    for _ in range(REPEATS):
        plan = plan_estimate(standardised, space, integral, FRESH, rng)
        margin = problem.limit(plan.designs)
        plan = plan.deviating(deviation_of_margins(latent, campaign.features, plan.designs, margin))
        before = Sampled(plan, margin <= 0.0, answered).estimate(0.9)
        everything = np.concatenate([simulated, plan.designs])
        places = places_of_check(campaign, question, everything, before.probability, rng)
        check = check_of(campaign, classifier, "failure", places, problem.run(places))
        yield before, Sampled(plan, margin <= 0.0, answered, check=check).estimate(0.9)


def row_of(before, after, true):
    is_warned = before.surprising > 0 or before.deviation > 2.0
    return (
        before.model,
        before.low <= true <= before.high,
        after.low <= true <= after.high,
        before.high - before.low,
        after.high - after.low,
        is_warned,
        is_warned or after.check.contradictions > 0 or after.check.deviation > 2.0,
        after.check.contradictions > 0,
        after.check.simulations,
    )


def share(values, rows):
    return f"{np.mean(values[rows]):.2f}" if rows.any() else "–"


def show(label, true, rows):
    model, covered, covers, width, wider, told, warned, contradicted, more = np.array(rows).T
    lacks, alarm = covered == 0, (covered == 1) & (np.abs(model / true - 1.0) <= 0.2)
    everything = np.ones(len(rows), dtype=bool)
    cells = [
        f"{label:20} {true:8.2e} {len(rows):4d} {np.median(model) / true:5.2f}",
        f"{covered.mean():4.2f} {covers.mean():4.2f}",
        f"{np.median(width) / true:5.2f} {np.median(wider) / true:5.2f}",
        f"{share(told, lacks):>4} {share(warned, lacks):>4}",
        f"{share(told, alarm):>4} {share(warned, alarm):>4}",
        f"{share(contradicted, everything):>4} {share(contradicted, lacks):>4} {share(contradicted, alarm):>4}",
        f"{more.mean():3.0f}",
    ]
    print("  ".join(cells), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    terms = {"batch": 1, "budget": 100, "asynchronous": False}
    print(
        "problem: question           P    n ratio  cover      width        warned     alarm      sides           more"
    )
    for name in options.problems.split(","):
        problem = PROBLEMS[name]
        spaces = {title: campaign_on(problem, given, 0, terms).space for title, given in problem.questions.items()}
        true = {title: true_probability(problem, given, terms)[0] for title, given in problem.questions.items()}
        rows = {title: [] for title in spaces}
        for seed in range(options.seeds):
            learned = learned_campaign(problem, seed, terms)
            with one_thread():
                for title, space in spaces.items():
                    for before, after in answers(problem, *learned, space, seed):
                        rows[title].append(row_of(before, after, true[title]))
        for title in spaces:
            show(f"{name}: {title}", true[title], rows[title])


if __name__ == "__main__":
    main()
