# SPDX-License-Identifier: MIT
"""Between the grid's tiles and the window in which the points of a tile see them (numba).

Rows of the grid stand tile by tile, ``(n_tiles * nodes of a tile, 8)``. Averages need one number a
node; their sums are collected in lines of four, of a node and of those after it, because numbers
that are read soon after they were written must be read as they were written.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from fenicsmpm.basis.blocks import OPTIONS
from fenicsmpm.basis.windows import window
from fenicsmpm.lanes import LANES, LINE_LANES, add_scaled, load, store, store_line, zero_line, zeros

_njit = numba.njit(**OPTIONS)
_inline = numba.njit(forceinline=True, **OPTIONS)

# What is allocated beyond the last node, for lines that begin there
SPARE = LINE_LANES


@_inline
def scratch_rows(n, lanes):
    """Zeros ``(n, lanes)`` in compiled code, each row or line within a cache line."""
    memory = np.zeros(n * lanes + LANES)
    skip = (LANES - memory.ctypes.data // 8 % LANES) % LANES
    return memory[skip : skip + n * lanes].reshape(n, lanes)


class Windows(NamedTuple):
    """Copies between tiles and windows; see ``windows``."""

    clear_rows: Callable[..., None]
    load_rows: Callable[..., None]
    add_rows: Callable[..., None]
    clear_lines: Callable[..., None]
    add_lines: Callable[..., None]
    load_averages: Callable[..., None]


@functools.cache
def windows(dim: int, width: int) -> Windows:
    """Compile copies between tiles and windows, for functions of some nodes a direction."""
    shape = window(dim, width)
    side, margin, size, far, near = shape.side, shape.margin, shape.size, shape.far, shape.near
    count, reach = shape.places, LINE_LANES - 1
    layers = range(3) if dim == 3 else range(1, 2)
    first_layer, last_layer = layers[0], layers[-1] + 1
    depth, side_z = (size, side) if dim == 3 else (1, 1)
    margin_z = margin if dim == 3 else 0
    per_tile = side * side * side_z

    @_inline
    def extent(i):
        """Nodes of the i-th of three tiles that are in the window, counted from the middle one."""
        return max((i - 1) * side, -margin), min(i * side, size - margin)

    @_inline
    def extent_z(i):
        return max((i - 1) * side_z, -margin_z), min(i * side_z, depth - margin_z)

    def each_line(body: Any) -> Any:
        """Compile a loop over what windows and tiles have in common, line by line.

        Arguments of the loop are a unit, its tiles, and two arrays; of the body the place in the
        window, the row of the grid, the number of nodes, and the arrays.
        """

        @_njit
        def loop(unit, tiles, a, b):
            for i in range(3):
                x_low, x_high = extent(i)
                for j in range(3):
                    y_low, y_high = extent(j)
                    for k in range(first_layer, last_layer):
                        tile = tiles[unit, (i * 3 + j) * 3 + k]
                        if tile < 0:
                            continue
                        z_low, z_high = extent_z(k)
                        for x in range(x_low, x_high):
                            if dim == 2:
                                place = (x + margin) * far + y_low + margin
                                row = tile * per_tile + (x - (i - 1) * side) * side
                                body(place, row + y_low - (j - 1) * side, y_high - y_low, a, b)
                                continue
                            for y in range(y_low, y_high):
                                place = (x + margin) * far + (y + margin) * near + z_low + margin
                                row = (x - (i - 1) * side) * side + y - (j - 1) * side
                                row = tile * per_tile + row * side_z + z_low - (k - 1) * side_z
                                body(place, row, z_high - z_low, a, b)

        return loop

    @_inline
    def from_row(place, row, n, rows, scratch):
        for m in range(n):
            store(scratch, place + m, load(rows, row + m))

    @_inline
    def to_row(place, row, n, scratch, rows):
        for m in range(n):
            store(rows, row + m, add_scaled(load(rows, row + m), 1.0, load(scratch, place + m)))

    @_inline
    def from_average(place, row, n, averages, scratch):
        for m in range(n):
            scratch[place + m] = averages[row + m]

    @_inline
    def to_sum(place, row, n, scratch, sums):
        for m in range(n):
            sums[row + m] += scratch[place + m]

    add_sums = each_line(to_sum)

    @_njit
    def clear_rows(scratch):
        for n in range(count):
            store(scratch, n, zeros())

    @_njit
    def clear_lines(lines):
        for n in range(count + SPARE):
            store_line(lines, n, zero_line())

    @_njit
    def add_lines(unit, tiles, lines, scratch, sums):
        """Lines ``(count + SPARE, 4)``, of which the first reach ones are empty, to the nodes."""
        for n in range(count):
            m = n + reach
            total = lines[m, 0] + lines[m - 1, 1]
            scratch[n] = total + (lines[m - 2, 2] + lines[m - 3, 3])
        add_sums(unit, tiles, scratch, sums)

    return Windows(
        clear_rows,
        each_line(from_row),
        each_line(to_row),
        clear_lines,
        add_lines,
        each_line(from_average),
    )
