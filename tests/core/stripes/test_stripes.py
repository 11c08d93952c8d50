"""Probabilities over finitely many values: which are simulated, what is kept, and what the intervals say."""

import inspect
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import activefail, refused
from scipy.stats import beta, norm

from activefail.analyses.design.by_stripes import design_by_stripes
from activefail.analyses.design.design_task import Requirement, design_task
from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.fragility.capacities import fit_lognormal
from activefail.analyses.stripes.intervals import (
    Checked,
    SureWrong,
    deviations,
    expected_wrong,
    most_wrong,
    of_others,
    of_these,
)
from activefail.analyses.stripes.stripe import Round, Stripe, Stripes
from activefail.campaign.assembly import Campaign
from activefail.campaign.finite import FiniteValues
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question, asked_of
from activefail.campaign.settings import parse_settings
from activefail.errors import InputError
from activefail.execution.executor import Arrived
from activefail.execution.local import ThreadExecutor
from activefail.learning.model.moments import Moments
from activefail.learning.model.threads import one_thread
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.record.batch import GIVEN
from activefail.record.memory import MemoryStore
from activefail.run.analyses import probability
from activefail.run.opening import open_run
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator
from activefail.space.parameter import Parameter
from activefail.space.shares import significant
from activefail.space.space import Array, DesignSpace
from activefail.text.progress import silent

VALUES = 30

NONE = Checked(0, 0)

CAMPAIGN = f"""
simulator = {{ python = "mine:plane" }}
seed = 2
[space]
x = {{ low = 0.0, high = 4.0 }}
y = {{ low = 0.0, high = 2.0 }}
record = {{ choices = {list(range(VALUES))} }}
[classifier]
features = {{ expressions = {{ a = "x", b = "y", c = "sin(1.7 * record + 0.4)" }}, variables = false }}
[sampling]
initial = 24
budget = 36
"""

CODE = """
import math

def plane(design):
    fails = design["x"] + 1.3 * math.sin(1.7 * design["record"] + 0.4) - 0.8 * design["y"] >= 1.7
    return "failure" if fails else "safe"
"""


def fails(X: Array) -> np.ndarray:
    return np.asarray(X[:, 0] + 1.3 * np.sin(1.7 * X[:, 2] + 0.4) - 0.8 * X[:, 1] >= 1.7)


class Plane:
    """The simulator of `CODE`, which counts, may lose values of the record, and may be interrupted."""

    outcomes, causes, margins, releases_gil = ("safe", "failure"), ("", "lost"), (), True

    def __init__(self, lost: tuple[int, ...] = (), impossible: bool = False) -> None:
        self.lost, self.rows, self.impossible = lost, 0, (1,) if impossible else ()

    def run(self, X: Array) -> Results:
        n, lost = len(X), np.isin(X[:, 2], self.lost)
        self.rows += n
        outcome = np.where(lost, NUMERICAL_FAILURE, fails(X)).astype(np.int8)
        return Results(outcome, lost.astype(np.int8), np.empty((n, 0)), np.zeros(n))


class Interrupted(ThreadExecutor):
    """An executor that Ctrl-C ends in its k-th call."""

    def __init__(self, call: int) -> None:
        super().__init__(1)
        self.left = call

    def run(self, *arguments: object, **words: object) -> Results:
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt
        return super().run(*arguments, **words)  # type: ignore[arg-type]


class Stopping(ThreadExecutor):
    """An executor that Ctrl-C ends once the first results have arrived."""

    def run(self, simulator: Simulator, X: Array, arrived: Arrived | None = None) -> Results:
        def stop(row: int, results: Results) -> None:
            assert arrived is not None
            arrived(row, results)
            raise KeyboardInterrupt

        return super().run(simulator, X, stop)


@dataclass
class Ran:
    campaign: Campaign
    store: MemoryStore

    def stripes(self, executor: ThreadExecutor | None = None, learn: Callable[[], object] | None = None) -> Stripes:
        def learned() -> object:
            return current(self.campaign, self.store, write=True).classifier

        return Stripes(self.campaign, self.store, executor or ThreadExecutor(1), learn or learned)  # type: ignore[arg-type]

    def question(self, x: float = 2.0) -> Question:
        return asked_of("", self.campaign.space, {}, {"x": x, "y": 0.5})

    def ask(self, x: float = 2.0, wrong: float = 0.01, **words: object) -> Stripe:
        with one_thread():
            return self.stripes(**words).ask(self.question(x), "failure", wrong)  # type: ignore[arg-type]

    @property
    def history(self) -> History:
        return History.of(self.store.batches)


