# SPDX-License-Identifier: MIT
"""Assembly for functions that are linear within a group, such as P1 on simplices.

In a group, gradients do not depend on the point, and values depend on it linearly. With the first
point x0 of the group, ``f(x) = f(x0) + (x - x0) . grad f``. Therefore the outputs D of the kernel
are first summed over all points, and for value slots also times x - x0. The contraction with the
basis then takes place once for each group instead of once for each point.
"""

# mypy: disallow_untyped_defs=False

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.forms.kernels import evaluate_kernel
from fenicsmpm.forms.loops import contract_matrix, contract_vector


def with_moments(table, values, dim):
    """Return the slots of a table, followed by the gradient slots that belong to its value slots.

    Args:
        table: A ``SlotTable`` whose gradient rows follow its value rows.
        values: Positions ``(n,)`` of the value slots within the used slots.
        dim: Space dimension.

    Returns:
        Basis, column, length and start of the extended slots.
    """
    rows = np.arange(1, dim + 1)
    length = table.length[values]
    column = (table.column[values, None] + rows * length[:, None]).ravel()
    return (
        table.basis,
        np.concatenate([table.column, column]),
        np.concatenate([table.length, np.repeat(length, dim)]),
        np.concatenate([table.start, np.repeat(table.start[values], dim)]),
    )


@njit(parallel=True)
def gather_function(
    values, dofs, groups, offsets, rows, is_value, basis, column, length, start, inputs, first
):
    """Gather slots as ``loops.gather_function``; in a group, only slots with ``is_value`` vary."""
    for i in numba.prange(len(groups)):
        local = values[dofs[groups[i]]]
        slots = np.zeros(len(column))
        for k in range(offsets[i], offsets[i + 1]):
            row = basis[rows[k]]
            for s in range(len(column)):
                if is_value[s] or k == offsets[i]:
                    slots[s] = 0.0
                    for a in range(length[s]):
                        slots[s] += row[column[s] + a] * local[start[s] + a]
            for s in range(len(column)):
                inputs[k - offsets[0], first + s] = slots[s]


@njit(parallel=True)
def element_vectors(
    address, offsets, weights, rows, inputs, x, values,
    basis, column, length, start, result,
):  # fmt: skip
    """Compute ``loops.element_vectors`` with positions x ``(n_points, d)`` and extended slots."""
    dim = x.shape[1]
    n0 = len(column) - dim * len(values)
    for i in numba.prange(len(offsets) - 1):
        tensor = np.empty(n0)
        moments = np.zeros(len(column))
        first = offsets[i]
        for k in range(first, offsets[i + 1]):
            evaluate_kernel(address, tensor, inputs[k - offsets[0]])
            for s in range(n0):
                moments[s] += weights[k] * tensor[s]
            for v in range(len(values)):
                for m in range(dim):
                    distance = x[k, m] - x[first, m]
                    moments[n0 + v * dim + m] += weights[k] * distance * tensor[values[v]]
        result[i] = 0.0
        contract_vector(moments, 1.0, basis[rows[first]], column, length, start, result[i])


@njit(parallel=True)
def element_matrices(
    address, offsets, weights, rows, inputs, x, values0, values1,
    basis0, column0, length0, start0, basis1, column1, length1, start1, result,
):  # fmt: skip
    """Compute ``matrix_loops.element_matrices`` with positions x and extended slots."""
    dim = x.shape[1]
    n0 = len(column0) - dim * len(values0)
    n1 = len(column1) - dim * len(values1)
    for i in numba.prange(len(offsets) - 1):
        tensor = np.empty((n1, n0))
        flat = tensor.reshape(n1 * n0)
        total = np.zeros(n1 * n0)
        moments = np.zeros((len(column1), len(column0)))
        first = offsets[i]
        for k in range(first, offsets[i + 1]):
            evaluate_kernel(address, flat, inputs[k - offsets[0]])
            weight = weights[k]
            for s in range(n1 * n0):
                total[s] += weight * flat[s]
            for m in range(dim):
                distance = weight * (x[k, m] - x[first, m])
                for v in range(len(values0)):
                    target = n0 + v * dim + m
                    for t in range(n1):
                        moments[t, target] += distance * tensor[t, values0[v]]
                for v in range(len(values1)):
                    line = moments[n1 + v * dim + m]
                    for s in range(n0):
                        line[s] += distance * tensor[values1[v], s]
                    for v0 in range(len(values0)):
                        product = distance * tensor[values1[v], values0[v0]]
                        for m0 in range(dim):
                            line[n0 + v0 * dim + m0] += product * (x[k, m0] - x[first, m0])
        for t in range(n1):
            for s in range(n0):
                moments[t, s] += total[t * n0 + s]
        half = np.empty((result.shape[2], len(column0)))
        result[i] = 0.0
        contract_matrix(
            moments, 1.0, basis0[rows[first]], column0, length0, start0,
            basis1[rows[first]], column1, length1, start1, half, result[i],
        )  # fmt: skip
