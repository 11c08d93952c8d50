"""Designs for a target probability: against closed forms, verified by simulations that did not choose them."""

import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from operator import itemgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import CommandResult, activefail, refused
from scipy.stats import norm

from activefail.analyses.classifier_probability import classifier_probability
from activefail.analyses.design.design_task import LOOKS, DesignTask, Requirement, confidence_of_bound, read_targets
from activefail.analyses.design.findings import DesignFindings
from activefail.analyses.design.required_chart import least_value, required_chart
from activefail.analyses.design.search import Candidate, Designed, Look, cheapest, find_design, verifies
from activefail.campaign.inquiry import Inquiry
from activefail.campaign.question import Question
from activefail.errors import InputError
from activefail.estimates.confidence_bounds import upper_bound
from activefail.estimates.estimate import Plan, plan_estimate
from activefail.estimates.probability_estimator import Sampled
from activefail.pages.figures.risk import plot_looks
from activefail.pages.report.analyses import render_design
from activefail.run.opening import open_run
from activefail.run.run import Run
from activefail.space.distributions import moments
from activefail.space.parameter import Parameter
from activefail.space.shares import percent
from activefail.space.space import Array, Constraint, DesignSpace

CAMPAIGN = """
simulator = { python = "tank:run", outcomes = ["safe", "damage", "failure"] }
[space]
capacity = { low = 0.5, high = 4.0, unit = "m" }
friction = { low = 0.5, high = 1.5 }
demand = { low = 0.1, high = 6.0, unit = "m", distribution = "log_uniform" }
[sampling]
initial = 80
budget = 100
batch = 10
[classifier.features.expressions]
ratio = "log(demand / (capacity * sqrt(friction)))"
"""

SIMULATOR = """
def run(design):
    demand = design["demand"] / design["friction"] ** 0.5
    return "failure" if demand > design["capacity"] else "damage" if demand > 0.6 * design["capacity"] else "safe"
"""

MEDIAN, DISPERSION = 0.9, 0.4

QUESTION = f"""
description = "a site"
[space]
demand = {{ distribution = "lognormal", median = {MEDIAN}, dispersion = {DISPERSION} }}
"""


def needed(target: float, friction: float = 1.0, share: float = 1.0) -> float:
    """The smallest capacity whose demand exceeds `share` of it with the target probability."""
    return float(MEDIAN * math.exp(DISPERSION * norm.isf(target)) / math.sqrt(friction) / share)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("design")
    (folder / "tank.py").write_text(SIMULATOR)
    (folder / "tank.toml").write_text(CAMPAIGN)
    (folder / "site.toml").write_text(QUESTION)
    (folder / "fixed.toml").write_text("friction = 1.0\n")
    result = activefail("run", folder / "tank.toml", "--out", folder / "run")
    assert result.code == 0, result.err
    return folder


def asked(folder: Path, command: str, *options: object, question: str = "site.toml") -> CommandResult:
    """What a command prints about the design of a tank."""
    files = ("--question", folder / question, "--fixed", folder / "fixed.toml")
    return activefail(command, folder / "run", "--code", folder, *files, "--free", "capacity", *options)


@pytest.fixture
def run(folder: Path) -> Iterator[Run]:
    with open_run(folder / "run", write=True, code=folder) as opened:
        yield opened


@pytest.mark.parametrize("target", [0.1, 0.025])
def test_a_design_meets_its_target_and_is_hardly_larger_than_the_smallest_that_does(
    run: Run, folder: Path, target: float
) -> None:
    found = run.design(target, None, folder / "site.toml", {"friction": 1.0}, ["capacity"]).designed
    assert found.status == "verified"
    assert needed(target) < found.values["capacity"] < 1.12 * needed(target)
    assert found.result.estimates[0].high <= target
    assert found.simulations == sum(look.size for look in found.looks) <= 1000


def test_the_same_search_reads_its_simulations_again(run: Run, folder: Path) -> None:
    asked = (0.1, None, folder / "site.toml", {"friction": 1.0}, ["capacity"])
    first = run.design(*asked).as_json()
    stored = run.store.set_names()
    assert run.design(*asked).as_json() == first
    assert run.store.set_names() == stored


