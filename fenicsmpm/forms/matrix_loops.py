# SPDX-License-Identifier: MIT
"""Element matrices A_K = sum_p V_p B0^T D B1 by products of small matrices in registers.

For each pair of a test and a trial component, the terms of all slots and of several points of a
group are computed as one product of two factors. One factor contains the functions of the component
with fewer slots, the other D times the functions of the other component. Therefore some blocks of
the matrix are computed transposed. If D is symmetric, the block of a pair of components is the
mirror image of another one. Blocks of 4 x 16 entries of the product are accumulated in registers.
Zero entries of D, such as those that couple values to gradients, are skipped.
"""

# mypy: disallow_untyped_defs=False

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.forms.kernels import evaluate_kernel
from fenicsmpm.forms.loops import add_matrices
from fenicsmpm.lanes import LANES, add_scaled, load, number_at, store, zeros

# Number of points whose terms go into one product, such that the factors stay in the L1 cache
_POINTS = 8
# Number of rows of a product that are accumulated at once
_ROWS = 4
# Number of entries in the element matrices of a thread that are added at once, such that they stay
# in the L2 cache
_NUMBERS = 1 << 17
# Difference of numbers that are equal up to round-off, relative to the largest of them
_ROUND_OFF = 1e-13
# How the block of a pair of components is computed: directly, transposed, or as a mirror image
_DIRECT, _TRANSPOSED, _MIRRORED = 0, 1, 2


