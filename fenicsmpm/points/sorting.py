# SPDX-License-Identifier: MIT
"""Points by cell."""

import numba
import numpy as np
import numpy.typing as npt


@numba.njit(cache=True)
def sort_by_cell(
    cell: npt.NDArray[np.int32], num_cells: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Stable counting sort of points by cell.

    Args:
        cell: Cell of each point, shape (n,).
        num_cells: Number of cells.

    Returns:
        order (n,) and offsets (num_cells + 1,), both int64: the points of cell c are
        order[offsets[c]:offsets[c + 1]].
    """
    offsets = np.zeros(num_cells + 1, dtype=np.int64)
    for c in cell:
        offsets[c + 1] += 1
    for c in range(num_cells):
        offsets[c + 1] += offsets[c]
    position = offsets[:-1].copy()
    order = np.empty(len(cell), dtype=np.int64)
    for p in range(len(cell)):
        order[position[cell[p]]] = p
        position[cell[p]] += 1
    return order, offsets
