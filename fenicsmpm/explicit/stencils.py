# SPDX-License-Identifier: MIT
"""Grid functions at blocks of eight points, for the kernels of explicit steps (numba).

What belongs to the points of a block stands side by side: arrays over points have the shape
``(n_blocks * components, 8)``, so that formulas act on rows, eight points at once.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm.basis.lines import (
    CUBIC,
    LINEAR,
    QUADRATIC,
    WIDTH,
    cubic,
    cubic_inside,
    gimp,
    gimp_inside,
    linear,
    quadratic,
    quadratic_inside,
)
from fenicsmpm.lanes import LANES, between, load, store, store_integers, zeros

OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
# Calls in the loops over points would cost more than what they do. What is inlined need not be kept
# on disk for itself: it is a part of the loops.
_inline = numba.njit(forceinline=True, **OPTIONS)


def in_blocks(values: npt.NDArray[np.float64], filling: Any = 0.0) -> npt.NDArray[np.float64]:
    """Array ``(n, ...)`` over points as one of blocks, ``(n_blocks * components, 8)``.

    Args:
        values: at the points.
        filling: value of the points that fill up the last block, as the shape of a point's.
    """
    n, full = len(values), len(values) // LANES
    components = math.prod(values.shape[1:])
    rows = np.empty((-(-n // LANES), components, LANES))
    flat = values.reshape(n, components)
    rows[:full] = np.moveaxis(flat[: full * LANES].reshape(full, LANES, components), 1, 2)
    if n % LANES:
        rows[full] = np.broadcast_to(filling, values.shape[1:]).reshape(components, 1)
        rows[full, :, : n % LANES] = flat[full * LANES :].T
    return rows.reshape(-1, LANES)


def out_of_blocks(
    rows: npt.NDArray[np.float64], n: int, shape: tuple[int, ...] = ()
) -> npt.NDArray[np.float64]:
    """Values ``(n, *shape)`` at points from an array of blocks."""
    components = math.prod(shape)
    points = np.moveaxis(rows.reshape(-1, components, LANES), 2, 1)
    return points.reshape(-1, *shape)[:n]


@functools.cache
def stencils(dim: int, kind: int) -> Any:
    """Compile the numba function that finds grid functions at a block of points.

    Its arguments are positions ``(n_blocks * d, 8)``, the number of the block, the nodes
    (``grid.Nodes``), the points' half size in cells, and results: the number of each point's first
    node ``(8,)``, values and slopes ``(3 * width, 8)``, row ``k * width + a`` for the a-th node in
    direction k.
    """
    width = WIDTH[kind]
    inside, anywhere = _functions(kind)

    @_inline
    def fill(x, block, nodes, half, base, w, d):
        near_wall, node = False, zeros()
        for k in range(dim):
            t = (load(x, block * dim + k) - nodes.origin[k]) * nodes.per_metre[k]
            first, values, slopes, no_wall = inside(t, nodes.shape[k] - 1, half[k])
            near_wall |= not no_wall
            for a in range(width):
                store(w, k * width + a, values[a])
                store(d, k * width + a, slopes[a] * nodes.per_metre[k])
            node = node * nodes.shape[k] + first
        store_integers(base, node)
        if near_wall:
            for i in range(LANES):
                number = np.int64(0)
                for k in range(dim):
                    t_i = (x[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                    first_i, values_i, slopes_i = anywhere(t_i, nodes.shape[k] - 1, half[k])
                    number = number * nodes.shape[k] + first_i
                    for a in range(width):
                        w[k * width + a, i] = values_i[a]
                        d[k * width + a, i] = slopes_i[a] * nodes.per_metre[k]
                base[i] = number

    return fill


@_inline
def strides(nodes):
    """Distances in memory of nodes next to each other in the first and in the second direction."""
    return nodes.shape[1] * nodes.shape[2], nodes.shape[2]


@functools.cache
def _functions(kind: int) -> Any:
    """Functions of a kind in one direction for eight points away from walls, and for one anywhere.

    Both give the first node, values and slopes of functions; the first one in addition whether all
    points are away from walls.
    """
    if kind == LINEAR:

        @_inline
        def inside(t, cells, half):
            c = min(max(math.floor(t), 0.0), cells - 1.0)
            values, slopes, _ = linear(t - c)
            return c, values, (zeros() + slopes[0], zeros() + slopes[1]), True

        @_inline
        def anywhere(t, cells, half):
            c = min(int(t), cells - 1)
            values, slopes, _ = linear(t - c)
            return c, values, slopes

    elif kind == CUBIC:

        @_inline
        def inside(t, cells, half):
            c = math.floor(t)
            values, slopes = cubic_inside(t - c)
            return c - 1.0, values, slopes, between(c, 1, cells - 2)

        @_inline
        def anywhere(t, cells, half):
            c = min(int(t), cells - 1)
            values, slopes, _ = cubic(t - c, c == 0, c == cells - 1)
            # a node beyond a wall has no share: the four nodes that count are inside
            if c == 0:
                return 0, _up4(values), _up4(slopes)
            if c == cells - 1:
                return cells - 3, _down4(values), _down4(slopes)
            return c - 1, values, slopes

    else:
        is_spline = kind == QUADRATIC

        @_inline
        def inside(t, cells, half):
            node = math.floor(t + 0.5)
            values, slopes = (
                quadratic_inside(t - node) if is_spline else gimp_inside(t - node, half)
            )
            return node - 1.0, values, slopes, between(node, 1, cells - 1)

        @_inline
        def anywhere(t, cells, half):
            node = int(t + 0.5)
            lower, upper = node == 0, node == cells
            if is_spline:
                values, slopes, _ = quadratic(t - node, lower, upper)
            else:
                values, slopes, _ = gimp(t - node, half, lower, upper)
            if lower:
                return 0, _up3(values), _up3(slopes)
            if upper:
                return cells - 2, _down3(values), _down3(slopes)
            return node - 1, values, slopes

    return inside, anywhere


@_inline
def _up3(f):
    return f[1], f[2], 0.0


@_inline
def _down3(f):
    return 0.0, f[0], f[1]


@_inline
def _up4(f):
    return f[1], f[2], f[3], 0.0


@_inline
def _down4(f):
    return 0.0, f[0], f[1], f[2]