def test_a_search_for_another_target_keeps_the_simulations_of_the_same_design(run: Run, folder: Path) -> None:
    (folder / "stronger.toml").write_text(QUESTION.replace(str(MEDIAN), "5.0"))
    asked = (None, folder / "stronger.toml", {"friction": 1.0}, ["capacity"])
    first = run.design(0.05, *asked).designed
    kept = {name: run.store.read_set(name) for name in run.store.set_names()}
    other = run.design(0.1, *asked).designed
    assert first.values == other.values == {"capacity": 4.0}
    for name, stored in kept.items():
        again = run.store.read_set(name)
        assert stored is not None
        assert again is not None
        assert np.array_equal(stored[0], again[0])


@pytest.mark.slow
def test_several_free_variables_are_searched_for_the_least_cost(run: Run, folder: Path) -> None:
    # capacity √friction is what counts: with a cost that is steep in friction, the least friction is cheapest, and with
    # one that is steep in capacity, the largest.
    for cost, friction in (("capacity * friction", 0.5), ("capacity", 1.5)):
        found = run.design(0.1, question=folder / "site.toml", free=["capacity", "friction"], cost=cost).designed
        assert found.status == "verified"
        assert found.values["friction"] == pytest.approx(friction, abs=0.03)
        assert needed(0.1, friction) < 1.03 * found.values["capacity"] < 1.15 * needed(0.1, friction)


@pytest.fixture(scope="module")
def of_two_targets(folder: Path) -> DesignFindings:
    with open_run(folder / "run", write=True, code=folder) as opened:
        return opened.design("failure=0.1,damage=0.1", None, folder / "site.toml", {"friction": 1.0}, ["capacity"])


def test_each_outcome_may_have_a_target_and_the_hardest_decides(of_two_targets: DesignFindings) -> None:
    found = of_two_targets.designed
    assert found.status == "verified"
    assert needed(0.1, share=0.6) < found.values["capacity"] < 1.1 * needed(0.1, share=0.6)
    assert [estimate.high <= 0.1 for estimate in found.result.estimates] == [True, True]
    assert found.simulations == sum(2 * look.size for look in found.looks) <= 2000


def test_the_page_has_the_classifiers_probability_of_each_outcome_beside_its_target(
    of_two_targets: DesignFindings,
) -> None:
    page, result = render_design(of_two_targets), of_two_targets.designed.result
    for share, estimate in zip(result.candidate.model, result.estimates, strict=True):
        assert f'<td class="n">{percent(share, 2)}</td><td class="n">{estimate.simulations}</td>' in page


def test_two_looks_are_numbered_and_the_target_lies_below_the_upper_edge(of_two_targets: DesignFindings) -> None:
    looks = replace(of_two_targets.designed, looks=2 * of_two_targets.designed.looks[:1])
    axes = plot_looks(replace(of_two_targets, designed=looks), ["damage", "failure"]).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["look 1", "look 2"]
    assert axes.get_ylim()[1] > 1.05 * 100.0 * 0.1


def test_the_page_names_what_continues_with_the_design(of_two_targets: DesignFindings) -> None:
    page = render_design(of_two_targets)
    assert "<code>design.toml</code> gives this design to the <code>--fixed</code> of other commands" in page
    assert "activefail fragility" not in page
    unreachable = replace(of_two_targets.designed, status="out of reach")
    assert "<dd>a wider range of capacity, or other values" in render_design(
        replace(of_two_targets, designed=unreachable)
    )
    liner = Parameter.of_choices("capacity", ("A", "B"))
    catalogue = replace(unreachable, task=replace(unreachable.task, stepped={"capacity": liner}))
    assert "<dd>other choices of capacity, or" in render_design(replace(of_two_targets, designed=catalogue))


def test_a_target_that_no_design_meets_ends_with_the_nearest_one(folder: Path) -> None:
    (folder / "strong.toml").write_text(QUESTION.replace(str(MEDIAN), "4.5"))
    result = asked(folder, "design", "--target", "0.01", question="strong.toml")
    assert result.code == 3
    assert "Out of reach: according to the classifier, no design within the ranges" in result.out
    assert "capacity is at the upper end of its range" in result.out
    assert "No design within the ranges brings the classifier's probability down to the search's goal." in result.out
    assert "Beyond this design" not in result.out
    assert "classifier" in result.out


