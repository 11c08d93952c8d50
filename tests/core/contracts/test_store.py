"""The contract of every Store."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from activefail.errors import InputError, StoreError
from activefail.record.asked import NEVER, Asked
from activefail.record.batch import ACTIVE, INITIAL, Batch, Schema
from activefail.record.memory import MemoryStore
from activefail.record.run_folder import FolderStore
from activefail.record.store import Store
from activefail.simulators.interface import NUMERICAL_FAILURE, Results

SCHEMA = Schema(("radius", "mu"), ("none", "impact", "failure"), ("", "uplift"), ("drift", "gap", "force"))

# Quiet and signalling NaNs with payloads, both zeros, a denormal: equal bits is more than equal values.
ODD = np.array([0x7FF8000000000001, 0xFFF0000000000007, 0x8000000000000000, 0, 1, 0x7FF0000000000000], dtype=np.uint64)


@dataclass
class Kind:
    store: Store
    reopen: Callable[[], Store]


@pytest.fixture(params=["memory", "folder", "folder opened again"])
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Kind]:
    """A store, and a way to see what is kept in it."""
    if request.param == "memory":
        memory = MemoryStore(SCHEMA)
        yield Kind(memory, lambda: memory)
        return
    stores = [FolderStore.create(tmp_path / "run", "seed = 1\n", SCHEMA)]

    def reopen() -> Store:
        if request.param == "folder opened again":
            stores[-1].close()
            stores.append(FolderStore.open(tmp_path / "run", SCHEMA, write=True))
        return stores[-1]

    yield Kind(stores[0], reopen)
    stores[-1].close()


def results(n: int, seed: int) -> Results:
    rng = np.random.default_rng(seed)
    margins = rng.normal(size=(n, 3))
    margins.ravel()[: min(6, 3 * n)] = ODD.view(np.float64)[: min(6, 3 * n)]
    outcome = rng.integers(NUMERICAL_FAILURE, 3, n).astype(np.int8)
    return Results(outcome, rng.integers(0, 2, n).astype(np.int8), margins, rng.random(n))


def batch(n: int, seed: int, iteration: int = 0) -> Batch:
    rng = np.random.default_rng(seed)
    origin = np.full(n, INITIAL if iteration == 0 else ACTIVE, dtype=np.int8)
    return Batch(iteration, seed + np.arange(n), rng.normal(size=(n, 2)), origin, results(n, seed + 1000))


def bits(*arrays: NDArray[np.generic]) -> list[tuple[str, tuple[int, ...], bytes]]:
    return [(str(array.dtype), array.shape, array.tobytes()) for array in arrays]


def batch_bits(one: Batch) -> list[object]:
    answers = one.results
    arrays = (one.id, one.designs, one.origin, answers.outcome, answers.cause, answers.margins, answers.seconds)
    return [one.iteration, *bits(*arrays)]


def test_committed_batches_come_back_in_order_and_bit_for_bit(kind: Kind) -> None:
    committed = [batch(n, seed, iteration) for seed, (n, iteration) in enumerate([(5, 0), (1, 1), (7, 1), (3, 2)])]
    for one in committed:
        kind.store.commit(one)
    assert [batch_bits(one) for one in kind.reopen().batches] == [batch_bits(one) for one in committed]


def test_the_faults_of_results_are_not_kept(kind: Kind) -> None:
    one = batch(4, 0)
    kind.store.commit(replace(one, results=replace(one.results, faults={1: "the stiffness vanished"})))
    kind.store.write_set("test", one.designs, replace(one.results, faults={1: "the stiffness vanished"}))
    for store in (kind.store, kind.reopen()):
        kept = store.read_set("test")
        assert kept is not None
        assert (store.batches[0].results.faults, kept[1].faults) == ({}, {})


def test_a_new_store_has_neither_batches_nor_states_nor_sets(kind: Kind) -> None:
    store = kind.reopen()
    assert store.batches == ()
    assert store.latest_state() is None
    assert store.read_set("validation") is None


def test_what_the_caller_does_to_its_arrays_later_does_not_reach_the_store(kind: Kind) -> None:
    one, arrays = batch(4, 0), {"a": np.arange(3.0)}
    X, answers = np.ones((4, 2)), results(4, 1)
    kind.store.commit(one)
    kind.store.write_state(1, arrays)
    kind.store.write_set("test", X, answers)
    before = batch_bits(kind.store.batches[0]), bits(arrays["a"]), bits(X, answers.margins)
    one.designs[:] = one.results.margins[:] = arrays["a"][:] = X[:] = answers.margins[:] = 77.0
    store = kind.reopen()
    state, kept = store.latest_state(), store.read_set("test")
    assert state is not None
    assert kept is not None
    assert (batch_bits(store.batches[0]), bits(state[1]["a"]), bits(kept[0], kept[1].margins)) == before


def test_committed_batches_cannot_be_written_to(kind: Kind) -> None:
    kind.store.commit(batch(4, 0))
    kept = kind.reopen().batches[0]
    for array in (kept.designs, kept.origin, kept.results.outcome, kept.results.margins):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_state_comes_back_bit_for_bit_whatever_its_names_and_shapes(kind: Kind) -> None:
    names = ["a", "a/b", "/", ".", "..", "a%2Fb", "a.b.c", " x ", "Länge", "\0", "\n", "0"]
    state: dict[str, NDArray[np.generic]] = {name: np.array([float(i)]) for i, name in enumerate(names)}
    state |= {
        "nan": ODD.view(np.float64),
        "scalar": np.array(-0.0),
        "count": np.array(2**63 - 1),
        "none": np.zeros((0, 3)),
        "turned": np.arange(6).reshape(2, 3).T,
        "large": np.random.default_rng(0).normal(size=(700, 300)),
    }
    kind.store.write_state(3, state)
    saved = kind.reopen().latest_state()
    assert saved is not None
    assert saved[0] == 3
    assert {name: bits(array) for name, array in saved[1].items()} == {name: bits(a) for name, a in state.items()}


def test_the_latest_state_is_that_of_the_highest_iteration(kind: Kind) -> None:
    for iteration in range(12):
        kind.store.write_state(iteration, {"i": np.array(iteration)})
        saved = kind.reopen().latest_state()
        assert saved is not None
        assert (saved[0], saved[1]["i"]) == (iteration, iteration)
        kind.store = kind.reopen()


def test_a_state_of_an_earlier_iteration_drops_those_of_a_course_not_taken(kind: Kind) -> None:
    for iteration in (1, 2, 8, 9, 3):
        kind.store.write_state(iteration, {"i": np.array(iteration)})
    saved = kind.reopen().latest_state()
    assert saved is not None
    assert (saved[0], saved[1]["i"]) == (3, 3)


def test_a_set_comes_back_bit_for_bit_and_a_second_one_replaces_it(kind: Kind) -> None:
    for seed, n in enumerate((9, 4, 0)):
        X, answers = np.random.default_rng(seed).normal(size=(n, 2)), results(n, seed)
        kind.store.write_set("validation", X, answers)
        kept = kind.reopen().read_set("validation")
        assert kept is not None
        arrays = (kept[1].outcome, kept[1].cause, kept[1].margins, kept[1].seconds)
        assert bits(kept[0], *arrays) == bits(X, answers.outcome, answers.cause, answers.margins, answers.seconds)
        kind.store = kind.reopen()
    assert kind.store.read_set("test") is None
    assert kind.store.batches == ()


def test_what_is_not_of_the_schema_is_refused_and_leaves_nothing(kind: Kind) -> None:
    good = results(3, 0)
    origin = np.zeros(3, dtype=np.int8)
    X = np.zeros((3, 2))
    bad = {
        "finite, got nan for 'mu' in row 2": (np.array([[0.0, 0.0], [0.0, 0.0], [0.0, np.nan]]), good),
        "columns": (np.zeros((3, 1)), good),
        "float64": (np.zeros((3, 2), dtype=np.float32), good),
        "margins": (X, Results(good.outcome, good.cause, np.zeros((3, 2)), good.seconds)),
        "outcome < 3": (X, Results(np.full(3, 3, dtype=np.int8), good.cause, good.margins, good.seconds)),
        "<= cause": (X, Results(good.outcome, np.full(3, -7, dtype=np.int8), good.margins, good.seconds)),
        "int8": (X, Results(good.outcome.astype(np.int64), good.cause, good.margins, good.seconds)),
    }
    for rule, (designs, answers) in bad.items():
        with pytest.raises(InputError, match=rule):
            kind.store.commit(Batch(0, np.arange(len(designs)), designs, origin, answers))
        with pytest.raises(InputError, match=rule):
            kind.store.write_set("test", designs, answers)
    with pytest.raises(InputError, match="origin"):
        kind.store.commit(Batch(0, np.arange(len(X)), X, origin.astype(np.int64), good))
    with pytest.raises(InputError, match="different numbers"):
        kind.store.commit(Batch(0, np.zeros(len(X), dtype=np.int64), X, origin, good))
    for name in ("", "../x", "a/b", "a.b"):
        with pytest.raises(InputError, match="letters"):
            kind.store.write_set(name, X, good)
    for state in ({"a": np.zeros(2, dtype=np.float32)}, {"a": np.array(["x"])}, {"": np.zeros(2)}):
        with pytest.raises(InputError):
            kind.store.write_state(0, state)
    kind.store.commit(batch(2, 5))
    store = kind.reopen()
    assert len(store.batches) == 1
    assert store.latest_state() is None
    assert store.read_set("test") is None


def test_a_closed_store_refuses_writing_and_still_shows_its_batches(kind: Kind) -> None:
    with kind.store as store:
        store.commit(batch(2, 0))
    for write in (
        lambda: store.commit(batch(2, 1)),
        lambda: store.write_state(1, {"a": np.zeros(1)}),
        lambda: store.write_set("test", np.zeros((2, 2)), results(2, 0)),
        lambda: store.hand_out(asked(0)),
        lambda: store.correct(np.array([0]), results(1, 0)),
    ):
        with pytest.raises(StoreError, match="closed"):
            write()
    store.close()
    assert len(store.batches) == 1


def test_a_commit_does_not_change_the_batches_that_were_given_before(kind: Kind) -> None:
    kind.store.commit(batch(4, 0))
    committed = kind.store.batches
    kind.store.commit(batch(3, 1, 1))
    assert len(committed) == 1
    assert [len(one) for one in kind.store.batches] == [4, 3]


def test_what_the_caller_does_to_a_state_or_set_that_it_was_given_does_not_reach_the_store(kind: Kind) -> None:
    kind.store.write_state(0, {"a": np.zeros(3)})
    kind.store.write_set("test", np.zeros((2, 2)), results(2, 0))
    for _ in range(2):
        state, kept = kind.store.latest_state(), kind.store.read_set("test")
        assert state is not None
        assert kept is not None
        assert not state[1]["a"].any()
        assert not kept[0].any()
        state[1]["a"][:] = kept[0][:] = kept[1].margins[:] = 77.0
        assert bits(kept[1].seconds) == bits(results(2, 0).seconds)


def test_the_last_two_states_stay_and_a_rejected_one_is_skipped_until_it_is_written_anew(kind: Kind) -> None:
    for iteration in range(5):
        kind.store.write_state(iteration, {"i": np.array(iteration)})
    store = kind.reopen()
    for iteration in (4, 3):
        saved = store.latest_state()
        assert saved is not None
        assert saved[0] == iteration
        store.reject_state(iteration, "predicts nothing")
    store.reject_state(99, "was never there")
    assert store.latest_state() is None
    store.write_state(4, {"i": np.array(7)})
    saved = store.latest_state()
    assert saved is not None
    assert saved[1]["i"] == 7


def test_a_state_is_skipped_once_its_iteration_has_another_batch(kind: Kind) -> None:
    kind.store.commit(batch(2, 0, 0))
    kind.store.write_state(0, {"i": np.array(0)})
    kind.store.commit(batch(2, 1, 1))
    kind.store.write_state(1, {"i": np.array(1)})
    kind.store.commit(batch(1, 2, 1))
    store = kind.reopen()
    saved = store.latest_state()
    assert saved is not None
    assert saved[0] == 0
    store.write_state(1, {"i": np.array(2)})
    saved = store.latest_state()
    assert saved is not None
    assert (saved[0], saved[1]["i"]) == (1, 2)


def asked(*ids: int) -> Asked:
    designs = np.random.default_rng(len(ids)).normal(size=(len(ids), 2))
    return Asked.of(np.array(ids, dtype=np.int64), designs, ACTIVE, NEVER)


def asked_bits(one: Asked) -> list[object]:
    return bits(one.id, one.designs, one.origin, one.learned, one.loop, one.dropped)


def test_a_new_record_has_handed_out_no_designs(kind: Kind) -> None:
    assert len(kind.store.asked) == 0


def test_designs_that_were_handed_out_come_back_bit_for_bit_and_dropped_ones_are_marked(kind: Kind) -> None:
    first, later = asked(0, 1, 4), asked(7, 9)
    kind.store.hand_out(first)
    store = kind.reopen()
    assert asked_bits(store.asked) == asked_bits(first)
    store.hand_out(later)
    store.drop(np.array([1, 9]))
    expected = Asked.joined([first, later]).without(np.array([1, 9]))
    assert asked_bits(kind.reopen().asked) == asked_bits(expected)


def test_the_list_of_handed_out_designs_shares_no_array_with_its_caller(kind: Kind) -> None:
    given = asked(0, 1)
    before = asked_bits(given)
    kind.store.hand_out(given)
    given.designs[:] = 0.0
    kind.store.asked.designs[:] = 1.0
    assert asked_bits(kind.store.asked) == before


def test_handed_out_designs_of_another_dimension_or_with_old_ids_are_refused_and_the_list_stays(kind: Kind) -> None:
    kind.store.hand_out(asked(5))
    with pytest.raises(InputError, match="must have 2 columns"):
        kind.store.hand_out(Asked.none(3))
    with pytest.raises(InputError, match="need new ids"):
        kind.store.hand_out(asked(4, 6))
    assert kind.store.asked.id.tolist() == [5]


def test_a_state_of_a_negative_iteration_is_refused(kind: Kind) -> None:
    with pytest.raises(InputError, match="iteration >= 0"):
        kind.store.write_state(-1, {"a": np.zeros(1)})


def test_sets_are_named_in_order(kind: Kind) -> None:
    for name in ("validation-0", "look-2", "test_1"):
        kind.store.write_set(name, np.zeros((2, 2)), results(2, 0))
    assert kind.reopen().set_names() == ["look-2", "test_1", "validation-0"]


def test_a_closed_store_still_reads_states_and_sets_and_skips_those_that_are_rejected(kind: Kind) -> None:
    kind.store.write_state(1, {"a": np.zeros(1)})
    kind.store.write_set("test", np.zeros((2, 2)), results(2, 0))
    store = kind.reopen()
    store.close()
    assert store.latest_state() is not None
    assert store.read_set("test") is not None
    assert store.set_names() == ["test"]
    store.reject_state(1, "predicts nothing")
    assert store.latest_state() is None


def test_an_exception_passes_through_a_store_and_closes_it(kind: Kind) -> None:
    with pytest.raises(ZeroDivisionError), kind.store as store:
        raise ZeroDivisionError
    with pytest.raises(StoreError, match="closed"):
        store.commit(batch(1, 0))


def test_a_reader_of_a_folder_sees_the_batches_of_its_opening_and_no_later_ones(tmp_path: Path) -> None:
    with FolderStore.create(tmp_path / "run", "seed = 1\n", SCHEMA) as writer:
        writer.commit(batch(2, 0))
        writer.write_state(0, {"i": np.array(0)})
        with FolderStore.open(tmp_path / "run", write=False) as reader:
            writer.commit(batch(3, 1, 1))
            assert [batch_bits(one) for one in reader.batches] == [batch_bits(one) for one in writer.batches[:1]]
            writer.write_state(1, {"i": np.array(1)})
            saved = reader.latest_state()
            assert saved is not None
            assert saved[0] == 0
            with pytest.raises(StoreError, match="reading only"):
                reader.commit(batch(1, 2))


def test_after_a_write_that_was_interrupted_a_store_refuses_to_write_until_it_is_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    with FolderStore.create(tmp_path / "run", "seed = 1\n", SCHEMA) as store:
        store.commit(batch(2, 0))
        with monkeypatch.context() as patch:
            patch.setattr("activefail.record.journal.sync_file", interrupted)
            with pytest.raises(KeyboardInterrupt):
                store.commit(batch(2, 1))
        with pytest.raises(StoreError, match="interrupted"):
            store.commit(batch(2, 1))
    with FolderStore.open(tmp_path / "run", write=True) as store:
        assert len(store.batches) in (1, 2)
        store.commit(batch(2, 1))


@pytest.mark.parametrize(
    ("designs", "origin", "iteration"),
    [
        (np.zeros((2, 2)), np.zeros(3, dtype=np.int8), 0),
        (np.zeros(3), np.zeros(3, dtype=np.int8), 0),
        (np.zeros((3, 2)), np.zeros((3, 1), dtype=np.int8), 0),
        (np.zeros((3, 2)), np.zeros(3, dtype=np.int8), -1),
    ],
)
def test_a_batch_whose_shapes_do_not_agree_is_refused(
    designs: NDArray[np.float64], origin: NDArray[np.int8], iteration: int
) -> None:
    with pytest.raises(ValueError, match="got"):
        Batch(iteration, np.arange(3), designs, origin, results(3, 0))


def test_results_kept_with_a_batch_or_a_correction_come_back(kind: Kind) -> None:
    kind.store.commit(batch(3, 0), {("a",): 1, ("b", "c"): {"d": [None, 0.1]}})
    kind.store.correct(np.array([1]), results(1, 7), {("a",): 2})
    store = kind.reopen()
    assert (store.recall(("a",)), store.recall(("b", "c"))) == (2, {"d": [None, 0.1]})
    assert (len(store.batches), len(store.corrections)) == (1, 1)


def test_a_batch_is_of_the_iteration_of_the_last_one_or_of_the_next(kind: Kind) -> None:
    for before, good in ((None, 0), (0, 1), (1, 1), (1, 2)):
        allowed = "0 <= iteration <= 0" if before is None else f"{before} <= iteration <= {before + 1}"
        for wrong in {0, 1, 2, 3, 10**12} - {good, before, (before or 0) + (before is not None)}:
            with pytest.raises(InputError, match=f"`{allowed}` must hold, got {wrong}"):
                kind.store.commit(batch(2, 9, wrong))
        kind.store.commit(batch(2, 2 * len(kind.store.batches), good))
    assert [one.iteration for one in kind.reopen().batches] == [0, 1, 1, 2]


def test_designs_are_learned_from_an_iteration_of_the_record(kind: Kind) -> None:
    for learned in (0, 10**12):
        with pytest.raises(InputError, match=f"`learned <= -1` must hold, got {learned}"):
            kind.store.hand_out(replace(asked(4), learned=np.array([learned])))
    kind.store.commit(batch(2, 0))
    kind.store.hand_out(replace(asked(4), learned=np.array([0])))
    assert kind.reopen().asked.learned.tolist() == [0]


def test_a_batch_without_designs_is_refused() -> None:
    with pytest.raises(ValueError, match="designs > 0"):
        batch(0, 0)


def test_a_schema_of_anything_but_tuples_of_texts_is_refused() -> None:
    with pytest.raises(ValueError, match="outcomes"):
        Schema(("a",), ["none"], (), ())


def test_a_corrected_result_replaces_the_former_one_which_is_kept(kind: Kind) -> None:
    committed = [batch(3, 0), batch(2, 1, 1)]
    for one in committed:
        kind.store.commit(one)
    before = kind.store.batches
    new = results(2, 7)
    kind.store.correct(np.array([4, 1]), new)
    store = kind.reopen()
    assert [batch_bits(one) for one in before] == [batch_bits(one) for one in committed]
    wanted = [replace(one, results=Results(*(column.copy() for column in columns(one.results)))) for one in committed]
    for row, (number, place) in enumerate([(1, 1), (0, 1)]):
        for column, value in zip(columns(wanted[number].results), columns(new), strict=True):
            column[place] = value[row]
    assert [batch_bits(one) for one in store.batches] == [batch_bits(one) for one in wanted]
    kept = store.corrections
    assert kept.place.tolist() == [4, 1]
    assert bits(*columns(kept.results)) == bits(*columns(new))
    former = Results.concatenate([committed[1].results[1:2], committed[0].results[1:2]])
    assert bits(*columns(kept.former)) == bits(*columns(former))


def columns(one: Results) -> list[NDArray[np.generic]]:
    return [one.outcome, one.cause, one.margins, one.seconds]


def test_a_result_is_corrected_again_and_what_is_committed_later_follows(kind: Kind) -> None:
    kind.store.commit(batch(3, 0))
    for seed in (1, 2):
        kind.store.correct(np.array([0]), results(1, seed))
    kind.reopen().commit(batch(2, 1, 1))
    store = kind.reopen()
    assert bits(*columns(store.batches[0].results[:1])) == bits(*columns(results(1, 2)))
    assert bits(*columns(store.corrections.former[1:])) == bits(*columns(results(1, 1)))
    assert batch_bits(store.batches[1]) == batch_bits(batch(2, 1, 1))


def test_states_that_learned_from_a_corrected_result_are_skipped_and_earlier_ones_hold(kind: Kind) -> None:
    for iteration in range(3):
        kind.store.commit(batch(2, iteration, iteration))
        kind.store.write_state(iteration, {"i": np.array(iteration)})
    kind.store.correct(np.array([4]), results(1, 9))
    store = kind.reopen()
    saved = store.latest_state()
    assert saved is not None
    assert saved[0] == 1
    store.write_state(2, {"i": np.array(7)})
    saved = kind.reopen().latest_state()
    assert saved is not None
    assert (saved[0], saved[1]["i"]) == (2, 7)


def test_what_the_caller_does_to_corrections_later_does_not_reach_the_store(kind: Kind) -> None:
    kind.store.commit(batch(2, 0))
    new = results(1, 3)
    kind.store.correct(np.array([1]), new)
    new.margins[:] = 77.0
    kind.store.corrections.results.margins[:] = 77.0
    for one in (kind.store.batches[0].results[1:], kind.store.corrections.results):
        assert bits(one.margins) == bits(results(1, 3).margins)


@pytest.mark.parametrize("place", [[], [5], [-1], [1, 1]])
def test_places_to_correct_are_different_ones_of_the_record(kind: Kind, place: list[int]) -> None:
    kind.store.commit(batch(5, 0))
    with pytest.raises(InputError, match="must be different places below 5"):
        kind.store.correct(np.array(place, dtype=np.int64), results(len(place), 0))
    with pytest.raises(InputError, match="`margins` must have 3 columns"):
        kind.store.correct(np.array([0]), Results(*(np.zeros(1, dtype=np.int8),) * 2, np.zeros((1, 2)), np.zeros(1)))
    assert len(kind.store.corrections) == 0
    assert [batch_bits(one) for one in kind.reopen().batches] == [batch_bits(batch(5, 0))]
