# SPDX-License-Identifier: MIT
"""Grid functions at blocks of points, for the kernels of explicit steps (numba).

Kernels work on blocks: what a point needs is found for all points of a block before the next stage
begins. The loops are then short enough for a processor to work on several points at once.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np

from fenicsmpm.basis.lines import CUBIC, LINEAR, QUADRATIC, WIDTH, cubic, gimp, quadratic

BLOCK = 8

# Not cached: numba would not find again what is compiled for functions that were passed to it
OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
# calls in the loops over points would cost more than what they do
_inline = numba.njit(forceinline=True, **OPTIONS)


@functools.cache
def stencils(dim: int, kind: int) -> Any:
    """Compile the numba function that finds grid functions at a block of points.

    Its arguments are positions ``(n, d)``, the first point and the number of points, the nodes
    (``grid.Nodes``), the points' half size in cells, and results: the number of each point's first
    node ``(BLOCK,)``, values and slopes in each direction ``(BLOCK, 3, width)``.
    """
    width, functions = WIDTH[kind], _functions(kind)

    @_inline
    def fill(x, start, n, nodes, half, base, w, d):
        for i in range(n):
            node = np.int64(0)
            for k in range(dim):
                t = (x[start + i, k] - nodes.origin[k]) * nodes.per_metre[k]
                first = functions(t, nodes.shape[k] - 1, half[k], w, d, i, k)
                node = node * nodes.shape[k] + first
                for a in range(width):
                    d[i, k, a] *= nodes.per_metre[k]
            base[i] = node

    return fill


@_inline
def strides(nodes):
    """Distances in memory of nodes next to each other in the first and in the second direction."""
    return nodes.shape[1] * nodes.shape[2], nodes.shape[2]


@functools.cache
def _functions(kind: int) -> Any:
    """Values and slopes of a kind of functions in one direction, and the first node."""
    if kind == LINEAR:

        @_inline
        def functions(t, cells, half, w, d, i, k):
            c = min(int(t), cells - 1)
            w[i, k, 0], w[i, k, 1] = 1.0 - (t - c), t - c
            d[i, k, 0], d[i, k, 1] = -1.0, 1.0
            return c

    elif kind == CUBIC:

        @_inline
        def functions(t, cells, half, w, d, i, k):
            c = min(int(t), cells - 1)
            values, slopes, _ = cubic(t - c, c == 0, c == cells - 1)
            # a node beyond a wall has no share: the four nodes that count are inside
            shift = 1 if c == 0 else -1 if c == cells - 1 else 0
            for a in range(4):
                b = a + shift
                w[i, k, a] = values[b] if 0 <= b < 4 else 0.0
                d[i, k, a] = slopes[b] if 0 <= b < 4 else 0.0
            return c - 1 + shift

    else:
        spline = kind == QUADRATIC

        @_inline
        def functions(t, cells, half, w, d, i, k):
            node = int(t + 0.5)
            lower, upper = node == 0, node == cells
            if spline:
                values, slopes, _ = quadratic(t - node, lower, upper)
            else:
                values, slopes, _ = gimp(t - node, half, lower, upper)
            a0, a1, a2 = values
            d0, d1, d2 = slopes
            if lower:
                w[i, k, 0], w[i, k, 1], w[i, k, 2] = a1, a2, 0.0
                d[i, k, 0], d[i, k, 1], d[i, k, 2] = d1, d2, 0.0
                return 0
            if upper:
                w[i, k, 0], w[i, k, 1], w[i, k, 2] = 0.0, a0, a1
                d[i, k, 0], d[i, k, 1], d[i, k, 2] = 0.0, d0, d1
                return cells - 2
            w[i, k, 0], w[i, k, 1], w[i, k, 2] = a0, a1, a2
            d[i, k, 0], d[i, k, 1], d[i, k, 2] = d0, d1, d2
            return node - 1

    return functions