@pytest.mark.usefixtures("without_pictures")
def test_a_result_that_simulations_do_not_confirm_is_not_called_verified(folder: Path, tmp_path: Path) -> None:
    # Fifty simulations can hardly show 1 %.
    out = tmp_path / "out"
    result = asked(folder, "design", "--target", "0.01", "--simulations", 50, "--out", out)
    shown = json.loads((out / "design.json").read_text())
    assert (result.code == 3) == (shown["high"] > 0.01)
    assert ("Not verified" in result.out) == (shown["status"] == "not verified")


def test_the_command_writes_a_page_numbers_and_values_for_other_commands(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "here"
    result = asked(folder, "design", "--target", "II", "--out", out)
    assert result.code == 0, result.err
    assert sorted(path.name for path in out.iterdir()) == ["design.html", "design.json", "design.toml"]
    numbers, values = json.loads((out / "design.json").read_text()), tomllib.loads((out / "design.toml").read_text())
    assert values == numbers["bearing"] == {"capacity": values["capacity"], "friction": 1.0}
    assert (numbers["target"], numbers["confidence"], numbers["status"]) == (0.1, 0.95, "verified")
    page = (out / "design.html").read_text()
    assert "The design meets its target with 95 % confidence" in page
    assert f"<b>capacity\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{values['capacity']:.4g}" in page
    assert f"<b>{percent(numbers['probability'], 2)}</b>" in page
    assert "may verify a smaller one" not in page
    assert numbers["probability"] > 0.075
    options = ("--code", folder, "--question", folder / "site.toml", "--fixed", out / "design.toml")
    again = activefail("probability", folder / "run", *options, "--simulations", 350, "--json")
    assert again.code == 0, again.err
    assert json.loads(again.out)["outcomes"]["failure"]["probability"] == pytest.approx(
        numbers["probability"], abs=0.02
    )


# What follows knows the truth in closed form: failure where ln(demand/capacity) + a + b > 0, demand lognormal.


def question_of(median: float = 1.0, dispersion: float = 0.4) -> Question:
    mean, sd = moments("lognormal", None, None, {"median": median, "dispersion": dispersion})
    demand = Parameter("demand", 1e-4, 1e4, "m", "lognormal", mean, sd)
    names = ("capacity", "a", "b", "demand")
    return Question("made", names, DesignSpace((demand,)), {"capacity": 1.0, "a": 0.0, "b": 0.0})


def limit(X: Array) -> Array:
    return np.asarray(np.log(X[:, 3] / X[:, 0]) + X[:, 1] + X[:, 2])


_QUESTION = Question("none", ("x",), None)  # type: ignore[arg-type]


def task_on(
    low: float, high: float, target: float, name: str = "x", question: Question = _QUESTION, simulations: int = 100
) -> DesignTask:
    """The smallest value of one variable that meets a target."""
    asked, required = Inquiry(None, question), (Requirement("failure", target),)  # type: ignore[arg-type]
    price = itemgetter(name)
    return DesignTask(asked, {name: low}, {name: high}, price, name, required, 0.95, simulations)


def task_of(question: Question, target: float = 0.1, simulations: int = 500) -> DesignTask:
    return task_on(0.5, 6.0, target, "capacity", question, simulations)


@dataclass
class MadeEstimator:
    """An estimator whose classifier is wrong by a factor on the demand, and whose simulator is exact."""

    factor: float
    sd: float
    seed: int

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        return lambda X: (limit(X) + math.log(self.factor)) / self.sd

    def probability(self, outcome: str, question: Question) -> float:
        return classifier_probability(self.standardised(outcome), question)

    def plan(self, outcome: str, simulations: int, question: Question) -> Plan:
        of_designs = self.standardised(outcome)
        rng = np.random.default_rng([self.seed, question.draw])

        def boundary(X: Array) -> Array:
            return of_designs(question.designs(X))

        return plan_estimate(boundary, question.space, simulations, rng, sceptical=True)

    def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
        plan = self.plan(outcome, simulations, question)
        return Sampled(plan, limit(question.designs(plan.designs)) > 0.0, np.ones(len(plan.designs), dtype=bool))


@pytest.mark.exhaustive
def test_a_wrong_classifier_is_corrected_by_the_first_look_and_hardly_ever_gives_a_design_that_misses_its_target() -> (
    None
):
    question, target = question_of(), 0.1
    corrected = missed = verified = 0
    for seed in range(60):
        # Wrong by up to a fifth of the demand, on either side, and unsure by as much.
        factor = float(np.exp(np.random.default_rng(seed).uniform(-0.2, 0.2)))
        found = find_design(MadeEstimator(factor, 0.15, seed), task_of(question, target))  # type: ignore[arg-type]
        truth = float(norm.sf(math.log(found.values["capacity"]) / 0.4))
        verified += found.status == "verified"
        missed += found.status == "verified" and truth > target
        corrected += len(found.looks) >= 2
    assert verified >= 50
    assert corrected >= 10
    assert missed <= 3  # 95 % confidence


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.999])
def test_the_looks_together_spend_at_most_the_error_of_the_result(confidence: float) -> None:
    spent = [1.0 - confidence_of_bound(confidence, look) for look in range(LOOKS)]
    assert 0.99 * (1.0 - confidence) < sum(spent) <= 1.0 - confidence
    assert sorted(spent, reverse=True) == spent


