"""Lanes: vectors of four numbers, one for each vertex of the slider, which compiled code processes at once.

Roots and divisions dominate the cost of a contact, and the processor computes four of them in the time of one. The
functions here also accept plain numbers, so that a contact law is written once, for one vertex and for four.
"""

import math
import operator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import PrimitiveModel
from numba.core.types.containers import UniTuple
from numba.core.typing import signature
from numba.extending import intrinsic, overload, register_model

from activefail.seismic.bearing.kernels import INLINE, KERNEL

_VECTOR = ir.VectorType(ir.DoubleType(), 4)
_ZERO = ir.Constant(_VECTOR, [0.0] * 4)
_FLAGS = tuple(KERNEL["fastmath"])


class _LanesType(types.Type):
    def __init__(self):
        super().__init__(name="Lanes")


LANES = _LanesType()
Lanes = Any
"""For annotations; lanes exist only in compiled code."""


@register_model(_LanesType)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def sqrt(x):
    """√x; undefined for a negative number."""
    raise NotImplementedError


def positive(x):
    """x where x is positive, else 0."""
    raise NotImplementedError


def where(test, x):
    """x where `test` is positive, else 0."""
    raise NotImplementedError


def any_positive(x):
    """Whether x, or any of its lanes, is positive."""
    raise NotImplementedError


def sign(x):
    """1 with the sign of x."""
    raise NotImplementedError


@intrinsic
def lanes(typing_context, a, b, c, d):
    """Four numbers as lanes."""

    def build(context, builder, kinds, arguments):
        vector = ir.Constant(_VECTOR, ir.Undefined)
        for place, value in enumerate(arguments):
            vector = builder.insert_element(vector, value, ir.IntType(32)(place))
        return vector

    return LANES(types.float64, types.float64, types.float64, types.float64), build


@intrinsic
def numbers(typing_context, x):
    """Lanes as a tuple of four numbers."""

    def build(context, builder, kinds, arguments):
        values = [builder.extract_element(arguments[0], ir.IntType(32)(place)) for place in range(4)]
        return context.make_tuple(builder, kinds.return_type, values)

    return signature(UniTuple(types.float64, 4), LANES), build


def _elementwise(combine):
    """A binary intrinsic of lanes, or lanes and a number, from the instruction that `combine` builds."""

    @intrinsic
    def operation(typing_context, x, y):
        def build(context, builder, kinds, arguments):
            spread = []
            for kind, value in zip(kinds.args, arguments, strict=True):
                if kind != LANES:
                    value = context.cast(builder, value, kind, types.float64)
                    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.IntType(32)(0))
                    mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), [0] * 4)
                    value = builder.shuffle_vector(first, first, mask)
                spread.append(value)
            return combine(builder, *spread)

        return LANES(x, y), build

    return operation


def _binary(function, combine):
    operation = _elementwise(combine)

    @overload(function, jit_options=INLINE)
    def _(x, y):
        if LANES in (x, y):
            return lambda x, y: operation(x, y)
        return None


_binary(operator.add, lambda builder, x, y: builder.fadd(x, y, flags=_FLAGS))
_binary(operator.sub, lambda builder, x, y: builder.fsub(x, y, flags=_FLAGS))
_binary(operator.mul, lambda builder, x, y: builder.fmul(x, y, flags=_FLAGS))
_binary(operator.truediv, lambda builder, x, y: builder.fdiv(x, y))

_select = _elementwise(lambda builder, test, x: builder.select(builder.fcmp_ordered(">", test, _ZERO), x, _ZERO))


def _unary(name):
    @intrinsic
    def operation(typing_context, x):
        def build(context, builder, kinds, arguments):
            kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v4f64")
            return builder.call(function, arguments)

        return LANES(LANES), build

    return operation


_sqrt, _fabs = _unary("sqrt"), _unary("fabs")


@overload(operator.neg, jit_options=INLINE)
def _negative(x):
    if x == LANES:
        return lambda x: 0.0 - x
    return None


@overload(abs, jit_options=INLINE)
def _absolute(x):
    if x == LANES:
        return lambda x: _fabs(x)
    return None


@overload(sqrt, jit_options=INLINE)
def _sqrt_overload(x):
    if x == LANES:
        return lambda x: _sqrt(x)
    return lambda x: math.sqrt(x)


@overload(positive, jit_options=INLINE)
def _positive(x):
    if x == LANES:
        return lambda x: _select(x, x)
    return lambda x: x if x > 0.0 else 0.0


@overload(where, jit_options=INLINE)
def _where(test, x):
    if LANES in (test, x):
        return lambda test, x: _select(test, x)
    return lambda test, x: x if test > 0.0 else 0.0


@overload(sign, jit_options=INLINE)
def _sign(x):
    if x == LANES:
        return lambda x: where(x, 2.0) - 1.0
    return lambda x: 1.0 if x > 0.0 else -1.0


@overload(any_positive, jit_options=INLINE)
def _any_positive(x):
    if x == LANES:

        def any_lane(x):
            a, b, c, d = numbers(x)
            return a > 0.0 or b > 0.0 or c > 0.0 or d > 0.0

        return any_lane
    return lambda x: x > 0.0
