# SPDX-License-Identifier: MIT
"""Compilation of pointwise forms to C functions by FFCx, and calls of these from numba."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from fenicsmpm import _compat, _jit
from fenicsmpm._njit import njit
from fenicsmpm.forms.lowering import PointwiseForm


def processor() -> str:
    """Return a short name of the instruction set, by which its binaries can be recognized."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.machine(), platform.node()]
    flags = next((line for line in lines if line.startswith(("flags", "Features"))), lines[0])
    return hashlib.sha256(flags.encode()).hexdigest()[:12]


# These flags were chosen by measurements on residuals and tangents of stabilized forms, which are
# straight-line code of up to some thousand lines.
# - Reciprocals instead of divisions, and free association, save a third of the time.
# - Vectorization within the code (-O2 or -ftree-slp-vectorize) makes some kernels 5 times slower.
# - NaN and infinity keep their meaning (no -ffinite-math-only).
# - Without "-g0", Python's own flags request debugging information, and compilation takes up to
#   four times as long.
COMPILE_ARGS = [
    "-O1",
    "-g0",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-freciprocal-math",
    # different machines that share a cache must not share binaries
    f"-DFENICSMPM_PROCESSOR={processor()}",
]

# Coordinates of the interval on which pointwise forms are compiled
COORDINATES = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])


@dataclass
class Kernel:
    """Compiled pointwise form.

    Attributes:
        address: Address of the C function ``tabulate_tensor(A, w, c, coordinates, ...)``. It adds
            to A ``(trial slots, test slots)`` and reads its inputs from c.
        shape: Shape of A: (), (test slots,) or (trial slots, test slots).
        module: CFFI module that owns the function.
    """

    address: int
    shape: tuple[int, ...]
    module: Any


def compile_pointwise(
    comm: Any, lowered: PointwiseForm, jit_options: dict[str, Any]
) -> Kernel | None:
    """Compile a lowered integrand once for all ranks, or load it from FFCx's cache.

    Args:
        comm: MPI communicator. Collective.
        lowered: The pointwise form.
        jit_options: Options of ``dolfinx.jit.ffcx_jit``, which override the default ones.

    Returns:
        The kernel, or None for an integrand that is zero.
    """
    if lowered.form is None:
        return None
    shape = tuple(max(len(s.used), 1) for s in reversed(lowered.arguments))
    return compile_kernel(comm, lowered.form, shape, jit_options)


def compile_kernel(
    comm: Any, form: ufl.Form, shape: tuple[int, ...], jit_options: dict[str, Any]
) -> Kernel:
    """Compile a form with one quadrature point, as ``compile_pointwise`` does.

    Args:
        comm: MPI communicator. Collective.
        form: UFL form.
        shape: Shape of its element tensor.
        jit_options: Options of ``dolfinx.jit.ffcx_jit``, which override the default ones.
    """
    options = {"cffi_extra_compile_args": COMPILE_ARGS} | jit_options
    compiled, module = _jit.kernel_form(comm, form, options)
    return Kernel(_compat.kernel_address(compiled, module), shape, module)


def _build_call(builder, address, tensor, coefficients, inputs, coordinates):  # type: ignore[no-untyped-def]
    """Build the call of a kernel at an address; the other arguments are pointers.

    FFCx has the seventh pointer since version 0.10. In the C calling conventions, a callee ignores
    additional arguments.
    """
    pointer = ir.IntType(8).as_pointer()
    function = builder.inttoptr(address, ir.FunctionType(ir.VoidType(), [pointer] * 7).as_pointer())
    null = ir.Constant(pointer, None)
    arguments = [builder.bitcast(p, pointer) for p in (tensor, coefficients, inputs, coordinates)]
    builder.call(function, [*arguments, null, null, null])


@intrinsic
def call_kernel(typingctx, address, tensor, inputs, coordinates):  # type: ignore[no-untyped-def]
    """Call a kernel by its address; all four arguments are addresses (int64).

    In this way one compiled loop serves all forms.
    """
    signature = types.void(types.int64, types.int64, types.int64, types.int64)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        tensor, inputs, coordinates = (builder.inttoptr(a, pointer) for a in args[1:])
        null = ir.Constant(pointer, None)
        _build_call(builder, args[0], tensor, null, inputs, coordinates)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def call_facet_kernel(typingctx, address, tensor, constants, coordinates, facets, permutations):  # type: ignore[no-untyped-def]
    """Call a kernel of an interior facet, without coefficients, by its address.

    All arguments are addresses (int64): of the function, of its result, of the constants, of the
    coordinates of both cells, of the two local facet numbers (int32), and of the two facet
    permutations (uint8).
    """
    signature = types.void(*[types.int64] * 6)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        function = builder.inttoptr(
            args[0], ir.FunctionType(ir.VoidType(), [pointer] * 7).as_pointer()
        )
        tensor, *others = (builder.inttoptr(a, pointer) for a in args[1:])
        null = ir.Constant(pointer, None)
        builder.call(function, [tensor, null, *others, null])
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def kernel_of_nine(typingctx, address, values, inputs, coordinates):  # type: ignore[no-untyped-def]
    """Return the results of a kernel, at most nine, for nine coefficients, both as tuples of 9.

    The values are on the stack, so no array is needed. Inputs and coordinates are addresses
    (int64).
    """
    nine = types.UniTuple(types.float64, 9)
    signature = nine(types.int64, nine, types.int64, types.int64)

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = ir.IntType(8).as_pointer()
        array = context.get_value_type(nine)
        coefficients, tensor = (cgutils.alloca_once(builder, array) for _ in range(2))
        builder.store(args[1], coefficients)
        builder.store(ir.Constant(array, None), tensor)  # kernels add to their output
        inputs, coordinates = (builder.inttoptr(a, pointer) for a in args[2:])
        _build_call(builder, args[0], tensor, coefficients, inputs, coordinates)
        return builder.load(tensor)

    return signature, codegen


@njit
def evaluate_kernel(address, tensor, inputs):  # type: ignore[no-untyped-def]
    """Set ``tensor`` to the output of a kernel for the inputs of one point."""
    tensor[:] = 0.0  # kernels add to their output
    call_kernel(address, tensor.ctypes.data, inputs.ctypes.data, COORDINATES.ctypes.data)
