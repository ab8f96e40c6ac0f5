# SPDX-License-Identifier: MIT
"""Uniform bins over the bounding boxes of cells, which tell the cells that may contain a point."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit


class Bins(NamedTuple):
    """Bins and the cells in each of them, as a tuple that numba understands.

    Attributes:
        origin: Lower corner of the first bin, shape (d,), in m.
        inverse_size: Bins per metre, shape (d,).
        shape: Number of bins in each direction, shape (d,), int64.
        offsets: Cells of bin b are ``cells[offsets[b]:offsets[b + 1]]``, int64.
        cells: Local cells, int32.
    """

    origin: npt.NDArray[np.float64]
    inverse_size: npt.NDArray[np.float64]
    shape: npt.NDArray[np.int64]
    offsets: npt.NDArray[np.int64]
    cells: npt.NDArray[np.int32]


def make_bins(lower: npt.NDArray[np.float64], upper: npt.NDArray[np.float64]) -> Bins:
    """Make bins about as large as the cells.

    Args:
        lower: Lower corners of the cells' bounding boxes in m with tolerance, shape (cells, d).
        upper: Upper corners, likewise.
    """
    n, d = lower.shape
    if n == 0:
        none = np.zeros(0, dtype=np.int32)
        return Bins(np.zeros(d), np.ones(d), np.zeros(d, np.int64), np.zeros(1, np.int64), none)
    size = np.mean(upper - lower, axis=0)
    extent = upper.max(axis=0) - lower.min(axis=0)
    # Few cells in a large box (a graded mesh, bodies far apart) must not cost much memory.
    size *= max(1.0, np.prod(extent / size) / (4.0 * n + 1000.0)) ** (1.0 / d)
    # Shift bins off the planes of regular meshes: a cell then touches two per direction, not three.
    origin = lower.min(axis=0) - 0.37 * size
    shape = np.floor((upper.max(axis=0) - origin) / size).astype(np.int64) + 1
    first = np.floor((lower - origin) / size).astype(np.int64)
    last = np.minimum(np.floor((upper - origin) / size).astype(np.int64), shape - 1)
    offsets, cells = _fill(first, last, shape)
    return Bins(origin, 1.0 / size, shape, offsets, cells)


@njit
def _fill(first, last, shape):  # type: ignore[no-untyped-def]
    """Return CSR lists of the cells in each bin, from the first and last bin of each cell."""
    n, d = first.shape
    bins = 1
    for i in range(d):
        bins *= shape[i]
    ny = shape[1]
    nz = shape[2] if d == 3 else 1
    offsets = np.zeros(bins + 1, dtype=np.int64)
    cells = np.empty(0, dtype=np.int32)
    for fill in range(2):
        if fill:
            offsets[1:] = np.cumsum(offsets[1:])
            cells = np.empty(offsets[-1], dtype=np.int32)
            position = offsets[:-1].copy()
        for c in range(n):
            k0 = first[c, 2] if d == 3 else 0
            k1 = last[c, 2] if d == 3 else 0
            for i in range(first[c, 0], last[c, 0] + 1):
                for j in range(first[c, 1], last[c, 1] + 1):
                    for k in range(k0, k1 + 1):
                        b = (i * ny + j) * nz + k
                        if fill:
                            cells[position[b]] = c
                            position[b] += 1
                        else:
                            offsets[b + 1] += 1
    return offsets, cells
