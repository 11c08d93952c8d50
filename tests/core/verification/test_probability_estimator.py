"""The estimates from fresh simulations of one question agree with each other."""

from dataclasses import dataclass

import numpy as np
from campaign.stub import given

from activefail.campaign.assembly import Campaign
from activefail.campaign.question import Question
from activefail.estimates.estimate import plan_estimate
from activefail.estimates.probability_estimator import Estimator, Sampled
from activefail.execution.local import ThreadExecutor
from activefail.loop.history import History
from activefail.loop.learning import current
from activefail.loop.running import run
from activefail.record.memory import MemoryStore
from activefail.simulators.interface import Results
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace


@dataclass(frozen=True)
class Nearly:
    """Failure of two normal variables, and impact that is hardly likelier."""

    outcomes = ("safe", "impact", "failure")
    causes = ("",)
    margins = ()
    impossible = ()
    releases_gil = True

    def run(self, X):
        g = 2.0 - X[:, 0] - 0.3 * np.sin(2.0 * X[:, 1])
        outcome = np.digitize(-g, [-0.1, 0.0]).astype(np.int8)
        return Results(outcome, np.zeros(len(X), dtype=np.int8), np.empty((len(X), 0)), np.zeros(len(X)))


def test_the_same_fresh_simulations_answer_for_all_outcomes_and_no_worse_one_is_likelier() -> None:
    normal = {"distribution": "normal", "mean": 0.0, "sd": 1.0}
    keys = {"space": {"x": normal, "y": normal}, "sampling.initial": 60, "sampling.budget": 60}
    campaign = Campaign.of(given().changed({**keys, "classifier.features": "design"}), simulator=Nearly())
    store, question = MemoryStore(campaign.schema), Question.of_space(campaign.space)
    with ThreadExecutor(1) as executor:
        run(campaign, store, executor, 60)
        classifier = current(campaign, store, write=False).classifier
        estimator = Estimator(campaign, store, executor, classifier, History.of(store.batches).last_iteration)
        for draw in (0, 4):
            asked = question.drawn(draw) if draw else question
            failure, impact = (estimator.sample(one, 40, asked).estimate(0.9) for one in ("failure", "impact"))
            assert failure.probability <= impact.probability
            assert failure.low <= impact.low
            assert failure.high <= impact.high
            assert estimator.stored("impact", asked, 0.9) == impact
    assert set(store.set_names()) == {"fresh-1-0-40-0"}


def test_the_bound_holds_where_all_designs_of_a_grid_were_simulated() -> None:
    grid = DesignSpace((Parameter("a", 1.0, 6.0, step=1.0), Parameter("b", 1.0, 5.0, step=1.0)))
    held = 0
    for seed in range(40):
        plan = plan_estimate(lambda X: X.sum(axis=1) - 7.0, grid, 40, np.random.default_rng(seed))
        assert len(plan.designs) == 30
        bound = Sampled(plan, plan.designs.prod(axis=1) > 11.5, np.ones(30, dtype=bool)).estimate(0.9).bound
        held += 0.4 <= bound < 0.45
    # Nominal 36 of 40; fewer than 32 have a chance of 4 %.
    assert held >= 32
