"""A record in memory, for tests and for campaigns that are not saved; and what every event means."""

import hashlib
import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError, StoreError
from activefail.record.asked import NEVER, Asked
from activefail.record.batch import Batch, Schema, answers_of, batch_of, check_rows, columns_of, results_of
from activefail.record.checkpoint import State, States
from activefail.record.corrections import Corrections, correct_batches, correcting
from activefail.record.events import Event, is_bounded, of_arrays
from activefail.record.store import NOTHING, Remembered, check_asked, check_set, checked_state
from activefail.simulators.interface import Results
from activefail.space.space import Array


class MemoryStore:
    """A record that lasts as long as this object; implements `Store`.

    Every change is an event. `FolderStore` is this store with events that are durable before they count.
    """

    def __init__(self, schema: Schema) -> None:
        self._start()
        self._record(Event("campaign", {"settings": "", "schema": asdict(schema)}, {}))

    def _start(self) -> None:
        self.settings = ""
        self._schema: Schema | None = None
        # Versions and digests of what computes batches and sets at present.
        self._made_by: dict[str, str] = {}
        self._batches: list[Batch] = []
        # Made on demand: neither a commit nor a replay copies all that was before.
        self._tuple: tuple[Batch, ...] | None = ()
        self._asked: list[Asked] = []
        self._corrections: list[Corrections] = []
        # The digest after each batch; the first place and the digest of each list of corrections.
        self._chain = [""]
        self._corrected: list[tuple[int, str]] = []
        self._sets: dict[str, tuple[Array, Results, dict[str, str]]] = {}
        self._results: dict[tuple[str, ...], Any] = {}
        self._states: States = {}
        self._rejected: set[int] = set()
        # The reason why this object may not write; empty if it may.
        self._refusal = ""
        self._events = 0

    def _writable(self) -> Schema:
        """The schema for writing; raises StoreError if this object may not write."""
        if self._refusal:
            raise StoreError(self._refusal)
        return self.schema

    def _record(self, *events: Event) -> None:
        """Keep events, then take them in."""
        for event in events:
            self._events += 1
            self._take(event, str(self._events))

    def _take(self, event: Event, content: str) -> None:
        """Take an event in; its arrays belong to the record from now on.

        Args:
            event: the event.
            content: a digest of it.

        Raises:
            ArithmeticError, AttributeError, LookupError, TypeError, ValueError: if activefail never writes such an
                event.
        """
        of, arrays = event.attributes, event.arrays
        for array in arrays.values():
            array.flags.writeable = False
        match event.kind:
            case "campaign":
                self.settings = str(of["settings"])
                self._schema = Schema(**{name: tuple(names) for name, names in of["schema"].items()})
                self._asked = [Asked.none(len(self._schema.variables))]
                self._corrections = [Corrections.none(self._schema)]
            case "software":
                self._made_by = {str(name): str(text) for name, text in of.items()}
            case "batch":
                batch = batch_of(int(of["iteration"]), arrays)
                self._check(batch)
                self._batches.append(batch)
                self._chain.append(hashlib.sha256(f"{self._chain[-1]}{content}".encode()).hexdigest())
                self._tuple = None
            case "asked":
                self._asked.append(Asked(**arrays))
            case "dropped":
                self._asked = [self._handed_out.without(arrays["id"])]
            case "corrected":
                new = correcting(self._batches, arrays["place"], results_of(arrays), self.schema)
                correct_batches(self._batches, new)
                self._corrections.append(new)
                self._corrected.append((int(new.place.min()), content))
                self._tuple = None
            case "set":
                X, results = arrays["designs"], results_of(arrays)
                check_set(of["name"], X, results, self.schema)
                self._sets[of["name"]] = X, results, self._made_by
            case "result":
                self._results[tuple(map(str, of["of"]))] = of["value"]
            case kind:
                raise ValueError(f"unknown event {kind!r}")

    @property
    def schema(self) -> Schema:
        """The meaning of the columns."""
        if self._schema is None:
            raise ValueError("the first event must be that of the campaign")
        return self._schema

    @property
    def _iteration(self) -> int:
        """The iteration of the last batch; NEVER if there is none."""
        return self._batches[-1].iteration if self._batches else NEVER

    def _check(self, batch: Batch) -> None:
        """Raise InputError if the next batch breaks a rule."""
        self.schema.check(batch.designs, batch.results)
        check_rows(batch, self._iteration)

    @property
    def digest(self) -> str:
        """A digest of all batches and corrections."""
        return self._known(float("inf"))

    def _known(self, iteration: float) -> str:
        """A digest of the batches of the iterations up to this one, and of their corrections."""
        batches = self._batches
        count = next((k for k in range(len(batches), 0, -1) if batches[k - 1].iteration <= iteration), 0)
        simulations = sum(map(len, batches[:count])) if self._corrected else 0
        digests = [self._chain[count], *(one for first, one in self._corrected if first < simulations)]
        return hashlib.sha256(" ".join(digests).encode()).hexdigest()

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order, with the corrections."""
        if self._tuple is None:
            self._tuple = tuple(self._batches)
        return self._tuple

    def commit(self, batch: Batch, also: Remembered = NOTHING) -> None:
        """Append a batch (see Store)."""
        self._writable()
        self._check(batch)
        self._record(of_arrays("batch", columns_of(batch), iteration=batch.iteration), *_remembering(also))

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays (see Store)."""
        self._writable()
        state = State(self._known(iteration), checked_state(iteration, arrays))
        # Results of the last iteration may still arrive; the state before it then saves learning everything again.
        before = {one: kept for one, kept in sorted(self._saved_states().items()) if one < iteration}
        self._save_states(dict(list(before.items())[-1:]) | {iteration: state})
        self._rejected.discard(iteration)

    def _saved_states(self) -> States:
        return self._states

    def _save_states(self, states: States) -> None:
        self._states = states

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state (see Store)."""
        for iteration, state in sorted(self._saved_states().items(), reverse=True):
            if iteration not in self._rejected and state.record == self._known(iteration):
                return iteration, {name: array.copy() for name, array in state.arrays.items()}
        return None

    def reject_state(self, iteration: int, reason: str) -> None:
        """Skip a state from now on (see Store)."""
        self._rejected.add(iteration)

    @property
    def _handed_out(self) -> Asked:
        if len(self._asked) > 1:
            self._asked = [Asked.joined(self._asked)]
        return self._asked[0]

    @property
    def asked(self) -> Asked:
        """The designs that were handed out (see Store)."""
        return deepcopy(self._handed_out)

    def hand_out(self, designs: Asked) -> None:
        """Keep designs that are handed out (see Store)."""
        check_asked(designs, self._writable(), self._iteration)
        if len(designs) and int(self._handed_out.id.max(initial=-1)) >= designs.id[0]:
            raise InputError(f"Designs that are handed out need new ids, got {designs.id.tolist()}.")
        self._record(of_arrays("asked", vars(designs)))

    def drop(self, ids: NDArray[np.int64]) -> None:
        """Give up designs that were handed out (see Store)."""
        self._writable()
        self._record(of_arrays("dropped", {"id": ids}))

    @property
    def corrections(self) -> Corrections:
        """The corrections of the batches, in the order in which they were made (see Store)."""
        if len(self._corrections) > 1:
            self._corrections = [Corrections.joined(self._corrections)]
        return deepcopy(self._corrections[0])

    def correct(self, place: NDArray[np.int64], results: Results, also: Remembered = NOTHING) -> None:
        """Replace results of the batches (see Store)."""
        new = correcting(self._batches, place, results, self._writable())
        self._record(of_arrays("corrected", {"place": new.place, **answers_of(results)}), *_remembering(also))

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep a set (see Store)."""
        check_set(name, X, results, self._writable())
        self._record(of_arrays("set", {"designs": X, **answers_of(results)}, name=name))

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store)."""
        return deepcopy(self._sets[name][:2]) if name in self._sets else None

    def set_names(self) -> list[str]:
        """Names of the sets (see Store)."""
        return sorted(self._sets)

    def remember(self, identity: tuple[str, ...], value: Any) -> None:
        """Keep a computed result (see Store)."""
        self._writable()
        self._record(*_remembering({identity: value}))

    def recall(self, identity: tuple[str, ...]) -> Any:
        """A computed result, or None (see Store)."""
        return _copied(self._results.get(identity))

    def close(self) -> None:
        """Refuse further writing."""
        self._refusal = self._refusal or "This store is closed."

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _remembering(results: Remembered) -> list[Event]:
    events = [Event("result", {"of": [*of], "value": _copied(value)}, {}) for of, value in results.items()]
    for event in events:
        if not is_bounded(event.attributes):
            raise ValueError(f"{event.attributes['of']} is nested too deep, or has a number of more than 64 bits.")
    return events


def _copied(value: Any) -> Any:
    """A copy of a value of JSON, made several times as fast as by `deepcopy`."""
    return json.loads(json.dumps(value))
