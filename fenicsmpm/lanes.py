# SPDX-License-Identifier: MIT
"""Eight numbers at once in loops compiled by numba, in one vector register.

A ``Row`` behaves like a number in formulas: operators ``+ - * /``, ``min``, ``max``, ``math.sqrt``
and ``math.floor`` act on each of its lanes. So what is written for one point can be compiled for
eight of them, if it has no branches. Rows are loaded from arrays ``(n, 8)``. A ``Line`` are four
numbers of an array ``(n, 4)``, which can only be summed up.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False, disable-error-code=misc

from __future__ import annotations

import functools
import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES, LINE_LANES = 8, 4

_DOUBLE, _INT64, _INT32 = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_VECTOR, _INTEGERS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_INT64, LANES)
_SHORT_VECTOR = ir.VectorType(_DOUBLE, LINE_LANES)
# products and sums may be fused: faster and not less accurate
_FUSE = ("contract",)
_NUMBERS = (types.Float, types.Integer)


class RowType(types.Type):
    """Numba's type of a row."""

    def __init__(self):
        """Name it."""
        super().__init__(name="Row")


class LineType(types.Type):
    """Numba's type of a line."""

    def __init__(self):
        """Name it."""
        super().__init__(name="Line")


ROW, LINE = RowType(), LineType()


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager, row_type):
        super().__init__(manager, row_type, _VECTOR)


@register_model(LineType)
class _LineModel(models.PrimitiveModel):
    def __init__(self, manager, line_type):
        super().__init__(manager, line_type, _SHORT_VECTOR)


def _splat(builder, number, kind=_VECTOR):
    """LLVM vector with the same number in each lane."""
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(_INT32, 0))
    mask = ir.Constant(ir.VectorType(_INT32, kind.count), None)
    return builder.shuffle_vector(first, undefined, mask)


def _call(builder, name, kind, *arguments):
    """LLVM's own function of one or more vectors or doubles."""
    suffix = "f64" if kind is _DOUBLE else f"v{kind.count}f64"
    function_type = ir.FunctionType(kind, [kind] * len(arguments))
    function = cgutils.get_or_insert_function(
        builder.module, function_type, f"llvm.{name}.{suffix}"
    )
    return builder.call(function, arguments)


# --- operators and functions of the language -----------------------------------------------------


def _is_row_function(arguments):
    return ROW in arguments and all(a is ROW or isinstance(a, _NUMBERS) for a in arguments)


def _define(function, count, build):
    """Make a function act on rows, and on rows with numbers.

    Args:
        function: such as ``operator.add``.
        count: of its arguments.
        build: ``build(builder, *vectors)``, the LLVM code.
    """

    @type_callable(function)
    def _typer(_context):
        def typer(*arguments):
            if len(arguments) == count and _is_row_function(arguments):
                return ROW
            return None

        # numba looks at the signature
        if count == 1:
            return lambda a: typer(a)
        return lambda a, b: typer(a, b)

    def generate(context, builder, signature, arguments):
        vectors = [
            value
            if kind is ROW
            else _splat(builder, context.cast(builder, value, kind, types.float64))
            for kind, value in zip(signature.args, arguments, strict=True)
        ]
        return build(builder, *vectors)

    if count == 1:
        lower_builtin(function, ROW)(generate)
        return
    lower_builtin(function, ROW, ROW)(generate)
    for number in _NUMBERS:
        lower_builtin(function, ROW, number)(generate)
        lower_builtin(function, number, ROW)(generate)


for _operators, _build in (
    ((operator.add, operator.iadd), lambda b, x, y: b.fadd(x, y, flags=_FUSE)),
    ((operator.sub, operator.isub), lambda b, x, y: b.fsub(x, y, flags=_FUSE)),
    ((operator.mul, operator.imul), lambda b, x, y: b.fmul(x, y, flags=_FUSE)),
    ((operator.truediv, operator.itruediv), lambda b, x, y: b.fdiv(x, y)),
):
    for _operator in _operators:
        _define(_operator, 2, _build)
_define(operator.neg, 1, lambda b, x: b.fneg(x))
_define(math.sqrt, 1, lambda b, x: _call(b, "sqrt", _VECTOR, x))
_define(math.floor, 1, lambda b, x: _call(b, "floor", _VECTOR, x))
_define(min, 2, lambda b, x, y: _call(b, "minnum", _VECTOR, x, y))
_define(max, 2, lambda b, x, y: _call(b, "maxnum", _VECTOR, x, y))


# --- what the language does not have -------------------------------------------------------------