def ran(simulator: Plane | None = None) -> Ran:
    campaign = Campaign.of(parse_settings(CAMPAIGN, "c.toml"), simulator=simulator or Plane())
    store = MemoryStore(campaign.schema)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 36)
    return Ran(campaign, store)


def truth(x: float, y: float = 0.5) -> float:
    X = np.column_stack([np.full(VALUES, x), np.full(VALUES, y), np.arange(VALUES)])
    return float(fails(X).mean())


def holds(stripe: Stripe, probability: float) -> bool:
    low, high = stripe.of_these(0.9)
    rounding = 1e-9
    return low - rounding <= probability <= high + rounding


# --- the values -----------------------------------------------------------------------------------------------------


def test_the_values_are_the_products_of_choices_and_steps_with_their_probabilities() -> None:
    of_question = {"probabilities": (0.5, 0.0, 0.5), "groups": ("clay", "sand", "clay")}
    soil = replace(Parameter.of_choices("soil", ("A", "B", "C")), **of_question)  # type: ignore[arg-type]
    storeys = Parameter("storeys", 1.0, 3.0, distribution="truncated_normal", mean=2.0, sd=0.6, step=1.0)
    values = FiniteValues.of(Question.of_space(DesignSpace((soil, storeys))))
    assert values.X.tolist() == [[0, 1], [0, 2], [0, 3], [2, 1], [2, 2], [2, 3]]
    low, middle = norm.cdf([-0.5 / 0.6, 0.5 / 0.6])
    tail = norm.cdf(-1.5 / 0.6)
    of_steps = np.array([low - tail, middle - low, low - tail]) / (1.0 - 2.0 * tail)
    np.testing.assert_allclose(values.weight, 0.5 * np.tile(of_steps, 2))
    assert values.group is not None
    assert len(set(values.group.tolist())) == 1
    assert FiniteValues.of(Question.of_space(DesignSpace((storeys,)))).group is None


def test_only_finitely_many_independent_values_are_enumerated() -> None:
    x, one, other = Parameter("x", 0.0, 4.0), Parameter("a", 0.0, 3.0, step=1.0), Parameter("b", 0.0, 3.0, step=1.0)
    tied = (("a", "b", 0.5),)
    for space, rule in (
        (DesignSpace((x, one)), "x is continuous. Give it values, such as --fixed x=2, or leave --wrong out"),
        (
            DesignSpace((one, other), correlation=tied),
            "independent variables, but a and b are correlated",
        ),
        (DesignSpace((replace(one, high=9999.0),)), "at most 5000 values of a, got 10000"),
    ):
        with pytest.raises(InputError) as error:
            FiniteValues.of(Question.of_space(space))
        assert rule in str(error.value)


# --- the mechanism --------------------------------------------------------------------------------------------------


def test_doubtful_values_are_simulated_and_teach_the_next_question() -> None:
    found = ran()
    one = found.ask()
    assert one.probability == pytest.approx(truth(2.0))
    assert 0 < one.new < VALUES
    assert one.expected_wrong <= 0.01
    assert holds(one, truth(2.0))
    assert one.checked == Checked(3, 0)
    given = found.history[found.history.origin == GIVEN]
    assert len(given) == one.new == one.known.sum()
    assert found.history.asked_for == 36
    again = found.ask()
    assert (again.new, again.probability, again.checked) == (0, one.probability, one.checked)
    further = found.ask(1.7)
    assert further.probability == pytest.approx(truth(1.7))
    assert further.learned == 36 + one.new + further.new


