# SPDX-License-Identifier: MIT
"""Rows of eight numbers that numba keeps in one vector register.

All that a grid node receives from a point, and all that it gives back, is one row of 64 bytes, a
cache line. A transfer is then a few fused multiply-adds of rows a node.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False, disable-error-code=misc

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

LANES = 8

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INT = ir.IntType(32)


class RowType(types.Type):
    """Numba's type of a row."""

    def __init__(self):
        """Name it."""
        super().__init__(name="Row")


_ROW = RowType()


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager, row_type):
        super().__init__(manager, row_type, _VECTOR)


@intrinsic
def zeros(_typing):
    """A row of zeros."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(_VECTOR, None)

    return _ROW(), generate


@intrinsic
def scaled(_typing, factor, vector):
    """Factor * vector."""

    def generate(_context, builder, _signature, arguments):
        return builder.fmul(_splat(builder, arguments[0]), arguments[1])

    return _ROW(types.float64, _ROW), generate


@intrinsic
def add_scaled(_typing, total, factor, vector):
    """Total + factor * vector, rounded once."""

    def generate(_context, builder, _signature, arguments):
        fma_type = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        fma = cgutils.get_or_insert_function(builder.module, fma_type, f"llvm.fma.v{LANES}f64")
        return builder.call(fma, [_splat(builder, arguments[1]), arguments[2], arguments[0]])

    return _ROW(_ROW, types.float64, _ROW), generate


@intrinsic
def load(_typing, rows, i):
    """Row i of a C-contiguous array ``(n, 8)``."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature, arguments), align=8)

    return _ROW(rows, types.intp), generate


@intrinsic
def store(_typing, rows, i, vector):
    """Overwrite row i of a C-contiguous array ``(n, 8)``."""

    def generate(context, builder, signature, arguments):
        builder.store(arguments[2], _address(context, builder, signature, arguments), align=8)
        return context.get_dummy_value()

    return types.void(rows, types.intp, _ROW), generate


@intrinsic
def number_at(_typing, numbers, i):
    """Element i of a C-contiguous array ``(n,)``; i is not negative, which saves looking."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, value=arguments[0])
        return builder.load(builder.gep(array.data, [arguments[1]]))

    return types.float64(numbers, types.intp), generate


@intrinsic
def add_at(_typing, numbers, i, number):
    """Add to element i of a C-contiguous array ``(n,)``; i is not negative."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, value=arguments[0])
        address = builder.gep(array.data, [arguments[1]])
        builder.store(builder.fadd(builder.load(address), arguments[2]), address)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, types.float64), generate


def _splat(builder, number):
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(_INT, 0))
    mask = ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, mask)


def _address(context, builder, signature, arguments):
    array = context.make_array(signature.args[0])(context, builder, value=arguments[0])
    index = builder.mul(arguments[1], ir.Constant(arguments[1].type, LANES))
    return builder.bitcast(builder.gep(array.data, [index]), _VECTOR.as_pointer())
