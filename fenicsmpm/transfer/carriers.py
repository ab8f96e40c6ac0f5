# SPDX-License-Identifier: MIT
"""Points without material, which carry forces to the nodes and follow the motion (numba)."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import OPTIONS, stencils
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import ON_WALL
from fenicsmpm.lanes import LANES
from fenicsmpm.transfer.grid_rows import MASS, VELOCITY
from fenicsmpm.transfer.tiles import row_of

_njit = njit(**OPTIONS)


@functools.cache
def node_rows(dim: int, kind: int) -> Any:
    """Compile the function that lists the nodes of the i-th point of a block.

    Its arguments are i, the results of ``stencils`` for the block (not in a window), the nodes, the
    numbers of the existing tiles, and two results ``(width^d,)``: rows of the nodes in all tiles,
    -1 without a tile; and values of the grid functions.
    """
    width = WIDTH[kind]
    depth = width if dim == 3 else 1

    @_njit
    def find(i, base, w, nodes, ids, rows, values):
        first_x = base[i] // (nodes.shape[1] * nodes.shape[2])
        first_y = base[i] // nodes.shape[2] % nodes.shape[1]
        first_z, n = base[i] % nodes.shape[2], 0
        for a in range(width):
            for b in range(width):
                for c in range(depth):
                    rows[n] = row_of(first_x + a, first_y + b, first_z + c, nodes, ids)
                    values[n] = w[a, i] * w[width + b, i]
                    if dim == 3:
                        values[n] *= w[2 * width + c, i]
                    n += 1

    return find


class Carriers(NamedTuple):
    """Kernels of points without material; see ``carriers``."""

    add_forces: Callable[..., int]
    follow: Callable[..., Any]


@functools.cache
def carriers(dim: int, kind: int) -> Carriers:
    """Compile the kernels of points that carry forces through the grid."""
    width, fill = WIDTH[kind], stencils(dim, kind, in_window=False)
    find, count, lower = node_rows(dim, kind), WIDTH[kind] ** dim, (0.0, 0.0, 0.0)

    @_njit
    def add_forces(nodes, ids, half, x, force, rows, forces):
        """Add external forces of points, ``(n, d)`` in N, to all nodes, ``(n_nodes, 3)``.

        Positions x are in blocks; the rows have the mass of all points.

        Returns:
            A point without any mass at its nodes, or -1.
        """
        corner, base = np.empty((3, LANES)), np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        places, values = np.empty(count, np.int64), np.empty(count)
        bad = -1
        for p in range(len(force)):
            i = p % LANES
            if i == 0:
                fill(x, p // LANES, nodes, half, lower, corner, base, w, d)
            find(i, base, w, nodes, ids, places, values)
            mass = 0.0
            for n in range(count):
                if places[n] >= 0:
                    mass += values[n] * rows[places[n], MASS]
                    for k in range(dim):
                        forces[places[n], k] += values[n] * force[p, k]
            if not mass > 0.0:
                bad = p
        return bad

    @_njit
    def follow(nodes, ids, half, x, points, t_low, t_high, rows, dt):
        """Move points, in blocks, with the grid (eq. 17).

        Returns:
            A point that has left the lattice, or -1; and whether some point has moved beyond its
            tiles.
        """
        corner, base = np.empty((3, LANES)), np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        places, values = np.empty(count, np.int64), np.empty(count)
        bad, strays = -1, False
        for p in range(points):
            block, i = p // LANES, p % LANES
            if i == 0:
                fill(x, block, nodes, half, lower, corner, base, w, d)
            find(i, base, w, nodes, ids, places, values)
            for k in range(dim):
                for n in range(count):
                    if places[n] >= 0:
                        x[block * dim + k, i] += dt * values[n] * rows[places[n], VELOCITY + k]
                t = (x[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                if not -ON_WALL <= t <= nodes.shape[k] - 1 + ON_WALL:
                    bad = p
                elif t < ON_WALL:
                    x[block * dim + k, i] = nodes.origin[k]
                elif t > nodes.shape[k] - 1 - ON_WALL:
                    x[block * dim + k, i] = nodes.upper[k]
                strays |= not t_low[p, k] <= t <= t_high[p, k]
        return bad, strays

    return Carriers(add_forces, follow)
