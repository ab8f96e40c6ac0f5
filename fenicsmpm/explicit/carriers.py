# SPDX-License-Identifier: MIT
"""What points without material do: carry forces to the nodes, and follow them (numba)."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit.stencils import OPTIONS, stencils, strides
from fenicsmpm.lanes import LANES

# Nodes are light that have less than this share of the largest mass around a point. Where points
# that are loaded have mass there are no such nodes: they would change the moment of a traction
_LIGHT = 0.01

_njit = njit(**OPTIONS)


@functools.cache
def to_nodes(dim: int, kind: int) -> Any:
    """Compile the function that adds the force ``(d,)`` of the i-th point of a block to its nodes.

    Arguments are i, what ``stencils`` gives of its block, the force and the nodes' rows.
    """
    width = WIDTH[kind]
    depth = width if dim == 3 else 1

    @_njit
    def add(i, nodes, base, w, force, rows):
        far, near = strides(nodes)
        for a in range(width):
            for b in range(width):
                for c in range(depth):
                    node = base[i] + a * far + b * near + c
                    share = w[a, i] * w[width + b, i]
                    if dim == 3:
                        share *= w[2 * width + c, i]
                    for k in range(dim):
                        rows[node, 5 + k] += share * force[k]

    return add


class Carriers(NamedTuple):
    """What points without material do; see ``carriers``."""

    add_forces: Callable[..., int]
    follow: Callable[..., int]


@functools.cache
def carriers(dim: int, kind: int) -> Carriers:
    """Compile what points do that carry forces through the grid.

    They lie on surfaces, where some nodes have little mass or none. Their full share of the force
    would throw such nodes ahead, and the point with them; so they have less of the force and of the
    motion, in proportion to their mass, and the others have more.
    """
    width, fill = WIDTH[kind], stencils(dim, kind)
    depth = width if dim == 3 else 1

    @_njit
    def shares(i, nodes, base, w, rows, least_mass, numbers, values):
        """Nodes of the i-th point of a block and their shares, whose sum is one.

        Returns:
            Whether there is mass.
        """
        far, near = strides(nodes)
        n, largest = 0, least_mass
        for a in range(width):
            for b in range(width):
                for c in range(depth):
                    numbers[n] = base[i] + a * far + b * near + c
                    values[n] = w[a, i] * w[width + b, i]
                    if dim == 3:
                        values[n] *= w[2 * width + c, i]
                    largest = max(largest, rows[numbers[n], 0])
                    n += 1
        total = 0.0
        for n in range(width**dim):
            values[n] *= min(1.0, rows[numbers[n], 0] / (_LIGHT * largest))
            total += values[n]
        values /= total if total > 0.0 else 1.0
        return total > 0.0

    @_njit
    def add_forces(nodes, half, x, force, rows, least_mass, forces):
        """External forces of points, ``(n, d)`` [N], to ``forces (n_nodes, 3)``.

        Positions x are in blocks, rows have the mass of all points.

        Returns:
            A point without any mass at its nodes; or -1.
        """
        base = np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        numbers, values = np.empty(width**dim, np.int64), np.empty(width**dim)
        bad = -1
        for p in range(len(force)):
            i = p % LANES
            if i == 0:
                fill(x, p // LANES, nodes, half, base, w, d)
            if not shares(i, nodes, base, w, rows, least_mass, numbers, values):
                bad = p
            for n in range(width**dim):
                for k in range(dim):
                    forces[numbers[n], k] += values[n] * force[p, k]
        return bad

    @_njit
    def follow(nodes, half, x, count, rows, least_mass, dt):
        """Move points, in blocks, with the grid (eq. 17).

        Returns:
            One of them that has left the lattice; or -1.
        """
        base = np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        numbers, values = np.empty(width**dim, np.int64), np.empty(width**dim)
        bad = -1
        for p in range(count):
            block, i = p // LANES, p % LANES
            if i == 0:
                fill(x, block, nodes, half, base, w, d)
            shares(i, nodes, base, w, rows, least_mass, numbers, values)
            for k in range(dim):
                for n in range(width**dim):
                    x[block * dim + k, i] += dt * values[n] * rows[numbers[n], 1 + k]
                t = (x[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                if not 0 <= t <= nodes.shape[k] - 1:
                    bad = p
        return bad

    return Carriers(add_forces, follow)