@njit(parallel=True)
def element_matrices(
    address,
    offsets,
    weights,
    rows,
    inputs,
    is_same,
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
    """Set ``result (n_groups, n_local0, n_local1)`` to A_K = sum_p V_p B0^T D B1.

    The output of the kernel is D transposed, ``tensor[trial slot, test slot]``. Slot s of the test
    functions is ``basis0[row, column0[s]:][:length0[s]]`` on the dofs from ``start0[s]`` on.
    ``is_same`` says that test and trial functions have the same slots.
    """
    n0, n1 = len(column0), len(column1)
    runs0, runs1 = _runs(start0), _runs(start1)
    width0 = (np.max(length0) + LANES - 1) // LANES  # in rows of eight
    width1 = (np.max(length1) + LANES - 1) // LANES
    is_whole = _are_all(runs0, start0, length0, result.shape[1])
    is_whole &= _are_all(runs1, start1, length1, result.shape[2])
    for i in numba.prange(len(offsets) - 1):
        tensors = np.empty((offsets[i + 1] - offsets[i], n1, n0))
        for k in range(len(tensors)):
            point = offsets[i] + k
            evaluate_kernel(address, tensors[k], inputs[point - offsets[0]])
            for t in range(n1):
                for s in range(n0):
                    tensors[k, t, s] *= weights[point]
        pairs = _pairs(tensors, runs0, runs1, is_same)
        functions0 = np.zeros((_POINTS * n0 * width0, LANES))
        functions1 = functions0 if is_same else np.zeros((_POINTS * n1 * width1, LANES))
        product = np.empty((_POINTS * max(n0 * width1, n1 * width0), LANES))
        terms = np.empty(_POINTS * max(n0, n1), dtype=np.int64)
        size = LANES * max(width0, width1) ** 2
        blocks = np.zeros((len(runs0) - 1, len(runs1) - 1, size, LANES))
        for begin in range(0, len(tensors), _POINTS):
            some = tensors[begin : begin + _POINTS]
            swapped = some.transpose(0, 2, 1)
            for k in range(len(some)):
                row = rows[offsets[i] + begin + k]
                _gather(basis0[row], column0, length0, functions0, k * n0, width0)
                if not is_same:
                    _gather(basis1[row], column1, length1, functions1, k * n1, width1)
            for m0 in range(len(runs0) - 1):
                slots0 = range(runs0[m0], runs0[m0 + 1])
                for m1 in range(len(runs1) - 1):
                    slots1 = range(runs1[m1], runs1[m1 + 1])
                    if pairs[m0, m1] == _DIRECT:
                        n = _factor(some, functions1, slots0, slots1, width1, product, terms)
                        height = _up(length0[runs0[m0]])
                        _add_product(
                            functions0, width0, product, width1, terms, n, height, blocks[m0, m1]
                        )
                    elif pairs[m0, m1] == _TRANSPOSED:
                        n = _factor(swapped, functions0, slots1, slots0, width0, product, terms)
                        height = _up(length1[runs1[m1]])
                        _add_product(
                            functions1, width1, product, width0, terms, n, height, blocks[m0, m1]
                        )
        if not is_whole:
            result[i] = 0.0
        for m0 in range(len(runs0) - 1):
            for m1 in range(len(runs1) - 1):
                first0, first1 = start0[runs0[m0]], start1[runs1[m1]]
                target = result[i, first0 : first0 + length0[runs0[m0]]]
                target = target[:, first1 : first1 + length1[runs1[m1]]]
                if pairs[m0, m1] == _DIRECT:
                    _write(blocks[m0, m1], width1, is_whole, target)
                elif pairs[m0, m1] == _TRANSPOSED:
                    _write(blocks[m0, m1], width0, is_whole, target.T)
                elif pairs[m1, m0] == _DIRECT:
                    _write(blocks[m1, m0], width1, is_whole, target.T)
                else:
                    _write(blocks[m1, m0], width0, is_whole, target)


@njit
def add_element_matrices(
    address,
    offsets,
    weights,
    rows,
    inputs,
    is_same,
    basis0,
    column0,
    length0,
    start0,
    basis1,
    column1,
    length1,
    start1,
    dofs0,
    dofs1,
    groups,
    places,
    indptr,
    fixed0,
    fixed1,
    data,
    threads,
):
    """Add element matrices to CSR data, in batches that stay in the L2 cache.

    The arguments are those of ``element_matrices`` and of ``loops.add_matrices``.
    """
    size = dofs0.shape[1] * dofs1.shape[1]
    some = max(1, _NUMBERS // size) * threads
    matrices = np.empty((min(some, len(groups)), dofs0.shape[1], dofs1.shape[1]))
    for begin in range(0, len(groups), some):
        end = min(begin + some, len(groups))
        element_matrices(
            address, offsets[begin : end + 1], weights, rows, inputs[offsets[begin] - offsets[0] :],
            is_same, basis0, column0, length0, start0, basis1, column1, length1, start1,
            matrices[: end - begin],
        )  # fmt: skip
        add_matrices(
            matrices[: end - begin], dofs0, dofs1, groups[begin:end], places[begin:end], indptr,
            fixed0, fixed1, data,
        )  # fmt: skip


@njit
def _up(n):
    """Round a number of rows up to the next multiple of ``_ROWS``."""
    return (n + _ROWS - 1) // _ROWS * _ROWS


@njit
def _runs(start):
    """Return the starts of runs of slots on the same dofs, and the end."""
    result = [0]
    for s in range(1, len(start)):
        if start[s] != start[s - 1]:
            result.append(s)
    result.append(len(start))
    return np.array(result)


@njit
def _are_all(runs, start, length, n):
    """Return whether runs of slots cover all n dofs, each once.

    Slots of averages are on the same dofs as those of values, so the answer is no if both are used.
    """
    total = 0
    for m in range(len(runs) - 1):
        if m > 0 and start[runs[m]] <= start[runs[m - 1]]:
            return False
        total += length[runs[m]]
    return total == n


@njit
def _pairs(tensors, runs0, runs1, is_same):
    """Return ``(n_test, n_trial)`` how the block of each pair of components is computed."""
    result = np.empty((len(runs0) - 1, len(runs1) - 1), dtype=np.int8)
    for m0 in range(len(runs0) - 1):
        for m1 in range(len(runs1) - 1):
            if is_same and m1 < m0 and _is_mirrored(tensors, runs0, m0, m1):
                result[m0, m1] = _MIRRORED
            elif runs0[m0 + 1] - runs0[m0] <= runs1[m1 + 1] - runs1[m1]:
                result[m0, m1] = _DIRECT
            else:
                result[m0, m1] = _TRANSPOSED
    return result


@njit
def _is_mirrored(tensors, runs, m0, m1):
    """Return whether D of two components is the transpose of D of the swapped components."""
    largest = difference = 0.0
    for tensor in tensors:
        for s in range(runs[m0], runs[m0 + 1]):
            for t in range(runs[m1], runs[m1 + 1]):
                largest = max(largest, abs(tensor[t, s]))
                difference = max(difference, abs(tensor[t, s] - tensor[s, t]))
    return difference <= _ROUND_OFF * largest


@njit
def _gather(row, column, length, functions, first, width):
    """Copy the functions of all slots at a point to rows of eight, from slot ``first`` on."""
    for s in range(len(column)):
        begin = (first + s) * width
        line = functions[begin : begin + width].reshape(width * LANES)
        for a in range(length[s]):
            line[a] = row[column[s] + a]


@njit
def _factor(tensors, functions, slots0, slots1, width, product, terms):
    """Write the nonzero rows D B1 of some slots and points to ``product``.

    Args:
        tensors: D as ``[point, slot of B1, slot of the other factor]``.
        functions: B1.
        slots0: Slots of the other factor.
        slots1: Slots of B1.
        width: Width of B1 in rows of eight.
        product: Result, overwritten.
        terms: Overwritten by the lines of the other factor that belong to the rows.

    Returns:
        The number of rows.
    """
    _, n1, n0 = tensors.shape
    n = 0
    for s in slots0:
        for k in range(len(tensors)):
            is_zero = True
            for t in slots1:
                factor = tensors[k, t, s]
                if factor == 0.0:
                    continue
                for r in range(width):
                    total = zeros() if is_zero else load(product, n * width + r)
                    row = load(functions, (k * n1 + t) * width + r)
                    store(product, n * width + r, add_scaled(total, factor, row))
                is_zero = False
            if not is_zero:
                terms[n] = k * n0 + s
                n += 1
    return n


@njit
def _write(block, width, is_only, target):
    """Write a block without padding to a part of a matrix; add it unless ``is_only``."""
    numbers = block.reshape(block.size)
    for a in range(target.shape[0]):
        line = numbers[a * width * LANES :]
        if is_only:
            for b in range(target.shape[1]):
                target[a, b] = line[b]
        else:
            for b in range(target.shape[1]):
                target[a, b] += line[b]


@njit
def _add_product(left, left_width, right, width, terms, n, height, block):
    """Add L^T R of n terms to a block of ``height`` times ``width`` rows of eight.

    Eight sums are accumulated at once, which hides the latency of additions.
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
                where = terms[k] * left_width * LANES + a
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
                where = terms[k] * left_width * LANES + a
                sum0 = add_scaled(sum0, number_at(left, where), row)
                sum1 = add_scaled(sum1, number_at(left, where + 1), row)
                sum2 = add_scaled(sum2, number_at(left, where + 2), row)
                sum3 = add_scaled(sum3, number_at(left, where + 3), row)
            store(block, at, sum0)
            store(block, at + width, sum1)
            store(block, at + 2 * width, sum2)
            store(block, at + 3 * width, sum3)