@pytest.mark.parametrize("simulations", [10, 25, 100, 300, 1000, 5000])
def test_looks_ask_for_no_more_than_what_is_allowed(simulations: int) -> None:
    task = task_of(question_of(), simulations=simulations)
    for choice in (0, -1):
        made = last = 0
        while sizes := task.sizes(made, last):
            assert min(sizes) > last or sizes == [simulations - made]
            last = sizes[choice]
            made += last
        assert simulations - 10 < made <= simulations


@pytest.mark.parametrize(("sd", "most", "excess"), [(0.02, 200, 0.05), (0.1, 400, 0.1)])
def test_a_design_asks_for_as_many_simulations_as_the_doubt_of_the_classifier_needs(
    sd: float, most: int, excess: float
) -> None:
    smallest = math.exp(0.4 * float(norm.isf(0.1)))
    for seed in range(3):
        found = find_design(MadeEstimator(1.0, sd, seed), task_of(question_of(), 0.1, 1000))  # type: ignore[arg-type]
        assert found.status == "verified"
        assert found.simulations <= most
        assert smallest < found.values["capacity"] < (1.0 + excess) * smallest


@dataclass
class Unsure(MadeEstimator):
    """Its classifier is unsure of small demands, which no design fails under; less so where the capacity is small."""

    small: float = 0.736
    of_small_capacity: float = 0.736

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        def of(X: Array) -> Array:
            is_unsure = X[:, 3] < np.where(X[:, 0] < 2.0, self.of_small_capacity, self.small)
            return np.where(is_unsure & (X[:, 0] > self.small), 0.1, limit(X) / self.sd)

        return of


def test_a_classifier_that_is_unsure_of_survival_does_not_make_the_design_much_too_large() -> None:
    # Its probability exceeds the target even at the largest capacity, by 12 % under small demands.
    found = find_design(Unsure(1.0, 0.1, 0), task_of(question_of(), 0.1, 1000))  # type: ignore[arg-type]
    assert found.status == "verified"
    assert found.looks[0].candidate.values["capacity"] == 6.0
    smallest = math.exp(0.4 * float(norm.isf(0.1)))
    assert smallest < found.values["capacity"] < 1.15 * smallest


def test_a_smaller_design_that_is_looked_at_and_fails_leaves_the_verified_one_as_the_result() -> None:
    # What is wrong at the largest capacity is less wrong at small ones, so the second proposal is too small.
    estimator = Unsure(1.0, 0.1, 0, of_small_capacity=0.64)
    found = find_design(estimator, task_of(question_of(), 0.1, 300))  # type: ignore[arg-type]
    large, small = (look.candidate.values["capacity"] for look in found.looks)
    assert small < 2.0 < large
    assert found.looks[0].size < found.looks[1].size
    assert (found.status, found.number, found.values["capacity"]) == ("verified", 1, large)
    assert found.result.estimates[0].high <= 0.1 < found.looks[1].estimates[0].high


def test_a_failure_where_the_classifier_was_sure_is_never_called_verified() -> None:
    @dataclass
    class Island(MadeEstimator):
        """Where the demand is small, a tenth of all designs fail unseen."""

        def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
            plan = self.plan(outcome, simulations, question)
            X = question.designs(plan.designs)
            return Sampled(plan, (limit(X) > 0.0) | (X[:, 3] < 0.6), np.ones(len(plan.designs), dtype=bool))

    for seed in range(5):
        found = find_design(Island(1.0, 0.1, seed), task_of(question_of(), 0.3))  # type: ignore[arg-type]
        assert found.status == "not verified"
        assert found.result.surprising > 0
        assert 0.01 < found.missable < 0.1  # of a look of at most 100


