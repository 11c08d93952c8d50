"""A record in memory, for tests and for campaigns that are not saved."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from activefail.errors import StoreError
from activefail.record.asked import Asked
from activefail.record.batch import Batch, Schema, checked_copy, copy_results
from activefail.record.corrections import Corrections, corrected, correcting
from activefail.record.store import STATES_KEPT, check_asked, check_set, checked_state
from activefail.simulators.interface import Results
from activefail.space import Array


class MemoryStore:
    """A record that lasts as long as this object."""

    def __init__(self, schema: Schema) -> None:
        self.schema = schema
        self._batches: tuple[Batch, ...] = ()
        self._states: dict[int, dict[str, NDArray[Any]]] = {}
        self._learned_from: dict[int, tuple[int, str]] = {}
        self._asked = Asked.none(len(schema.variables))
        self._corrections = Corrections.none(schema)
        self._sets: dict[str, tuple[Array, Results]] = {}
        self._open = True

    @property
    def batches(self) -> tuple[Batch, ...]:
        """All committed batches, in order, with the corrections."""
        return self._batches

    def commit(self, batch: Batch) -> None:
        """Append a batch (see Store)."""
        self._check_open()
        self._batches = (*self._batches, checked_copy(batch, self.schema))

    def write_state(self, iteration: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep named arrays (see Store)."""
        self._check_open()
        kept = [i for i in sorted(self._states) if i < iteration][1 - STATES_KEPT :]
        self._states = {i: self._states[i] for i in kept} | {iteration: checked_state(iteration, arrays)}
        self._learned_from[iteration] = self._batches_through(iteration)

    def _batches_through(self, iteration: int) -> tuple[int, str]:
        """The number of batches of the iterations up to this one, and the digest of their corrections."""
        batches = [batch for batch in self._batches if batch.iteration <= iteration]
        return len(batches), self._corrections.before(sum(map(len, batches))).digest

    def latest_state(self) -> tuple[int, dict[str, NDArray[Any]]] | None:
        """The newest state (see Store)."""
        valid = [i for i in self._states if self._learned_from[i] == self._batches_through(i)]
        if not valid:
            return None
        iteration = max(valid)
        return iteration, {name: array.copy() for name, array in self._states[iteration].items()}

    def reject_state(self, iteration: int, reason: str) -> None:
        """Forget a state (see Store)."""
        self._states.pop(iteration, None)

    @property
    def asked(self) -> Asked:
        """The designs that were handed out (see Store)."""
        return self._asked.copy()

    def write_asked(self, asked: Asked) -> None:
        """Keep the designs that were handed out (see Store)."""
        self._check_open()
        check_asked(asked, self.schema)
        self._asked = asked.copy()

    @property
    def corrections(self) -> Corrections:
        """The corrections of the batches (see Store)."""
        return self._corrections.copy()

    def correct(self, place: NDArray[np.int64], results: Results) -> None:
        """Replace results of the batches (see Store)."""
        self._check_open()
        new = correcting(self._batches, place, results, self.schema)
        self._corrections = self._corrections.and_then(new)
        self._batches = tuple(corrected(self._batches, new)[0])

    def write_set(self, name: str, X: Array, results: Results) -> None:
        """Keep a set (see Store)."""
        self._check_open()
        check_set(name, X, results, self.schema)
        self._sets[name] = X.copy(), copy_results(results)

    def read_set(self, name: str) -> tuple[Array, Results] | None:
        """The set, or None (see Store)."""
        if name not in self._sets:
            return None
        X, results = self._sets[name]
        return X.copy(), copy_results(results)

    def set_names(self) -> list[str]:
        """Names of the sets (see Store)."""
        return sorted(self._sets)

    def close(self) -> None:
        """Refuse further writing."""
        self._open = False

    def _check_open(self) -> None:
        if not self._open:
            raise StoreError("This store is closed.")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
