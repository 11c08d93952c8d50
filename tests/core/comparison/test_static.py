"""The comparison: two samplings, one test set, nothing simulated twice."""

from pathlib import Path

import numpy as np
import pytest
from campaign.stub import Counting, Disc, disc
from commandline import table

from activefail.analyses.comparison.static import (
    compare,
    default_budgets,
    remember_scores,
    remembered_scores,
    score_lines,
    write_scores,
)
from activefail.campaign.assembly import Campaign
from activefail.campaign.random_streams import stream
from activefail.errors import InputError
from activefail.estimates.scores import Score, recalls, score
from activefail.estimates.stored_sets import estimate_sizes
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.latent import VariationalGP
from activefail.learning.model.threads import one_thread
from activefail.learning.model.training import train
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.progress import Observer, standing
from activefail.loop.running import run
from activefail.loop.telling import add
from activefail.record.memory import MemoryStore
from activefail.space.space import Array

TEST = 300


def scores(campaign: Campaign, store: MemoryStore, budgets: list[int] | None, test_size: int = TEST) -> list[Score]:
    with ThreadExecutor(2) as executor:
        return compare(campaign, store, executor, budgets, test_size)


@pytest.fixture(scope="module")
def counting() -> Counting:
    return Counting()


@pytest.fixture(scope="module")
def campaign(counting: Counting) -> Campaign:
    return disc(counting, initial=20, budget=40, batch=10)


@pytest.fixture(scope="module")
def store(campaign: Campaign) -> MemoryStore:
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(2) as executor:
        run(campaign, store, executor, 40)
    return store


@pytest.fixture(scope="module")
def first(campaign: Campaign, store: MemoryStore, counting: Counting) -> tuple[list[Score], int]:
    """The scores, and how many designs were simulated for them."""
    before = counting.rows
    return scores(campaign, store, [20, 30, 40]), counting.rows - before


def test_each_sampling_has_a_row_for_each_budget(first: tuple[list[Score], int]) -> None:
    assert [(row.sampling, row.simulations) for row in first[0]] == [
        *(("active", n) for n in (20, 30, 40)),
        *(("static", n) for n in (20, 30, 40)),
    ]


def test_only_the_test_set_and_the_static_hypercubes_are_simulated(first: tuple[list[Score], int]) -> None:
    assert first[1] == TEST + 20 + 30 + 40


def test_asked_again_nothing_is_simulated_and_the_scores_are_the_same(
    campaign: Campaign, store: MemoryStore, counting: Counting, first: tuple[list[Score], int]
) -> None:
    before = counting.rows
    assert scores(campaign, store, [20, 30, 40]) == first[0]
    assert scores(campaign, store, [30]) == [row for row in first[0] if row.simulations == 30]
    assert counting.rows == before


def test_another_size_of_the_test_set_is_another_set(
    campaign: Campaign, store: MemoryStore, counting: Counting, first: tuple[list[Score], int]
) -> None:
    before = counting.rows
    scores(campaign, store, [20], test_size=150)
    assert counting.rows == before + 150


def test_comparing_leaves_the_campaign_as_it_was(campaign: Campaign, store: MemoryStore) -> None:
    assert standing(campaign, History.of(store.batches), 40).done == 40
    before = [batch.designs.tobytes() for batch in store.batches], store.latest_state()
    scores(campaign, store, [20])
    assert [batch.designs.tobytes() for batch in store.batches] == before[0]
    state = store.latest_state()
    assert state is not None
    assert before[1] is not None
    assert {name: array.tobytes() for name, array in state[1].items()} == {
        name: array.tobytes() for name, array in before[1][1].items()
    }


def test_a_score_is_that_of_a_classifier_of_the_first_designs_on_fresh_ones(
    campaign: Campaign, store: MemoryStore, first: tuple[list[Score], int]
) -> None:
    X = campaign.space.from_unit(stream(1, "test").random((TEST, 2)))
    static = campaign.space.latin_hypercube(30, stream(1, "static", 30))
    active = np.concatenate([batch.designs for batch in store.batches])[:30]
    truth = Disc().run(X).outcome
    for row, designs in zip((first[0][1], first[0][4]), (active, static), strict=True):
        with one_thread():
            classifier = train(designs, Disc().run(designs).outcome, Disc.outcomes, campaign.features, VariationalGP())
            latent = classifier.latents[0].moments(campaign.features(X))
        sides = (latent.mean > 0.0).astype(int)
        assert row.simulations == 30
        assert row.accuracy == np.mean(sides == truth)
        assert row.outcome_accuracy == row.accuracy  # two outcomes: the boundary is all there is to know
        p = np.where(truth == 1, latent.probability, 1.0 - latent.probability)
        assert row.log_score == pytest.approx(np.mean(np.log(p)))