def test_a_failure_where_the_classifier_was_sure_ends_what_a_former_look_verified() -> None:
    @dataclass
    class Missed(Unsure):
        """A twentieth of all designs fails unseen, which its first look misses by chance."""

        def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
            sampled = super().sample(outcome, simulations, question)
            demand = question.designs(sampled.plan.designs)[:, 3]
            hidden = (demand > 0.8) & (demand < 0.85) & (question.draw > 1)
            return replace(sampled, beyond=sampled.beyond | hidden)

    found = find_design(Missed(1.0, 0.1, 0), task_of(question_of(), 0.1, 1000))  # type: ignore[arg-type]
    first, last = found.looks
    assert verifies(first.estimates, [0.1])
    assert first.candidate.values["capacity"] > last.candidate.values["capacity"]
    assert (found.status, found.number, found.result.surprising > 0) == ("not verified", 2, True)


@dataclass
class Pessimist(MadeEstimator):
    """Its classifier believes that large capacities fail too, more often the larger they are."""

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        return lambda X: np.maximum(limit(X) / self.sd, np.minimum(X[:, 0] - 1.3, 1.0) - 1.2 + np.log(X[:, 3]))


def test_a_target_that_a_larger_design_meets_is_not_called_out_of_reach() -> None:
    found = find_design(Pessimist(1.0, 0.1, 0), task_of(question_of(), 0.05, 1000))  # type: ignore[arg-type]
    nearest, end = found.looks[0], found.looks[1]
    assert not nearest.candidate.is_feasible
    assert nearest.above(np.array([0.05])).all()
    assert nearest.candidate.values["capacity"] < 1.9
    assert end.candidate.values["capacity"] == 6.0
    assert (found.status, found.values["capacity"]) == ("verified", 6.0)


@dataclass
class Reversed(MadeEstimator):
    """Its classifier believes that the smallest capacity is the safest, and that it misses the target."""

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        return lambda X: (np.log(X[:, 3]) + 0.1 * X[:, 0] - 0.3) / 0.4


def test_no_target_is_out_of_reach_because_the_wrong_end_of_the_range_exceeds_it() -> None:
    found = find_design(Reversed(1.0, 0.1, 0), task_of(question_of(), 0.1, 1000))  # type: ignore[arg-type]
    wrong, right, *_ = found.looks
    assert (wrong.candidate.values["capacity"], right.candidate.values["capacity"]) == (0.5, 6.0)
    assert wrong.above(np.array([0.1])).all()
    assert found.status != "out of reach"


def test_a_target_is_out_of_reach_if_all_ends_of_the_range_exceed_it() -> None:
    task = replace(task_of(question_of(), 0.05), high={"capacity": 1.5})
    found = find_design(MadeEstimator(1.0, 0.1, 0), task)  # type: ignore[arg-type]
    assert (found.status, found.values["capacity"]) == ("out of reach", 1.5)
    assert [look.candidate.values["capacity"] for look in found.looks] == [1.5, 0.5]
    assert all(look.above(np.array([0.05])).all() for look in found.looks)


@dataclass
class Blind(MadeEstimator):
    """Its classifier does not see that values between two are safe: 40 % fail at the smallest, more elsewhere."""

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        return lambda X: (np.log(X[:, 3]) + 0.1 * X[:, 0] + 0.05) / 0.4

    def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
        plan = self.plan(outcome, simulations, question)
        X = question.designs(plan.designs)
        return Sampled(plan, np.log(X[:, 3]) > 0.8 - np.abs(X[:, 0] - 3.0), np.ones(len(X), dtype=bool))


def test_no_target_is_out_of_reach_because_both_ends_of_the_range_exceed_it_if_the_classifier_is_wrong_there() -> None:
    found = find_design(Blind(1.0, 0.1, 0), task_of(question_of(), 0.1, 1000))  # type: ignore[arg-type]
    assert {0.5, 6.0} <= {look.candidate.values["capacity"] for look in found.looks}
    assert all(look.above(np.array([0.1])).all() for look in found.looks)
    assert found.status == "not verified"


