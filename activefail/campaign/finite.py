"""The values of a question whose uncertain variables have finitely many: choices, steps, the rows of a table."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from activefail.campaign.question import Question
from activefail.errors import InputError, SimulationError
from activefail.space.space import Array, DesignSpace
from activefail.space.weighted import WeightedRows

MOST = 5000
"""Most values of a question."""


@dataclass(frozen=True, eq=False)
class FiniteValues:
    """The joint values of a question's uncertain variables, and their probabilities.

    Attributes:
        names: of the uncertain variables.
        X: (n, d) designs of the campaign, one for each value.
        weight: (n,) probabilities; their sum is 1.
        group: (n,) number of the group of each value, from 0, where the values are a sample of others of their kind.
            Values of one group are no independent sample, such as records of one event. None if they are no sample.
    """

    names: tuple[str, ...]
    X: Array
    weight: Array
    group: NDArray[np.intp] | None

    @classmethod
    def of(cls, question: Question) -> "FiniteValues":
        """The values of a question.

        Raises:
            InputError: if they are not finitely many, too many, or without probabilities of their own.
        """
        rows = question.space
        if isinstance(rows, WeightedRows):
            U, weight, group = rows.X, rows.weight, None
        else:
            _check(rows)
            places = np.indices([len(one.values) for one in rows.parameters]).reshape(rows.dimension, -1)
            pairs = list(zip(rows.parameters, places, strict=True))
            U = np.column_stack([one.values[place] for one, place in pairs])
            weight = np.prod([one.shares[place] for one, place in pairs], axis=0)
            is_possible = (weight > 0.0) & rows.meets_constraints(U)
            if not is_possible.any():
                raise InputError("constraints: no value of the question meets them.")
            # Records are a sample if there are any; otherwise a single variable's choices. Pairs are not independent.
            sampled = [pair for pair in pairs if pair[0].groups is not None] or [p for p in pairs if p[0].choices]
            U, weight, group = U[is_possible], weight[is_possible], None
            if len(sampled) == 1:
                ((one, place),) = sampled
                group = np.unique(_groups(one.groups, len(one.values))[place][is_possible], return_inverse=True)[1]
        if len(U) > MOST:
            raise InputError(f"wrong: requires at most {MOST} values of {_listed(rows.names)}, got {len(U)}.")
        return cls(tuple(rows.names), question.designs(U), weight / weight.sum(), group)

    def without(self, excluded: NDArray[np.bool_]) -> "FiniteValues":
        """The values where some, (n,), have no weight.

        Raises:
            SimulationError: if none is left.
        """
        weight = np.where(excluded, 0.0, self.weight)
        if not weight.any():
            raise SimulationError(f"None of the {len(weight)} values of {_listed(self.names)} exists.")
        return replace(self, weight=weight / weight.sum())

    def __len__(self) -> int:
        return len(self.weight)


def _check(space: DesignSpace) -> None:
    """Check that a distribution has finitely many values with probabilities of their own."""
    if continuous := [one.name for one in space.parameters if one.step is None]:
        example = ",".join(f"{one.name}={0.5 * (one.low + one.high):g}" for one in space.parameters if one.step is None)
        raise InputError(
            f"wrong: requires finitely many values, but {_listed(continuous)} "
            f"{'is' if len(continuous) == 1 else 'are'} continuous. Give {'it' if len(continuous) == 1 else 'them'} "
            f"values, such as --fixed {example}, or leave --wrong out."
        )
    if tied := sorted({name for one, other, rho in space.correlation if rho for name in (one, other)}):
        raise InputError(f"wrong: requires independent variables, but {_listed(tied)} are correlated.")
    if (count := math.prod(len(one.values) for one in space.parameters)) > 100 * MOST:
        raise InputError(f"wrong: requires at most {MOST} values of {_listed(space.names)}, got {count}.")


def _groups(groups: tuple[str, ...] | None, count: int) -> NDArray[np.intp]:
    """The number of each choice's group, (count,); without groups each is one of its own."""
    if groups is None:
        return np.arange(count)
    return np.array([groups.index(one) for one in groups])


def _listed(names: tuple[str, ...] | list[str]) -> str:
    return ", ".join(names[:-1]) + " and " * (len(names) > 1) + names[-1]
