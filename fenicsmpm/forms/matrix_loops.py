# SPDX-License-Identifier: MIT
"""Element matrices A_K = sum_p V_p B0^T D B1 by products of small matrices in registers.

For each pair of a test and a trial component, the terms of all slots and of several points of a
group are one product L^T R of two factors: L has the test functions, R = D B1. Blocks of 4 x 16
entries of the product are summed up in registers. Entries of D that are zero, such as couplings of
values to gradients, are skipped.
"""

# mypy: disallow_untyped_defs=False

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.forms.kernels import evaluate_kernel
from fenicsmpm.lanes import LANES, add_scaled, load, number_at, store, zeros

# Points of a group whose terms go into one product: the factors then stay in the first cache
_POINTS = 8
# Rows of a product that are summed up at once
_ROWS = 4


@njit(parallel=True)
def element_matrices(
    address,
    offsets,
    weights,
    rows,
    inputs,
    basis0,
    column0,
    length0,
    start0,
    basis1,
    column1,
    length1,
    start1,
    result,
):
    """A_K = sum_p V_p B0^T D B1 into ``result (n_groups, n_local0, n_local1)``.

    The kernel's output is D transposed: ``tensor[trial slot, test slot]``. Slot s of the test
    functions is ``basis0[row, column0[s]:][:length0[s]]`` on dofs from ``start0[s]`` on.
    """
    n0, n1 = len(column0), len(column1)
    runs0, runs1 = _runs(start0), _runs(start1)
    height = (np.max(length0) + _ROWS - 1) // _ROWS * _ROWS
    width = (np.max(length1) + LANES - 1) // LANES  # in rows of eight
    is_whole = _are_all(runs0, start0, length0, result.shape[1])
    is_whole &= _are_all(runs1, start1, length1, result.shape[2])
    for i in numba.prange(len(offsets) - 1):
        tensors = np.empty((_POINTS, n1, n0))
        left = np.zeros((n0 * _POINTS, height))
        functions = np.zeros((_POINTS * n1 * width, LANES))
        right = np.empty((n0 * _POINTS * width, LANES))
        terms = np.empty(n0 * _POINTS, dtype=np.int64)
        blocks = np.zeros(((len(runs0) - 1) * (len(runs1) - 1), height * width, LANES))
        for begin in range(offsets[i], offsets[i + 1], _POINTS):
            some = min(_POINTS, offsets[i + 1] - begin)
            for k in range(some):
                point = begin + k
                evaluate_kernel(address, tensors[k], inputs[point - offsets[0]])
                row0, row1, weight = basis0[rows[point]], basis1[rows[point]], weights[point]
                for s in range(n0):
                    line = left[s * _POINTS + k]
                    for a in range(length0[s]):
                        line[a] = weight * row0[column0[s] + a]
                for t in range(n1):
                    first = (k * n1 + t) * width
                    line = functions[first : first + width].reshape(width * LANES)
                    for b in range(length1[t]):
                        line[b] = row1[column1[t] + b]
            for m0 in range(len(runs0) - 1):
                for m1 in range(len(runs1) - 1):
                    n = _factors(
                        tensors, functions, some, runs0[m0], runs0[m0 + 1], runs1[m1],
                        runs1[m1 + 1], n1, width, right, terms,
                    )  # fmt: skip
                    block = blocks[m0 * (len(runs1) - 1) + m1]
                    _add_product(left, right, terms, n, height, width, block)
        if not is_whole:
            result[i] = 0.0
        for m0 in range(len(runs0) - 1):
            for m1 in range(len(runs1) - 1):
                block = blocks[m0 * (len(runs1) - 1) + m1].reshape(height, width * LANES)
                row, column = start0[runs0[m0]], start1[runs1[m1]]
                for a in range(length0[runs0[m0]]):
                    target = result[i, row + a]
                    if is_whole:
                        for b in range(length1[runs1[m1]]):
                            target[column + b] = block[a, b]
                    else:
                        for b in range(length1[runs1[m1]]):
                            target[column + b] += block[a, b]


