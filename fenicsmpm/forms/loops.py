# SPDX-License-Identifier: MIT
"""Numba loops of assembly, which gather inputs, call the kernel, contract and scatter.

Arrays over points are in group order. ``rows`` maps a selected point to its row of the table.
Groups are processed in parallel into element tensors, which are then added serially. Therefore the
result does not depend on the number of threads.
"""

# mypy: disallow_untyped_defs=False

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.forms.kernels import call_facet_kernel, evaluate_kernel


@njit(parallel=True)
def gather_function(
    values, dofs, groups, offsets, rows, basis, column, length, start, inputs, first
):
    """Write the slots of a function at the points of some groups to ``inputs[:, first:]``.

    Args:
        values: Local coefficient vector ``(n_dofs,)``, ghosts included.
        dofs: Local dofs of all groups ``(n_all_groups, n_local)``.
        groups: Groups to process ``(n_groups,)``.
        offsets: Ranges of their points within ``rows`` ``(n_groups + 1,)``.
        rows: Table row of each point.
        basis: Table ``(n_table, n_columns)``.
        column: First column of each slot.
        length: Number of grid functions of each slot.
        start: First local dof of each slot.
        inputs: Result ``(n_points of these groups, n_inputs)``.
        first: First column of the result.
    """
    for i in numba.prange(len(groups)):
        local = values[dofs[groups[i]]]
        for k in range(offsets[i], offsets[i + 1]):
            row = basis[rows[k]]
            for s in range(len(column)):
                value = 0.0
                for a in range(length[s]):
                    value += row[column[s] + a] * local[start[s] + a]
                inputs[k - offsets[0], first + s] = value


@njit(parallel=True)
def evaluate_points(address, inputs, tensors):
    """Set ``tensors (n_points, n)`` to the output of a kernel at each point."""
    for k in numba.prange(len(inputs)):
        evaluate_kernel(address, tensors[k], inputs[k])


@njit
def put_rows(result, rows, values, first):
    """Set ``result[rows] = values[:, first:first + n_columns]`` row by row."""
    for k in range(len(rows)):
        for c in range(result.shape[1]):
            result[rows[k], c] = values[k, first + c]


@njit(parallel=True)
def element_scalars(address, offsets, weights, inputs, result):
    """Set ``result (n_groups,)`` to the integral over the points of each group."""
    for i in numba.prange(len(offsets) - 1):
        tensor = np.empty(1)
        result[i] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            evaluate_kernel(address, tensor, inputs[k - offsets[0]])
            result[i] += weights[k] * tensor[0]


@njit(parallel=True)
def element_vectors(address, offsets, weights, rows, inputs, basis, column, length, start, result):
    """Set ``result (n_groups, n_local)`` to b_K = sum_p V_p B^T D."""
    n_slots = len(column)
    for i in numba.prange(len(offsets) - 1):
        tensor = np.empty(n_slots)
        result[i] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            evaluate_kernel(address, tensor, inputs[k - offsets[0]])
            contract_vector(tensor, weights[k], basis[rows[k]], column, length, start, result[i])


@njit
def contract_vector(tensor, weight, row, column, length, start, result):
    """Add weight B^T D; slot s is ``row[column[s]:][:length[s]]`` on dofs ``start[s]``."""
    for s in range(len(column)):
        factor = weight * tensor[s]
        for a in range(length[s]):
            result[start[s] + a] += factor * row[column[s] + a]


@njit
def contract_matrix(
    tensor, weight, row0, column0, length0, start0, row1, column1, length1, start1, half, result
):
    """Add weight B0^T D B1, with ``tensor`` = D^T and the work array ``half`` = (D B1)^T."""
    n0 = len(column0)
    half[:] = 0.0
    for t in range(len(column1)):
        for b in range(length1[t]):
            factor = weight * row1[column1[t] + b]
            target = half[start1[t] + b]
            for s in range(n0):
                target[s] += factor * tensor[t, s]
    for s in range(n0):
        for a in range(length0[s]):
            factor = row0[column0[s] + a]
            target = result[start0[s] + a]
            for j in range(len(target)):
                target[j] += factor * half[j, s]


@njit
def mark_seen(offsets, rows, basis, column, length, start, least, seen):
    """Mark local dofs whose functions are not zero at all points of a group.

    A function counts as zero at a point if it is smaller than ``least`` times the largest one.

    Args:
        offsets: Ranges of the points of each group within ``rows`` ``(n_groups + 1,)``.
        rows: Table row of each point.
        basis: Table ``(n_table, n_columns)``.
        column: First column of each slot.
        length: Number of grid functions of each slot.
        start: First local dof of each slot.
        least: Relative limit of each group ``(n_groups,)``.
        seen: Result ``(n_groups, n_local)``.
    """
    for i in range(len(offsets) - 1):
        for k in range(offsets[i], offsets[i + 1]):
            if seen[i].all():  # mostly after the first point
                break
            for s in range(len(column)):
                row = basis[rows[k], column[s] : column[s] + length[s]]
                largest = np.max(np.abs(row))
                for a in range(length[s]):
                    if abs(row[a]) > least[i] * largest:
                        seen[i, start[s] + a] = True


