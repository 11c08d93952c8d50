"""Input and output of a custom simulator: one design as a dictionary, and its result."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from enum import Enum
from numbers import Real
from typing import Any

import numpy as np

from activefail.simulators.interface import NotFiniteError, Results, UnusableAnswerError
from activefail.space.expressions import Expression, outputs_of, parsed_name
from activefail.space.space import Array, DesignSpace
from activefail.visible import margin_in_words


def designs_by_name(space: DesignSpace, X: Array) -> list[dict[str, Any]]:
    """One dictionary per design, (n, d): values of the variables, with choices as written, features, and fixed ones."""
    columns = space.columns(X)
    for one, x in zip(space.parameters, np.reshape(X, (-1, space.dimension)).T, strict=True):
        columns |= one.carried(x)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{**dict(zip(columns, row, strict=True)), **space.fixed} for row in rows]


def read_objects(space: DesignSpace) -> None:
    """Read what choices stand for, such as records, once in this process."""
    for one in space.parameters:
        if one.payload is not None:
            one.payload()


def objects_in(space: DesignSpace, design: Mapping[str, Any]) -> dict[str, Any]:
    """What the choices in a design, by name, stand for, such as records; by the names of their variables."""
    return {
        one.name: one.payload.in_design(int(one.number_of(design[one.name])), design)
        for one in space.parameters
        if one.payload is not None
    }


def read_answer(
    answer: object,
    outcomes: tuple[str, ...],
    margins: tuple[str, ...],
    levels: tuple[float, ...],
    seconds: float,
    system: Callable[[Array], Array] | None = None,
    causes: tuple[str, ...] = ("",),
    truncated: tuple[str, ...] = (),
    expressions: Mapping[str, Expression] | None = None,
) -> Results:
    """The result of one design, from what a custom simulator returned.

    A margin that is left out is undefined. One that is NaN is no result, except in a system whose other margins decide,
    and where `truncated` says that it is undefined.

    Args:
        answer: the outcome, a table with "outcome", "margins" and "cause", the only margin as a number, or the margins
            of a system by name. With `expressions`, a table of the outputs, with "outcome" and "cause"; or the only
            output, as a number.
        outcomes, margins: names that it may contain.
        levels: values of the only margin at or below which each outcome but the first occurs; empty if a number is no
            answer.
        seconds: wall time.
        system: margins, (k,) -> the system's, at most 0 where it fails, NaN if they do not say; None without a system.
        causes: names that it may contain; the first is none. If it is the only one, causes are ignored.
        truncated: margins that may be NaN at the most severe outcome.
        expressions: of the outputs, by margin; none if the margins are returned.

    Returns:
        The result, with the outputs that are no margins behind the margins.

    Raises:
        NotFiniteError: if a margin is NaN, or infinite without an outcome.
        UnusableAnswerError: if the answer breaks another rule.
    """
    if expressions:
        given, outputs = _of_outputs(answer, outcomes, levels, system, expressions)
        result = read_answer(given, outcomes, tuple(expressions), (), seconds, system, causes, truncated)
        kept = [outputs.get(name, np.nan) for name in outputs_of(expressions) if name not in expressions]
        return replace(result, margins=np.hstack([result.margins, np.reshape(kept, (1, -1))]))
    if isinstance(answer, str | Enum):
        answer = {"outcome": answer}
    elif levels and not isinstance(answer, Mapping):
        answer = _of_limit_state(answer, outcomes, margins[0], levels)
    cause = ""
    if isinstance(answer, Mapping) and "cause" not in margins:
        cause = answer.get("cause", "")
        answer = {key: value for key, value in answer.items() if key != "cause"}
    if system is not None and isinstance(answer, Mapping) and "outcome" not in answer:
        rest = {key: value for key, value in answer.items() if key != "margins"} if "margins" in answer else {}
        answer = rest | _of_system(answer.get("margins", answer), outcomes, margins, system)
    if not isinstance(answer, Mapping):
        raise UnusableAnswerError(f"{_ways(outcomes)}, got {answer!r}")
    unknown = set(answer) - {"outcome", "margins"}
    if unknown:
        raise UnusableAnswerError(
            f"the answer may contain only outcome, margins, cause, got {min(map(str, unknown))!r}"
        )
    if len(causes) == 1:  # none is declared
        cause = ""
    if not isinstance(cause, str) or cause not in causes:
        named = ", ".join(causes[1:])
        raise UnusableAnswerError(f"cause: must be one of simulator.causes, which names {named}, got {cause!r}")
    outcome, margin_values = answer.get("outcome"), answer.get("margins", {})
    outcome = outcome.value if isinstance(outcome, Enum) else outcome
    # A subclass of str may override `==`; compare its characters.
    outcome_name = str.__str__(outcome) if isinstance(outcome, str) else None
    if outcome_name not in outcomes:
        raise UnusableAnswerError(f"outcome: must be one of {', '.join(outcomes)}, got {outcome!r}")
    values = _values(margin_values, margins)
    nan = [name for name, value in zip(margins, values, strict=True) if np.isnan(value) and name in margin_values]
    is_decided = system is not None and not np.isnan(system(np.array(values)))
    if nan and not is_decided and not (outcome_name == outcomes[-1] and {*nan} <= {*truncated}):
        raise NotFiniteError(
            f"margins.{nan[0]}: must be a number beside the outcome {outcome_name}, got nan; leave it out where it is "
            "undefined, or name it in simulator.truncated if failure leaves it undefined"
        )
    return Results(
        np.array([outcomes.index(outcome_name)], dtype=np.int8),
        np.array([causes.index(cause)], dtype=np.int8),
        np.array([values], dtype=np.float64).reshape(1, len(margins)),
        np.array([seconds]),
    )


def _of_outputs(
    answer: object,
    outcomes: tuple[str, ...],
    levels: tuple[float, ...],
    system: Callable[[Array], Array] | None,
    expressions: Mapping[str, Expression],
) -> tuple[dict[str, object], dict[str, float]]:
    """The outcome, the cause and the margins in an answer that is outputs, and the outputs.

    A margin is undefined where one of its outputs is left out. Others than the expressions' outputs are ignored.

    Raises:
        NotFiniteError: if margins that are NaN or infinite leave the outcome open.
        UnusableAnswerError: if an output is no number, or left out although it decides the outcome.
    """
    names = outputs_of(expressions)
    if isinstance(answer, str | Enum):
        answer = {"outcome": answer}
    elif not isinstance(answer, Mapping):
        if len(names) > 1:
            raise UnusableAnswerError(f"the answer must be a dictionary with {', '.join(names)}, got {answer!r}")
        answer = {names[0]: answer}
    named = {parsed_name(str(name)): value for name, value in answer.items()}
    outputs = {name: _number(name, named[name]) for name in names if name in named}
    with np.errstate(all="ignore"):  # what is not finite has its own error
        margins = {name: float(one(outputs)) for name, one in expressions.items() if one.names <= outputs.keys()}
    said: dict[str, object] = {name: named[name] for name in ("outcome", "cause") if name in named}
    if "outcome" in said:
        return said | {"margins": margins}, outputs
    if not (levels or system):
        raise UnusableAnswerError(
            f"the answer must have `outcome` ({', '.join(outcomes)}), since neither one margin decides nor a system; "
            "state simulator.system, or levels of one margin"
        )
    values = [margins.get(name, np.nan) for name in expressions]
    missing = [name for name in names if name not in outputs]
    if missing and (system is None or np.isnan(system(np.array(values)))):
        raise UnusableAnswerError(
            f"the answer must have the output {missing[0]}, as simulator.margins says; it has {', '.join(named)}"
        )
    decided = _of_system(margins, outcomes, (*expressions,), system) if system else None
    return said | (decided or _of_limit_state(values[0], outcomes, next(iter(expressions)), levels)), outputs


def _ways(outcomes: tuple[str, ...]) -> str:
    return f"the answer must be the name of an outcome ({', '.join(outcomes)}), or a dictionary with `outcome`"


def _values(given: object, margins: tuple[str, ...]) -> list[float]:
    """The margins by name as numbers, NaN where one is missing.

    Raises:
        UnusableAnswerError: if they are no dictionary of numbers with these names.
    """
    if not isinstance(given, Mapping):
        raise UnusableAnswerError(f"margins: must be a dictionary of {', '.join(margins) or 'nothing'}, got {given!r}")
    for name in given:
        if name not in margins:
            raise UnusableAnswerError(
                f"margins: {name!r} is not declared in simulator.margins, which names {', '.join(margins) or 'none'}"
            )
    return [_number(f"margins.{name}", given.get(name, np.nan)) for name in margins]


def _of_system(
    given: Any, outcomes: tuple[str, ...], margins: tuple[str, ...], system: Callable[[Array], Array]
) -> dict[str, object]:
    """The outcome and the margins of an answer that is a system's margins.

    Raises:
        NotFiniteError: if those that are NaN leave the outcome open.
        UnusableAnswerError: if they are no numbers, or those that are left out leave it open.
    """
    values = dict(zip(margins, _values(given, margins), strict=True))
    value = float(system(np.array(list(values.values()))))
    if np.isnan(value):
        undefined = [name for name, number in values.items() if np.isnan(number)]
        kind = NotFiniteError if {*undefined} & {*given} else UnusableAnswerError
        raise kind(f"margins: {', '.join(undefined)} must be defined, since the others leave the outcome open")
    return {"outcome": outcomes[int(value <= 0.0)], "margins": values}


def _of_limit_state(
    answer: object, outcomes: tuple[str, ...], margin: str, levels: tuple[float, ...]
) -> dict[str, object]:
    """The outcome and the margin of an answer that is the margin alone.

    Raises:
        NotFiniteError: if it is NaN or infinite.
        UnusableAnswerError: if it is no number.
    """
    number = _one_number(answer)
    if number is None:
        raise UnusableAnswerError(f"{_ways(outcomes)}, or {margin_in_words(margin)} as one number, got {answer!r}")
    value = _number(f"margins.{margin}", number)
    if not np.isfinite(value):
        raise NotFiniteError(f"{margin_in_words(margin)} is {value}; without an outcome it must be a finite number")
    return {"outcome": outcomes[sum(value <= level for level in levels)], "margins": {margin: value}}


def _one_number(value: object) -> Any:
    """The number in a scalar, or in an array or list of one; None if there is no number, more than one, or a bool.

    Nor is a quantity with a unit a number: the unit of the margin may be another.
    """
    if isinstance(value, Enum) or hasattr(value, "unit") or hasattr(value, "units"):
        return None
    try:
        array = np.asarray(value.detach() if hasattr(value, "detach") else value)  # a tensor with a gradient
    except Exception:  # whatever the value's own conversion raises
        return None
    if array.size != 1 or np.ma.is_masked(value):
        return None
    number = array.reshape(-1)[0]
    # NumPy counts differences of times among the integers; to Python, booleans are whole numbers.
    is_number = isinstance(number, Real | Decimal)
    return number if is_number and not isinstance(number, bool | np.timedelta64) else None


def _number(name: str, value: object) -> float:
    """A margin or an output as float64. NaN and infinity are values; a finite number must not become one.

    Raises:
        UnusableAnswerError: if it is not one real number, or too large.
    """
    given = _one_number(value)
    if given is None:
        raise UnusableAnswerError(f"{name}: must be one number, left out where it is undefined, got {value!r}")
    try:
        number = float(given)
    except OverflowError:  # an integer
        number = np.inf
    if np.isinf(number) and given not in (np.inf, -np.inf):
        raise UnusableAnswerError(f"{name}: must fit a float64, at most 1.8e308 in size, got a larger number")
    return number
