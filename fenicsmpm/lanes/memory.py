# SPDX-License-Identifier: MIT
"""Loads and stores of rows and lines in memory, without bounds checks."""

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
    LINE_LANES,
    ROW,
    SHORT_VECTOR,
    VECTOR,
    shuffle,
)


def _address(context, builder, array_type, array, index):
    """Return the address of a number in a contiguous array, without checks of the index."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.gep(data, [index])


def row_address(context, builder, array_type, array, row, kind=VECTOR):
    """Return an LLVM pointer to a row, or another vector, of a contiguous array."""
    index = builder.mul(row, ir.Constant(INT64, kind.count))
    address = _address(context, builder, array_type, array, index)
    return builder.bitcast(address, kind.as_pointer())


def _access(register, kind, what):
    """Return functions that read and write vectors of one kind."""

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

    load.__doc__ = f"Return {what} i of a C-contiguous array ``(n, {kind.count})``."
    store.__doc__ = f"Overwrite {what} i of a C-contiguous array ``(n, {kind.count})``."
    return load, store


load, store = _access(ROW, VECTOR, "row")
load_line, store_line = _access(LINE, SHORT_VECTOR, "line")


@intrinsic
def prefetch(_typing, rows, i):
    """Prefetch row i of a C-contiguous array ``(n, 8)``; the row need not exist."""

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
    """Return element i of a flattened C-contiguous array."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature.args[0], *arguments))

    return types.float64(numbers, types.intp), generate


@intrinsic
def line_of(_typing, a, b, c, d):
    """Return the line of four numbers."""

    def generate(_context, builder, _signature, numbers):
        line = ir.Constant(SHORT_VECTOR, ir.Undefined)
        for i, number in enumerate(numbers):
            line = builder.insert_element(line, number, ir.Constant(INT32, i))
        return line

    return LINE(*[types.float64] * LINE_LANES), generate


@intrinsic
def line_at(_typing, numbers, i):
    """Return four numbers of a flattened C-contiguous array from element i on."""

    def generate(context, builder, signature, arguments):
        address = _address(context, builder, signature.args[0], *arguments)
        return builder.load(builder.bitcast(address, SHORT_VECTOR.as_pointer()), align=8)

    return LINE(numbers, types.intp), generate


# Of two rows: alternately the first numbers of each pair, and the second ones
_EVEN, _ODD = (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)
# Of two rows, in each half: the first two numbers of both, and the last two of both
_FIRST, _LAST = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)


def _transpose(builder, rows):
    """Transpose the 4 x 4 matrices of the first and of the last halves of four rows."""
    a, b, c, d = rows
    even, odd = shuffle(builder, a, b, _EVEN), shuffle(builder, a, b, _ODD)
    even_2, odd_2 = shuffle(builder, c, d, _EVEN), shuffle(builder, c, d, _ODD)
    pairs = (even, even_2), (odd, odd_2)
    return [shuffle(builder, *pair, places) for places in (_FIRST, _LAST) for pair in pairs]


def _line_addresses(context, builder, array_type, array, first):
    for i in range(LANES):
        line = builder.add(first, ir.Constant(INT64, i))
        yield row_address(context, builder, array_type, array, line, SHORT_VECTOR)


@intrinsic
def load_columns(_typing, lines, first):
    """Return the four columns of the eight lines from `first` on in ``(n, 4)``, as rows."""

    def generate(context, builder, signature, arguments):
        addresses = _line_addresses(context, builder, signature.args[0], *arguments)
        loaded = [builder.load(address, align=8) for address in addresses]
        halves = [shuffle(builder, loaded[i], loaded[i + 4], range(8)) for i in range(4)]
        columns = _transpose(builder, halves)
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(ROW, LINE_LANES)(lines, types.intp), generate


@intrinsic
def store_columns(_typing, lines, first, a, b, c, d):
    """Overwrite the eight lines from `first` on in ``(n, 4)`` with four rows as columns."""

    def generate(context, builder, signature, arguments):
        array, first, *columns = arguments
        addresses = _line_addresses(context, builder, signature.args[0], array, first)
        halves = _transpose(builder, columns)
        for places in (range(4), range(4, 8)):
            for half in halves:
                line = shuffle(builder, half, half, places)
                builder.store(line, next(addresses), align=8)
        return context.get_dummy_value()

    return types.void(lines, types.intp, ROW, ROW, ROW, ROW), generate


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
