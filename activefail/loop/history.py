"""The simulations of a campaign as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from activefail.record.batch import GIVEN, INITIAL, Batch
from activefail.simulators.interface import NUMERICAL_FAILURE, Results
from activefail.space.space import Array


@dataclass(frozen=True, eq=False)
class History:
    """The n simulations of a record, in its order, including numerical failures.

    Attributes:
        id: (n,) int64, of each design.
        designs: (n, d), in the variables' units; (0, 0) for an empty record.
        outcome: (n,) int8, index into the simulator's outcomes, or NUMERICAL_FAILURE.
        iteration: (n,) int64, iteration of each simulation's batch; 0 in the initial design.
        origin: (n,) int8, INITIAL, ACTIVE, CHECK or GIVEN.
        margins: (n, k) float64, one column for each of the simulator's margins; (0, 0) for an empty record.
        cause: (n,) int8, code of what decided the outcome, or of why there is none.
    """

    id: NDArray[np.int64]
    designs: Array
    outcome: NDArray[np.int8]
    iteration: NDArray[np.int64]
    origin: NDArray[np.int8]
    margins: Array
    cause: NDArray[np.int8]

    @classmethod
    def of(cls, batches: Sequence[Batch]) -> Self:
        """The history of some batches."""
        if not batches:
            none, ids = np.empty(0, dtype=np.int8), np.empty(0, dtype=np.int64)
            return cls(ids, np.empty((0, 0)), none, ids, none, np.empty((0, 0)), none)
        return cls(
            np.concatenate([batch.id for batch in batches]),
            np.concatenate([batch.designs for batch in batches]),
            np.concatenate([batch.results.outcome for batch in batches]),
            np.repeat([batch.iteration for batch in batches], [len(batch) for batch in batches]),
            np.concatenate([batch.origin for batch in batches]),
            np.concatenate([batch.results.margins for batch in batches]),
            np.concatenate([batch.results.cause for batch in batches]),
        )

    @classmethod
    def of_sample(cls, X: Array, results: Results) -> Self:
        """The history of designs, (n, d), that were simulated together, like an initial design."""
        n = len(X)
        origin = np.full(n, INITIAL, dtype=np.int8)
        return cls(
            np.arange(n), X, results.outcome, np.zeros(n, dtype=np.int64), origin, results.margins, results.cause
        )

    def __len__(self) -> int:
        return len(self.outcome)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    def through(self, iteration: int) -> Self:
        """The simulations of the batches up to an iteration."""
        return self[self.iteration <= iteration]

    @property
    def answered(self) -> NDArray[np.bool_]:
        """Which simulations gave an outcome, (n,)."""
        return np.asarray(self.outcome != NUMERICAL_FAILURE)

    @property
    def training(self) -> Self:
        """The simulations that a classifier learns from: those that gave an outcome."""
        return self[self.answered]

    @property
    def initial(self) -> NDArray[np.bool_]:
        """Which simulations belong to the initial design, (n,); only these are a sample of the design space."""
        return np.asarray(self.origin == INITIAL)

    @property
    def given(self) -> NDArray[np.bool_]:
        """Which simulations the campaign did not ask for, (n,)."""
        return np.asarray(self.origin == GIVEN)

    @property
    def chosen(self) -> NDArray[np.bool_]:
        """Which simulations the campaign chose after the initial design, (n,): active designs and checks."""
        return ~self.initial & ~self.given

    @property
    def asked_for(self) -> int:
        """How many simulations count towards the budget: all but those that the campaign did not ask for."""
        return int((~self.given).sum())

    @property
    def failed_designs(self) -> Array:
        """Designs of the numerical failures, (k, d)."""
        return self.designs[~self.answered]

    @property
    def leading_failures(self) -> int:
        """How many simulations failed before the first one with an outcome, without those that were given."""
        answered = self.answered[~self.given]
        return int(np.argmax(answered)) if answered.any() else len(answered)

    @property
    def without_leading_failures(self) -> Self:
        """The simulations without those `leading_failures`: the simulator has been fixed since."""
        return self[self.given | (np.cumsum(~self.given) > self.leading_failures)]

    @property
    def first_learnable(self) -> int:
        """The first iteration with an outcome, at which learning begins; 0 if there is none."""
        return int(self.iteration[self.answered].min()) if self.answered.any() else 0

    @property
    def last_iteration(self) -> int:
        """Iteration of the last batch; 0 for an empty record."""
        return int(self.iteration[-1]) if len(self) else 0

    def counts(self, outcomes: int) -> NDArray[np.int64]:
        """Simulations by outcome, (outcomes,), without numerical failures."""
        return np.bincount(self.outcome[self.answered], minlength=outcomes)