@dataclass
class Dip(MadeEstimator):
    """Its classifier is right: failure is less probable around one value, between two of the grid of a line."""

    slope: float = 0.0

    def standardised(self, outcome: str) -> Callable[[Array], Array]:
        return lambda X: (np.log(X[:, 3]) - self.strength(X)) / self.sd

    def strength(self, X: Array) -> Array:
        return np.asarray(0.1 + self.slope * X[:, 0] + 0.6 * np.exp(-(((X[:, 0] - 3.03) / 0.12) ** 2)))

    def sample(self, outcome: str, simulations: int, question: Question) -> Sampled:
        plan = self.plan(outcome, simulations, question)
        X = question.designs(plan.designs)
        return Sampled(plan, np.log(X[:, 3]) > self.strength(X), np.ones(len(X), dtype=bool))


@pytest.mark.parametrize("slope", [0.0, 0.05])  # with a slope, the best value of the grid is the end, far from the dip
@pytest.mark.parametrize("step", [None, 0.01])
def test_a_target_that_is_met_between_two_values_of_the_grid_is_not_called_out_of_reach(
    step: float | None, slope: float
) -> None:
    stepped = {} if step is None else {"capacity": Parameter("capacity", 0.5, 6.0, step=step)}
    task = replace(task_of(question_of(), 0.07, 1000), stepped=stepped)
    found = find_design(Dip(1.0, 0.02, 0, slope), task)  # type: ignore[arg-type]
    assert found.status == "verified"
    assert found.values["capacity"] == pytest.approx(3.03, abs=0.1)


def constrained(task: DesignTask, most: float) -> DesignTask:
    """The task with a constraint on the capacity, which it calls feasible if it is no larger."""
    limit = Constraint("capacity", frozenset({"capacity"}), itemgetter("capacity"), lambda _: most, False)
    campaign = SimpleNamespace(space=SimpleNamespace(quantities=dict))
    return replace(task, constraints=(limit,), asked=Inquiry(campaign, task.question))  # type: ignore[arg-type]


def test_a_design_up_to_the_limit_of_a_constraint_is_found_between_two_values_of_the_grid() -> None:
    # The grid has 1.875, which fails with 5.8 %, and 2.33, which is not allowed.
    task = constrained(task_of(question_of(), 0.045, 1000), 2.2)
    found = find_design(MadeEstimator(1.0, 0.02, 0), task)  # type: ignore[arg-type]
    assert found.status == "verified"
    assert 1.97 < found.values["capacity"] <= 2.2


def test_a_target_is_not_out_of_reach_where_a_constraint_excludes_an_end_of_the_range() -> None:
    found = find_design(Reversed(1.0, 0.1, 0), constrained(task_of(question_of(), 0.1, 1000), 5.0))  # type: ignore[arg-type]
    assert [look.candidate.values["capacity"] for look in found.looks] == [0.5]
    assert found.status == "not verified"


def test_constraints_that_no_value_meets_are_refused_before_anything_is_simulated() -> None:
    with pytest.raises(InputError, match="constraints: no value of capacity was found that meets them"):
        find_design(MadeEstimator(1.0, 0.1, 0), constrained(task_of(question_of()), 0.1))  # type: ignore[arg-type]


def test_the_safest_of_the_designs_that_exceed_a_target_is_the_result() -> None:
    # The end with 0.5 is looked at last.
    task = constrained(task_of(question_of(), 0.03), 1.5)
    found = find_design(MadeEstimator(1.0, 0.1, 0), task)  # type: ignore[arg-type]
    assert [look.candidate.values["capacity"] for look in found.looks] == pytest.approx([1.5, 0.5], abs=0.01)
    assert (found.status, found.number) == ("not verified", 1)


def test_nothing_can_fail_unseen_where_every_pulse_was_simulated() -> None:
    question = question_of()
    sampled = MadeEstimator(1.0, 0.1, 0).sample("failure", 100, question)
    of_all = MadeEstimator(1.0, 0.1, 0).sample("failure", 10**6, question)
    count, share = sampled.plan.surest
    assert count >= 10
    for of, unseen in ((of_all, 0.0), (sampled, share * upper_bound(0, count, 0.96))):
        look = Look(Candidate({"capacity": 2.0}, np.array([0.1]), True), (of,), 0.96)
        assert Designed(task_of(question), (look,), 1, "verified").missable == pytest.approx(unseen)