@njit
def add_vectors(vectors, dofs, groups, result):
    """Add element vectors to a local vector."""
    for i in range(len(groups)):
        for a in range(dofs.shape[1]):
            result[dofs[groups[i], a]] += vectors[i, a]


@njit
def add_matrices(matrices, dofs0, dofs1, groups, places, indptr, fixed0, fixed1, data):
    """Add element matrices to CSR data, without constrained rows and columns.

    Args:
        matrices: Element matrices ``(n_groups, n_local0, n_local1)``.
        dofs0: Rows ``(n_all_groups, n_local0)``.
        dofs1: Columns ``(n_all_groups, n_local1)``.
        groups: Groups of the matrices ``(n_groups,)``.
        places: Place of each entry within its row ``(n_groups, n, n_local1)``; see ``csr_places``.
        indptr: Start of each row in ``data``.
        fixed0: uint8 marks of constrained rows.
        fixed1: uint8 marks of constrained columns.
        data: CSR values.
    """
    n0, n1, n = dofs0.shape[1], dofs1.shape[1], places.shape[1]
    for i in range(len(groups)):
        is_free = True
        for b in range(n1):
            is_free &= not fixed1[dofs1[groups[i], b]]
        for a in range(n0):
            if fixed0[dofs0[groups[i], a]]:
                continue
            first = indptr[dofs0[groups[i], a]]
            row = data[first : indptr[dofs0[groups[i], a] + 1]]
            place = places[i, a % n]
            if is_free:
                for b in range(n1):
                    row[place[b]] += matrices[i, a, b]
            else:
                for b in range(n1):
                    if not fixed1[dofs1[groups[i], b]]:
                        row[place[b]] += matrices[i, a, b]


@njit
def lift(matrices, dofs0, dofs1, groups, fixed1, values, result):
    """Subtract the constrained columns of element matrices times given values from a vector.

    Args:
        matrices: Element matrices ``(n_groups, n_local0, n_local1)``.
        dofs0: Rows ``(n_all_groups, n_local0)``.
        dofs1: Columns ``(n_all_groups, n_local1)``.
        groups: Groups of the matrices ``(n_groups,)``.
        fixed1: uint8 marks of constrained columns.
        values: Values of the constrained dofs ``(n_dofs1,)``.
        result: Local vector, changed in place.
    """
    for i in range(len(groups)):
        for b in range(dofs1.shape[1]):
            j = dofs1[groups[i], b]
            if fixed1[j]:
                for a in range(dofs0.shape[1]):
                    result[dofs0[groups[i], a]] -= matrices[i, a, b] * values[j]


@njit
def rows_repeat(indptr, indices, dofs0, groups, n):
    """Return whether each row of element matrices has the same columns as the n-th row before it.

    This is the case for a mixed space whose parts all have the same n functions in a group.
    """
    for i in range(len(groups)):
        for a in range(n, dofs0.shape[1]):
            row, other = dofs0[groups[i], a], dofs0[groups[i], a % n]
            first, before = indptr[row], indptr[other]
            length = indptr[row + 1] - first
            if length != indptr[other + 1] - before:
                return False
            for k in range(length):
                if indices[first + k] != indices[before + k]:
                    return False
    return True


@njit
def csr_places(indptr, indices, dofs0, dofs1, groups, places):
    """Find the place of each element matrix entry within its row of a CSR matrix.

    Args:
        indptr: Start of each row.
        indices: Columns, ascending in each row.
        dofs0: Rows ``(n_all_groups, n_local0)``.
        dofs1: Columns ``(n_all_groups, n_local1)``.
        groups: Groups to process ``(n_groups,)``.
        places: Result ``(n_groups, n, n_local1)`` for the first n rows, which are valid for all
            rows if ``rows_repeat``. Its type is unsigned, as numba checks signed indices for
            negative values.

    Returns:
        Whether the pattern has a place for all entries.
    """
    for i in range(len(groups)):
        columns = dofs1[groups[i]]
        ascending = np.argsort(columns)
        for a in range(places.shape[1]):
            row = dofs0[groups[i], a]
            first, last = indptr[row], indptr[row + 1]
            k = first
            for b in ascending:
                # rows have few other columns, so the next one is near
                while k < last and indices[k] < columns[b]:
                    k += 1
                if k == last or indices[k] != columns[b]:
                    return False
                places[i, a, b] = k - first
    return True


@njit
def diagonal_positions(indptr, indices, result):
    """Find the position of the diagonal entry in each of the first rows of a CSR matrix."""
    for row in range(len(result)):
        first, last = indptr[row], indptr[row + 1]
        result[row] = first + np.searchsorted(indices[first:last], row)


