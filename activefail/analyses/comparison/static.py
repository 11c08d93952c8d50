"""Compare a campaign with static designs of the same size on the same fresh designs: scores with their intervals."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import InputError
from activefail.estimates.scores import Score, score, score_of
from activefail.estimates.stored_sets import set_name, simulated_results, simulated_set
from activefail.execution.executor import Executor
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.initial import initial_size
from activefail.record.store import Store
from activefail.space.shares import interval_percent, percent
from activefail.text.csv_table import writing


def default_budgets(initial: int, done: int) -> list[int]:
    """Six numbers of simulations, from the initial design to all."""
    steps = np.linspace(initial, done, 6 if done > initial else 1)
    return sorted({round(float(step)) for step in steps})


def _static_stream(seed: int, size: int, number: int) -> np.random.Generator:
    """The generator of a static design; number 0 has the designs that earlier versions compared with."""
    rng = stream(seed, "static", size)
    return rng.spawn(number)[-1] if number else rng


def compare(
    campaign: Campaign,
    store: Store,
    executor: Executor,
    budgets: list[int] | None,
    test_size: int,
    stage: Callable[[str], None] = lambda _: None,
    static: Sequence[int] | None = None,
    hypercubes: int = 1,
) -> list[Score]:
    """Score the campaign's first n simulations for each budget n, and static designs.

    Args:
        campaign, store: the campaign and its record.
        executor: runs the simulations of the test set and the static designs.
        budgets: numbers of simulations; None for `default_budgets`.
        test_size: number of test designs.
        stage: called with each stage of the work.
        static: sizes of the static designs; None for the budgets.
        hypercubes: number of static designs of each size.

    Simulations that the campaign did not ask for count among its first n: it learned and chose from them, so without
    them it would look better than what it cost. A score says how many they are. Both samplings train the same
    classifier. Test set and static designs are simulated once and kept in the run folder.

    Raises:
        InputError: if a budget is below 2 or above the campaign's simulations, the size of a static design is below 2,
            the campaign has no simulations, or its simulator does not repeat.
    """
    from activefail.loop.learning import learn_from  # it loads torch

    if reason := campaign.settings.refused.get("compare"):
        raise InputError(f"compare: {reason}.")
    seed = campaign.settings.seed
    history = History.of(store.batches)
    done = len(history)
    if done < 2:
        raise InputError("The campaign has no simulations to compare yet.")
    initial = initial_size(campaign, history)
    budgets = budgets or default_budgets(min(initial, done), done)
    for n in budgets:
        if not 2 <= n <= done:
            raise InputError(f"budgets: must be between 2 and the {done} recorded simulations, got {n}.")
    for n in static or ():
        if n < 2:
            raise InputError(f"static: must be at least 2, got {n}.")
    severity = campaign.severity

    with one_thread():
        stage(f"simulating {test_size} test designs")
        test = campaign.space.random(test_size, stream(seed, "test"))
        test_set = simulated_set(campaign, store, executor, set_name("test", test_size), test)
        assert test_set is not None  # no stop was requested
        X_test, outcome_test = test_set
        if unanswered := test_size - len(X_test):
            stage(f"{unanswered} of {test_size} test designs failed numerically; using the other {len(X_test)}")
        scores = []
        for n in budgets:
            stage(f"learning from {n} active simulations")
            classifier = learn_from(campaign, history[:n])
            given = int((history.given[:n]).sum())
            scores.append(replace(score("active", classifier, severity, n, X_test, outcome_test), given=given))
        for n in static or budgets:
            for number in range(hypercubes):
                of_several = f" ({number + 1} of {hypercubes})" if hypercubes > 1 else ""
                stage(f"simulating and learning from {n} static simulations{of_several}")
                hypercube = campaign.space.latin_hypercube(n, _static_stream(seed, n, number))
                name = set_name("static", n, *([f"seed{number}"] if number else []))
                results = simulated_results(campaign, store, executor, name, hypercube)
                assert results is not None  # no stop was requested
                classifier = learn_from(campaign, History.of_sample(hypercube, results))
                scored = score("static", classifier, severity, n, X_test, outcome_test)
                scores.append(replace(scored, hypercube=number))
    return scores


def by_size(scores: Sequence[Score]) -> list[list[Score]]:
    """Scores of one sampling in groups of equal size, the smallest first."""
    sizes = sorted({row.simulations for row in scores})
    return [[row for row in scores if row.simulations == n] for n in sizes]


def score_lines(scores: Sequence[Score], boundary: str) -> list[str]:
    """Scores as a table for a terminal, followed by the recall of each outcome.

    Of several static designs of one size, the table has the median and the range of each measure.
    """
    groups = [group for name in ("active", "static") for group in by_size([s for s in scores if s.sampling == name])]
    groups.sort(key=lambda group: (group[0].simulations, group[0].sampling))
    lines = [
        f"{'simulations':>11}  {'sampling':<8}  {f'{boundary} accuracy':>18} {'95 % interval':>16}"
        f"  {'outcome accuracy':>16}  {'log score':>9}"
    ]
    lines += [_score_line(group) for group in groups]
    if any(len(group) > 1 for group in groups):
        lines.append("Several static designs of one size: medians; in place of the interval, lowest to highest.")
    lines += [f"given: {given}"] if (given := given_in_words(scores)) else []
    lines.append(
        "recall: share of the test designs with an outcome that are predicted to have it, with a 95 % interval"
    )
    for group in groups:
        row = median_score(group)
        recall = ", ".join(f"{name} {one.in_words}" for name, one in row.recall.items())
        lines.append(f"{row.simulations:>11}  {row.sampling:<8}  {recall}")
    return lines


def median_score(group: Sequence[Score]) -> Score:
    """The score of median accuracy among designs of one size; the lower one of two."""
    return sorted(group, key=lambda row: row.accuracy)[(len(group) - 1) // 2]


def _score_line(group: Sequence[Score]) -> str:
    accuracies = [row.accuracy for row in group]
    low, high = (group[0].low, group[0].high) if len(group) == 1 else (min(accuracies), max(accuracies))
    outcome_accuracy = float(np.median([row.outcome_accuracy for row in group]))
    return (
        f"{group[0].simulations:>11}  {group[0].sampling:<8}  {percent(float(np.median(accuracies)), 2):>18} "
        f"{interval_percent(low, high):>16}  {percent(outcome_accuracy, 2):>16}  "
        f"{float(np.median([row.log_score for row in group])):>9.4f}"
    )


def given_in_words(scores: Sequence[Score]) -> str:
    """What to know of simulations that the campaign did not ask for; empty without any."""
    counts = ", ".join(f"{one.given} of the first {one.simulations}" for one in scores if one.given)
    if not counts:
        return ""
    return (
        f"Given simulations, which the campaign did not ask for: {counts}. The comparison includes them. If they were "
        "chosen near the boundary, it favours active sampling."
    )


def write_scores(scores: Sequence[Score], test_designs: int, path: Path) -> None:
    """Write scores to a CSV file, with the number of numerical failures in the test set."""
    columns = [one.name for one in fields(Score) if one.name not in ("recall", "given", "hypercube")]
    with writing(path, [*columns, *scores[0].counts, "test_unanswered", "given", "hypercube"]) as write:
        for one in scores:
            values = [getattr(one, name) for name in columns]
            write([[*values, *one.counts.values(), test_designs - one.test_designs, one.given, one.hypercube]])


_IDENTITY = ("comparison",)


def remember_scores(store: Store, scores: Sequence[Score], test_designs: int) -> None:
    """Keep the scores of the last comparison on a test set of so many designs."""
    unanswered = test_designs - scores[0].test_designs
    store.remember(_IDENTITY, {"unanswered": unanswered, "scores": [asdict(one) for one in scores]})


def remembered_scores(store: Store) -> tuple[list[Score], int] | None:
    """The scores of the last comparison, and the number of numerical failures in its test set; None without any."""
    saved = store.recall(_IDENTITY)
    try:
        first, *others = map(score_of, saved["scores"])
        return [first, *others], int(saved["unanswered"])
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):  # none, or of other versions
        return None
