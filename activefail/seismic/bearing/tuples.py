"""Vectors and matrices as tuples of numbers of any length, which compiled code unrolls and keeps in registers.

A vector is a tuple of n numbers, a matrix a tuple of n rows. Every operation handles the first element and recurses for
the rest. The compiler resolves the recursion by the tuples' types, so that neither loops nor memory accesses remain.
With arrays, the integrator's algebra takes three times as long.
"""

from numba import njit
from numba.extending import overload

from activefail.seismic.bearing.kernels import INLINE


def scaled(a, x):
    """Vector a·x."""
    raise NotImplementedError


def axpy(a, x, y):
    """Vector a·x + y."""
    raise NotImplementedError


def combination(y, weights, vectors):
    """Vector y + Σ weights_j·vectors_j."""
    raise NotImplementedError


def weighted(weights, vectors):
    """Vector Σ weights_j·vectors_j."""
    raise NotImplementedError


def dot(x, y):
    """Number Σ x_i·y_i."""
    raise NotImplementedError


def product(rows, x):
    """Vector of a matrix times a vector."""
    raise NotImplementedError


def scaled_rows(a, X):
    """Matrix a·X."""
    raise NotImplementedError


def axpy_rows(a, X, Y):
    """Matrix a·X + Y."""
    raise NotImplementedError


def factorise(rows):
    """LU factors of the identity plus a matrix, without pivoting, for `solve`.

    A tuple: the inverse pivot, the rest of its row divided by the pivot, the multipliers of the rows below, and the
    factors of the remaining matrix.
    """
    raise NotImplementedError


def solve(factors, x):
    """Solution of a linear system with the factors of `factorise`."""
    raise NotImplementedError


def error_sum(error, before, after, scale):
    """Number Σ (error_i / (scale_i + max(|before_i|, |after_i|)))²."""
    raise NotImplementedError


def _is_last(vector):
    return len(vector) == 1  # of a type of tuple


@overload(scaled, jit_options=INLINE)
def _scaled(a, x):
    if _is_last(x):
        return lambda a, x: (a * x[0],)
    return lambda a, x: (a * x[0], *scaled(a, x[1:]))


@overload(axpy, jit_options=INLINE)
def _axpy(a, x, y):
    if _is_last(x):
        return lambda a, x, y: (a * x[0] + y[0],)
    return lambda a, x, y: (a * x[0] + y[0], *axpy(a, x[1:], y[1:]))


@overload(combination, jit_options=INLINE)
def _combination(y, weights, vectors):
    if _is_last(vectors):
        return lambda y, weights, vectors: axpy(weights[0], vectors[0], y)
    return lambda y, weights, vectors: combination(axpy(weights[0], vectors[0], y), weights[1:], vectors[1:])


@overload(weighted, jit_options=INLINE)
def _weighted(weights, vectors):
    if _is_last(vectors):
        return lambda weights, vectors: scaled(weights[0], vectors[0])
    return lambda weights, vectors: combination(scaled(weights[0], vectors[0]), weights[1:], vectors[1:])


@overload(dot, jit_options=INLINE)
def _dot(x, y):
    if _is_last(x):
        return lambda x, y: x[0] * y[0]
    return lambda x, y: x[0] * y[0] + dot(x[1:], y[1:])


@overload(product, jit_options=INLINE)
def _product(rows, x):
    if _is_last(rows):
        return lambda rows, x: (dot(rows[0], x),)
    return lambda rows, x: (dot(rows[0], x), *product(rows[1:], x))


@overload(scaled_rows, jit_options=INLINE)
def _scaled_rows(a, X):
    if _is_last(X):
        return lambda a, X: (scaled(a, X[0]),)
    return lambda a, X: (scaled(a, X[0]), *scaled_rows(a, X[1:]))


@overload(axpy_rows, jit_options=INLINE)
def _axpy_rows(a, X, Y):
    if _is_last(X):
        return lambda a, X, Y: (axpy(a, X[0], Y[0]),)
    return lambda a, X, Y: (axpy(a, X[0], Y[0]), *axpy_rows(a, X[1:], Y[1:]))


def _eliminated(inverse, top, rows):
    """The multipliers of the rows below a pivot, and the remaining rows without its column."""
    raise NotImplementedError


@overload(_eliminated, jit_options=INLINE)
def _eliminated_overload(inverse, top, rows):
    if _is_last(rows):

        def last(inverse, top, rows):
            factor = rows[0][0] * inverse
            return (factor,), (axpy(-factor, top, rows[0][1:]),)

        return last

    def more(inverse, top, rows):
        factor = rows[0][0] * inverse
        factors, remainder = _eliminated(inverse, top, rows[1:])
        return (factor, *factors), (axpy(-factor, top, rows[0][1:]), *remainder)

    return more


@overload(factorise, jit_options=INLINE)
def _factorise(rows):
    if _is_last(rows):
        return lambda rows: (1.0 / (1.0 + rows[0][0]),)

    def eliminate(rows):
        inverse, top = 1.0 / (1.0 + rows[0][0]), rows[0][1:]
        factors, remainder = _eliminated(inverse, top, rows[1:])
        return inverse, scaled(inverse, top), factors, factorise(remainder)

    return eliminate


@overload(solve, jit_options=INLINE)
def _solve(factors, x):
    if _is_last(factors):
        return lambda factors, x: (x[0] * factors[0],)

    def substitute(factors, x):
        inverse, top, below, remainder = factors
        rest = solve(remainder, axpy(-x[0], below, x[1:]))
        return (x[0] * inverse - dot(top, rest), *rest)

    return substitute


@njit(**INLINE)
def _square(x):
    return x * x


@overload(error_sum, jit_options=INLINE)
def _error_sum(error, before, after, scale):
    if _is_last(error):
        return lambda error, before, after, scale: _square(error[0] / (scale[0] + max(abs(before[0]), abs(after[0]))))
    return lambda error, before, after, scale: (
        _square(error[0] / (scale[0] + max(abs(before[0]), abs(after[0]))))
        + error_sum(error[1:], before[1:], after[1:], scale[1:])
    )