def test_a_chart_gives_the_required_value_for_each_target() -> None:
    question = question_of()
    x, values, targets = np.array([-0.2, 0.1, 1.5]), np.array([0.0, 0.3]), np.array([0.1, 0.025])

    def standardised(X: Array) -> Array:
        return limit(X) / 1e-3

    chart = required_chart(task_of(question), {}, standardised, ("a", x), ("b", values), targets)
    for target, lines in zip(targets, chart.required, strict=True):
        exact = np.exp(0.4 * norm.isf(target) + x[None, :] + values[:, None])
        np.testing.assert_allclose(lines[:, :2], exact[:, :2], rtol=0.04)
    # At a = 1.5 no capacity up to 6 is enough.
    assert np.isnan(chart.required[:, :, 2]).all()


def test_a_cost_with_a_minimum_inside_the_feasible_range_is_found() -> None:
    def model(values: dict[str, float], points: int) -> Array:
        return np.array([0.5 if values["x"] < 2.0 else 0.01])

    task = replace(task_on(0.0, 10.0, 0.1), cost=lambda values: (values["x"] - 4.6) ** 2)
    assert cheapest(task, model, np.array([0.1])).values["x"] == pytest.approx(4.6, abs=1e-3)


@pytest.mark.parametrize("step", [None, 0.01])
def test_a_cost_with_its_minimum_between_two_values_of_the_grid_proposes_no_design_that_misses_the_aim(
    step: float | None,
) -> None:
    def model(values: dict[str, float], points: int) -> Array:
        return np.array([0.5 if abs(values["x"] - 4.6) < 0.2 else 0.01])  # the grid has 4.17 and 5

    stepped = {} if step is None else {"x": Parameter("x", 0.0, 10.0, step=step)}
    task = replace(task_on(0.0, 10.0, 0.1), cost=lambda values: (values["x"] - 4.6) ** 2, stepped=stepped)
    found = cheapest(task, model, np.array([0.1]))
    assert found.is_feasible
    assert found.model == 0.01
    assert abs(found.values["x"] - 4.6) < 0.5


def test_of_several_ranges_that_meet_the_aim_the_smallest_design_is_taken_and_all_are_named() -> None:
    def model(values: dict[str, float], points: int) -> Array:
        x = values["x"]
        return np.array([0.01 if 1.0 < x < 2.0 else 0.05 if x > 4.0 else 0.5])

    found = cheapest(task_on(0.0, 10.0, 0.1), model, np.array([0.1]))
    assert found.is_feasible
    assert 1.0 <= found.values["x"] < 1.01
    assert found.ranges == ((found.values["x"], pytest.approx(2.0, abs=0.01)), (pytest.approx(4.0, abs=0.01), 10.0))


@dataclass
class Counted:
    """A model that is safe from some value of x on, and the points that it was asked for."""

    least: float
    points: int = 0

    def __call__(self, values: dict[str, float], points: int) -> Array:
        self.points += points
        return np.array([0.1 * math.exp(5.0 * (self.least - values["x"]))])


def test_a_variable_with_many_steps_takes_hardly_more_predictions_than_a_continuous_one() -> None:
    task = task_on(0.45, 1.0, 0.1)
    in_steps = replace(task, stepped={"x": Parameter("x", 0.45, 1.0, step=0.001)})
    continuous, stepped = Counted(0.7), Counted(0.7)
    assert cheapest(task, continuous, np.array([0.1])).values["x"] == pytest.approx(0.7, abs=1e-3)
    found = cheapest(in_steps, stepped, np.array([0.1]))
    assert found.is_feasible
    assert found.values["x"] == pytest.approx(0.7)
    assert found.ranges == ((pytest.approx(0.7), 1.0),)
    assert continuous.points <= 20_000
    assert stepped.points <= 1.5 * continuous.points


def test_a_variable_with_steps_is_searched_among_those_that_constraints_allow() -> None:
    model, steps = Counted(0.7), Parameter("x", 0.45, 1.0, step=0.001)
    task = replace(task_on(0.45, 1.0, 0.1), stepped={"x": steps})

    class Allowed(DesignTask):
        def allows(self, values: Mapping[str, float]) -> bool:
            return 0.713 <= round(values["x"], 3) <= 0.717

    known = {one.name: getattr(task, one.name) for one in fields(task)}
    allowed = Allowed(**{**known, "constraints": (None,)})
    assert cheapest(allowed, model, np.array([0.1])).values["x"] == pytest.approx(0.713)


