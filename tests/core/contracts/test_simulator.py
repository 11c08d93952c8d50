"""The contract of every Simulator."""

import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest
from campaign.stub import HIGH, LOW, Disc

from activefail.record.batch import Schema
from activefail.simulators.interface import NUMERICAL_FAILURE, Results, Simulator
from activefail.space.parameter import Parameter
from activefail.space.space import Array, DesignSpace

PLANE = DesignSpace((Parameter("x", LOW[0], HIGH[0]), Parameter("y", LOW[1], HIGH[1])))


@dataclass
class Kind:
    simulator: Simulator
    space: DesignSpace
    gives_up: bool = False

    def designs(self, n: int) -> Array:
        return self.space.latin_hypercube(n, np.random.default_rng(8))


KINDS: dict[str, Callable[[], Kind]] = {
    "disc": lambda: Kind(Disc(), PLANE),
    "disc in fog": lambda: Kind(Disc(blind=0.0), PLANE, gives_up=True),
}


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]()


def bits(results: Results) -> tuple[bytes, ...]:
    """Every bit of the answers; their wall times differ from run to run."""
    return results.outcome.tobytes(), results.cause.tobytes(), results.margins.tobytes()


def test_outcomes_causes_and_margins_have_names_and_none_comes_twice(kind: Kind) -> None:
    simulator = kind.simulator
    assert len(simulator.outcomes) >= 2
    assert simulator.causes[0] == ""
    for names in (simulator.outcomes, simulator.causes, simulator.margins):
        assert len(set(names)) == len(names)


def test_every_design_gets_an_answer_that_the_record_can_hold(kind: Kind) -> None:
    X = kind.designs(24)
    results = kind.simulator.run(X)
    assert len(results) == 24
    simulator = kind.simulator
    Schema(kind.space.names, simulator.outcomes, simulator.causes, simulator.margins).check(X, results)
    assert (results.seconds >= 0.0).all()
    assert results.outcome.max() >= 0


def test_a_numerical_failure_is_an_outcome_of_its_own_and_names_its_cause(kind: Kind) -> None:
    results = kind.simulator.run(kind.designs(24))
    failed = results.outcome == NUMERICAL_FAILURE
    assert failed.any() == kind.gives_up
    assert (results.cause[failed] > 0).all()


def test_no_design_gives_no_answers(kind: Kind) -> None:
    results = kind.simulator.run(kind.designs(4)[:0])
    assert len(results) == 0
    assert results.margins.shape == (0, len(kind.simulator.margins))


def test_the_answer_to_a_design_does_not_depend_on_those_beside_it(kind: Kind) -> None:
    X = kind.designs(12)
    whole = kind.simulator.run(X)
    order = np.random.default_rng(0).permutation(12)
    assert bits(kind.simulator.run(X[order])) == bits(whole[order])
    assert bits(Results.concatenate([kind.simulator.run(X[i : i + 1]) for i in range(12)])) == bits(whole)


def test_asked_again_a_simulator_gives_the_same_bits_and_leaves_the_designs_alone(kind: Kind) -> None:
    X = kind.designs(12)
    before = X.copy()
    X.flags.writeable = False
    assert bits(kind.simulator.run(X)) == bits(kind.simulator.run(X))
    assert X.tobytes() == before.tobytes()


def test_the_results_are_the_callers_to_change(kind: Kind) -> None:
    X = kind.designs(12)
    results = kind.simulator.run(X)
    before = bits(results)
    for column in (results.outcome, results.cause, results.margins, results.seconds):
        column[:] = 1
    assert bits(kind.simulator.run(X)) == before


def test_a_pickled_simulator_gives_the_same_answers(kind: Kind) -> None:
    X = kind.designs(6)
    assert bits(pickle.loads(pickle.dumps(kind.simulator)).run(X)) == bits(kind.simulator.run(X))


def test_a_simulator_that_frees_the_lock_answers_side_by_side_what_it_answers_alone(kind: Kind) -> None:
    assert kind.simulator.releases_gil
    X = kind.designs(24)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(kind.simulator.run, np.split(X, 8)))
    assert bits(Results.concatenate(together)) == bits(kind.simulator.run(X))


# --- results -----------------------------------------------------------------------------------------------------


def test_results_whose_columns_differ_in_length_are_refused() -> None:
    two, three = np.zeros(2, dtype=np.int8), np.zeros(3, dtype=np.int8)
    for columns in (
        (two, three, np.zeros((2, 1)), np.zeros(2)),
        (two, two, np.zeros((3, 1)), np.zeros(2)),
        (two, two, np.zeros(2), np.zeros(2)),
        (two, two, np.zeros((2, 1)), np.zeros((2, 1))),
    ):
        with pytest.raises(ValueError, match="got shapes"):
            Results(*columns)


def test_results_cut_and_put_together_are_the_results() -> None:
    whole = Disc(blind=0.0).run(PLANE.latin_hypercube(9, np.random.default_rng(0)))
    assert bits(Results.concatenate([whole[:4], whole[4:4], whole[4:]])) == bits(whole)
    assert len(whole[whole.outcome == 1]) == int((whole.outcome == 1).sum())


def test_faults_stay_with_their_rows_where_results_are_cut_and_put_together() -> None:
    whole = replace(Disc().run(PLANE.latin_hypercube(9, np.random.default_rng(0))), faults={2: "a", 5: "b", 8: "c"})
    assert whole[3:].faults == {2: "b", 5: "c"}
    assert whole[::-1].faults == {0: "c", 3: "b", 6: "a"}
    assert whole[np.array([5, 0, 2, 5])].faults == {0: "b", 2: "a", 3: "b"}
    assert whole[np.arange(9) % 2 == 0].faults == {1: "a", 4: "c"}
    assert Results.concatenate([whole[:3], whole[3:3], whole[3:6], whole[6:]]).faults == whole.faults


@pytest.mark.parametrize("row", [-1, 2])
def test_a_fault_without_a_row_is_refused(row: int) -> None:
    with pytest.raises(ValueError, match=rf"`0 <= row < 2` must hold for the faults, got rows \[{row}\]"):
        replace(Disc().run(np.zeros((2, 2))), faults={row: "of none"})
