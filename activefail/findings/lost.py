"""Where the runs of a campaign give no result, in words."""

import numpy as np
from numpy.typing import NDArray

from activefail.parameter import Parameter
from activefail.space import Array, DesignSpace
from activefail.visible import visible

_TELLING = 3.0
"""Least difference between the mean ranks of lost and other runs, in standard errors, that is no chance."""


def where_lost(space: DesignSpace, designs: Array, lost: NDArray[np.bool_]) -> str:
    """How many runs gave no result, and which variable tells them best from the others; empty if all gave one.

    Args:
        space: of the campaign.
        designs: (n, d) of its simulations.
        lost: (n,) which gave no result.
    """
    if not lost.any():
        return ""
    text = f"{int(lost.sum())} of {len(lost)} runs gave no result"
    if lost.all():
        return text
    ranks = np.argsort(np.argsort(designs, axis=0), axis=0) / max(1, len(lost) - 1)
    apart = ranks[lost].mean(axis=0) - ranks[~lost].mean(axis=0)
    column = int(np.argmax(np.abs(apart)))
    # A rank is uniform, with a variance of 1/12.
    error = np.sqrt((1.0 / lost.sum() + 1.0 / (~lost).sum()) / 12.0)
    if abs(apart[column]) < _TELLING * error:
        return f"{text}, scattered over the space"
    one = space.parameters[column]
    of_lost, of_others = (float(np.median(designs[rows, column])) for rows in (lost, ~lost))
    kind = "low" if apart[column] < 0.0 else "high"
    return (
        f"{text}, most of them at {kind} {visible(one.name)} (median {_with_unit(of_lost, one)}, of the others "
        f"{_with_unit(of_others, one)})"
    )


def _with_unit(value: float, parameter: Parameter) -> str:
    return f"{value:.3g} {visible(parameter.unit)}".rstrip()