@njit
def _runs(start):
    """Where slots on the same dofs begin, one after the other, and the end."""
    result = [0]
    for s in range(1, len(start)):
        if start[s] != start[s - 1]:
            result.append(s)
    result.append(len(start))
    return np.array(result)


@njit
def _are_all(runs, start, length, n):
    """Whether runs of slots are on all n dofs, each once.

    Slots of averages are on the same dofs as those of values, so the answer is no if both are used.
    """
    total = 0
    for m in range(len(runs) - 1):
        if m > 0 and start[runs[m]] <= start[runs[m - 1]]:
            return False
        total += length[runs[m]]
    return total == n


@njit
def _factors(tensors, functions, some, first0, last0, first1, last1, n1, width, right, terms):
    """Rows D B1 of some slots and points into ``right``, but for those that are zero.

    Returns:
        Their number; ``terms`` has the rows of the other factor that belong to them.
    """
    n = 0
    for s in range(first0, last0):
        for k in range(some):
            is_zero = True
            for t in range(first1, last1):
                factor = tensors[k, t, s]
                if factor == 0.0:
                    continue
                for r in range(width):
                    total = zeros() if is_zero else load(right, n * width + r)
                    row = load(functions, (k * n1 + t) * width + r)
                    store(right, n * width + r, add_scaled(total, factor, row))
                is_zero = False
            if not is_zero:
                terms[n] = s * _POINTS + k
                n += 1
    return n


@njit
def _add_product(left, right, terms, n, height, width, block):
    """Add L^T R of n terms to a block of ``height`` times ``width`` rows of eight.

    Eight sums at once: as many as it takes until a processor has added the first product.
    """
    for a in range(0, height, _ROWS):
        for r in range(0, width - 1, 2):
            at = a * width + r
            sum0, sum4 = load(block, at), load(block, at + 1)
            sum1, sum5 = load(block, at + width), load(block, at + width + 1)
            sum2, sum6 = load(block, at + 2 * width), load(block, at + 2 * width + 1)
            sum3, sum7 = load(block, at + 3 * width), load(block, at + 3 * width + 1)
            for k in range(n):
                row, next_row = load(right, k * width + r), load(right, k * width + r + 1)
                where = terms[k] * height + a
                factor0, factor1 = number_at(left, where), number_at(left, where + 1)
                factor2, factor3 = number_at(left, where + 2), number_at(left, where + 3)
                sum0, sum4 = add_scaled(sum0, factor0, row), add_scaled(sum4, factor0, next_row)
                sum1, sum5 = add_scaled(sum1, factor1, row), add_scaled(sum5, factor1, next_row)
                sum2, sum6 = add_scaled(sum2, factor2, row), add_scaled(sum6, factor2, next_row)
                sum3, sum7 = add_scaled(sum3, factor3, row), add_scaled(sum7, factor3, next_row)
            store(block, at, sum0)
            store(block, at + 1, sum4)
            store(block, at + width, sum1)
            store(block, at + width + 1, sum5)
            store(block, at + 2 * width, sum2)
            store(block, at + 2 * width + 1, sum6)
            store(block, at + 3 * width, sum3)
            store(block, at + 3 * width + 1, sum7)
        if width % 2:
            at = a * width + width - 1
            sum0, sum1 = load(block, at), load(block, at + width)
            sum2, sum3 = load(block, at + 2 * width), load(block, at + 3 * width)
            for k in range(n):
                row = load(right, k * width + width - 1)
                where = terms[k] * height + a
                sum0 = add_scaled(sum0, number_at(left, where), row)
                sum1 = add_scaled(sum1, number_at(left, where + 1), row)
                sum2 = add_scaled(sum2, number_at(left, where + 2), row)
                sum3 = add_scaled(sum3, number_at(left, where + 3), row)
            store(block, at, sum0)
            store(block, at + width, sum1)
            store(block, at + 2 * width, sum2)
            store(block, at + 3 * width, sum3)