def test_an_interrupted_question_continues_with_what_was_recorded() -> None:
    whole, parts = ran(), ran()
    expected = whole.ask()
    calls = 1
    while calls < 10:
        try:
            stripe = parts.ask(executor=Interrupted(2))
            break
        except KeyboardInterrupt:
            calls += 1
    assert calls > 1
    assert stripe.probability == expected.probability
    assert stripe.rounds == expected.rounds
    np.testing.assert_array_equal(parts.history.designs, whole.history.designs)


def test_of_an_interrupted_round_what_has_an_outcome_is_recorded() -> None:
    found, lost = ran(), Plane()
    with pytest.raises(KeyboardInterrupt):
        found.ask(executor=Stopping(1))
    assert len(found.history) == 37
    assert fails(found.history.designs[-1:]) == [found.history.outcome[-1] == 1]
    found = ran(lost)
    lost.lost = tuple(range(VALUES))
    with pytest.raises(KeyboardInterrupt):
        found.ask(executor=Stopping(1))
    assert len(found.history) == 36


@dataclass(frozen=True)
class Sure:
    """A classifier that is sure that nothing fails."""

    latents = ()

    def moments(self, F: Array) -> Moments:
        return Moments(np.full(len(F), -6.0), np.zeros(len(F)))


def test_the_check_catches_a_classifier_that_is_wrong_where_it_is_sure() -> None:
    found = ran()
    sure = Sure()
    object.__setattr__(sure, "latents", (sure,))
    stripe = found.ask(learn=lambda: sure)
    assert stripe.doubted < 1e-8
    assert stripe.checked.contradicted
    assert round(abs(stripe.probability - truth(2.0)) * VALUES) <= 3
    assert stripe.predicted.sum() < 0.35 * VALUES
    assert holds(stripe, truth(2.0))


def test_a_value_without_an_outcome_counts_both_ways() -> None:
    found = ran(Plane(lost=(4,)))
    stripe = found.ask(wrong=0.0)
    assert stripe.lost.tolist() == [row == 4 for row in range(VALUES)]
    low, high = stripe.of_these(0.9)
    assert high - low == pytest.approx(1.0 / VALUES)
    assert holds(stripe, truth(2.0))


def test_values_that_do_not_exist_have_no_weight() -> None:
    found = ran(Plane(lost=(4,), impossible=True))
    stripe = found.ask(wrong=0.0)
    kept = np.arange(VALUES) != 4
    X = np.column_stack([np.full(VALUES, 2.0), np.full(VALUES, 0.5), np.arange(VALUES)])
    assert stripe.probability == pytest.approx(fails(X)[kept].mean())
    assert stripe.of_these(0.9) == pytest.approx((stripe.probability, stripe.probability))


# --- the intervals --------------------------------------------------------------------------------------------------


def test_a_wrong_check_counts_for_predictions_of_which_the_classifier_has_no_doubt_at_all() -> None:
    weight, predicted, doubt = np.full(40, 1.0 / 40.0), np.arange(40) >= 4, np.zeros(40)
    assert expected_wrong(predicted, doubt, weight, Checked(4, 1)) > 0.05
    assert deviations(np.zeros(40, bool), predicted, doubt, weight, SureWrong.of(Checked(4, 1), NONE)).max() > 0.2


def test_the_interval_of_others_is_the_same_for_all_beyond_as_for_none() -> None:
    weight, group, drawn = np.full(44, 1.0 / 44.0), np.arange(44) % 14, np.zeros((2, 4000))
    every, none = (of_others(np.full(44, side), weight, group, drawn, 0.9) for side in (True, False))
    assert every is not None
    assert none is not None
    assert (every.low, every.high) == pytest.approx((1.0 - none.high, 1.0))


def test_pairs_of_choices_are_no_sample_of_others_but_those_of_records_with_them_are() -> None:
    soil = Parameter.of_choices("soil", ("A", "B"), (0.5, 0.5))
    record = Parameter.of_choices("record", ("a", "b", "c", "d"), (0.25,) * 4)
    events = replace(record, groups=("1", "1", "2", "3"))
    for choices, groups in (((soil, record), None), ((soil, events), 3), ((record,), 4)):
        space = DesignSpace(choices)
        group = FiniteValues.of(asked_of("", space, {}, {})).group
        assert groups == (None if group is None else len(set(group.tolist())))


