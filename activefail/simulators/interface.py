"""The simulator interface: designs in, outcomes and margins out; and the causes of a lost run."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray

from activefail.space.space import Array

NUMERICAL_FAILURE = -1
"""The outcome of a simulation without a usable result: counted, never learned from."""


WORKER_DIED, TIME_LIMIT, OUT_OF_MEMORY, RAISED, UNUSABLE_ANSWER, NOT_FINITE = -1, -2, -3, -4, -5, -6
"""Causes of a numerical failure in the execution of a simulation, in addition to each simulator's causes."""

ExecutionCause = Literal["worker_died", "time_limit", "out_of_memory", "raised", "unusable_answer", "not_finite"]
"""Their names, in this order."""

EXECUTION_CAUSES: dict[int, str] = {-place: name for place, name in enumerate(get_args(ExecutionCause), 1)}


def cause_name(causes: Sequence[str], code: int) -> str:
    """The name of a cause: one of the simulator's or of EXECUTION_CAUSES."""
    return EXECUTION_CAUSES[code] if code < 0 else causes[code]


class UnusableAnswerError(Exception):
    """A simulator returned something that is not a valid answer."""


class NotFiniteError(UnusableAnswerError):
    """A simulator returned NaN or infinity where it must return a number."""


@dataclass(frozen=True)
class Results:
    """Results of n designs.

    The arrays are not copied: slices share memory with them. The receiver of results owns the arrays.

    Attributes:
        outcome: (n,) int8, index into the simulator's outcomes, or NUMERICAL_FAILURE.
        cause: (n,) int8, index into the simulator's causes, or one of EXECUTION_CAUSES.
        margins: (n, k) float64, one column for each of the simulator's margins; NaN where a margin is undefined.
        seconds: (n,) float64, wall time of each simulation [s]; finite, at least 0.
        faults: by row, why each simulation with one of EXECUTION_CAUSES failed; every text names its design. Slices and
            concatenations keep it with its row. Only executors fill it, and no record keeps it: a simulator and a store
            give none.

    Raises:
        ValueError: if the columns differ in length, the margins do not have two axes, or a fault has no row.
    """

    outcome: NDArray[np.int8]
    cause: NDArray[np.int8]
    margins: Array
    seconds: Array
    faults: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.outcome)
        shapes = (self.outcome.shape, self.cause.shape, self.margins.shape[:1], self.seconds.shape)
        if any(shape != (n,) for shape in shapes) or self.margins.ndim != 2:
            raise ValueError(f"Results need n outcomes, causes, rows of margins and times, got shapes {shapes}.")
        if not all(0 <= row < n for row in self.faults):
            raise ValueError(f"`0 <= row < {n}` must hold for the faults, got rows {sorted(self.faults)}.")

    def __len__(self) -> int:
        return len(self.outcome)

    def __getitem__(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        kept = enumerate(np.arange(len(self))[rows].tolist())
        faults = {row: self.faults[old] for row, old in kept if old in self.faults}
        return type(self)(self.outcome[rows], self.cause[rows], self.margins[rows], self.seconds[rows], faults)

    @classmethod
    def concatenate(cls, parts: list[Self]) -> Self:
        """The rows of several results, in order."""
        firsts = np.cumsum([0, *map(len, parts[:-1])]).tolist()
        return cls(
            np.concatenate([part.outcome for part in parts]),
            np.concatenate([part.cause for part in parts]),
            np.concatenate([part.margins for part in parts]),
            np.concatenate([part.seconds for part in parts]),
            {
                first + row: fault
                for first, part in zip(firsts, parts, strict=True)
                for row, fault in part.faults.items()
            },
        )


class Simulator(Protocol):
    """Anything that maps designs to outcomes in order of severity.

    **Names.** `outcomes`, `causes` and `margins` never change, and the names in each are unique. The record stores
    indices into them.

    **Rows.** The result of a design depends on that design alone: not on other rows, nor on earlier calls. The same
    design gives the same bits, except for `seconds`, unless `simulator.repeatable` is false. Only then is a resumed
    campaign bit-identical.

    **Threads and processes.** If `releases_gil` is true, `run` is called from several threads at once. Otherwise it is
    called in worker processes, one design at a time. A simulator can be pickled, and gives the same results afterwards.
    If it has a method `prepare`, a worker process calls it once before the first simulation; its time does not count
    towards the time limit.

    **Optional attributes.** `renew` (int or None) is the most simulations of one worker process. `isolated` (bool)
    means that each simulation runs in its own process, so that an error is not repeated in a fresh worker. `cores`
    (int) are those that each simulation uses. `failing` and `impossible` (tuples of codes of causes) say which lost
    runs are failures (`settled`), and which are designs that do not exist. `space` (DesignSpace) has the names of a
    design's values, and `folder_of(x)` the folder of a design, (d,), for messages. `check(X)` raises an InputError if
    one of the designs can have no result at all, such as one with a negative friction. `harmless(X)` says which
    designs, (n, d) -> (n,), have the least severe outcome for certain. `title` names the simulator in words, `noun` is
    what a design describes, such as "bearing", `quantities` are symbols, units and meanings of variables by name
    (`Quantity`), `limits` are sentences on what the model leaves out, and `view` is the name of a plug-in's view
    (`pages/view.py`). `terms(quantities)` gives a design in the designer's terms (`Terms`), from its quantities by name
    (`DesignSpace.quantities`); None if some lack.

    **Arrays.** `run` neither modifies X, which may be read-only, nor keeps it. The caller owns the results.

    **Exceptions.** An ActivefailError ends the campaign. Any other exception fails its simulation only: a call for
    several designs that raises is repeated row by row, and a row that raises is a numerical failure with the cause
    `raised` or `out_of_memory`. A row with an invalid answer is one with the cause `unusable_answer`, or `not_finite`.
    """

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names of the outcomes, least severe first; at least two."""
        ...

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of what can decide an outcome; the first is the empty string (no cause)."""
        ...

    @property
    def margins(self) -> tuple[str, ...]:
        """Names of the margins, and then of the outputs in their expressions; may be empty."""
        ...

    @property
    def releases_gil(self) -> bool:
        """Whether to run it in parallel threads; otherwise it runs in processes."""
        ...

    def run(self, X: Array) -> Results:
        """Simulate designs.

        Args:
            X: (n, d) float64, n >= 0; columns and units of the design space.

        Returns:
            Results of the n designs, in their order. A simulation that the simulator abandons has the outcome
            NUMERICAL_FAILURE and one of the simulator's causes.
        """
        ...


class Terms(Protocol):
    """A design in the designer's terms."""

    @property
    def text(self) -> str:
        """All in one line."""
        ...

    def lines(self, upper: Collection[str] | None = None) -> list[tuple[str, str]]:
        """Titles and texts.

        Args:
            upper: the variables that are at their upper property bounds, to say so; None where none has bounds.
        """
        ...

    def as_json(self) -> dict[str, float]:
        """The terms as JSON values."""
        ...


def terms_of(simulator: object, quantities: Mapping[str, float]) -> Terms | None:
    """A design in the designer's terms; None if its simulator has none."""
    terms = getattr(simulator, "terms", None)
    return None if terms is None else terms(quantities)


def limits_of(simulator: object) -> tuple[str, ...]:
    """What the model of a simulator leaves out, as sentences."""
    return getattr(simulator, "limits", ())


def noun_of(simulator: object) -> str:
    """What a design of a simulator describes."""
    return getattr(simulator, "noun", "design")


def design_in_words(simulator: Simulator, x: Array) -> str:
    """A design, (d,), as messages name it: its values by name, and its folder if it has one."""
    space = getattr(simulator, "space", None)
    pairs = () if space is None or space.dimension != len(x) else zip(space.names, space.row(x), strict=True)
    shown = (f"{name} = {value if isinstance(value, str) else f'{value:.6g}'}" for name, value in pairs)
    text = ", ".join(shown) or str(np.asarray(x).tolist())
    folder_of = getattr(simulator, "folder_of", None)
    return f"design {text}" + ("" if folder_of is None else f" in {folder_of(x)}")


def settled(simulator: Simulator, results: Results) -> Results:
    """The results with lost runs as the most severe outcome, if their causes mean that; the causes stay."""
    means_failure = (results.outcome == NUMERICAL_FAILURE) & np.isin(results.cause, getattr(simulator, "failing", ()))
    if not means_failure.any():
        return results
    most_severe = np.int8(len(simulator.outcomes) - 1)
    return replace(results, outcome=np.where(means_failure, most_severe, results.outcome))


def is_impossible(simulator: Simulator, outcome: NDArray[np.int8], cause: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Which simulations, (n,), say that their design does not exist."""
    return np.asarray((outcome == NUMERICAL_FAILURE) & np.isin(cause, getattr(simulator, "impossible", ())))


def unanswered(simulator: Simulator, n: int, cause: int = 0, fault: str = "") -> Results:
    """Results of n simulations that failed with a cause, and with a fault unless it is empty."""
    return Results(
        np.full(n, NUMERICAL_FAILURE, dtype=np.int8),
        np.full(n, cause, dtype=np.int8),
        np.full((n, len(simulator.margins)), np.nan),
        np.zeros(n),
        dict.fromkeys(range(n), fault) if fault else {},
    )
