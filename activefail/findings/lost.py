"""Where the runs of a campaign give no result, in words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activefail.visible import visible

_TELLING = 3.0
"""Least difference between the mean ranks of lost and other runs, in standard errors, that is no chance."""


def where_lost(names: Sequence[str], designs: NDArray[np.float64], lost: NDArray[np.bool_]) -> str:
    """How many runs gave no result, and which variable tells them best from the others; empty if all gave one.

    Args:
        names: of the variables.
        designs: (n, d) of the simulations.
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
        return f"{text}; no single variable shows where; simulator.lost says what that means"
    of_lost, of_others = (float(np.median(designs[rows, column])) for rows in (lost, ~lost))
    return (
        f"{text}, most of them at {'low' if apart[column] < 0.0 else 'high'} {visible(names[column])} (median "
        f"{of_lost:.3g}, of the others {of_others:.3g}); simulator.lost says what that means"
    )