def test_a_safe_range_between_two_unsafe_ends_is_named_as_such() -> None:
    def model(values: dict[str, float], points: int) -> Array:
        return np.array([0.02 if 3.0 < values["x"] < 8.0 else 0.2])

    found = cheapest(task_on(0.0, 10.0, 0.1), model, np.array([0.1]))
    assert 3.0 <= found.values["x"] < 3.01
    assert found.ranges == ((found.values["x"], pytest.approx(8.0, abs=0.01)),)


def test_a_line_that_fewer_points_call_feasible_is_judged_again() -> None:
    # x is at its limit; only y decides, and 256 points are 1 % too low.
    def model(values: dict[str, float], points: int) -> Array:
        exact = 0.2 - 0.1 * values["y"] - 0.05 * values["x"]
        return np.array([exact / 1.01 if points < 1000 else exact])

    both = {"low": {"x": 0.0, "y": 0.0}, "high": {"x": 1.0, "y": 1.0}}
    task = replace(task_on(0.0, 1.0, 0.1), **both, cost=lambda values: values["y"])
    found = cheapest(task, model, np.array([0.1]))
    assert found.is_feasible
    assert found.values["y"] == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--target", "0.1", "--free", "mass"), ("free", "mass", "capacity, friction, demand")),
        (("--target", "0.1", "--free", "capacity,capacity"), ("free", "twice")),
        (("--target", "0.1", "--free", "capacity,friction,demand"), ("question", "uncertain")),
        (("--target", "0.1"), ("free", "name the variables")),
        (("--target", "high", "--free", "capacity"), ("target", "high", "II, III, IV")),
        (("--target", "1.5", "--free", "capacity"), ("target", "0.9", "got 1.5")),
        (("--target", "collapse=0.1", "--free", "capacity"), ("target", "damage, failure", "collapse")),
        (("--target", "failure=0.1,failure=0.2", "--free", "capacity"), ("target", "one target")),
        (("--target", "0.1", "--free", "capacity", "--cost", "mass * 2"), ("cost", "mass")),
        (("--target", "0.1", "--free", "capacity", "--cost", "log(capacity - 4)"), ("cost", "finite")),
    ],
)
def test_a_wrong_task_is_refused_with_the_rule_and_the_value(
    folder: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    monkeypatch.chdir(folder)
    (folder / "setup.cfg").touch()
    refused(activefail("design", folder / "run", *options), *parts)


def test_targets_may_be_numbers_categories_or_one_for_each_outcome() -> None:
    outcomes = ("safe", "damage", "failure")
    assert read_targets("0.07", outcomes, "failure") == (Requirement("failure", 0.07),)
    assert read_targets("7%", outcomes, "failure")[0].target == pytest.approx(0.07)
    assert read_targets("III", outcomes, "failure") == (Requirement("failure", 0.05),)
    assert read_targets("damage=0.3, failure=IV", outcomes, "failure") == (
        Requirement("damage", 0.3),
        Requirement("failure", 0.025),
    )


def test_a_variable_whose_increase_makes_failure_likelier_is_searched_from_its_other_end() -> None:
    def model(values: dict[str, float], points: int) -> Array:
        return np.array([norm.cdf(values["x"] - 5.0)])

    found = cheapest(task_on(0.0, 10.0, 0.1), model, np.array([0.1]))
    assert found.values["x"] == 0.0  # the cheapest of all that meet the aim


def test_a_required_value_is_where_the_probability_last_exceeds_its_target() -> None:
    grid = np.linspace(0.0, 1.0, 6)
    P = np.array([0.5, 0.05, 0.3, 0.1, 0.05, 0.01])
    assert 0.4 < least_value(grid, P, 0.2) < 0.6
    assert math.isnan(least_value(grid, P, 0.005))
    assert least_value(grid, P, 0.6) == 0.0


def test_a_question_without_uncertain_variables_is_refused(run: Run) -> None:
    with pytest.raises(InputError, match="fixes every variable"):
        run.design(0.1, fixed={"friction": 1.0, "demand": 1.0, "capacity": 1.0}, free=["capacity"])
