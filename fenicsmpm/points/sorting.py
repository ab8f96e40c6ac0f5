# SPDX-License-Identifier: MIT
"""Sorting of points by cell or by another number."""

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit

# Number of bits sorted at a time: the counts then fit into the first-level cache.
_BITS = 11


def order_by_number(number: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Sort stably, with memory that does not grow with the largest number.

    Args:
        number: Non-negative number of each point, shape (n,).

    Returns:
        The order of the points by number, shape (n,), int64.
    """
    highest = int(number.max(initial=0))
    if highest < len(number):
        return sort_by_number(number, highest + 1)[0]
    return _sort_by_bits(number, highest)


@njit
def _sort_by_bits(number, highest):  # type: ignore[no-untyped-def]
    """Return the order (n,) of numbers up to `highest`, sorted from the lowest bits upwards."""
    n = len(number)
    order = np.arange(n)
    other = np.empty_like(order)
    position = np.empty((1 << _BITS) + 1, dtype=np.int64)
    shift = 0
    while highest >> shift > 0:
        position[:] = 0
        for p in range(n):
            position[(number[p] >> shift & (1 << _BITS) - 1) + 1] += 1
        for k in range(1 << _BITS):
            position[k + 1] += position[k]
        for p in order:
            bits = number[p] >> shift & (1 << _BITS) - 1
            other[position[bits]] = p
            position[bits] += 1
        order, other = other, order
        shift += _BITS
    return order


@njit
def sort_by_number(
    number: npt.NDArray[np.integer], count: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Sort by counting, stably.

    Args:
        number: Number of each point, such as its cell, shape (n,).
        count: Upper bound of the numbers, which lie from 0 to count - 1.

    Returns:
        The order, shape (n,), and offsets, shape (count + 1,), both int64: the points with number
        c are ``order[offsets[c]:offsets[c + 1]]``.
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
