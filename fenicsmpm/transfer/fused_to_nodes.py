# SPDX-License-Identifier: MIT
"""Contributions of blocks of eight points to nodes: mass, momentum, volume and force.

Equation numbers refer to Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric locking in explicit
material point methods" (F-bar).
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from fenicsmpm.basis.blocks import inline
from fenicsmpm.basis.windows import window
from fenicsmpm.lanes import (
    LANES,
    LINE_LANES,
    WIDE,
    add_scaled,
    join,
    line_of,
    load,
    load_line,
    number_at,
    scaled,
    store,
    store_columns,
    store_line,
    zero_line,
    zeros,
)

# First lines of a block's points: mass and momentum, then forces by slopes in each direction. The
# volumes form a row behind them.
_LOW, _X, _Y, _Z, _VOLUMES = (k * LANES for k in range(5))
LINES = _VOLUMES + LANES // LINE_LANES


class ToNodes(NamedTuple):
    """Parts of kernels, to be inlined; see ``to_nodes``."""

    pack: Callable[..., None]
    add: Callable[..., None]


@functools.cache
def to_nodes(dim: int, width: int) -> ToNodes:
    """Compile the functions that add blocks of points to nodes.

    Args:
        dim: Dimension, 2 or 3.
        width: Number of nodes per direction that a point sees.
    """
    shape, last = window(dim, width), (dim - 1) * width

    @inline
    def pack(block, body, V, s, first, lines):
        """Compute the contributions of a block per value and slopes of a grid function.

        They are mass, momentum, volume and internal force (F-bar, eqs. 7, 8, 10). The stresses are
        s (3, 3) from row ``first`` on, of which the upper triangle is read. Each line is stored in
        memory and then loaded, which is faster than in registers.
        """
        m, nothing = load(body.mass, block), zeros()
        x, y = m * load(body.v, block * dim), m * load(body.v, block * dim + 1)
        z = m * load(body.v, block * dim + 2) if dim == 3 else nothing
        store_columns(lines, _LOW, m, x, y, z)
        store(lines, _VOLUMES * LINE_LANES // LANES, V)
        for k in range(dim):
            x, y = -V * load(s, first + k), -V * load(s, first + 3 * min(1, k) + max(1, k))
            z = -V * load(s, first + 3 * k + 2) if dim == 3 else nothing
            store_columns(lines, _X + k * LANES, nothing, x, y, z)

    @inline
    def of_point(lines, i):
        """Return the halves of a row of the grid, and the slopes of the second one."""
        low = load_line(lines, _LOW + i)
        high = line_of(number_at(lines, _VOLUMES * LINE_LANES + i), 0.0, 0.0, 0.0)
        by_x, by_y = load_line(lines, _X + i), load_line(lines, _Y + i)
        by_z = load_line(lines, _Z + i)
        if WIDE:
            none = zero_line()
            by_x, by_y, by_z = join(none, by_x), join(none, by_y), join(none, by_z)
            return none, join(low, high), by_x, by_y, by_z
        return low, high, by_x, by_y, by_z

    @inline
    def get(rows, node):
        """Return the halves of a row of the grid. Of wide registers, ``high`` holds all of it."""
        if WIDE:
            return zero_line(), load(rows, node)
        return load_line(rows, 2 * node), load_line(rows, 2 * node + 1)

    @inline
    def put(rows, node, low, high):
        """Overwrite a row of the grid with its halves."""
        if WIDE:
            store(rows, node, high)
        else:
            store_line(rows, 2 * node, low)
            store_line(rows, 2 * node + 1, high)

    @inline
    def at_first(given, i, a, w, d):
        """Multiply these by a point's functions in the first direction."""
        low, high, by_x, by_y, by_z = given
        w_a, d_a = number_at(w, a * LANES + i), number_at(d, a * LANES + i)
        high = add_scaled(scaled(w_a, high), d_a, by_x)
        return scaled(w_a, low), high, scaled(w_a, by_y), scaled(w_a, by_z)

    @inline
    def at_second(given, i, b, w, d):
        """Multiply them by the functions in the second of three directions."""
        low, high, by_y, by_z = given
        w_b, d_b = number_at(w, (width + b) * LANES + i), number_at(d, (width + b) * LANES + i)
        high = add_scaled(scaled(w_b, high), d_b, by_y)
        return scaled(w_b, low), high, scaled(w_b, by_z)

    @inline
    def times_last(low, high, given, i, c, w, d):
        """Multiply them by the functions in the last direction, and add them to halves of a row."""
        w_c, d_c = number_at(w, (last + c) * LANES + i), number_at(d, (last + c) * LANES + i)
        high = add_scaled(add_scaled(high, w_c, given[1]), d_c, given[2])
        return add_scaled(low, w_c, given[0]), high

    def adder(points: int) -> Any:
        """Compile the function that adds one point, or two with the same nodes, to these nodes."""

        @inline
        def along_last(first, i, one, j, two, w, d, rows):
            for c in range(width):
                low, high = get(rows, first + c)
                low, high = times_last(low, high, one, i, c, w, d)
                if points == 2:
                    low, high = times_last(low, high, two, j, c, w, d)
                put(rows, first + c, low, high)

        @inline
        def add_points(i, j, base, w, d, lines, rows):
            one, two, start = of_point(lines, i), of_point(lines, j), base[i]
            for a in range(width):
                one_a, two_a = at_first(one, i, a, w, d), at_first(two, j, a, w, d)
                first = start + a * shape.far
                if dim == 2:
                    along_last(first, i, one_a, j, two_a, w, d, rows)
                else:
                    for b in range(width):
                        one_b, two_b = at_second(one_a, i, b, w, d), at_second(two_a, j, b, w, d)
                        along_last(first + b * shape.near, i, one_b, j, two_b, w, d, rows)

        return add_points

    add_one, add_two = adder(1), adder(2)

    @inline
    def add(base, w, d, lines, rows):
        """Add the points of a block to their nodes, two at once if these are the same."""
        for i in range(0, LANES, 2):
            if base[i] == base[i + 1]:
                add_two(i, i + 1, base, w, d, lines, rows)
            else:
                add_one(i, i, base, w, d, lines, rows)
                add_one(i + 1, i + 1, base, w, d, lines, rows)

    return ToNodes(pack, add)
