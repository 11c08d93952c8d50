"""The bearing keeps the contract of every Simulator."""

from collections.abc import Callable

import numpy as np
import pytest
from contracts.test_simulator import (  # noqa: F401
    Kind,
    test_a_numerical_failure_is_an_outcome_of_its_own_and_names_its_cause,
    test_a_pickled_simulator_gives_the_same_answers,
    test_a_simulator_that_frees_the_lock_answers_side_by_side_what_it_answers_alone,
    test_asked_again_a_simulator_gives_the_same_bits_and_leaves_the_designs_alone,
    test_every_design_gets_an_answer_that_the_record_can_hold,
    test_no_design_gives_no_answers,
    test_outcomes_causes_and_margins_have_names_and_none_comes_twice,
    test_the_answer_to_a_design_does_not_depend_on_those_beside_it,
    test_the_results_are_the_callers_to_change,
)

from activefail.errors import InputError
from activefail.seismic.bearing import TABLE_1, Model, Tolerance, simulate
from activefail.seismic.simulator import DfpSimulator
from activefail.space.parameter import Parameter
from activefail.space.space import DesignSpace

TURNED = DesignSpace(TABLE_1.parameters[::-1])

KINDS: dict[str, Callable[[], Kind]] = {
    "bearing": lambda: Kind(DfpSimulator.on(TABLE_1, Model(), Tolerance()), TABLE_1),
    "bearing, variables turned round": lambda: Kind(DfpSimulator.on(TURNED, Model(), Tolerance()), TURNED),
    "bearing that gives up": lambda: Kind(DfpSimulator.on(TABLE_1, Model(), Tolerance(most_steps=900)), TABLE_1, True),
}


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]()


def test_the_bearing_answers_as_the_bearing_model_does_whatever_the_order_of_the_variables() -> None:
    X = TABLE_1.latin_hypercube(20, np.random.default_rng(4))
    model, tolerance = Model(slider_diameter=0.28), Tolerance(relative=1e-3)
    answers = simulate(X, model, tolerance)
    for space in (TABLE_1, TURNED):
        results = DfpSimulator.on(space, model, tolerance).run(TABLE_1.table(X, space.names))
        assert (results.outcome.tolist(), results.cause.tolist()) == (answers.outcome.tolist(), answers.cause.tolist())
        assert results.margins.tobytes() == answers.columns.tobytes()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"p": Parameter("p", 30e6, 60e6, "Pa")}, r"space\.p\.unit: must be 'MPa' or left out, got 'Pa'"),
        ({"T_b": Parameter("T_b", 1.5, 5.5, "s")}, "cannot be built"),
    ],
)
def test_a_space_in_other_units_or_with_bearings_that_cannot_be_built_is_refused(change, says):
    space = DesignSpace(tuple(change.get(p.name, p) for p in TABLE_1.parameters))
    with pytest.raises(InputError, match=says):
        DfpSimulator.on(space, Model(), Tolerance())