@njit
def add_facet_matrices(
    addresses, constants, entities, x, nodes, dofs0, dofs1, permutations, fixed0, fixed1,
    indptr, indices, data,
):  # fmt: skip
    """Add matrices of interior facets to CSR data, without constrained rows and columns.

    Zero entries are skipped. Most entries are zero, as only components of the same name interact.

    Args:
        addresses: Addresses ``(n_kernels,)`` of kernels without coefficients.
        constants: Constants ``(n,)`` of these kernels, at least one number.
        entities: Cell and local facet on both sides ``(n_facets, 4)``.
        x: Node positions ``(n_nodes, 3)``.
        nodes: Nodes of the cells ``(n_cells, n_corners)``.
        dofs0: Unrolled test dofs ``(n_cells, n_local)``.
        dofs1: Unrolled trial dofs ``(n_cells, n_local)``.
        permutations: Facet permutations ``(n_cells, facets of a cell)``.
        fixed0: 1 for constrained rows ``(n_dofs,)``.
        fixed1: 1 for constrained columns ``(n_dofs,)``.
        indptr: Start of each row of the matrix.
        indices: Columns of the matrix, ascending in each row.
        data: Values of the matrix.

    Returns:
        Whether the pattern has a place for all entries.
    """
    corners = nodes.shape[1]
    n0, n1 = dofs0.shape[1], dofs1.shape[1]
    coordinates = np.empty((2, corners, 3))
    facets, twists = np.empty(2, dtype=np.int32), np.empty(2, dtype=np.uint8)
    tensor = np.empty((2 * n0, 2 * n1))
    rows, columns = np.empty(2 * n0, dtype=np.int64), np.empty(2 * n1, dtype=np.int64)
    for e in range(len(entities)):
        for side in range(2):
            cell, facet = entities[e, 2 * side], entities[e, 2 * side + 1]
            facets[side], twists[side] = facet, permutations[cell, facet]
            for a in range(corners):
                coordinates[side, a] = x[nodes[cell, a]]
            rows[side * n0 : (side + 1) * n0] = dofs0[cell]
            columns[side * n1 : (side + 1) * n1] = dofs1[cell]
        tensor[:] = 0.0
        for address in addresses:
            call_facet_kernel(
                address,
                tensor.ctypes.data,
                constants.ctypes.data,
                coordinates.ctypes.data,
                facets.ctypes.data,
                twists.ctypes.data,
            )
        for a in range(2 * n0):
            row = rows[a]
            if fixed0[row]:
                continue
            first, last = indptr[row], indptr[row + 1]
            for b in range(2 * n1):
                value = tensor[a, b]
                if value == 0.0 or fixed1[columns[b]]:
                    continue
                k = first + np.searchsorted(indices[first:last], columns[b])
                if k == last or indices[k] != columns[b]:
                    return False
                data[k] += value
    return True


@njit
def mark_rows(indptr, data, result):
    """Mark the rows of a CSR matrix that have a nonzero entry."""
    for row in range(len(result)):
        for k in range(indptr[row], indptr[row + 1]):
            if data[k] != 0.0:
                result[row] = True
                break


@njit
def add_rows(from_indptr, from_columns, values, indptr, indices, data):
    """Add the first rows of one CSR matrix to those of another whose pattern contains them."""
    for row in range(len(from_indptr) - 1):
        columns = indices[indptr[row] : indptr[row + 1]]
        for k in range(from_indptr[row], from_indptr[row + 1]):
            data[indptr[row] + np.searchsorted(columns, from_columns[k])] += values[k]


@njit
def average_groups(table, weights, offsets):
    """Return the weighted averages of table rows over the points of groups, one row per point.

    Args:
        table: Rows of all points ``(n_points, n_columns)``, in group order.
        weights: Weights of the points ``(n_points,)``.
        offsets: Range of points of each group ``(n_groups + 1,)``.
    """
    result = np.empty_like(table)
    for i in range(len(offsets) - 1):
        mean = np.zeros(table.shape[1])
        total = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            total += weights[k]
            for c in range(table.shape[1]):
                mean[c] += weights[k] * table[k, c]
        for k in range(offsets[i], offsets[i + 1]):
            for c in range(table.shape[1]):
                result[k, c] = mean[c] / total
    return result


def equal_rows(indptr, indices):
    """Sort the rows of a sparse pattern so that rows with the same columns are together.

    Args:
        indptr: Start of each row.
        indices: Columns, sorted in each row.

    Returns:
        The order of the rows, and the start of each set of equal rows in it.
    """
    keys = np.empty(len(indptr) - 1, dtype=np.uint64)
    _digests(indptr, indices, keys)
    order = np.argsort(keys, kind="stable").astype(np.int32)
    return order, np.flatnonzero(_differs(indptr, indices, order))


@njit
def _digests(indptr, indices, keys):
    for row in range(len(keys)):
        key = np.uint64(14695981039346656037)  # FNV-1a
        for k in range(indptr[row], indptr[row + 1]):
            key = (key ^ np.uint64(indices[k])) * np.uint64(1099511628211)
        keys[row] = key


@njit
def _differs(indptr, indices, order):
    """Return whether each row differs from the row before it in the order."""
    result = np.ones(len(order), dtype=np.bool_)
    for i in range(1, len(order)):
        a, b = order[i - 1], order[i]
        n = indptr[a + 1] - indptr[a]
        if indptr[b + 1] - indptr[b] == n:
            same = True
            for k in range(n):
                if indices[indptr[a] + k] != indices[indptr[b] + k]:
                    same = False
                    break
            result[i] = not same
    return result
