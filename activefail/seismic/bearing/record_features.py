"""The cheap models' features of bearings under records: the sliding block's and the collision's."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from activefail.errors import InputError
from activefail.seismic.bearing.accelerogram import Accelerogram
from activefail.seismic.bearing.collision import COLLISION_FEATURES, Choices, severity_of
from activefail.seismic.bearing.design import TABLE_1, Model
from activefail.seismic.bearing.ground import Samples, Scaled
from activefail.seismic.bearing.kernels import check_compiled, kernel
from activefail.seismic.bearing.sliding import SLIDING_FEATURES, STEPS, sliding_pair
from activefail.space.space import Array

RECORD_FEATURES = (*SLIDING_FEATURES, *COLLISION_FEATURES)
"""Names of the columns of `record_features`."""

_LEAST_PART = 16
"""Fewest rows of a thread: computing their features takes about 10 ms."""


@kernel(nogil=True, error_model="numpy")
def _under_record(X, samples, factors, choices, steps, out):
    for row in range(len(X)):
        motion = Scaled(samples, factors[row])
        v, a = sliding_pair(X[row], motion, choices.slider_diameter, choices.restitution, steps)
        severity = severity_of(X[row], motion, choices, steps)
        out[row, 0], out[row, 1], out[row, 2] = v, a, np.tanh(1.5 * (severity - 1.0))


def record_features(
    X: Array,
    records: Sequence[Accelerogram],
    which: NDArray[np.intp],
    factors: Array,
    model: Model | None = None,
    threads: int | None = None,
) -> Array:
    """v*, a* and m* of bearings under scaled records, (n, 3): `sliding_features` and `collision_features` for records.

    A row's features depend on that row alone. A bearing that cannot be built has NaN.

    Args:
        X: (n, 7) bearings: T_b [s], mu, D_tot [m], h_sl/D_sl, h_rim/D_sl, p [MPa], k [N/m^1.5].
        records: the records.
        which: (n,) each row's record, an index into `records`.
        factors: (n,) by which each row's record is multiplied.
        model: source of slider diameter, density, restitution and rims.
        threads: number of threads; None uses all cores.

    Raises:
        InputError: if shapes do not agree, an index has no record, or a factor is not finite.
    """
    check_compiled()
    choices = Choices.of(model or Model())
    X, which, factors = np.ascontiguousarray(X, dtype=np.float64), np.asarray(which), np.asarray(factors, np.float64)
    if X.ndim != 2 or X.shape[1] != TABLE_1.dimension - 2:
        raise InputError(
            f"bearings: must be an array of shape (n, {TABLE_1.dimension - 2}) with the columns "
            f"{', '.join(TABLE_1.names[:-2])}, got shape {X.shape}."
        )
    if which.shape != (len(X),) or factors.shape != (len(X),):
        raise InputError(f"{len(X)} bearings need as many records and factors, got {which.shape} and {factors.shape}.")
    if len(X) and (which.min() < 0 or which.max() >= len(records)):
        raise InputError(f"which: must be from 0 to {len(records) - 1}, got {which.min()} to {which.max()}.")
    if not np.isfinite(factors).all():
        raise InputError(f"factors: must be finite, got {factors[~np.isfinite(factors)][0]}.")
    out = np.full((len(X), len(RECORD_FEATURES)), np.nan)

    def fill(rows: NDArray[np.intp]) -> None:
        samples: Samples = records[which[rows[0]]].samples
        part = np.empty((len(rows), out.shape[1]))
        _under_record(
            X[rows],
            samples,
            factors[rows],
            choices,
            STEPS,
            part,
        )
        out[rows] = part

    parts = []
    for k in np.unique(which):
        rows = np.flatnonzero(which == k)
        parts += np.array_split(rows, -(-len(rows) // _LEAST_PART))
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        list(pool.map(fill, parts))
    return out