@intrinsic
def zeros(_typing):
    """A row of zeros."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(_VECTOR, None)

    return ROW(), generate


@intrinsic
def zero_line(_typing):
    """A line of zeros."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(_SHORT_VECTOR, None)

    return LINE(), generate


@intrinsic
def add_scaled(_typing, total, factor, vector):
    """Total + factor * vector, rows or lines with a number as factor, rounded once."""

    def generate(_context, builder, signature, arguments):
        kind = _VECTOR if signature.return_type is ROW else _SHORT_VECTOR
        total, factor, vector = arguments
        return _call(builder, "fma", kind, _splat(builder, factor, kind), vector, total)

    return total(total, types.float64, total), generate


@intrinsic
def between(_typing, row, low, high):
    """Whether all lanes are in ``low <= row <= high``; NaN is not."""

    def generate(context, builder, signature, arguments):
        low, high = (
            _splat(builder, context.cast(builder, value, kind, types.float64))
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        )
        above = builder.fcmp_ordered(">=", arguments[0], low)
        below = builder.fcmp_ordered("<=", arguments[0], high)
        lanes = builder.bitcast(builder.and_(above, below), ir.IntType(LANES))
        return builder.icmp_unsigned("==", lanes, ir.Constant(ir.IntType(LANES), 2**LANES - 1))

    return types.boolean(ROW, low, high), generate


@intrinsic
def if_positive(_typing, condition, value):
    """The value where the condition is above zero, NaN elsewhere; of rows or of numbers."""

    def generate(_context, builder, signature, arguments):
        kind = _VECTOR if signature.args[0] is ROW else _DOUBLE
        positive = builder.fcmp_ordered(">", arguments[0], ir.Constant(kind, None))
        nan = ir.Constant(_DOUBLE, math.nan)
        return builder.select(
            positive, arguments[1], _splat(builder, nan) if kind is _VECTOR else nan
        )

    kind = ROW if condition is ROW else types.float64
    return kind(kind, kind), generate


# bits of 1.0, and what the least error of the guess below takes from them
_BITS_OF_ONE, _SHIFT = 0x3FF0000000000000, 0.0505 * 2**52


@intrinsic
def rough_inverse_cube_root(_typing, x):
    """x^(-1/3) with an error of a few percent for positive x; of rows or of numbers.

    The bits of a double, read as an integer, are nearly linear in its logarithm.
    """

    def generate(_context, builder, signature, arguments):
        is_row = signature.args[0] is ROW
        kind, integer = (_VECTOR, _INTEGERS) if is_row else (_DOUBLE, _INT64)

        def constant(value):
            number = ir.Constant(_DOUBLE, value)
            return _splat(builder, number) if is_row else number

        bits = builder.sitofp(builder.bitcast(arguments[0], integer), kind)
        third = builder.fmul(bits, constant(-1.0 / 3.0))
        guess = builder.fadd(third, constant((4.0 / 3.0) * _BITS_OF_ONE - _SHIFT))
        return builder.bitcast(builder.fptosi(guess, integer), kind)

    kind = ROW if x is ROW else types.float64
    return kind(kind), generate


# --- memory --------------------------------------------------------------------------------------


def _address(context, builder, array_type, array, index):
    """Of a number in a contiguous array, without looking whether the index is negative."""
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.gep(data, [index])


def _row_address(context, builder, array_type, array, row, kind=_VECTOR):
    index = builder.mul(row, ir.Constant(_INT64, kind.count))
    address = _address(context, builder, array_type, array, index)
    return builder.bitcast(address, kind.as_pointer())


@intrinsic
def load(_typing, rows, i):
    """Row i of a C-contiguous array ``(n, 8)``."""

    def generate(context, builder, signature, arguments):
        address = _row_address(context, builder, signature.args[0], *arguments)
        return builder.load(address, align=8)

    return ROW(rows, types.intp), generate


@intrinsic
def store(_typing, rows, i, row):
    """Overwrite row i of a C-contiguous array ``(n, 8)``."""

    def generate(context, builder, signature, arguments):
        array, i, row = arguments
        builder.store(row, _row_address(context, builder, signature.args[0], array, i), align=8)
        return context.get_dummy_value()

    return types.void(rows, types.intp, ROW), generate


@intrinsic
def load_line(_typing, lines, i):
    """Line i of a C-contiguous array ``(n, 4)``."""

    def generate(context, builder, signature, arguments):
        array, i = arguments
        address = _row_address(context, builder, signature.args[0], array, i, _SHORT_VECTOR)
        return builder.load(address, align=8)

    return LINE(lines, types.intp), generate


