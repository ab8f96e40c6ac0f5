# SPDX-License-Identifier: MIT
"""Eight numbers at once in one vector register, in loops compiled by numba.

A ``Row`` behaves like a number in formulas: operators ``+ - * /``, ``min``, ``max``, ``math.sqrt``,
``math.exp`` and ``math.floor`` act on each of its lanes. Of NaN and a number, ``min`` and ``max``
return the number. Code written for one point can thus be compiled for eight, if it has no branches.
Rows are loaded from arrays ``(n, 8)``. A ``Line`` consists of four numbers of an array ``(n, 4)``,
which can only be scaled and added up.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False, disable-error-code=misc

from __future__ import annotations

import math
import operator

from llvmlite import binding, ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES, LINE_LANES = 8, 4


def _has_wide_registers():
    """Return whether a register holds a row, and the processor works on all of it at once."""
    name = config.CPU_NAME or binding.get_host_cpu_name()
    if config.CPU_FEATURES is not None:
        features = config.CPU_FEATURES.split(",")
    else:
        features = binding.get_host_cpu_features().flatten().split(",")
    return "+avx512f" in features and name != "znver4"  # works on one half after the other


# Whether nodal values are added row by row, instead of line by line
WIDE = _has_wide_registers()

DOUBLE, INT64, INT32 = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
VECTOR, INTEGERS = ir.VectorType(DOUBLE, LANES), ir.VectorType(INT64, LANES)
SHORT_VECTOR = ir.VectorType(DOUBLE, LINE_LANES)
# products and sums may be fused, which is faster and no less accurate
_FUSE = ("contract",)
NUMBERS = (types.Float, types.Integer)


class RowType(types.Type):
    """Numba type of a row."""

    def __init__(self):
        """Set the name."""
        super().__init__(name="Row")


class LineType(types.Type):
    """Numba type of a line."""

    def __init__(self):
        """Set the name."""
        super().__init__(name="Line")


ROW, LINE = RowType(), LineType()


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager, row_type):
        super().__init__(manager, row_type, VECTOR)


@register_model(LineType)
class _LineModel(models.PrimitiveModel):
    def __init__(self, manager, line_type):
        super().__init__(manager, line_type, SHORT_VECTOR)


def splat(builder, number, kind=VECTOR):
    """Return an LLVM vector with the same number in each lane."""
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(INT32, 0))
    mask = ir.Constant(ir.VectorType(INT32, kind.count), None)
    return builder.shuffle_vector(first, undefined, mask)


def _call(builder, name, kind, *arguments):
    """Call LLVM's own function of one or more vectors or doubles."""
    suffix = "f64" if kind is DOUBLE else f"v{kind.count}f64"
    function_type = ir.FunctionType(kind, [kind] * len(arguments))
    function = cgutils.get_or_insert_function(
        builder.module, function_type, f"llvm.{name}.{suffix}"
    )
    return builder.call(function, arguments)


# --- operators and functions of Python -----------------------------------------------------------


def _is_row_function(arguments):
    return ROW in arguments and all(a is ROW or isinstance(a, NUMBERS) for a in arguments)


def _define(function, count, build):
    """Make a function act on rows, and on rows with numbers.

    Args:
        function: Function, such as ``operator.add``.
        count: Number of its arguments.
        build: Function ``build(builder, *vectors)`` that returns the LLVM code.
    """

    @type_callable(function)
    def _typer(_context):
        def typer(*arguments):
            if len(arguments) == count and _is_row_function(arguments):
                return ROW
            return None

        # numba inspects the signature
        if count == 1:
            return lambda a: typer(a)
        return lambda a, b: typer(a, b)

    def generate(context, builder, signature, arguments):
        vectors = [
            value
            if kind is ROW
            else splat(builder, context.cast(builder, value, kind, types.float64))
            for kind, value in zip(signature.args, arguments, strict=True)
        ]
        return build(builder, *vectors)

    if count == 1:
        lower_builtin(function, ROW)(generate)
        return
    lower_builtin(function, ROW, ROW)(generate)
    for number in NUMBERS:
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
_define(math.sqrt, 1, lambda b, x: _call(b, "sqrt", VECTOR, x))
# calls the function of numbers for one lane after the other
_define(math.exp, 1, lambda b, x: _call(b, "exp", VECTOR, x))
_define(math.floor, 1, lambda b, x: _call(b, "floor", VECTOR, x))
_define(min, 2, lambda b, x, y: _call(b, "minnum", VECTOR, x, y))
_define(max, 2, lambda b, x, y: _call(b, "maxnum", VECTOR, x, y))


# --- functions that Python does not have ---------------------------------------------------------


