"""Questions far from where a campaign learned: do intervals cover, and does the mode check warn of wrong answers?

    python studies/questions.py --seeds 20
    python studies/questions.py --problems straight,wavy --seeds 30

From margins, campaigns with the defaults of `stop = { probability = "failure" }` learn a limit state of problems.py
with a budget of 100. A question is asked 5 times with 50 fresh simulations, with and without the mode check. The table
gives

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

From outcomes, campaigns learn from 40 simulations without a margin whether a beam fails. Its strength (lognormal, mean
12, cov 0.1) is at most its effect: twice the load (normal, mean 3, sd 0.6; "straight"), or that less 0.8 sin(2.5 load)
("wavy"). A question is asked 20 times with 50 fresh simulations: "wider" has twice the deviations, "far" a load four
standard deviations beyond the mean that was learned from. The table gives the share of 90 % intervals that contain the
true probability, the shares that lie above and below it, and the median width over the probability.
"""

import numpy as np
from problems import QUESTIONED, Problem, true_probability, variables
from reliability import stopping_campaign
from study import asked, head, in_memory, line

from activefail.campaign.question import Question
from activefail.estimates.estimate import deviation_of_margins, plan_estimate
from activefail.estimates.integral import boundary_of, integrate
from activefail.estimates.mode_check import check_of, places_of_check
from activefail.estimates.probability_estimator import Sampled
from activefail.learning.model.margin import MarginLatent
from activefail.learning.model.threads import one_thread

FRESH, REPEATS, REPEATS_OF_OUTCOMES, TRUTH = 50, 5, 20, 4_000_000


def beam(load, sd, cov):
    """Load and strength of a beam."""
    return variables(("normal", load, sd), ("lognormal", 12.0, 12.0 * cov))


BEAMS = {
    name: Problem(
        lambda X, wave=wave: X[:, 1] - 2.0 * X[:, 0] + wave * np.sin(2.5 * X[:, 0]),
        beam(3.0, 0.6, 0.1),
        questions={"wider": beam(3.0, 1.2, 0.2), "far": beam(5.5, 0.3, 0.05)},
        shown=None,
    )
    for name, wave in {"straight": 0.0, "wavy": 0.8}.items()
}


def answers(problem, learned, space, seed):
    """(the classifier's probability, without the check, with it) for each estimate; none from outcomes alone."""
    campaign, classifier = learned.campaign, learned.classifier
    latent, question = classifier.latent("failure"), Question("asked", space.names, space)
    if not isinstance(latent, MarginLatent):
        return
    standardised, rng = boundary_of(classifier, campaign.features, "failure"), np.random.default_rng([seed, 1])
    integral, answered = integrate(lambda X: standardised(X)[:, None], space).of(0), np.ones(FRESH, dtype=bool)
    for _ in range(REPEATS):
        plan = plan_estimate(standardised, space, FRESH, rng)
        margin = problem.limit(plan.designs)
        plan = plan.deviating(deviation_of_margins(latent, campaign.features, plan.designs, margin))
        before = Sampled(plan, margin <= 0.0, answered).estimate(0.9)
        everything = np.concatenate([learned.history.designs, plan.designs])
        places = places_of_check(campaign, question, everything, before.probability, rng)
        check = check_of(campaign, classifier, "failure", places, problem.run(places))
        yield integral.probability, before, Sampled(plan, margin <= 0.0, answered, check=check).estimate(0.9)


def row_of(model, before, after, true):
    is_warned = before.surprising > 0 or before.deviation > 2.0
    return (
        model,
        before.low <= true <= before.high,
        after.low <= true <= after.high,
        before.high - before.low,
        after.high - after.low,
        is_warned,
        is_warned or after.check.contradictions > 0 or after.check.deviation > 2.0,
        after.check.contradictions > 0,
        after.check.simulations,
    )


def show(label, true, rows):
    model, covered, covers, width, wider, told, warned, contradicted, more = np.array(rows, dtype=float).T
    lacks, alarm = covered == 0, (covered == 1) & (np.abs(model / true - 1.0) <= 0.2)

    def shares(*pairs):
        return " ".join(f"{np.mean(values[rows]):.2f}" if rows.any() else "–" for values, rows in pairs)

    line(
        label,
        f"{true:.2e}",
        len(rows),
        f"{np.median(model) / true:.2f}",
        f"{covered.mean():.2f} {covers.mean():.2f}",
        f"{np.median(width) / true:.2f} {np.median(wider) / true:.2f}",
        shares((told, lacks), (warned, lacks)),
        shares((told, alarm), (warned, alarm)),
        shares((contradicted, lacks | True), (contradicted, lacks), (contradicted, alarm)),
        f"{more.mean():.0f}",
    )


def from_margins(names, seeds):
    head("problem: question", "P", "n", "ratio", "cover", "width", "warned", "alarm", "sides", "more")
    for name in names:
        problem = QUESTIONED[name]
        rows = {title: [] for title in problem.questions}
        for seed in range(seeds):
            learned = in_memory(stopping_campaign(problem, seed, budget=100))
            with one_thread():
                for title, space in problem.questions.items():
                    for pair in answers(problem, learned, problem.campaign(space).space, seed):
                        rows[title].append(row_of(*pair, true_probability(name, title)))
        for title, own in rows.items():
            if own:
                show(f"{name}: {title}", true_probability(name, title), own)


def from_outcomes(names, seeds):
    head("boundary: question", "P", "n", "cover", "above", "below", "width")
    for name in names:
        problem = BEAMS[name]
        spaces = {title: problem.campaign(space).space for title, space in problem.questions.items()}
        intervals = {title: [] for title in spaces}
        for seed in range(seeds):
            learned = in_memory(problem.campaign(seed=seed, sampling__initial=12, sampling__budget=40))
            standardised = boundary_of(learned.classifier, learned.campaign.features, "failure")
            with one_thread():
                for title, space in spaces.items():
                    for repeat in range(REPEATS_OF_OUTCOMES):
                        rng = np.random.default_rng([seed, repeat])
                        plan = plan_estimate(standardised, space, FRESH, rng, sceptical=True)
                        failed = problem.limit(plan.designs) <= 0.0
                        found = plan.estimate(failed, np.ones(FRESH, dtype=bool), 0.9)
                        intervals[title].append((found.low, found.high))
        for title, space in spaces.items():
            P = (problem.limit(space.from_unit(np.random.default_rng(0).random((TRUTH, 2)))) <= 0.0).mean()
            low, high = np.transpose(intervals[title])
            shares = (np.mean(rows) for rows in ((low <= P) & (high >= P), low > P, high < P))
            width = np.median(high - low) / P
            line(f"{name}: {title}", f"{P:.4f}", len(low), *(f"{one:.3f}" for one in shares), f"{width:.2f}")


def main():
    options = asked(__doc__, problems=list(QUESTIONED), seeds=20)
    for study, known in ((from_margins, QUESTIONED), (from_outcomes, BEAMS)):
        if names := [name for name in options.problems if name in known]:
            study(names, options.seeds)


if __name__ == "__main__":
    main()