def test_the_interval_of_these_values_knows_only_what_was_seen() -> None:
    weight, beyond = np.full(40, 1.0 / 40.0), np.arange(40) < 10
    at_first = SureWrong.of(NONE, NONE)
    known = of_these(0.25, deviations(beyond, np.zeros(40, bool), np.zeros(40), weight, at_first), (0.0, 0.0), 0.9)
    assert known == (0.25, 0.25)
    sure = np.where(np.arange(40) < 20, 0.0, 1e-9)
    widths, expected = [], []
    for checked in (Checked(15, 0), Checked(3, 0), Checked(3, 1), Checked(3, 2)):
        of_sure = SureWrong.of(checked, NONE)
        low, high = of_these(0.25, deviations(beyond, sure > 0.0, sure, weight, of_sure), (0.0, 0.0), 0.9)
        assert low == 0.25
        widths.append(high - low)
        expected.append(expected_wrong(sure > 0.0, sure, weight, checked))
    assert sorted(expected) == expected
    assert sorted(widths) == widths
    assert widths[-1] > 0.08


@pytest.mark.parametrize(("wrong", "drawn"), [(0.3, 4), (0.1, 10), (0.45, 6)])
def test_the_check_alone_bounds_the_wrong_probability_left_whatever_the_weights(wrong: float, drawn: int) -> None:
    rng, held, tried = np.random.default_rng(0), 0, 2000
    for _ in range(tried):
        weight = np.exp(1.5 * rng.standard_normal(40))
        is_wrong = rng.random(40) < wrong
        checked = np.argsort(rng.exponential(size=40) / weight)[:drawn]
        left = ~np.isin(np.arange(40), checked)
        bound = most_wrong(Checked(drawn, int(is_wrong[checked].sum())), 0.9)
        held += weight[left] @ is_wrong[left] <= bound * weight[left].sum() + 1e-12
    assert held / tried >= 0.9 - 3.0 * np.sqrt(0.09 / tried)


def test_without_a_check_everything_may_be_wrong_and_a_check_that_is_all_wrong_says_so() -> None:
    assert most_wrong(NONE, 0.9) == most_wrong(Checked(3, 3), 0.9) == 1.0
    assert most_wrong(Checked(3, 0), 0.9) == pytest.approx(1.0 - 0.1 ** (1.0 / 3.0))


@pytest.mark.parametrize("spread", [0.0, 1.0])
@pytest.mark.parametrize("irregular", [0.0, 0.01, 0.03, 0.05, 0.1])
@pytest.mark.parametrize(("questions", "of_beyond"), [(0, 0.15), (5, 0.15), (0, 0.5), (5, 0.5)])
def test_the_interval_of_these_holds_where_irregular_values_are_predicted_wrongly(
    irregular: float, spread: float, questions: int, of_beyond: float
) -> None:
    # Where half of the values are beyond the boundary, all irregular ones lie on the safe side.
    rng = np.random.default_rng([int(100 * irregular), int(spread), questions])
    held, tried, predicted, drawn = 0, 300, 30, 3
    for _ in range(tried):
        # Of 40 values ten were simulated. The check finds a wrong one, or the rest stays predicted.
        weight = np.exp(spread * rng.standard_normal(40))
        weight = (weight / weight.sum())[:predicted]
        beyond, is_wrong = rng.random(predicted) < of_beyond, rng.random(predicted) < irregular
        is_wrong &= ~beyond if of_beyond == 0.5 else True
        left = ~np.isin(np.arange(predicted), np.argsort(rng.exponential(size=predicted) / weight)[:drawn])
        if is_wrong[~left].any():
            held += 1  # then nearly all values are simulated
            continue
        earlier = Checked(questions * drawn, int(rng.binomial(questions * drawn, irregular)))
        drawings = deviations(beyond, left, np.zeros(predicted), weight, SureWrong.of(Checked(drawn, 0), earlier))
        low, high = of_these(0.5, drawings, (0.0, 0.0), 0.9)
        off = np.where(beyond, -weight, weight)[left] @ is_wrong[left]
        held += low - 1e-9 <= 0.5 + off <= high + 1e-9
    assert held / tried >= 0.88 - 2.0 * np.sqrt(0.1 / tried)