@intrinsic
def zeros(_typing):
    """Return a row of zeros."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(VECTOR, None)

    return ROW(), generate


@intrinsic
def zero_line(_typing):
    """Return a line of zeros."""

    def generate(_context, _builder, _signature, _arguments):
        return ir.Constant(SHORT_VECTOR, None)

    return LINE(), generate


@intrinsic
def add_scaled(_typing, total, factor, vector):
    """Return total + factor * vector, rows or lines with a number as factor, rounded once."""

    def generate(_context, builder, signature, arguments):
        kind = VECTOR if signature.return_type is ROW else SHORT_VECTOR
        total, factor, vector = arguments
        return _call(builder, "fma", kind, splat(builder, factor, kind), vector, total)

    return total(total, types.float64, total), generate


@intrinsic
def scaled(_typing, factor, line):
    """Return factor * line, or factor * row."""

    def generate(_context, builder, signature, arguments):
        kind = VECTOR if signature.return_type is ROW else SHORT_VECTOR
        factor, line = arguments
        return builder.fmul(splat(builder, factor, kind), line, flags=_FUSE)

    return line(types.float64, line), generate


def shuffle(builder, a, b, places):
    """Return the numbers at some places of two LLVM vectors, one after the other."""
    mask = ir.Constant(ir.VectorType(INT32, len(places)), [ir.Constant(INT32, i) for i in places])
    return builder.shuffle_vector(a, b, mask)


@intrinsic
def join(_typing, low, high):
    """Return the row of two lines."""

    def generate(_context, builder, _signature, arguments):
        return shuffle(builder, *arguments, range(LANES))

    return ROW(low, high), generate


@intrinsic
def low_half(_typing, row):
    """Return the line of the first four numbers of a row."""

    def generate(_context, builder, _signature, arguments):
        return shuffle(builder, *arguments, *arguments, range(LINE_LANES))

    return LINE(row), generate


@intrinsic
def high_half(_typing, row):
    """Return the line of the last four numbers of a row."""

    def generate(_context, builder, _signature, arguments):
        return shuffle(builder, *arguments, *arguments, range(LINE_LANES, LANES))

    return LINE(row), generate


@intrinsic
def between(_typing, row, low, high):
    """Return whether all lanes are in ``low <= row <= high``; NaN is not."""

    def generate(context, builder, signature, arguments):
        low, high = (
            splat(builder, context.cast(builder, value, kind, types.float64))
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        )
        above = builder.fcmp_ordered(">=", arguments[0], low)
        below = builder.fcmp_ordered("<=", arguments[0], high)
        lanes = builder.bitcast(builder.and_(above, below), ir.IntType(LANES))
        return builder.icmp_unsigned("==", lanes, ir.Constant(ir.IntType(LANES), 2**LANES - 1))

    return types.boolean(ROW, low, high), generate


@intrinsic
def choose(_typing, condition, value, other):
    """Return the value where the condition is positive, else the other; rows or numbers."""

    def generate(context, builder, signature, arguments):
        vectors = [
            argument
            if kind is ROW or signature.return_type is types.float64
            else splat(builder, argument)
            for kind, argument in zip(signature.args, arguments, strict=True)
        ]
        zero = ir.Constant(vectors[0].type, None)
        return builder.select(builder.fcmp_ordered(">", vectors[0], zero), *vectors[1:])

    kinds = [ROW if kind is ROW else types.float64 for kind in (condition, value, other)]
    return (ROW if ROW in kinds else types.float64)(*kinds), generate


# bits of 1.0, less what minimizes the error of the guess below
_BITS_OF_ONE, _SHIFT = 0x3FF0000000000000, 0.0505 * 2**52


@intrinsic
def rough_inverse_cube_root(_typing, x):
    """Return x^(-1/3) with an error of a few percent for positive x; rows or numbers.

    The bits of a double, read as an integer, are nearly linear in its logarithm.
    """

    def generate(_context, builder, signature, arguments):
        is_row = signature.args[0] is ROW
        kind, integer = (VECTOR, INTEGERS) if is_row else (DOUBLE, INT64)

        def constant(value):
            number = ir.Constant(DOUBLE, value)
            return splat(builder, number) if is_row else number

        bits = builder.sitofp(builder.bitcast(arguments[0], integer), kind)
        third = builder.fmul(bits, constant(-1.0 / 3.0))
        guess = builder.fadd(third, constant((4.0 / 3.0) * _BITS_OF_ONE - _SHIFT))
        return builder.bitcast(builder.fptosi(guess, integer), kind)

    kind = ROW if x is ROW else types.float64
    return kind(kind), generate
