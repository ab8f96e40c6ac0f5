# SPDX-License-Identifier: MIT
"""Points by cell, or by another number."""

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit


@njit
def sort_by_number(
    number: npt.NDArray[np.integer], count: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Stable counting sort.

    Args:
        number: Of each point, such as its cell, shape (n,).
        count: How many numbers there are, from 0.

    Returns:
        order (n,) and offsets (count + 1,), both int64: the points with number c are
        order[offsets[c]:offsets[c + 1]].
    """
    offsets = np.zeros(count + 1, dtype=np.int64)
    for c in number:
        offsets[c + 1] += 1
    for c in range(count):
        offsets[c + 1] += offsets[c]
    position = offsets[:-1].copy()
    order = np.empty(len(number), dtype=np.int64)
    for p in range(len(number)):
        order[position[number[p]]] = p
        position[number[p]] += 1
    return order, offsets
