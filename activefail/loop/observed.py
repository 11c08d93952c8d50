"""An executor whose faults the loop's observer sees."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from activefail.execution.executor import AsynchronousExecutor
from activefail.simulators.interface import Results, Simulator
from activefail.space import Array


@dataclass(frozen=True)
class ObservedExecutor:
    """An executor that also collects the faults of all its results. Its context remains the caller's.

    Attributes:
        executor: runs the simulations.
        faults: receives the faults, in order of arrival.
    """

    executor: AsynchronousExecutor
    faults: list[str]

    def run(self, simulator: Simulator, X: Array, progress: Callable[[int], None] | None = None) -> Results:
        """As `Executor.run`."""
        return self._noted(self.executor.run(simulator, X, progress))

    def start(self, simulator: Simulator, ticket: int, x: Array) -> None:
        """As `AsynchronousExecutor.start`."""
        self.executor.start(simulator, ticket, x)

    def answered(self, seconds: float) -> list[tuple[int, Results]]:
        """As `AsynchronousExecutor.answered`."""
        return [(ticket, self._noted(results)) for ticket, results in self.executor.answered(seconds)]

    def _noted(self, results: Results) -> Results:
        self.faults.extend(results.faults.values())
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...
