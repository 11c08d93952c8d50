"""Vectors and matrices as tuples, and four numbers side by side, against numpy."""

import math

import numpy as np
import pytest
from cases import some
from numba import njit

from activefail.seismic.bearing import TABLE_1, Bearing, Model, Pulse, simulate_one
from activefail.seismic.bearing.dynamics import cosine_and_sine, dfp_linearisation, system
from activefail.seismic.bearing.integrator import RODAS
from activefail.seismic.bearing.lanes import any_positive, lanes, numbers, positive, sign, sqrt, where
from activefail.seismic.bearing.tuples import (
    axpy,
    axpy_rows,
    combination,
    error_sum,
    factorise,
    product,
    scaled_rows,
    solve,
)


@njit
def _solution(rows, x):
    return solve(factorise(rows), x)


@njit
def _sums(a, X, Y, x, y, weights):
    return axpy(a, x, y), combination(y, weights, X), product(X, x), axpy_rows(a, X, Y), scaled_rows(a, X)


@njit
def _error_sum(error, before, after, scale):
    return error_sum(error, before, after, scale)


def rows_of(matrix):
    return tuple(tuple(row) for row in matrix.tolist())


@pytest.mark.parametrize("n", some([1, 2, 5], 1, 5))
def test_tuples_do_what_vectors_and_matrices_do(n):
    rng = np.random.default_rng(n)
    X, Y, (x, y, weights) = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=(3, n))
    sums = _sums(0.7, rows_of(X), rows_of(Y), tuple(x), tuple(y), tuple(weights))
    for one, other in zip(sums, (0.7 * x + y, y + weights @ X, X @ x, 0.7 * X + Y, 0.7 * X), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(_solution(rows_of(X @ X.T), tuple(x)), np.linalg.solve(np.eye(n) + X @ X.T, x))
    error = ((x / (np.abs(weights) + np.maximum(np.abs(x), np.abs(y)))) ** 2).sum()
    assert _error_sum(tuple(x), tuple(x), tuple(y), tuple(np.abs(weights))) == pytest.approx(error)


def test_elimination_without_pivoting_is_accurate_for_the_matrices_of_the_bearing():
    # At every state of motions of all outcomes, for the step that was made there and for one ten times as long.
    residuals = []
    for row in TABLE_1.latin_hypercube(40, np.random.default_rng(12)):
        bearing, pulse = Bearing.from_row(row.tolist(), 0.30), Pulse.from_table(*row[7:].tolist())
        constants, response = system(bearing, pulse, Model()), simulate_one(bearing, pulse)
        for i in range(0, len(response.t) - 1, 3):
            state = tuple(response.q[i].tolist()), tuple(response.v[i].tolist())
            _, by_q, by_v, _ = map(np.array, dfp_linearisation(constants, response.t[i], *state))
            for stretch in (1.0, 10.0):
                step = RODAS.gamma * stretch * (response.t[i + 1] - response.t[i])
                matrix = -step * (by_v + step * by_q)
                x = np.array(_solution(rows_of(matrix), tuple(response.a[i].tolist())))
                matrix = matrix + np.eye(5)
                size = np.abs(matrix) @ np.abs(x) + np.abs(response.a[i])
                residuals.append(np.abs((matrix @ x - response.a[i]) / size.max()).max())
    assert len(residuals) > 10_000
    assert np.quantile(residuals, 0.999) < 1e-12
    assert max(residuals) < 1e-9


@njit
def _laws(x, y):
    return sqrt(positive(x)) + where(x, y) * sign(x) - abs(y) / 2.0 + 3.0 * (-x)


@njit
def _side_by_side(x, y):
    together = lanes(x[0], x[1], x[2], x[3])
    return numbers(_laws(together, lanes(y[0], y[1], y[2], y[3]))), any_positive(together)


def test_four_numbers_side_by_side_are_computed_as_each_alone():
    rng = np.random.default_rng(13)
    for _ in range(100):
        x, y = tuple(rng.normal(size=4)), tuple(rng.normal(size=4))
        together, any_of_them = _side_by_side(x, y)
        assert together == pytest.approx([_laws(a, b) for a, b in zip(x, y, strict=True)], rel=1e-14, abs=1e-15)
        assert any_of_them == (max(x) > 0.0)
    assert not _side_by_side((-1.0, -2.0, 0.0, -3.0), y)[1]


def test_cosine_and_sine_are_right_to_the_last_digit_but_one():
    for angle in np.linspace(-2.0, 2.0, 4001):
        cosine, sine = cosine_and_sine(angle)
        assert abs(cosine - math.cos(angle)) <= 1.2e-16
        assert abs(sine - math.sin(angle)) <= 1.2e-16