def test_the_interval_of_these_holds_where_only_the_values_of_the_present_question_are_irregular() -> None:
    # Of 44 values, all predicted to be safe, a tenth is beyond the boundary; checks before found nothing.
    rng, held, tried, count = np.random.default_rng(3), 0, 600, 44
    for _ in range(tried):
        is_wrong, weight, left = rng.random(count) < 0.1, np.full(count, 1.0 / count), np.arange(count) >= 5
        if is_wrong[~left].any():
            held += 1  # then nearly all values are simulated
            continue
        of_sure = SureWrong.of(Checked(5, 0), Checked(12, 0))
        drawn = deviations(np.zeros(count, bool), left, np.zeros(count), weight, of_sure)
        held += weight @ is_wrong <= of_these(0.0, drawn, (0.0, 0.0), 0.9).high + 1e-9
    assert held / tried >= 0.9


def test_checks_of_other_questions_narrow_the_interval_as_far_as_their_weight_goes() -> None:
    few, many, most = (SureWrong.of(Checked(3, 0), Checked(n, 0)) for n in (0, 4, 800))
    assert few.mean > many.mean == most.mean > 0.02
    assert SureWrong.of(Checked(3, 0), Checked(16, 4)) == pytest.approx((0.5 + 1.0, 4.5 + 3.0 + 3.0))
    found = ran()
    one, other = found.ask(), found.ask(1.7)
    assert (one.earlier, other.earlier) == (NONE, one.checked)
    assert found.ask().earlier == other.checked
    # Asked for another accuracy, a question is checked again, and its first check still counts.
    assert found.ask(wrong=0.02).earlier == Checked(*np.add(one.checked, other.checked).tolist())
    assert found.ask(1.5).earlier.simulated == 3 * one.checked.simulated


def test_the_bound_of_the_check_is_one_on_the_present_predictions() -> None:
    found = ran()
    stripe = found.ask()
    assert stripe.check is not None
    rows = stripe.check.rows
    assert sorted(rows) == sorted(set(rows))
    # As if the check had been drawn from all values, and the first four simulated.
    check = Round(list(range(VALUES)), [False] * VALUES, 4)
    known, safe, one = np.arange(VALUES) < 4, np.zeros(VALUES, bool), 1.0 / VALUES
    at_once = replace(stripe, rounds=(check,), known=known, beyond=safe)
    bound = most_wrong(Checked(4, 0), 0.9) * (VALUES - 4) * one
    assert at_once.most_wrong == pytest.approx(bound)
    assert bound < (VALUES - 4) * one
    # Two predictions have changed since: each may be wrong beside those of before.
    changed = replace(at_once, beyond=np.arange(VALUES) >= VALUES - 2)
    assert changed.most_wrong == pytest.approx(bound + 2 * one)
    # Simulations found two of them wrong: they are no longer predicted, and so many fewer are wrong.
    later = replace(at_once, beyond=np.arange(VALUES) >= VALUES - 2, known=known | (np.arange(VALUES) >= VALUES - 2))
    assert later.most_wrong == pytest.approx(bound - 2 * one)
    assert replace(at_once, rounds=()).most_wrong == pytest.approx((VALUES - 4) * one)


