# SPDX-License-Identifier: MIT
"""Grid functions at blocks of eight points, for the kernels of explicit steps (numba).

Data of the points of a block are contiguous: arrays over points have the shape
``(n_blocks * components, 8)``, so that formulas act on rows, eight points at once. The last block
of a tile is filled up with copies of a point that have no mass and no volume.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
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
from fenicsmpm.basis.stencil import LEAST
from fenicsmpm.basis.windows import ON_WALL, window
from fenicsmpm.lanes import LANES, between, load, store, store_integers, zeros

OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
# Calls in the loops over points would cost more than their work, and so would reference counts of
# arrays: inlining avoids both. These functions need no cache of their own on disk. Nor are they
# called from Python: code that unpacks all arrays of a body would take a fifth of the compilation.
INNER: dict[str, Any] = {**OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inline = numba.njit(forceinline=True, _nrt=False, **INNER)


@njit
def plain_order(n):
    """Return the order of points in blocks, one after the other, filled up with the last one."""
    order = np.empty((n + LANES - 1) // LANES * LANES, np.int32)
    for i in range(len(order)):
        order[i] = i if i < n else -n
    return order


@njit
def _to_blocks(flat, order, rows, copied):
    components = flat.shape[1]
    for slot in range(len(order)):
        p, block, i = order[slot], slot // LANES, slot % LANES
        for k in range(components):
            if p >= 0:
                rows[block * components + k, i] = flat[p, k]
            else:
                rows[block * components + k, i] = flat[-1 - p, k] if copied else 0.0


@njit
def _from_blocks(rows, order, flat):
    components = flat.shape[1]
    for slot in range(len(order)):
        p, block, i = order[slot], slot // LANES, slot % LANES
        if p >= 0:
            for k in range(components):
                flat[p, k] = rows[block * components + k, i]


def in_blocks(
    values: npt.NDArray[np.float64], order: npt.NDArray[np.int32], copied: bool = True
) -> npt.NDArray[np.float64]:
    """Convert an array ``(n, ...)`` over points to blocks, ``(n_blocks * components, 8)``.

    Args:
        values: Values at the points.
        order: Points of the blocks, ``-1 - p`` for a copy of p, shape ``(8 n_blocks,)``.
        copied: Whether copies have the values of their point; otherwise they are zero.
    """
    components = math.prod(values.shape[1:])
    rows = empty_rows(len(order) // LANES * components, LANES)
    flat = np.ascontiguousarray(values).reshape(len(values), components)
    _to_blocks(flat, order, rows, copied)
    return rows


def out_of_blocks(
    rows: npt.NDArray[np.float64],
    order: npt.NDArray[np.int32],
    n: int,
    shape: tuple[int, ...] = (),
) -> npt.NDArray[np.float64]:
    """Convert an array of blocks to values ``(n, *shape)`` at points, see ``in_blocks``."""
    flat = np.empty((n, math.prod(shape)))
    _from_blocks(rows, order, flat)
    return flat.reshape(n, *shape)


def empty_rows(n: int, lanes: int) -> npt.NDArray[np.float64]:
    """Return an uninitialized array ``(n, lanes)`` whose rows do not cross cache lines."""
    memory = np.empty(n * lanes + LANES)
    skip = (-memory.ctypes.data // memory.itemsize) % LANES
    return memory[skip : skip + n * lanes].reshape(n, lanes)


@functools.cache
def stencils(dim: int, kind: int, in_window: bool, with_slopes: bool = True) -> Any:
    """Compile the numba function that evaluates grid functions at a block of points.

    Its arguments are the positions ``(n_blocks * d, 8)``, the number of the block, the nodes
    (``tiles.Nodes``), the points' half size in cells, the first node ``(3,)`` of a window, and the
    results: each point's first node in the window in each direction ``(3, 8)``, its place there
    ``(8,)``, and values and slopes ``(3 * width, 8)`` with row ``k * width + a`` for the a-th node
    in direction k.

    Args:
        dim: Dimension, 2 or 3.
        kind: Kind of the grid functions.
        in_window: False for places in the lattice, numbered with the last direction fastest.
        with_slopes: False for values only.
    """
    width = WIDTH[kind]
    inside, anywhere = _functions(kind)
    shape = window(dim, width)
    steps = (shape.far, shape.near, 1)
    # all kinds of functions are linear near a wall
    at_first = (1.0 - LEAST, LEAST, *[0.0] * (width - 2))
    at_last = (*[0.0] * (width - 2), LEAST, 1.0 - LEAST)

    @inline
    def step(k, nodes):
        if in_window:
            return steps[k]
        n = 1
        for j in range(k + 1, dim):
            n *= nodes.shape[j]
        return n

    @inline
    def at_wall(t, cells, half):
        """As ``anywhere``; on a wall, values are exact apart from ``LEAST``."""
        first, values, slopes = anywhere(min(max(t, 0.0), float(cells)), cells, half)
        if t < ON_WALL:
            return first, at_first, slopes
        if t > cells - ON_WALL:
            return first, at_last, slopes
        return first, values, slopes

    @inline
    def fill(x, block, nodes, half, lower, corner, base, w, d):
        near_wall, place = False, zeros()
        for k in range(dim):
            t = (load(x, block * dim + k) - nodes.origin[k]) * nodes.per_metre[k]
            first, values, slopes, no_wall = inside(t, nodes.shape[k] - 1, half[k])
            near_wall |= not no_wall
            for a in range(width):
                store(w, k * width + a, values[a])
                if with_slopes:
                    store(d, k * width + a, slopes[a] * nodes.per_metre[k])
            store(corner, k, first - lower[k])
            place = place + (first - lower[k]) * float(step(k, nodes))
        store_integers(base, place)
        if near_wall:
            for i in range(LANES):
                number = np.int64(0)
                for k in range(dim):
                    t_i = (x[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                    n = nodes.shape[k] - 1
                    first_i, values_i, slopes_i = at_wall(t_i, n, half[k])
                    corner[k, i] = first_i - np.int64(lower[k])
                    number += (first_i - np.int64(lower[k])) * step(k, nodes)
                    for a in range(width):
                        w[k * width + a, i] = values_i[a]
                        if with_slopes:
                            d[k * width + a, i] = slopes_i[a] * nodes.per_metre[k]
                base[i] = number

    return fill


@functools.cache
def _functions(kind: int) -> Any:
    """Return functions of a kind in one direction, for eight points away from walls and anywhere.

    Both return the first node, values and slopes. The first one also returns whether all points are
    away from walls.
    """
    if kind == LINEAR:

        @inline
        def inside(t, cells, half):
            c = min(max(math.floor(t), 0.0), cells - 1.0)
            values, slopes, _ = linear(min(max(t - c, LEAST), 1.0 - LEAST))
            return c, values, (zeros() + slopes[0], zeros() + slopes[1]), True

        @inline
        def anywhere(t, cells, half):
            c = min(int(t), cells - 1)
            values, slopes, _ = linear(t - c)
            return c, values, slopes

    elif kind == CUBIC:

        @inline
        def inside(t, cells, half):
            c = math.floor(t)
            values, slopes = cubic_inside(t - c)
            return c - 1.0, values, slopes, between(c, 1, cells - 2)

        @inline
        def anywhere(t, cells, half):
            c = min(int(t), cells - 1)
            values, slopes, _ = cubic(t - c, c == 0, c == cells - 1)
            # a node beyond a wall has value 0: the four nodes that count are inside
            if c == 0:
                return 0, _up4(values), _up4(slopes)
            if c == cells - 1:
                return cells - 3, _down4(values), _down4(slopes)
            return c - 1, values, slopes

    else:
        is_spline = kind == QUADRATIC

        @inline
        def inside(t, cells, half):
            node = math.floor(t + 0.5)
            values, slopes = (
                quadratic_inside(t - node) if is_spline else gimp_inside(t - node, half)
            )
            return node - 1.0, values, slopes, between(node, 1, cells - 1)

        @inline
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


@inline
def _up3(f):
    return f[1], f[2], 0.0


@inline
def _down3(f):
    return 0.0, f[0], f[1]


@inline
def _up4(f):
    return f[1], f[2], f[3], 0.0


@inline
def _down4(f):
    return 0.0, f[0], f[1], f[2]
