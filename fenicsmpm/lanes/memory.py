# SPDX-License-Identifier: MIT
"""Rows and lines in memory, without looking whether indices are in range."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False, disable-error-code=misc

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fenicsmpm.lanes.rows import (
    INT32,
    INT64,
    INTEGERS,
    LANES,
    LINE,
    ROW,
    SHORT_VECTOR,
    VECTOR,
)


def _address(context, builder, array_type, array, index):
    """Of a number in a contiguous array, without looking whether the index is negative."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.gep(data, [index])


def row_address(context, builder, array_type, array, row, kind=VECTOR):
    """LLVM pointer to a row, or another vector, of a contiguous array."""
    index = builder.mul(row, ir.Constant(INT64, kind.count))
    address = _address(context, builder, array_type, array, index)
    return builder.bitcast(address, kind.as_pointer())


def _access(register, kind, what):
    """Functions that read and write vectors of one kind."""

    @intrinsic
    def load(_typing, array, i):
        def generate(context, builder, signature, arguments):
            address = row_address(context, builder, signature.args[0], *arguments, kind)
            return builder.load(address, align=8)

        return register(array, types.intp), generate

    @intrinsic
    def store(_typing, array, i, value):
        def generate(context, builder, signature, arguments):
            array, i, value = arguments
            address = row_address(context, builder, signature.args[0], array, i, kind)
            builder.store(value, address, align=8)
            return context.get_dummy_value()

        return types.void(array, types.intp, register), generate

    load.__doc__ = f"{what.capitalize()} i of a C-contiguous array ``(n, {kind.count})``."
    store.__doc__ = f"Overwrite {what} i of a C-contiguous array ``(n, {kind.count})``."
    return load, store


load, store = _access(ROW, VECTOR, "row")
load_line, store_line = _access(LINE, SHORT_VECTOR, "line")


@intrinsic
def prefetch(_typing, rows, i):
    """Have row i of a C-contiguous array ``(n, 8)`` brought near; it need not exist."""

    def generate(context, builder, signature, arguments):
        address = row_address(context, builder, signature.args[0], *arguments)
        pointer = ir.IntType(8).as_pointer()
        function_type = ir.FunctionType(ir.VoidType(), [pointer, *[INT32] * 3])
        function = cgutils.get_or_insert_function(
            builder.module, function_type, "llvm.prefetch.p0i8"
        )
        to_read, into_all_caches, data = (ir.Constant(INT32, n) for n in (0, 3, 1))
        address = builder.bitcast(address, pointer)
        builder.call(function, [address, to_read, into_all_caches, data])
        return context.get_dummy_value()

    return types.void(rows, types.intp), generate


@intrinsic
def number_at(_typing, numbers, i):
    """Element i of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature.args[0], *arguments))

    return types.float64(numbers, types.intp), generate


@intrinsic
def line_at(_typing, numbers, i):
    """The four numbers of a C-contiguous array from element i on, counted through."""

    def generate(context, builder, signature, arguments):
        address = _address(context, builder, signature.args[0], *arguments)
        return builder.load(builder.bitcast(address, SHORT_VECTOR.as_pointer()), align=8)

    return LINE(numbers, types.intp), generate


@intrinsic
def load_column(_typing, numbers, first, step):
    """Row of the elements ``first + i * step`` of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        array, index, step = arguments
        row = ir.Constant(VECTOR, ir.Undefined)
        for i in range(LANES):
            number = builder.load(_address(context, builder, signature.args[0], array, index))
            row = builder.insert_element(row, number, ir.Constant(INT32, i))
            index = builder.add(index, step)
        return row

    return ROW(numbers, types.intp, types.intp), generate


@intrinsic
def store_column(_typing, numbers, first, step, row):
    """Overwrite the elements ``first + i * step`` of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        array, index, step, row = arguments
        for i in range(LANES):
            number = builder.extract_element(row, ir.Constant(INT32, i))
            builder.store(number, _address(context, builder, signature.args[0], array, index))
            index = builder.add(index, step)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, types.intp, ROW), generate


@intrinsic
def store_integers(_typing, integers, row):
    """Overwrite a C-contiguous array ``(8,)`` of int64 with a row of whole numbers."""

    def generate(context, builder, signature, arguments):
        array, row = arguments
        address = _address(context, builder, signature.args[0], array, ir.Constant(INT64, 0))
        address = builder.bitcast(address, INTEGERS.as_pointer())
        builder.store(builder.fptosi(row, INTEGERS), address, align=8)
        return context.get_dummy_value()

    return types.void(integers, ROW), generate