def test_test_set_hypercubes_and_campaign_share_no_design(
    campaign: Campaign, store: MemoryStore, first: tuple[list[Score], int]
) -> None:
    samples = [np.concatenate([batch.designs for batch in store.batches])]
    for name in (f"test-{TEST}-0", "static-20-0", "static-30-0", "static-40-0"):
        saved = store.read_set(name)
        assert saved is not None
        samples.append(saved[0])
    X = np.concatenate(samples)
    assert len(np.unique(X, axis=0)) == len(X)


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Wilson 1927: (p + z²/2n ± z √(p(1−p)/n + z²/4n²)) / (1 + z²/n)."""
    z, p = 1.959963984540054, successes / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)


def test_the_interval_of_an_accuracy_is_wilsons(first: tuple[list[Score], int]) -> None:
    for row in first[0]:
        assert (row.low, row.high) == pytest.approx(wilson(round(row.accuracy * TEST), TEST))
        assert 0.0 <= row.low < row.accuracy <= row.high <= 1.0


def test_a_perfect_score_and_one_in_which_all_is_wrong(campaign: Campaign, store: MemoryStore) -> None:
    with one_thread():
        classifier = current(campaign, store, write=False).classifier
        X: Array = campaign.space.sobol(64, np.random.default_rng(5))
        sides = (classifier.latents[0].moments(campaign.features(X)).mean > 0.0).astype(np.int8)
        right, wrong = (score("active", classifier, 1, 40, X, truth) for truth in (sides, 1 - sides))
    assert (right.accuracy, right.outcome_accuracy, wrong.accuracy, wrong.outcome_accuracy) == (1.0, 1.0, 0.0, 0.0)
    assert wrong.log_score < right.log_score < 0.0


@pytest.mark.parametrize("budgets", [[20, 41], [1, 20], [0], [-5]])
def test_a_budget_that_the_campaign_has_not_is_refused_before_anything_is_simulated(
    campaign: Campaign, store: MemoryStore, counting: Counting, budgets: list[int]
) -> None:
    before = counting.rows
    wrong = next(n for n in budgets if not 2 <= n <= 40)
    with pytest.raises(InputError) as refused:
        scores(campaign, store, budgets, test_size=77)
    assert str(refused.value) == f"budgets: must be between 2 and the 40 recorded simulations, got {wrong}."
    assert counting.rows == before


def test_a_campaign_that_has_done_nothing_cannot_be_compared() -> None:
    campaign = disc()
    with pytest.raises(InputError, match="no simulations to compare"):
        scores(campaign, MemoryStore(campaign.schema), None)


def test_a_campaign_that_stopped_within_its_seed_is_compared_at_what_it_has() -> None:
    campaign = disc()
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(2) as executor:
        run(campaign, store, executor, 28, Observer(stop=lambda: len(store.batches) == 2))
    assert [(row.sampling, row.simulations) for row in scores(campaign, store, None, 50)] == [
        ("active", 8),
        ("static", 8),
    ]


def test_numerical_failures_are_neither_learned_from_nor_judged_by() -> None:
    campaign = disc(Disc(blind=-1.0), extra="limits.numerical_failures = 1.0")
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(2) as executor:
        run(campaign, store, executor, 28)
    stages: list[str] = []
    with ThreadExecutor(2) as executor:
        row = compare(campaign, store, executor, [28], TEST, stages.append)[0]
    saved = store.read_set(f"test-{TEST}-0")
    assert saved is not None
    answered = int((saved[1].outcome >= 0).sum())
    assert answered < TEST
    assert row.test_designs == answered
    assert f"{TEST - answered} of {TEST} test designs failed numerically; using the other {answered}" in stages
    # Shares of the designs that were answered, and the interval of so many.
    assert row.accuracy * answered == pytest.approx(round(row.accuracy * answered))
    assert (row.low, row.high) == pytest.approx(wilson(round(row.accuracy * answered), answered))


@pytest.mark.parametrize(
    ("initial", "done", "expected"),
    [(250, 500, [250, 300, 350, 400, 450, 500]), (20, 20, [20]), (20, 23, [20, 21, 22, 23]), (8, 8, [8])],
)
def test_budgets_by_default_reach_from_the_seed_to_what_is_done(initial: int, done: int, expected: list[int]) -> None:
    assert default_budgets(initial, done) == expected


def test_the_table_of_scores_has_a_column_for_each_value(first: tuple[list[Score], int], tmp_path: Path) -> None:
    write_scores(first[0], TEST, tmp_path / "scores.csv")
    row = first[0][0]
    (written, *_) = table(tmp_path / "scores.csv")
    values = vars(row) | row.counts | {"test_unanswered": TEST - row.test_designs}
    assert written == {name: str(value) for name, value in values.items() if name != "recall"}
    assert row.counts["test_broken"] == row.recall["broken"].total > 0


def test_the_recall_of_an_outcome_is_the_share_of_its_designs_that_are_predicted_so() -> None:
    outcome = np.array([0] * 6 + [1] * 3, dtype=np.int8)
    predicted = np.array([0, 0, 0, 0, 0, 1, 1, 0, 0])
    recall = recalls(("safe", "broken", "lost"), predicted, outcome)
    assert (recall["safe"].recalled, recall["safe"].total, recall["broken"].recalled, recall["broken"].total) == (
        5,
        6,
        1,
        3,
    )
    assert recall["broken"].share == pytest.approx(1 / 3)
    # Clopper and Pearson's, from tables.
    assert recall["broken"].interval == pytest.approx((0.0084, 0.9057), abs=1e-4)
    assert recall["broken"].in_words == "33.3 % (1 of 3; 0.8 to 90.6 %)"
    assert recall["lost"].in_words == "– (none in the test set)"
    assert recall["lost"].interval == (0.0, 1.0)


def test_given_simulations_count_among_the_first_of_the_campaign_and_the_scores_say_so(tmp_path: Path) -> None:
    campaign = disc(initial=12, budget=20, batch=4)
    store = MemoryStore(campaign.schema)
    X = campaign.space.from_unit(np.random.default_rng(3).random((6, campaign.space.dimension)))
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 12)
        add(campaign, store, X, campaign.simulator.run(X))
        run(campaign, store, executor, 20)
    found = scores(campaign, store, [12, 18, 26], 60)
    assert [(one.simulations, one.given) for one in found if one.sampling == "active"] == [(12, 0), (18, 6), (26, 6)]
    assert all(one.given == 0 for one in found if one.sampling == "static")
    # The static design is as large as what the active side learned from, given simulations included.
    assert [one.simulations for one in found if one.sampling == "static"] == [12, 18, 26]
    (line,) = [line for line in score_lines(found, "broken") if line.startswith("given: ")]
    assert "did not ask for: 6 of the first 18, 6 of the first 26." in line
    with pytest.raises(InputError, match="between 2 and the 26 recorded simulations"):
        scores(campaign, store, [27], 60)
    assert not [line for line in score_lines(found[:1], "broken") if line.startswith("given: ")]
    remember_scores(store, found, 60)
    assert remembered_scores(store) == (found, 60 - found[0].test_designs)


def test_static_designs_have_their_own_sizes_and_several_of_one_size_differ(
    campaign: Campaign, store: MemoryStore, counting: Counting, tmp_path: Path
) -> None:
    scores(campaign, store, [40])
    before = counting.rows
    with ThreadExecutor(2) as executor:
        found = compare(campaign, store, executor, [40], TEST, static=[40, 60], hypercubes=2)
    # The first design of size 40 is the one of a comparison without these options.
    assert counting.rows == before + 40 + 2 * 60
    static = [one for one in found if one.sampling == "static"]
    assert [(one.simulations, one.hypercube) for one in static] == [(40, 0), (40, 1), (60, 0), (60, 1)]
    assert static[0] == scores(campaign, store, [40])[1]
    assert len({one.log_score for one in static}) == 4
    with ThreadExecutor(2) as executor:
        assert compare(campaign, store, executor, [40], TEST, static=[40, 60], hypercubes=2) == found
    assert counting.rows == before + 40 + 2 * 60
    remember_scores(store, found, TEST)
    assert remembered_scores(store) == (found, TEST - found[0].test_designs)
    (line,) = [
        line for line in score_lines(found, "broken") if line.split()[:2] == ["60", "static"] and "nan" not in line
    ][:1]
    accuracies = sorted(one.accuracy for one in static[2:])
    assert f"{100 * accuracies[0]:.2f} to {100 * accuracies[1]:.2f} %" in line
    with ThreadExecutor(2) as executor, pytest.raises(InputError, match="static: must be at least 2, got 1"):
        compare(campaign, store, executor, [40], TEST, static=[1])


NUMBERS = ("sampling", "simulations", "accuracy", "low", "high", "outcome_accuracy", "log_score")
ROW = dict.fromkeys(NUMBERS, 0.5) | {"test_designs": 3, "recall": {}}


@pytest.mark.parametrize(
    "value",
    [
        5,
        [],
        {"scores": [], "unanswered": 0},
        {"scores": [ROW], "unanswered": float("inf")},
        {"scores": [ROW | {"recall": {"a": {"recalled": float("inf"), "total": 1}}}], "unanswered": 0},
        {"scores": [ROW | {"accuracy": []}], "unanswered": 0},
    ],
)
def test_a_comparison_that_this_version_does_not_write_is_none(campaign: Campaign, value: object) -> None:
    store = MemoryStore(campaign.schema)
    store.remember(("comparison",), value)
    assert remembered_scores(store) is None


def test_a_set_whose_name_has_more_designs_than_can_be_stored_in_it_is_none(campaign: Campaign) -> None:
    store, results = MemoryStore(campaign.schema), campaign.simulator.run(np.zeros((3, 2)))
    for size in (3, 500, 700, 10**12):
        store.write_set(f"fresh-1-4-{size}-0", np.zeros((3, 2)), results)
    assert estimate_sizes(store, 1, 4) == [500, 3]
