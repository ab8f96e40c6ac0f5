# SPDX-License-Identifier: MIT
"""Copies between the grid's tiles and the window in which the points of a tile see them (numba).

Only the nodes of a window that points see at present are copied. Windows that are added to are
empty before and after a unit of work.

Rows of the grid are stored tile by tile, ``(n_tiles * nodes of a tile, 8)``. Averages need one
number per node. Their sums are collected in lines of four, of a node and the three after it:
numbers that are read soon after they were written must be read with the same width.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from fenicsmpm.basis.blocks import INNER, inline
from fenicsmpm.basis.windows import window
from fenicsmpm.lanes import (
    LANES,
    LINE_LANES,
    add_scaled,
    line_of,
    load,
    number_at,
    store,
    store_line,
    zero_line,
    zeros,
)
from fenicsmpm.transfer.grid_rows import INCREMENT, VELOCITY

_njit = numba.njit(**INNER)

# Extra room beyond the last node, for lines that begin there
SPARE = LINE_LANES


@numba.njit(forceinline=True, **INNER)
def scratch_rows(n, lanes):
    """Return zeros ``(n, lanes)`` in compiled code, each row or line within a cache line."""
    memory = np.zeros(n * lanes + LANES)
    skip = (LANES - memory.ctypes.data // 8 % LANES) % LANES
    return memory[skip : skip + n * lanes].reshape(n, lanes)


class Windows(NamedTuple):
    """Copies between tiles and windows; see ``windows``."""

    load_rows: Callable[..., None]
    add_rows: Callable[..., None]
    add_lines: Callable[..., None]
    load_averages: Callable[..., None]


@functools.cache
def windows(dim: int, width: int) -> Windows:
    """Compile copies between tiles and windows, for functions of `width` nodes per direction."""
    shape = window(dim, width)
    side, margin, far, near = shape.side, shape.margin, shape.far, shape.near
    before = LINE_LANES - 1
    layers = range(3) if dim == 3 else range(1, 2)
    first_layer, last_layer = layers[0], layers[-1] + 1
    side_z, margin_z = (side, margin) if dim == 3 else (1, 0)
    per_tile = side * side * side_z

    @inline
    def extent(i, n, rim, first, last):
        """Return the wanted nodes of the i-th of three tiles of n, from the middle one on."""
        return max((i - 1) * n, first - rim), min(i * n, last + 1 - rim)

    def each_line(body: Any) -> Any:
        """Compile a loop over the lines that windows and tiles have in common.

        The arguments of the loop are a unit, its tiles, the first and last nodes that points see in
        the windows, ``(n, 3)`` each, and two arrays. The arguments of `body` are the place in the
        window, the row of the grid, the number of nodes, and the arrays.
        """

        @_njit
        def loop(unit, tiles, first, last, a, b):
            for i in range(3):
                x_low, x_high = extent(i, side, margin, first[unit, 0], last[unit, 0])
                for j in range(3):
                    y_low, y_high = extent(j, side, margin, first[unit, 1], last[unit, 1])
                    for k in range(first_layer, last_layer):
                        tile = tiles[unit, (i * 3 + j) * 3 + k]
                        if tile < 0:
                            continue
                        z_low, z_high = extent(k, side_z, margin_z, first[unit, 2], last[unit, 2])
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

    @inline
    def from_row(place, row, n, rows, scratch):
        for m in range(n):
            if dim == 3:
                store(scratch, place + m, load(rows, row + m))
            else:
                first = (row + m) * LANES
                line = line_of(
                    number_at(rows, first + VELOCITY), number_at(rows, first + VELOCITY + 1),
                    number_at(rows, first + INCREMENT), number_at(rows, first + INCREMENT + 1),
                )  # fmt: skip
                store_line(scratch, place + m, line)

    @inline
    def to_row(place, row, n, scratch, rows):
        for m in range(n):
            store(rows, row + m, add_scaled(load(rows, row + m), 1.0, load(scratch, place + m)))
            store(scratch, place + m, zeros())

    @inline
    def from_average(place, row, n, averages, scratch):
        for m in range(n):
            scratch[place + m] = averages[row + m]

    @inline
    def to_sum(place, row, n, lines, sums):
        for i in range(n):
            m = place + before + i
            total = lines[m, 0] + lines[m - 1, 1]
            sums[row + i] += total + (lines[m - 2, 2] + lines[m - 3, 3])

    add_sums = each_line(to_sum)

    @_njit
    def add_lines(unit, tiles, first, last, lines, sums):
        """Add lines ``(places + SPARE, 4)``, of which the first three are empty, to the nodes."""
        add_sums(unit, tiles, first, last, lines, sums)
        for x in range(first[unit, 0], last[unit, 0] + 1):
            if dim == 2:
                for y in range(first[unit, 1], last[unit, 1] + 1):
                    store_line(lines, x * far + y + before, zero_line())
                continue
            for y in range(first[unit, 1], last[unit, 1] + 1):
                for z in range(first[unit, 2], last[unit, 2] + 1):
                    store_line(lines, x * far + y * near + z + before, zero_line())

    return Windows(each_line(from_row), each_line(to_row), add_lines, each_line(from_average))