def test_the_interval_of_others_is_that_of_independent_values_or_of_groups() -> None:
    weight, exact = np.full(40, 1.0 / 40.0), np.zeros((2, 4))
    beyond = np.arange(40) < 10
    single = of_others(beyond, weight, np.arange(40), exact, 0.9)
    assert single is not None
    assert single == pytest.approx((beta.ppf(0.05, 10, 31), beta.ppf(0.95, 11, 30)), abs=0.01)
    grouped = of_others(beyond, weight, np.arange(40) // 5, exact, 0.9)
    assert grouped is not None
    assert grouped.high - grouped.low > 1.8 * (single.high - single.low)
    none = of_others(np.zeros(40, dtype=bool), weight, np.arange(40) // 5, exact, 0.9)
    assert none is not None
    assert none.low == 0.0
    assert none.high > 1.0 - 0.05 ** (1.0 / 8.0)
    assert of_others(beyond, weight, np.arange(40) // 20, exact, 0.9) is None
    # The classifier's doubt widens it.
    doubted = of_others(beyond, weight, np.arange(40), np.random.default_rng(0).normal(size=(2, 4000), scale=0.07), 0.9)
    assert doubted is not None
    assert doubted.high - doubted.low > 1.3 * (single.high - single.low)


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from ran import ran_in

    return ran_in(tmp_path_factory.mktemp("stripes"), CAMPAIGN, CODE)


def test_the_command_names_both_intervals_and_its_json_has_them(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    words = ("probability", folder / "run", "--code", folder, "--fixed", "x=2,y=0.5", "--wrong", "0.02")
    shown = activefail(*words)
    assert shown.code == 0, shown.err
    lines = shown.out.splitlines()
    assert lines[0].startswith("probability of failure at x = 2.0, y = 0.5: 0.")
    assert f"the {VALUES} values of record" in lines[1]
    assert f"over {VALUES} groups" in lines[2]
    numbers = json.loads(activefail(*words, "--json").out)["outcomes"]["failure"]
    assert numbers["simulations"] == 0
    assert numbers["simulated"] + numbers["predicted"] == numbers["values"] == VALUES
    assert numbers["low"] <= numbers["probability"] <= numbers["high"]
    assert numbers["others"]["low"] < numbers["low"]
    assert numbers["others"]["high"] > numbers["high"]
    assert activefail("status", folder / "run").out.count("given") == 1
    with open_run(folder / "run", write=True, code=folder) as opened:
        assert opened.probability(fixed={"x": 2.0, "y": 0.5}, wrong=0.02).as_json()["outcomes"]["failure"] == numbers


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (("--fixed", "x=2"), "y is continuous. Give it values, such as --fixed y=1, or leave --wrong out"),
        (("--fixed", "x=2,y"), "fixed: must be a file, or values such as load=4,depth=0.3, got 'y'"),
        (("--fixed", "x=2,z=1"), "z: is not a variable of the campaign"),
        (("--fixed", "x=2,y=0.5,record=77"), "record: must be one of 0, 1"),
        (("--fixed", "x=2,y=0.5,record=3"), "fixes every variable"),
    ],
)
def test_what_has_no_finite_answer_is_refused(folder: Path, words: tuple[str, ...], rule: str) -> None:
    refused(activefail("probability", folder / "run", "--code", folder, "--wrong", "0.01", *words), rule)


@pytest.mark.parametrize(
    ("command", "words", "rule"),
    [
        ("probability", "--wrong 0.01 --simulations 60", "--simulations: cannot be combined with --wrong."),
        ("probability", "--at-once 4", "--at-once: requires --wrong."),
        ("probability", "--at-once 3", "--at-once: requires --wrong."),  # the default
        ("design", "--target 0.1 --wrong 0.01 --simulations 200", "--simulations: cannot be combined with --wrong."),
        ("design", "--target 0.1 --wrong 0.01 --chart --out OUT", "--chart: cannot be combined with --wrong."),
        ("design", "--target 0.1 --chart", "--chart: requires --out."),
        ("design", "--target 0.1 --at-once 2", "--at-once: requires --wrong."),
        ("fragility", "--against x --wrong 0.01 --verify 100", "--verify: cannot be combined with --wrong."),
        ("fragility", "--wrong 0.01 --hazard site.toml", "--hazard: cannot be combined with --wrong."),
        ("fragility", "--hazard site.toml --range 1,2", "--range: requires --against."),
    ],
)
def test_an_option_of_another_way_of_answering_is_refused(
    folder: Path, tmp_path: Path, command: str, words: str, rule: str
) -> None:
    shown = activefail(command, folder / "run", "--code", folder, *words.replace("OUT", str(tmp_path / "out")).split())
    refused(shown, rule)


def test_python_refuses_them_too_and_shows_their_defaults(folder: Path) -> None:
    with open_run(folder / "run", code=folder) as opened:
        for words, rule in (
            ({"wrong": 0.01, "simulations": 60}, "simulations: cannot be combined with wrong."),
            ({"at_once": 3}, "at_once: requires wrong."),
        ):
            with pytest.raises(InputError, match=rf"^{rule}"):
                opened.probability(**words)
        assert inspect.signature(opened.probability).parameters["simulations"].default == 50
        assert inspect.signature(probability).parameters["simulations"].default == 50


# --- design ---------------------------------------------------------------------------------------------------------


def test_design_finds_the_smallest_value_that_meets_its_target_in_few_simulations(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    words = ("design", folder / "run", "--code", folder, "--fixed", "x=2", "--free", "y", "--wrong", "0.01")
    shown = activefail(*words, "--target", "20%", "--json", "--out", tmp_path / "out")
    assert shown.code == 0, shown.err
    numbers = json.loads(shown.out)
    grid = np.linspace(0.0, 2.0, 41)
    smallest = min(y for y in grid if truth(2.0, y) <= 0.2 + 1e-9)
    assert numbers["bearing"] == {"x": 2.0, "y": pytest.approx(smallest)}
    assert numbers["probability"] == pytest.approx(truth(2.0, smallest))
    assert numbers["simulations"] < VALUES * len(numbers["looks"]) / 2
    assert (tmp_path / "out" / "design.html").exists()
    again = activefail(*words, "--target", "20%")
    assert f"y = {smallest:.4g}" in again.out.splitlines()[0]
    assert "0 simulations now" in again.out
    design = (tmp_path / "out" / "design.toml").read_text(encoding="utf-8")
    assert f"\ny = {smallest:.4g}\n" in design
    words = ("design", folder / "run", "--code", folder, "--fixed", "x=4", "--free", "y", "--wrong", "0.05")
    unreachable = activefail(*words, "--target", "1%")
    assert unreachable.code == 3
    assert "This largest y of the campaign's range does not meet the target" in unreachable.out


class MadeStripes:
    """Stripes of designs with made probabilities, the classifier's own before and after each that is asked for."""

    stage = staticmethod(silent)

    def __init__(self, predicted: list[tuple[float, ...]], truth: tuple[float, ...]) -> None:
        self.by_classifier, self.truth = predicted, truth
        self.asked, self.looked = list[int](), list[int]()

    def predicted(self, question: Question, outcome: str) -> SimpleNamespace:
        self.looked.append(int(question.fixed["bearing"]))
        return SimpleNamespace(probability=self.by_classifier[len(self.asked)][self.looked[-1]])

    def ask(self, question: Question, outcome: str, wrong: float) -> SimpleNamespace:
        self.asked.append(int(question.fixed["bearing"]))
        return SimpleNamespace(probability=self.truth[self.asked[-1]])


@pytest.mark.parametrize(
    ("predicted", "truth", "asked", "looked", "result"),
    [
        # The first fails by its simulations, though the classifier then thinks that it meets the target.
        ([(0.15, 0.5, 0.2), (0.05, 0.5, 0.11), (0.05, 0.5, 0.05)], (0.12, 0.5, 0.05), [0, 2], "012 12 1", "2, Of the 2 "
         "before it, 1 miss it by their simulations, and 1 by the classifier."),
        # The dearer ones behind one that promises to meet the target are not looked at.
        ([(0.2, 0.05, 0.01), (0.2, 0.05, 0.01)], (0.2, 0.06, 0.01), [1], "01 0", "1, Of the 1 before it, 0 miss"),
        # The safest is that by the simulations.
        ([(0.3, 0.05, 0.2), (0.3, 0.05, 0.13)], (0.3, 0.12, 0.1), [1], "01 02", "1, None of 3 designs meets the target "
         "under these values: 1 miss it by their simulations, and 2 by the classifier. This one is the safest."),
    ],
)  # fmt: skip
def test_of_a_catalogue_simulations_decide_and_the_classifier_says_what_to_ask_for(
    predicted: list[tuple[float, ...]], truth: tuple[float, ...], asked: list[int], looked: str, result: str
) -> None:
    space = DesignSpace((Parameter("x", 0.0, 4.0), Parameter.of_choices("bearing", ("A", "B", "C"))))
    inquiry = Inquiry(SimpleNamespace(space=space), Question.of_space(space))  # type: ignore[arg-type]
    stripes = MadeStripes(predicted, truth)
    task = design_task(inquiry, (Requirement("failure", 0.1),), ("bearing",))
    found = design_by_stripes(stripes, task, 0.01)  # type: ignore[arg-type]
    assert stripes.asked == asked
    assert stripes.looked == [int(one) for one in looked.replace(" ", "")]
    place, sentence = result.split(", ", 1)
    assert found.values["bearing"] == int(place)
    assert sentence in DesignFindings(found, None).verdict  # type: ignore[arg-type]


def test_design_by_stripes_refuses_two_ranges_and_a_continuous_open_variable(folder: Path) -> None:
    words = ("design", folder / "run", "--code", folder, "--wrong", "0.01", "--target", "0.2")
    refused(activefail(*words, "--free", "x,y"), "wrong: requires one free variable")
    refused(activefail(*words, "--free", "y"), "x is continuous")


# --- fragility ------------------------------------------------------------------------------------------------------


def test_a_fragility_curve_has_a_stripe_at_each_level_and_a_lognormal_fit(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    words = ("fragility", folder / "run", "--code", folder, "--fixed", "y=1", "--against", "x", "--wrong", "0.01")
    shown = activefail(*words, "--json", "--range", "0.8,3.8", "--out", tmp_path / "out")
    assert shown.code == 0, shown.err
    numbers = json.loads(shown.out)
    failure = numbers["outcomes"]["failure"]
    assert len(failure["verified"]) == 4
    for one in failure["verified"]:
        assert one["probability"] == pytest.approx(truth(one["level"], 1.0), abs=1.01 / VALUES)
    capacity = 2.5 - 1.3 * np.sin(1.7 * np.arange(VALUES) + 0.4)
    exact = fit_lognormal(capacity * 0.999, capacity)
    assert exact is not None
    assert failure["lognormal"]["median"] == pytest.approx(exact.median, rel=0.02)
    assert failure["lognormal"]["dispersion"] == pytest.approx(exact.dispersion, rel=0.1)
    low, high = failure["lognormal"]["median_interval"]
    assert low < exact.median < high
    assert sum(one["simulations"] for one in failure["verified"]) < VALUES * len(failure["verified"]) / 2
    assert json.loads((tmp_path / "out" / "fragility.json").read_text()) == numbers
    page = (tmp_path / "out" / "fragility.html").read_text()
    interval = f"{significant(low)} to {significant(high)} with 95 % confidence"
    assert f"<b>{significant(failure['lognormal']['median'])}</b> ({interval}" in page
    assert "<svg" in page
    table = activefail(*words, "--range", "0.8,3.8", "--csv", "-")
    assert [row.split(",")[1] for row in table.out.splitlines()].count("verified") == len(failure["verified"])
    again = activefail(*words, "--range", "0.8,3.8")
    assert again.out.splitlines()[0].startswith("fragility against x, under")
    assert "given      y = 1" in again.out
    assert re.search(r" median \d\.\d+ \(\d\.\d\d to \d\.\d\d, 95 %, over groups\)", again.out)
    assert "It follows from a prior with a mean of 10 %" in again.out


@pytest.mark.parametrize(
    ("levels", "why"),
    [
        ("0.5,1.8", "the curve does not cover 10 % to 50 %"),
        ("0,3.8", "some levels of the curve are not positive"),
    ],
)
def test_a_median_beyond_the_levels_is_not_led_with(folder: Path, tmp_path: Path, levels: str, why: str) -> None:
    words = ("fragility", folder / "run", "--code", folder, "--fixed", "y=1", "--against", "x", "--wrong", "0.01")
    shown = activefail(*words, "--range", levels, "--out", tmp_path)
    assert shown.code == 0, shown.err
    assert why in shown.out
    page = (tmp_path / "fragility.html").read_text()
    assert f"none is fitted: {why}" in page
    assert "over groups" not in page


def test_a_curve_by_stripes_has_levels_between_safe_and_failed(folder: Path) -> None:
    words = ("fragility", folder / "run", "--code", folder, "--wrong", "0.01", "--against", "x")
    refused(activefail(*words), "y is continuous")
    flat = activefail(*words, "--fixed", "y=1", "--range", "0,0.2")
    assert flat.code == 2
    assert "choose others with --range" in flat.err
