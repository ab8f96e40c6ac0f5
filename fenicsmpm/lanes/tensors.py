# SPDX-License-Identifier: MIT
"""Tensors at eight points, for constitutive laws."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False, disable-error-code=misc

from __future__ import annotations

import functools
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    lower_builtin,
    models,
    register_model,
    type_callable,
)

from fenicsmpm._njit import compiles
from fenicsmpm.lanes.memory import row_address
from fenicsmpm.lanes.rows import INT64, NUMBERS, ROW, VECTOR, splat


class TensorsType(types.Type):
    """Numba type of 3x3 tensors in eight lanes: ``T[j, k]`` is a row, to be read or set.

    ``T[k]`` is the k-th of any number of rows.
    """

    def __init__(self):
        """Set the name."""
        super().__init__(name="Tensors")


TENSORS = TensorsType()


@register_model(TensorsType)
class _TensorsModel(models.PrimitiveModel):
    def __init__(self, manager, tensors_type):
        super().__init__(manager, tensors_type, VECTOR.as_pointer())


@intrinsic
def tensors(_typing, rows, first):
    """Return rows of a C-contiguous array ``(n, 8)`` from `first` on as tensor components."""

    def generate(context, builder, signature, arguments):
        return row_address(context, builder, signature.args[0], *arguments)

    return TENSORS(rows, types.intp), generate


def _component(context, builder, kind, tensor, index):
    if isinstance(kind, types.Integer):
        return builder.gep(tensor, [context.cast(builder, index, kind, types.intp)])
    j, k = (
        context.cast(builder, value, each, types.intp)
        for value, each in zip(cgutils.unpack_tuple(builder, index, 2), kind, strict=True)
    )
    return builder.gep(tensor, [builder.add(builder.mul(j, ir.Constant(INT64, 3)), k)])


def _is_index(index):
    if isinstance(index, types.Integer):
        return True
    return isinstance(index, types.BaseTuple) and [
        isinstance(each, types.Integer) for each in index
    ] == [True, True]


@type_callable(operator.getitem)
def _type_getitem(_context):
    def typer(tensor, index):
        return ROW if tensor is TENSORS and _is_index(index) else None

    return typer


@lower_builtin(operator.getitem, TENSORS, types.Integer)
@lower_builtin(operator.getitem, TENSORS, types.BaseTuple)
def _getitem(context, builder, signature, arguments):
    address = _component(context, builder, signature.args[1], *arguments)
    return builder.load(address, align=8)


@type_callable(operator.setitem)
def _type_setitem(_context):
    def typer(tensor, index, value):
        if tensor is TENSORS and _is_index(index) and (value is ROW or isinstance(value, NUMBERS)):
            return types.void(tensor, index, ROW if value is ROW else types.float64)
        return None

    return typer


@lower_builtin(operator.setitem, TENSORS, types.Integer, types.Any)
@lower_builtin(operator.setitem, TENSORS, types.BaseTuple, types.Any)
def _setitem(context, builder, signature, arguments):
    tensor, index, value = arguments
    row = value if signature.args[2] is ROW else splat(builder, value)
    address = _component(context, builder, signature.args[1], tensor, index)
    builder.store(row, address, align=8)
    return context.get_dummy_value()


@functools.cache
def works_on_rows(update: Any) -> bool:
    """Return whether a law's function, as it has no branches, can be compiled for eight points."""
    parameters = types.Array(types.float64, 1, "C")
    return compiles(update, types.void(TENSORS, TENSORS, parameters, TENSORS, TENSORS))
