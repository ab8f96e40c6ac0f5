# SPDX-License-Identifier: MIT
"""Updates of blocks of eight points from the nodes: motion, F, averages of J.

Equation numbers refer to Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric locking in explicit
material point methods" (F-bar).
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fenicsmpm.basis.blocks import inline
from fenicsmpm.basis.windows import ON_WALL, window
from fenicsmpm.lanes import (
    LANES,
    LINE_LANES,
    WIDE,
    add_scaled,
    between,
    choose,
    high_half,
    line_at,
    load,
    load_columns,
    load_line,
    low_half,
    number_at,
    store,
    store_columns,
    store_line,
    zero_line,
    zeros,
)
from fenicsmpm.materials.tensors import cube_root

# First lines of a block's points: in 2D velocity and its increment; in 3D mass and velocity, then
# volume and increment; then the slopes of the velocity in each direction
_LOW, _HIGH, _X, _Y, _Z, LINES = (k * LANES for k in range(6))
_TINY, _HUGE = np.finfo(float).tiny, np.finfo(float).max


class ToPoints(NamedTuple):
    """Parts of kernels, to be inlined; see ``to_points``."""

    interpolate: Callable[..., None]
    move: Callable[..., tuple[bool, bool]]
    deform: Callable[..., bool]
    means: Callable[..., object]
    volume_ratio: Callable[..., object]
    root: Callable[..., object]


@functools.cache
def to_points(dim: int, width: int, rates: bool, has_F33: bool, has_J_0: bool) -> ToPoints:
    """Compile the functions that update blocks of points from nodes.

    Args:
        dim: Dimension, 2 or 3.
        width: Number of nodes per direction that a point sees.
        rates: Whether the material needs the velocity gradient.
        has_F33: Whether points in 2D have out-of-plane stretches.
        has_J_0: Whether averages of J began where J was not 1.
    """
    shape = window(dim, width)
    far, near, last = shape.far, shape.near, (dim - 1) * width
    # the first columns of velocities and of their increments
    v_first, i_first = (0, 2) if dim == 2 else (1, 1)
    before = LINE_LANES - 1

    @inline
    def determinant(F, first):
        """Return determinants of the tensors (d, d) in the rows from `first` on."""
        if dim == 2:
            return load(F, first) * load(F, first + 3) - load(F, first + 1) * load(F, first + 2)
        a, b, c = load(F, first), load(F, first + 1), load(F, first + 2)
        d, e, f = load(F, first + 3), load(F, first + 4), load(F, first + 5)
        g, h, i = load(F, first + 6), load(F, first + 7), load(F, first + 8)
        return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)

    @inline
    def volume_ratio(body, block):
        """Return J of the points of a block."""
        J = determinant(body.F, block * dim * dim)
        return J * load(body.F33, block) if has_F33 else J

    @inline
    def root(x):
        return math.sqrt(x) if dim == 2 else cube_root(x)

    @inline
    def strain(f):
        """Return the norm of sym(f) - I, the strain increment of relative gradients f (d, d)."""
        total = zeros()
        for j in range(dim):
            normal = load(f, j * dim + j) - 1.0
            total += normal * normal
            for k in range(j):
                shear = load(f, j * dim + k) + load(f, k * dim + j)
                total += 0.5 * shear * shear
        return math.sqrt(total)

    # in 2D, lines of four hold all that points need
    wide = WIDE and dim == 3
    none = zeros if wide else zero_line

    @inline
    def get(rows, node):
        """Return the halves of a row. In 2D and of wide registers, ``low`` holds all of it."""
        if wide:
            return load(rows, node), zero_line()
        if dim == 2:
            return load_line(rows, node), zero_line()
        return load_line(rows, 2 * node), load_line(rows, 2 * node + 1)

    @inline
    def along_last(first, i, w, d, rows):
        """Interpolate the halves of the rows, and slopes of ``low``, along one line of nodes."""
        low, high, slope = none(), zero_line(), none()
        for c in range(width):
            w_c, d_c = number_at(w, (last + c) * LANES + i), number_at(d, (last + c) * LANES + i)
            nodal, rest = get(rows, first + c)
            low, slope = add_scaled(low, w_c, nodal), add_scaled(slope, d_c, nodal)
            high = add_scaled(high, w_c, rest)
        return low, high, slope

    @inline
    def along_second(first, i, w, d, rows):
        """Interpolate also slopes in the second direction, in a plane of nodes in 3D."""
        if dim == 2:
            low, high, by_y = along_last(first, i, w, d, rows)
            return low, high, by_y, none()
        low, high, by_y, by_z = none(), zero_line(), none(), none()
        for b in range(width):
            w_b, d_b = number_at(w, (width + b) * LANES + i), number_at(d, (width + b) * LANES + i)
            low_b, high_b, z_b = along_last(first + b * near, i, w, d, rows)
            low, by_y = add_scaled(low, w_b, low_b), add_scaled(by_y, d_b, low_b)
            high, by_z = add_scaled(high, w_b, high_b), add_scaled(by_z, w_b, z_b)
        return low, high, by_y, by_z

    @inline
    def interpolate(base, w, d, rows, lines):
        """Interpolate all nodal values, and slopes of velocities, to the points of a block."""
        for i in range(LANES):
            low, high, start = none(), zero_line(), base[i]
            by_x, by_y, by_z = none(), none(), none()
            for a in range(width):
                w_a, d_a = number_at(w, a * LANES + i), number_at(d, a * LANES + i)
                low_a, high_a, y_a, z_a = along_second(start + a * far, i, w, d, rows)
                low, by_x = add_scaled(low, w_a, low_a), add_scaled(by_x, d_a, low_a)
                high, by_y = add_scaled(high, w_a, high_a), add_scaled(by_y, w_a, y_a)
                by_z = add_scaled(by_z, w_a, z_a)
            if wide:
                high, low = high_half(low), low_half(low)
                by_x, by_y, by_z = low_half(by_x), low_half(by_y), low_half(by_z)
            store_line(lines, _LOW + i, low)
            store_line(lines, _X + i, by_x)
            store_line(lines, _Y + i, by_y)
            if dim == 3:
                store_line(lines, _HIGH + i, high)
                store_line(lines, _Z + i, by_z)

    @inline
    def move(body, block, unit, units, nodes, lines, dt, flip):
        """Update velocity and next position of the points of a block (eqs. 11-13 and 17).

        Returns:
            Whether all are finite and inside the lattice, and inside their window.
        """
        vector, good, stays = block * dim, True, True
        low = load_columns(lines, _LOW)
        high = load_columns(lines, _HIGH) if dim == 3 else low
        for j in range(dim):
            velocity, increment = low[v_first + j], high[i_first + j]
            x_next = load(body.x, vector + j) + dt * velocity
            t = (x_next - nodes.origin[j]) * nodes.per_metre[j]
            cells = nodes.shape[j] - 1
            stays &= between(t, units.t_low[unit, j], units.t_high[unit, j])
            if between(t, -ON_WALL, cells + ON_WALL):
                x_next = choose(ON_WALL - t, nodes.origin[j], x_next)
                x_next = choose(t - (cells - ON_WALL), nodes.upper[j], x_next)
            else:
                good = False
            in_flip = load(body.v, vector + j) + increment
            v_next = flip * in_flip + (1.0 - flip) * velocity
            store(body.x_next, vector + j, x_next)
            store(body.v, vector + j, v_next)
            good &= between(v_next, -_HUGE, _HUGE)
        return good, stays

    @inline
    def deform(body, block, base, w, lines, f, shares, last_w, averages, dt, average, r, s):
        """Update F of the points of a block, and add J to the lines of the nodes for averaging.

        Returns:
            Whether no point is inverted.
        """
        tensor = block * dim * dim
        # eq. 16
        for k in range(dim):
            slopes = load_columns(lines, _X + k * LANES)
            for j in range(dim):
                rate = slopes[v_first + j]
                if rates:
                    store(body.L, tensor + j * dim + k, rate)
                store(f, j * dim + k, dt * rate + 1.0 if j == k else dt * rate)
        J_before, dJ = volume_ratio(body, block), determinant(f, 0)
        J_old = J_before
        shrink = 1.0 + zeros()
        if average and s > 0.0:
            J_star = J_old + min(s * strain(f), 1.0) * (load(body.J_bar, block) - J_old)
            shrink = root(J_star / J_old)
            J_old = J_star
        # eq. 14
        for k in range(dim):
            F_0, F_1 = load(body.F, tensor + k), load(body.F, tensor + dim + k)
            F_2 = load(body.F, tensor + 2 * dim + k) if dim == 3 else F_0
            for j in range(dim):
                new = load(f, j * dim) * F_0 + load(f, j * dim + 1) * F_1
                if dim == 3:
                    new += load(f, j * dim + 2) * F_2
                store(body.F, tensor + j * dim + k, shrink * new)
        if average:
            # algorithm 1, step 3, with r = 0; eq. 19 with r = 1
            mixed = (1.0 - r) * load(body.J_bar, block) + r * J_old
            if has_J_0:
                mixed /= load(body.J_0, block)
            store(shares, 0, load(body.V_0, block) * J_before * dJ * mixed)
            third = load(w, last + 2) if width > 2 else zeros()
            fourth = load(w, last + 3) if width > 3 else zeros()
            store_columns(last_w, 0, load(w, last), load(w, last + 1), third, fourth)
            for i in range(LANES):
                weights, share, start = load_line(last_w, i), shares[0, i], base[i] + before
                for a in range(width):
                    share_a = share * number_at(w, a * LANES + i)
                    if dim == 2:
                        _add_line(averages, start + a * far, share_a, weights)
                    else:
                        for b in range(width):
                            share_b = share_a * number_at(w, (width + b) * LANES + i)
                            _add_line(averages, start + a * far + b * near, share_b, weights)
        return between(dJ * J_old, _TINY, _HUGE)

    @inline
    def means(body, block, base, w, averages, lines):
        """Return the averaged J at the points of a block."""
        for i in range(LANES):
            total, start = zero_line(), base[i]
            for a in range(width):
                w_a = number_at(w, a * LANES + i)
                if dim == 2:
                    total = add_scaled(total, w_a, line_at(averages, start + a * far))
                else:
                    for b in range(width):
                        w_b = w_a * number_at(w, (width + b) * LANES + i)
                        node = start + a * far + b * near
                        total = add_scaled(total, w_b, line_at(averages, node))
            store_line(lines, i, total)
        total, columns = zeros(), load_columns(lines, 0)
        for c in range(width):
            total += columns[c] * load(w, last + c)
        return total * load(body.J_0, block) if has_J_0 else total

    return ToPoints(interpolate, move, deform, means, volume_ratio, root)


@inline
def _add_line(lines, node, factor, line):
    store_line(lines, node, add_scaled(load_line(lines, node), factor, line))
