# SPDX-License-Identifier: MIT
"""The transfers of an explicit step between points and a lattice, fused point by point (numba).

A step consists of the update of the nodes (`fenicsmpm.transfer.grid_rows`), ``gather`` and
``finish``, which goes on with what the points give to the nodes for the next step; before the
first step, that is ``scatter``. So in between no stress goes to memory, which is what limits the
speed. Each kernel
is compiled for a dimension, a basis and a material, in which it is inlined. In the plane, the third
direction has one node.

A row of the grid holds, of a node, mass, momentum, volume and internal force before its update, and
mass, velocity, volume and the increment of velocity after it (columns in
`fenicsmpm.transfer.grid_rows`). Points of a tile see its nodes in a window
(`fenicsmpm.transfer.windows`).

References are to Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric locking in explicit material
point methods" (F-bar).
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import OPTIONS, stencils
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import ON_WALL, window
from fenicsmpm.lanes import (
    LANES,
    LINE_LANES,
    add_scaled,
    between,
    choose,
    line_at,
    load,
    load_columns,
    load_line,
    number_at,
    prefetch,
    scaled,
    store,
    store_columns,
    store_line,
    zero_line,
    zeros,
)
from fenicsmpm.materials.tensors import cube_root
from fenicsmpm.transfer.stresses import stresses
from fenicsmpm.transfer.windows import SPARE, scratch_rows, windows

_njit = numba.njit(**OPTIONS)
_inline = numba.njit(forceinline=True, _nrt=False, **OPTIONS)
_parallel = njit(parallel=True)

# Blocks that are fetched from memory ahead of the one that is worked on (measured: 1 to 8)
_AHEAD = 8

# First lines of a block's points: both halves of what rows of the grid have, and slopes in each
# direction of the half that has any: velocities, or forces
_LOW, _HIGH, _X, _Y, _Z, _ALL = (k * LANES for k in range(6))
_TINY, _HUGE = np.finfo(float).tiny, np.finfo(float).max


class Kernels(NamedTuple):
    """Transfers for some dimension, basis and material; see ``transfers``."""

    scatter: Callable[..., None]
    gather: Callable[..., Any]
    finish: Callable[..., None]
    # for linear functions, instead of ``gather``: points are moved, their velocities mapped back,
    # and by these they are deformed
    move: Callable[..., Any]
    momenta: Callable[..., None]
    deform: Callable[..., Any]


@functools.cache
def transfers(
    dim: int, kind: int, update: Any, update_eight: Any, n_state: int, rates: bool, is_fluid: bool
) -> Kernels:
    """Compile the transfers.

    Args:
        dim: 2 or 3.
        kind: of grid functions, see ``basis.lines``.
        update: numba function of the material, ``(F, L, parameters, state, sigma)``.
        update_eight: the same for eight points, where it is easy, or None.
        n_state: how many numbers the material remembers.
        rates: the material needs the velocity gradient.
        is_fluid: of the deformation, only J is kept.
    """
    width, fill = WIDTH[kind], stencils(dim, kind, in_window=True)
    depth = width if dim == 3 else 1
    copies, shape = windows(dim, width), window(dim, width)
    far, near, count = shape.far, shape.near, shape.places
    # the first columns of velocities and their increments in windows
    v_first, i_first = (0, 2) if dim == 2 else (1, 1)
    set_stress = stresses(update, update_eight, n_state, rates)

    @_inline
    def fetch(body, block):
        """Have what a block needs brought near; it need not exist."""
        for rows in (body.mass, body.V_0, body.J_bar):
            prefetch(rows, block)
        for rows in (body.x, body.x_next, body.v):
            for j in range(dim):
                prefetch(rows, block * dim + j)
        for j in range(dim * dim):
            prefetch(body.F, block * dim * dim + j)

    @_inline
    def determinant(F, first):
        """Of the tensors (d, d) in the rows from the first on."""
        if dim == 2:
            return load(F, first) * load(F, first + 3) - load(F, first + 1) * load(F, first + 2)
        a, b, c = load(F, first), load(F, first + 1), load(F, first + 2)
        d, e, f = load(F, first + 3), load(F, first + 4), load(F, first + 5)
        g, h, i = load(F, first + 6), load(F, first + 7), load(F, first + 8)
        return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)

    @_inline
    def root(x):
        return math.sqrt(x) if dim == 2 else cube_root(x)

    @_inline
    def strain(f):
        """Norm of the strain increment sym(f) - I of relative deformation gradients (d, d)."""
        total = zeros()
        for j in range(dim):
            normal = load(f, j * dim + j) - 1.0
            total += normal * normal
            for k in range(j):
                shear = load(f, j * dim + k) + load(f, k * dim + j)
                total += 0.5 * shear * shear
        return math.sqrt(total)

    @_inline
    def pack(block, body, V, s, first, lines):
        """What the points of a block give: per value and slopes of a grid function.

        Mass, momentum, volume and internal force (F-bar, eqs. 7, 8, 10); stresses s (3, 3) from
        row ``first`` on. Each line is in memory before it is loaded: faster than in registers.
        """
        m, nothing = load(body.mass, block), zeros()
        x, y = m * load(body.v, block * dim), m * load(body.v, block * dim + 1)
        z = m * load(body.v, block * dim + 2) if dim == 3 else nothing
        store_columns(lines, _LOW, m, x, y, z)
        store_columns(lines, _HIGH, V, nothing, nothing, nothing)
        for k in range(dim):
            x, y = -V * load(s, first + k), -V * load(s, first + 3 + k)
            z = -V * load(s, first + 6 + k) if dim == 3 else nothing
            store_columns(lines, _X + k * LANES, nothing, x, y, z)

    @_inline
    def add_line(lines, node, factor, line):
        store_line(lines, node, add_scaled(load_line(lines, node), factor, line))

    @_inline
    def add_to_nodes(i, base, w, d, lines, rows):
        """Add the i-th point of a block to its nodes, each half of a row as what it needs."""
        low, high = load_line(lines, _LOW + i), load_line(lines, _HIGH + i)
        by_x, by_y = load_line(lines, _X + i), load_line(lines, _Y + i)
        by_z, start = load_line(lines, _Z + i), base[i]
        for a in range(width):
            w_a, d_a = number_at(w, a * LANES + i), number_at(d, a * LANES + i)
            low_a, high_a = scaled(w_a, low), add_scaled(scaled(w_a, high), d_a, by_x)
            y_a, z_a = scaled(w_a, by_y), scaled(w_a, by_z)
            for b in range(width):
                w_b = number_at(w, (width + b) * LANES + i)
                d_b = number_at(d, (width + b) * LANES + i)
                first = 2 * (start + a * far + b * near)
                if dim == 2:
                    add_line(rows, first, w_b, low_a)
                    total = add_scaled(load_line(rows, first + 1), w_b, high_a)
                    store_line(rows, first + 1, add_scaled(total, d_b, y_a))
                else:
                    low_b = scaled(w_b, low_a)
                    high_b, z_b = add_scaled(scaled(w_b, high_a), d_b, y_a), scaled(w_b, z_a)
                    for c in range(depth):
                        w_c = number_at(w, (2 * width + c) * LANES + i)
                        d_c = number_at(d, (2 * width + c) * LANES + i)
                        line = first + 2 * c
                        add_line(rows, line, w_c, low_b)
                        total = add_scaled(load_line(rows, line + 1), w_c, high_b)
                        store_line(rows, line + 1, add_scaled(total, d_c, z_b))

    @_inline
    def no_reach(reach):
        """Begin to look for the nodes of the points of a unit."""
        for k in range(dim):
            store(reach, k, zeros() + _HUGE)
            store(reach, 3 + k, zeros() - _HUGE)

    @_inline
    def widen(reach, corner):
        for k in range(dim):
            first = load(corner, k)
            store(reach, k, choose(first - load(reach, k), load(reach, k), first))
            store(reach, 3 + k, choose(load(reach, 3 + k) - first, load(reach, 3 + k), first))

    @_inline
    def keep_reach(reach, units, unit):
        for k in range(dim):
            first, last = reach[k, 0], reach[3 + k, 0]
            for i in range(1, LANES):
                first, last = min(first, reach[k, i]), max(last, reach[3 + k, i])
            units.first[unit, k], units.last[unit, k] = int(first), int(last) + width - 1

    @_njit
    def scatter(chunk, units, nodes, half, body, sigma, rows):
        """Points with known stresses (3, 3) to the nodes."""
        corner, base = scratch_rows(3, LANES), np.empty(LANES, np.int64)
        w, d = scratch_rows(3 * width, LANES), scratch_rows(3 * width, LANES)
        lines, scratch = scratch_rows(_ALL, LINE_LANES), scratch_rows(count, LANES)
        reach = scratch_rows(6, LANES)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            no_reach(reach)
            lower = units.lower[unit]
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                fill(body.x, block, nodes, half, lower, corner, base, w, d)
                widen(reach, corner)
                V = determinant(body.F, block * dim * dim) * load(body.V_0, block)
                pack(block, body, V, sigma, 9 * block, lines)
                for i in range(LANES):
                    add_to_nodes(i, base, w, d, lines, scratch)
            keep_reach(reach, units, unit)
            copies.add_rows(unit, units.target, units.first, units.last, scratch, rows)

    @_inline
    def from_nodes(i, base, w, d, rows, lines):
        """Values of all that nodes have, and slopes of velocities, at the i-th point of a block."""
        low, high = zero_line(), zero_line()
        by_x, by_y, by_z = zero_line(), zero_line(), zero_line()
        start = base[i]
        for a in range(width):
            w_a, d_a = number_at(w, a * LANES + i), number_at(d, a * LANES + i)
            low_a, high_a, y_a, z_a = zero_line(), zero_line(), zero_line(), zero_line()
            for b in range(width):
                w_b = number_at(w, (width + b) * LANES + i)
                d_b = number_at(d, (width + b) * LANES + i)
                first = 2 * (start + a * far + b * near)
                if dim == 2:
                    low_b = load_line(rows, start + a * far + b)
                else:
                    low_b, high_b, slope = zero_line(), zero_line(), zero_line()
                    for c in range(depth):
                        w_c = number_at(w, (2 * width + c) * LANES + i)
                        nodal = load_line(rows, first + 2 * c)
                        low_b = add_scaled(low_b, w_c, nodal)
                        slope = add_scaled(slope, number_at(d, (2 * width + c) * LANES + i), nodal)
                        high_b = add_scaled(high_b, w_c, load_line(rows, first + 2 * c + 1))
                    z_a = add_scaled(z_a, w_b, slope)
                low_a = add_scaled(low_a, w_b, low_b)
                if dim == 3:
                    high_a = add_scaled(high_a, w_b, high_b)
                y_a = add_scaled(y_a, d_b, low_b)
            low = add_scaled(low, w_a, low_a)
            by_x = add_scaled(by_x, d_a, low_a)
            by_y = add_scaled(by_y, w_a, y_a)
            if dim == 3:
                high = add_scaled(high, w_a, high_a)
                by_z = add_scaled(by_z, w_a, z_a)
        store_line(lines, _LOW + i, low)
        if dim == 3:
            store_line(lines, _HIGH + i, high)
        store_line(lines, _X + i, by_x)
        store_line(lines, _Y + i, by_y)
        if dim == 3:
            store_line(lines, _Z + i, by_z)

    @_inline
    def move(body, block, unit, units, nodes, lines, dt, flip):
        """Velocity and next position of the points of a block (eqs. 11-13 and 17).

        Returns:
            Whether all are finite and inside of the lattice, and inside of their window.
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

    @_inline
    def deform(body, block, base, w, lines, f, shares, last_w, averages, dt, average, r, s):
        """F of the points of a block, and J to the lines of the nodes, to be averaged.

        Returns:
            Whether no point is inverted.
        """
        tensor, before = block * dim * dim, LINE_LANES - 1
        # eq. 16
        for k in range(dim):
            slopes = load_columns(lines, _X + k * LANES)
            for j in range(dim):
                rate = slopes[v_first + j]
                if rates:
                    store(body.L, tensor + j * dim + k, rate)
                store(f, j * dim + k, dt * rate + 1.0 if j == k else dt * rate)
        J_before, dJ = determinant(body.F, tensor), determinant(f, 0)
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
            store(shares, 0, load(body.V_0, block) * J_before * dJ * mixed)
            last = (dim - 1) * width
            store_columns(
                last_w, 0, load(w, last), load(w, last + 1),
                load(w, last + 2) if width > 2 else zeros(),
                load(w, last + 3) if width > 3 else zeros(),
            )  # fmt: skip
            for i in range(LANES):
                weights, start = load_line(last_w, i), base[i] + before
                share = shares[0, i]
                for a in range(width):
                    share_a = share * number_at(w, a * LANES + i)
                    if dim == 2:
                        add_line(averages, start + a * far, share_a, weights)
                    else:
                        for b in range(width):
                            share_b = share_a * number_at(w, (width + b) * LANES + i)
                            place = start + a * far + b * near
                            add_line(averages, place, share_b, weights)
        return between(dJ * J_old, _TINY, _HUGE)

    def from_nodes_to_points(moves, deforms):
        """Compile a pass over the points: velocity and next position, F, or both.

        J goes back to the nodes with F, to be averaged. Found are a block with a point that is
        inverted, not finite or outside of the lattice, or -1; and whether a point has left its
        window.
        """

        @_njit
        def loop(chunk, units, nodes, half, body, rows, dt, flip, average, r, s, sums, found):
            corner, base = scratch_rows(3, LANES), np.empty(LANES, np.int64)
            w, d = scratch_rows(3 * width, LANES), scratch_rows(3 * width, LANES)
            f, shares = scratch_rows(9, LANES), scratch_rows(1, LANES)
            lines, last_w = scratch_rows(_ALL, LINE_LANES), scratch_rows(LANES, LINE_LANES)
            scratch = scratch_rows(count, LINE_LANES if dim == 2 else LANES)
            averages = scratch_rows(count + SPARE, LINE_LANES)
            found[0], stay = -1, True
            for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
                copies.load_rows(unit, units.source, units.first, units.last, rows, scratch)
                lower = units.lower[unit]
                for block in range(units.blocks[unit], units.blocks[unit + 1]):
                    fetch(body, block + _AHEAD)
                    fill(body.x, block, nodes, half, lower, corner, base, w, d)
                    for i in range(LANES):
                        from_nodes(i, base, w, d, scratch, lines)
                    good, stays = True, True
                    if moves:
                        good, stays = move(body, block, unit, units, nodes, lines, dt, flip)
                    if deforms:
                        good &= deform(
                            body, block, base, w, lines, f, shares, last_w, averages, dt, average,
                            r, s,
                        )  # fmt: skip
                    stay &= stays
                    if not good:
                        found[0] = block
                if deforms and average:
                    copies.add_lines(unit, units.target, units.first, units.last, averages, sums)
            found[1] = 0 if stay else 1

        @_parallel
        def in_all_units(units, nodes, half, body, rows, dt, flip, average, r, s, sums):
            found = np.empty((len(units.chunks) - 1, 2), dtype=np.int64)
            for t in numba.prange(len(units.chunks) - 1):
                loop(t, units, nodes, half, body, rows, dt, flip, average, r, s, sums, found[t])
            return found[:, 0].max(), found[:, 1].max() > 0

        return in_all_units

    @_njit
    def momenta(chunk, units, nodes, half, body, rows):
        """Mass and momentum of the points, where they were, to the nodes."""
        corner, base = scratch_rows(3, LANES), np.empty(LANES, np.int64)
        w, d = scratch_rows(3 * width, LANES), scratch_rows(3 * width, LANES)
        lines, scratch = scratch_rows(LANES, LINE_LANES), scratch_rows(count, LANES)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                fill(body.x, block, nodes, half, units.lower[unit], corner, base, w, d)
                m = load(body.mass, block)
                x, y = m * load(body.v, block * dim), m * load(body.v, block * dim + 1)
                z = m * load(body.v, block * dim + 2) if dim == 3 else zeros()
                store_columns(lines, 0, m, x, y, z)
                for i in range(LANES):
                    line = load_line(lines, i)
                    for a in range(width):
                        for b in range(width):
                            w_b = number_at(w, a * LANES + i) * number_at(
                                w, (width + b) * LANES + i
                            )
                            for c in range(depth):
                                if dim == 3:
                                    w_c = w_b * number_at(w, (2 * width + c) * LANES + i)
                                else:
                                    w_c = w_b
                                place = 2 * (base[i] + a * far + b * near + c)
                                add_line(scratch, place, w_c, line)
            copies.add_rows(unit, units.target, units.first, units.last, scratch, rows)

    @_inline
    def means(base, w, averages, lines):
        """Averaged J at the points of a block."""
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
            total += columns[c] * load(w, (dim - 1) * width + c)
        return total

    @_njit
    def finish(chunk, units, nodes, half, body, average, averages, again, sigma, rows):
        """Stresses by the averaged J: to the nodes for the next step, and to ``sigma`` if wanted.

        They are wanted if there is room for them in ``sigma (n_blocks * 9, 8)``.
        """
        is_kept = len(sigma) > 0
        corner, base = scratch_rows(3, LANES), np.empty(LANES, np.int64)
        w, d = scratch_rows(3 * width, LANES), scratch_rows(3 * width, LANES)
        F_bar, rate, stress = scratch_rows(9, LANES), scratch_rows(9, LANES), scratch_rows(9, LANES)
        work, state_i = np.zeros((3, 3, 3)), np.empty(n_state)
        F_bar[8] = 1.0
        lines, average_lines = scratch_rows(_ALL, LINE_LANES), scratch_rows(LANES, LINE_LANES)
        scratch, means_of = scratch_rows(count, LANES), np.zeros(count + SPARE)
        reach = scratch_rows(6, LANES)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            if average:
                copies.load_averages(
                    unit, units.body_source, units.first, units.last, averages, means_of
                )
            no_reach(reach)
            lower = units.lower[unit]
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                fetch(body, block + _AHEAD)
                tensor = block * dim * dim
                J = determinant(body.F, tensor)
                scale = 1.0 + zeros()
                if average:
                    fill(body.x, block, nodes, half, lower, corner, base, w, d)
                    J_bar = means(base, w, means_of, average_lines)
                    scale = root(J_bar / J)  # eq. 18
                else:
                    J_bar = J
                store(body.J_bar, block, J_bar)
                if is_fluid:
                    stretch = root(J)
                    for j in range(dim):
                        for k in range(dim):
                            store(body.F, tensor + j * dim + k, stretch if j == k else zeros())
                for j in range(dim):
                    for k in range(dim):
                        store(F_bar, 3 * j + k, scale * load(body.F, tensor + j * dim + k))
                        if rates:
                            store(rate, 3 * j + k, load(body.L, tensor + j * dim + k))
                set_stress(block, F_bar, rate, body.parameters, body.state, work, state_i, stress)
                if again:
                    pack(block, body, J * load(body.V_0, block), stress, 0, lines)
                    fill(body.x_next, block, nodes, half, lower, corner, base, w, d)
                    widen(reach, corner)
                    for i in range(LANES):
                        add_to_nodes(i, base, w, d, lines, scratch)
                if is_kept:
                    for k in range(9):
                        store(sigma, 9 * block + k, load(stress, k))
            if again:
                keep_reach(reach, units, unit)
                copies.add_rows(unit, units.target, units.first, units.last, scratch, rows)

    @_parallel
    def scatter_all(units, nodes, half, body, sigma, rows):
        for t in numba.prange(len(units.chunks) - 1):
            scatter(t, units, nodes, half, body, sigma, rows)

    @_parallel
    def finish_all(units, nodes, half, body, average, averages, again, sigma, rows):
        for t in numba.prange(len(units.chunks) - 1):
            finish(t, units, nodes, half, body, average, averages, again, sigma, rows)

    @_parallel
    def momenta_all(units, nodes, half, body, rows):
        for t in numba.prange(len(units.chunks) - 1):
            momenta(t, units, nodes, half, body, rows)

    return Kernels(
        scatter_all,
        from_nodes_to_points(moves=True, deforms=True),
        finish_all,
        from_nodes_to_points(moves=True, deforms=False),
        momenta_all,
        from_nodes_to_points(moves=False, deforms=True),
    )