@intrinsic
def store_line(_typing, lines, i, line):
    """Overwrite line i of a C-contiguous array ``(n, 4)``."""

    def generate(context, builder, signature, arguments):
        array, i, line = arguments
        address = _row_address(context, builder, signature.args[0], array, i, _SHORT_VECTOR)
        builder.store(line, address, align=8)
        return context.get_dummy_value()

    return types.void(lines, types.intp, LINE), generate


@intrinsic
def number_at(_typing, numbers, i):
    """Element i of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature.args[0], *arguments))

    return types.float64(numbers, types.intp), generate


@intrinsic
def load_column(_typing, numbers, first, step):
    """Row of the elements ``first + i * step`` of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        array, index, step = arguments
        row = ir.Constant(_VECTOR, ir.Undefined)
        for i in range(LANES):
            number = builder.load(_address(context, builder, signature.args[0], array, index))
            row = builder.insert_element(row, number, ir.Constant(_INT32, i))
            index = builder.add(index, step)
        return row

    return ROW(numbers, types.intp, types.intp), generate


@intrinsic
def store_column(_typing, numbers, first, step, row):
    """Overwrite the elements ``first + i * step`` of a C-contiguous array, counted through."""

    def generate(context, builder, signature, arguments):
        array, index, step, row = arguments
        for i in range(LANES):
            number = builder.extract_element(row, ir.Constant(_INT32, i))
            builder.store(number, _address(context, builder, signature.args[0], array, index))
            index = builder.add(index, step)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, types.intp, ROW), generate


@intrinsic
def store_integers(_typing, integers, row):
    """Overwrite a C-contiguous array ``(8,)`` of int64 with a row of whole numbers."""

    def generate(context, builder, signature, arguments):
        array, row = arguments
        address = _address(context, builder, signature.args[0], array, ir.Constant(_INT64, 0))
        address = builder.bitcast(address, _INTEGERS.as_pointer())
        builder.store(builder.fptosi(row, _INTEGERS), address, align=8)
        return context.get_dummy_value()

    return types.void(integers, ROW), generate


# --- tensors -------------------------------------------------------------------------------------


class TensorsType(types.Type):
    """Numba's type of 3x3 tensors in eight lanes: ``T[j, k]`` is a row, to be read or set."""

    def __init__(self):
        """Name it."""
        super().__init__(name="Tensors")


TENSORS = TensorsType()


@register_model(TensorsType)
class _TensorsModel(models.PrimitiveModel):
    def __init__(self, manager, tensors_type):
        super().__init__(manager, tensors_type, _VECTOR.as_pointer())


@intrinsic
def tensors(_typing, rows):
    """The rows of a C-contiguous array ``(9, 8)`` as eight tensors."""

    def generate(context, builder, signature, arguments):
        return _row_address(context, builder, signature.args[0], *arguments, ir.Constant(_INT64, 0))

    return TENSORS(rows), generate


def _component(context, builder, kind, tensor, index):
    j, k = (
        context.cast(builder, value, each, types.intp)
        for value, each in zip(cgutils.unpack_tuple(builder, index, 2), kind, strict=True)
    )
    return builder.gep(tensor, [builder.add(builder.mul(j, ir.Constant(_INT64, 3)), k)])


def _is_pair(index):
    return isinstance(index, types.BaseTuple) and [
        isinstance(each, types.Integer) for each in index
    ] == [True, True]


@type_callable(operator.getitem)
def _type_getitem(_context):
    def typer(tensor, index):
        return ROW if tensor is TENSORS and _is_pair(index) else None

    return typer


@lower_builtin(operator.getitem, TENSORS, types.BaseTuple)
def _getitem(context, builder, signature, arguments):
    address = _component(context, builder, signature.args[1], *arguments)
    return builder.load(address, align=8)


@type_callable(operator.setitem)
def _type_setitem(_context):
    def typer(tensor, index, value):
        if tensor is TENSORS and _is_pair(index) and (value is ROW or isinstance(value, _NUMBERS)):
            return types.void(tensor, index, ROW if value is ROW else types.float64)
        return None

    return typer


@lower_builtin(operator.setitem, TENSORS, types.BaseTuple, types.Any)
def _setitem(context, builder, signature, arguments):
    tensor, index, value = arguments
    row = value if signature.args[2] is ROW else _splat(builder, value)
    address = _component(context, builder, signature.args[1], tensor, index)
    builder.store(row, address, align=8)
    return context.get_dummy_value()


@functools.cache
def works_on_rows(update: Any) -> bool:
    """Whether a law's function can be compiled for eight points at once: it has no branches."""
    from numba.core.errors import NumbaError

    parameters = types.Array(types.float64, 1, "C")
    try:
        update.compile(types.void(TENSORS, TENSORS, parameters, parameters, TENSORS))
    except NumbaError:
        return False
    return True
