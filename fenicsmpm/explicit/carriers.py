# SPDX-License-Identifier: MIT
"""What points without material do: carry forces to the nodes, and follow them (numba)."""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit.stencils import OPTIONS, stencils, strides
from fenicsmpm.lanes import LANES

_njit = numba.njit(**OPTIONS)


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

    add_forces: Callable[..., None]
    follow: Callable[..., None]


@functools.cache
def carriers(dim: int, kind: int) -> Carriers:
    """Compile what points do that carry forces through the grid."""
    width, fill, add = WIDTH[kind], stencils(dim, kind), to_nodes(dim, kind)
    depth = width if dim == 3 else 1

    @_njit
    def add_forces(nodes, half, x, force, rows):
        """External forces of points, ``(n, d)`` [N], to the nodes; positions x in blocks."""
        base = np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        for p in range(len(force)):
            if p % LANES == 0:
                fill(x, p // LANES, nodes, half, base, w, d)
            add(p % LANES, nodes, base, w, force[p], rows)

    @_njit
    def follow(nodes, half, x, rows, dt):
        """Move points, in blocks, with the grid (eq. 17)."""
        base = np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        far, near = strides(nodes)
        for block in range(len(x) // dim):
            fill(x, block, nodes, half, base, w, d)
            for i in range(LANES):
                for a in range(width):
                    for b in range(width):
                        for c in range(depth):
                            node = base[i] + a * far + b * near + c
                            share = dt * w[a, i] * w[width + b, i]
                            if dim == 3:
                                share *= w[2 * width + c, i]
                            for k in range(dim):
                                x[block * dim + k, i] += share * rows[node, 1 + k]

    return Carriers(add_forces, follow)
