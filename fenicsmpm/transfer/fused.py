# SPDX-License-Identifier: MIT
"""Transfers of an explicit step between points and a lattice, fused point by point (numba).

A step consists of the update of the nodes (`fenicsmpm.transfer.grid_rows`), ``gather`` and
``finish``. ``finish`` also adds the contributions of the points to the nodes for the next step;
before the first step, ``scatter`` does this. Stresses are therefore never written to memory, whose
bandwidth limits the speed. Each kernel is compiled for a dimension, a basis and a material, which
is inlined. In 2D the third direction has one node.

A row of the grid holds mass, momentum, volume and internal force of a node before its update, and
mass, velocity, volume and velocity increment after it (columns in
`fenicsmpm.transfer.grid_rows`). Points of a tile see its nodes in a window
(`fenicsmpm.transfer.windows`). The transfers of a block of points to and from nodes are in
`fenicsmpm.transfer.fused_to_nodes` and `fenicsmpm.transfer.fused_to_points`.

Equation numbers refer to Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric locking in explicit
material point methods" (F-bar).
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import INNER, inline, stencils
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import window
from fenicsmpm.lanes import LANES, LINE_LANES, choose, load, prefetch, store, zeros
from fenicsmpm.transfer import fused_to_nodes, fused_to_points
from fenicsmpm.transfer.stresses import STORED, stresses
from fenicsmpm.transfer.windows import SPARE, scratch_rows, windows

_njit = numba.njit(**INNER)
_allocates = numba.njit(forceinline=True, **INNER)
_parallel = njit(parallel=True)

# Number of blocks that are prefetched ahead of the current one (measured: 1 to 8)
_AHEAD = 8

_HUGE = np.finfo(float).max


class Kernels(NamedTuple):
    """Transfers for a dimension, basis and material; see ``transfers``."""

    scatter: Callable[..., None]
    gather: Callable[..., Any]
    finish: Callable[..., None]
    # for linear functions, instead of ``gather``: points move, their velocities are mapped back to
    # the nodes, and these velocities deform the points
    move: Callable[..., Any]
    momenta: Callable[..., None]
    deform: Callable[..., Any]


@functools.cache
def transfers(
    dim: int,
    kind: int,
    update: Any,
    update_eight: Any,
    n_state: int,
    rates: bool,
    is_fluid: bool,
    has_F33: bool,
    has_J_0: bool,
) -> Kernels:
    """Compile the transfers.

    Args:
        dim: Dimension, 2 or 3.
        kind: Kind of the grid functions, see ``basis.lines``.
        update: Numba function of the material, ``(F, L, parameters, state, sigma)``.
        update_eight: The same for eight points at once, or None. It returns False where it
            cannot, such as at points that need iterations.
        n_state: Number of state variables of the material.
        rates: Whether the material needs the velocity gradient.
        is_fluid: Whether only J is kept of the deformation.
        has_F33: Whether points in 2D have out-of-plane stretches, which are constant.
        has_J_0: Whether averages of J began where J was not 1.
    """
    width, fill = WIDTH[kind], stencils(dim, kind, in_window=True)
    fill_values = stencils(dim, kind, in_window=True, with_slopes=False)
    copies, count = windows(dim, width), window(dim, width).places
    pack, add = fused_to_nodes.to_nodes(dim, width)
    of_point = fused_to_points.to_points(dim, width, rates, has_F33, has_J_0)
    interpolate, move_block, deform_block = of_point.interpolate, of_point.move, of_point.deform
    means, volume_ratio, root = of_point.means, of_point.volume_ratio, of_point.root
    set_stress = stresses(update, update_eight, n_state, rates)
    stored, n_stored = STORED[dim], len(STORED[dim])

    @inline
    def fetch(body, block):
        """Prefetch the data of a block, which need not exist."""
        for rows in (body.mass, body.V_0, body.J_bar):
            prefetch(rows, block)
        for rows in (body.x, body.x_next, body.v):
            for j in range(dim):
                prefetch(rows, block * dim + j)
        for j in range(dim * dim):
            prefetch(body.F, block * dim * dim + j)
        if has_F33:
            prefetch(body.F33, block)
        if has_J_0:
            prefetch(body.J_0, block)

    @inline
    def no_reach(reach):
        """Reset the range of nodes of the points of a unit."""
        for k in range(dim):
            store(reach, k, zeros() + _HUGE)
            store(reach, 3 + k, zeros() - _HUGE)

    @inline
    def widen(reach, corner):
        for k in range(dim):
            first = load(corner, k)
            store(reach, k, choose(first - load(reach, k), load(reach, k), first))
            store(reach, 3 + k, choose(load(reach, 3 + k) - first, load(reach, 3 + k), first))

    @inline
    def keep_reach(reach, units, unit):
        for k in range(dim):
            first, last = reach[k, 0], reach[3 + k, 0]
            for i in range(1, LANES):
                first, last = min(first, reach[k, i]), max(last, reach[3 + k, i])
            units.first[unit, k], units.last[unit, k] = int(first), int(last) + width - 1

    @inline
    def give(unit, units, nodes, half, body, x, stress, work, scratch, rows):
        """Add the points of a unit at positions x with stresses ``(3, 3)`` to the nodes."""
        corner, base, w, d, lines, reach = work
        begin = units.blocks[unit]
        no_reach(reach)
        for block in range(begin, units.blocks[unit + 1]):
            fill(x, block, nodes, half, units.lower[unit], corner, base, w, d)
            widen(reach, corner)
            V = volume_ratio(body, block) * load(body.V_0, block)
            pack(block, body, V, stress, 9 * (block - begin), lines)
            add(base, w, d, lines, scratch)
        keep_reach(reach, units, unit)
        copies.add_rows(unit, units.target, units.first, units.last, scratch, rows)

    @_allocates
    def to_work_with(n_lines):
        """Return memory for the functions at a block, its lines, and the range of a unit."""
        return (
            scratch_rows(3, LANES), np.empty(LANES, np.int64), scratch_rows(3 * width, LANES),
            scratch_rows(3 * width, LANES), scratch_rows(n_lines, LINE_LANES),
            scratch_rows(6, LANES),
        )  # fmt: skip

    @_allocates
    def for_stresses(chunk, units):
        """Return memory for the stresses (3, 3) of any unit of a chunk."""
        most = np.int64(0)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            most = max(most, units.blocks[unit + 1] - units.blocks[unit])
        return scratch_rows(9 * most, LANES)

    @_njit
    def scatter(chunk, units, nodes, half, body, sigma, rows):
        """Add points with known stresses, see ``STORED``, to the nodes."""
        work = to_work_with(fused_to_nodes.LINES)
        scratch, stress = scratch_rows(count, LANES), for_stresses(chunk, units)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            begin = units.blocks[unit]
            for block in range(begin, units.blocks[unit + 1]):
                for k in range(n_stored):
                    store(
                        stress, 9 * (block - begin) + stored[k], load(sigma, n_stored * block + k)
                    )
            give(unit, units, nodes, half, body, body.x, stress, work, scratch, rows)

    @_njit
    def momenta(chunk, units, nodes, half, body, rows):
        """Add mass and momentum of the points, at their old positions, to the nodes."""
        work, scratch = to_work_with(fused_to_nodes.LINES), scratch_rows(count, LANES)
        corner, base, w, d, lines, _ = work
        no_stress = scratch_rows(9, LANES)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                fill(body.x, block, nodes, half, units.lower[unit], corner, base, w, d)
                pack(block, body, zeros(), no_stress, 0, lines)
                add(base, w, d, lines, scratch)
            copies.add_rows(unit, units.target, units.first, units.last, scratch, rows)

    def from_nodes_to_points(moves: bool, deforms: bool) -> Any:
        """Compile a pass over the points that updates motion, deformation, or both.

        The motion consists of velocity and next position. Together with F, the pass adds J to the
        nodes, to be averaged. ``found`` gets a block with a point that is inverted, not finite or
        outside of the lattice, or -1; and whether a point has left its window.
        """

        @_njit
        def loop(chunk, units, nodes, half, body, rows, dt, flip, average, r, s, sums, found):
            corner, base, w, d, lines, _ = to_work_with(fused_to_points.LINES)
            f, shares = scratch_rows(9, LANES), scratch_rows(1, LANES)
            last_w = scratch_rows(LANES, LINE_LANES)
            scratch = scratch_rows(count, (dim - 1) * LINE_LANES)
            averages = scratch_rows(count + SPARE, LINE_LANES)
            found[0], stay = -1, True
            for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
                copies.load_rows(unit, units.source, units.first, units.last, rows, scratch)
                lower = units.lower[unit]
                for block in range(units.blocks[unit], units.blocks[unit + 1]):
                    fetch(body, block + _AHEAD)
                    fill(body.x, block, nodes, half, lower, corner, base, w, d)
                    interpolate(base, w, d, scratch, lines)
                    good, stays = True, True
                    if moves:
                        good, stays = move_block(body, block, unit, units, nodes, lines, dt, flip)
                    if deforms:
                        good &= deform_block(
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
                loop(
                    np.int64(t), units, nodes, half, body, rows, dt, flip, average, r, s, sums,
                    found[t],
                )  # fmt: skip
            return found[:, 0].max(), found[:, 1].max() > 0

        return in_all_units

    @_njit
    def finish(chunk, units, nodes, half, body, average, averages, again, sigma, rows):
        """Compute stresses from the averaged J and add them to the nodes for the next step.

        They are also stored in ``sigma (n_blocks * n_stored, 8)`` if it has room, see ``STORED``.
        All stresses of a unit are computed before they are added, so that processors work on
        several blocks at once.
        """
        is_kept, stress = len(sigma) > 0, for_stresses(chunk, units)
        work, scratch = to_work_with(fused_to_nodes.LINES), scratch_rows(count, LANES)
        corner, base, w, d, lines, _ = work
        F_bar, rate = scratch_rows(9, LANES), scratch_rows(9, LANES)
        F_bar[8] = 1.0
        law_work, state_i = np.zeros((3, 3, 3)), np.empty(n_state)
        means_of = np.zeros(count + SPARE)
        for unit in range(units.chunks[chunk], units.chunks[chunk + 1]):
            if average:
                copies.load_averages(
                    unit, units.body_source, units.first, units.last, averages, means_of
                )
            begin = units.blocks[unit]
            for block in range(begin, units.blocks[unit + 1]):
                fetch(body, block + _AHEAD)
                tensor = block * dim * dim
                J = volume_ratio(body, block)
                scale = 1.0 + zeros()
                if average:
                    fill_values(body.x, block, nodes, half, units.lower[unit], corner, base, w, d)
                    J_bar = means(body, block, base, w, means_of, lines)
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
                if has_F33:
                    store(F_bar, 8, load(body.F33, block))
                set_stress(
                    block, F_bar, rate, body.parameters, body.state, law_work, state_i, stress,
                    9 * (block - begin),
                )  # fmt: skip
                if is_kept:
                    for k in range(n_stored):
                        of_block = 9 * (block - begin) + stored[k]
                        store(sigma, n_stored * block + k, load(stress, of_block))
            if again:
                give(unit, units, nodes, half, body, body.x_next, stress, work, scratch, rows)

    @_parallel
    def scatter_all(units, nodes, half, body, sigma, rows):
        for t in numba.prange(len(units.chunks) - 1):
            scatter(np.int64(t), units, nodes, half, body, sigma, rows)

    @_parallel
    def finish_all(units, nodes, half, body, average, averages, again, sigma, rows):
        for t in numba.prange(len(units.chunks) - 1):
            finish(np.int64(t), units, nodes, half, body, average, averages, again, sigma, rows)

    @_parallel
    def momenta_all(units, nodes, half, body, rows):
        for t in numba.prange(len(units.chunks) - 1):
            momenta(np.int64(t), units, nodes, half, body, rows)

    return Kernels(
        scatter_all,
        from_nodes_to_points(moves=True, deforms=True),
        finish_all,
        from_nodes_to_points(moves=True, deforms=False),
        momenta_all,
        from_nodes_to_points(moves=False, deforms=True),
    )
