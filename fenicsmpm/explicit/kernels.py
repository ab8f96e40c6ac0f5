# SPDX-License-Identifier: MIT
"""The transfers of an explicit step between points and a lattice, fused point by point (numba).

A step consists of the update of the nodes (`fenicsmpm.explicit.grid`), ``gather`` and ``finish``,
which goes on with what the points give to the nodes for the next step; before the first step, that
is ``scatter``. So in between no stress goes to memory, which is what limits the speed. Each kernel
is compiled for a dimension, a basis and a material, in which it is inlined. In the plane, the third
direction has one node.

A row of the grid holds, of a node, ``(m, m v_x, m v_y, m v_z, V, f_x, f_y, f_z)`` before its
update and ``(m, v_x, v_y, v_z, V, dv_x, dv_y, dv_z)`` after it, with the increments dv of velocity.

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

from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit.simd import (
    LANES,
    add_at,
    add_scaled,
    load,
    number_at,
    scaled,
    store,
    zeros,
)
from fenicsmpm.explicit.stencils import BLOCK, OPTIONS, stencils, strides
from fenicsmpm.materials.tensors import cube_root

_njit = numba.njit(**OPTIONS)
_inline = numba.njit(forceinline=True, **OPTIONS)
_parallel = numba.njit(parallel=True)


class Body(NamedTuple):
    """Working arrays over the points of a body.

    Attributes:
        x: positions ``(n, d)`` at the beginning of a step [m].
        x_next: at its end.
        v: velocities ``(n, d)``.
        F: deformation gradients ``(n, d, d)``.
        J_bar: averaged J ``(n,)``.
        mass: ``(n,)``.
        V_0: initial volumes ``(n,)``.
        state: what the material remembers ``(n, n_state)``.
        L: velocity gradients ``(n, d, d)``, of no points if the material does not need them.
        parameters: of the material.
    """

    x: Any
    x_next: Any
    v: Any
    F: Any
    J_bar: Any
    mass: Any
    V_0: Any
    state: Any
    L: Any
    parameters: Any


class Kernels(NamedTuple):
    """Transfers for some dimension, basis and material; see ``transfers``."""

    scatter: Callable[..., None]
    gather: Callable[..., Any]
    finish: Callable[..., None]


@functools.cache
def transfers(dim: int, kind: int, update: Any, rates: bool, is_fluid: bool) -> Kernels:
    """Compile the transfers.

    Args:
        dim: 2 or 3.
        kind: of grid functions, see ``basis.lines``.
        update: numba function of the material, ``(F, L, parameters, state, sigma)``.
        rates: the material needs the velocity gradient.
        is_fluid: of the deformation, only J is kept.
    """
    width, fill = WIDTH[kind], stencils(dim, kind)
    depth = width if dim == 3 else 1

    @_inline
    def determinant(F, p):
        if dim == 2:
            return F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0]
        return (
            F[p, 0, 0] * (F[p, 1, 1] * F[p, 2, 2] - F[p, 1, 2] * F[p, 2, 1])
            - F[p, 0, 1] * (F[p, 1, 0] * F[p, 2, 2] - F[p, 1, 2] * F[p, 2, 0])
            + F[p, 0, 2] * (F[p, 1, 0] * F[p, 2, 1] - F[p, 1, 1] * F[p, 2, 0])
        )

    @_inline
    def pack(i, m, v, V, p, s, q, lines):
        """What point p, the i-th of its block, gives: per value and slopes of a grid function.

        Mass, momentum, volume and internal force (F-bar, eqs. 7, 8, 10); s[q] is its stress. That
        the rows are in memory before they are loaded is faster than to build them in registers.
        """
        lines[4 * i, 0], lines[4 * i, 4] = m, V
        for k in range(dim):
            lines[4 * i, 1 + k] = m * v[p, k]
            for j in range(dim):
                lines[4 * i + 1 + k, 5 + j] = -V * s[q, j, k]

    @_inline
    def add_to_nodes(i, base, far, near, w, d, lines, rows):
        """Add the i-th point of a block to its nodes."""
        value, by_x, by_y = load(lines, 4 * i), load(lines, 4 * i + 1), load(lines, 4 * i + 2)
        by_z = load(lines, 4 * i + 3)
        for a in range(width):
            value_a = add_scaled(scaled(w[i, 0, a], value), d[i, 0, a], by_x)
            y_a, z_a = scaled(w[i, 0, a], by_y), scaled(w[i, 0, a], by_z)
            for b in range(width):
                node = base[i] + a * far + b * near
                if dim == 2:
                    total = add_scaled(load(rows, node), w[i, 1, b], value_a)
                    store(rows, node, add_scaled(total, d[i, 1, b], y_a))
                else:
                    value_b = add_scaled(scaled(w[i, 1, b], value_a), d[i, 1, b], y_a)
                    z_b = scaled(w[i, 1, b], z_a)
                    for c in range(depth):
                        total = add_scaled(load(rows, node + c), w[i, 2, c], value_b)
                        store(rows, node + c, add_scaled(total, d[i, 2, c], z_b))

    @_njit
    def scatter(first, last, nodes, half, body, sigma, rows):
        """Points with known stresses ``(n, 3, 3)`` to the nodes."""
        base = np.empty(BLOCK, np.int64)
        w, d = np.ones((BLOCK, 3, width)), np.zeros((BLOCK, 3, width))
        far, near = strides(nodes)
        lines = np.zeros((4 * BLOCK, LANES))
        for start in range(first, last, BLOCK):
            n = min(BLOCK, last - start)
            fill(body.x, start, n, nodes, half, base, w, d)
            for i in range(n):
                p = start + i
                V = determinant(body.F, p) * body.V_0[p]
                pack(i, body.mass[p], body.v, V, p, sigma, p, lines)
            for i in range(n):
                add_to_nodes(i, base, far, near, w, d, lines, rows)

    @_njit
    def gather(first, last, nodes, half, body, rows, dt, flip, average, r, averages):
        """Velocity, next position and F of points; J goes back to the nodes to be averaged.

        Returns:
            A point that is inverted, not finite or outside of the lattice; or -1.
        """
        x, x_next, v, F = body.x, body.x_next, body.v, body.F
        J_bar, V_0, L = body.J_bar, body.V_0, body.L
        base, share = np.empty(BLOCK, np.int64), np.empty(BLOCK)
        w, d = np.ones((BLOCK, 3, width)), np.zeros((BLOCK, 3, width))
        f, lines = np.empty((BLOCK, 3, 3)), np.zeros((4 * BLOCK, LANES))
        far, near = strides(nodes)
        bad = np.int64(-1)
        for start in range(first, last, BLOCK):
            n = min(BLOCK, last - start)
            fill(x, start, n, nodes, half, base, w, d)
            for i in range(n):
                p = start + i
                value, by_x, by_y, by_z = zeros(), zeros(), zeros(), zeros()
                for a in range(width):
                    value_a, y_a, z_a = zeros(), zeros(), zeros()
                    for b in range(width):
                        node = base[i] + a * far + b * near
                        if dim == 2:
                            line = load(rows, node)
                        else:
                            line, slope = zeros(), zeros()
                            for c in range(depth):
                                nodal = load(rows, node + c)
                                line = add_scaled(line, w[i, 2, c], nodal)
                                slope = add_scaled(slope, d[i, 2, c], nodal)
                            z_a = add_scaled(z_a, w[i, 1, b], slope)
                        value_a = add_scaled(value_a, w[i, 1, b], line)
                        y_a = add_scaled(y_a, d[i, 1, b], line)
                    value = add_scaled(value, w[i, 0, a], value_a)
                    by_x = add_scaled(by_x, d[i, 0, a], value_a)
                    by_y = add_scaled(by_y, w[i, 0, a], y_a)
                    if dim == 3:
                        by_z = add_scaled(by_z, w[i, 0, a], z_a)
                store(lines, 4 * i, value)
                store(lines, 4 * i + 1, by_x)
                store(lines, 4 * i + 2, by_y)
                if dim == 3:
                    store(lines, 4 * i + 3, by_z)
            for i in range(n):
                p = start + i
                for j in range(dim):
                    # eqs. 11-13 and 17
                    x_next[p, j] = x[p, j] + dt * lines[4 * i, 1 + j]
                    in_flip = v[p, j] + lines[4 * i, 5 + j]
                    v[p, j] = flip * in_flip + (1.0 - flip) * lines[4 * i, 1 + j]
                    # eq. 16
                    for k in range(dim):
                        rate = lines[4 * i + 1 + k, 1 + j]
                        f[i, j, k] = dt * rate
                        if rates:
                            L[p, j, k] = rate
                    f[i, j, j] += 1.0
                # eq. 14
                if dim == 2:
                    for j in range(2):
                        F0, F1 = F[p, 0, j], F[p, 1, j]
                        F[p, 0, j] = f[i, 0, 0] * F0 + f[i, 0, 1] * F1
                        F[p, 1, j] = f[i, 1, 0] * F0 + f[i, 1, 1] * F1
                else:
                    for j in range(3):
                        F0, F1, F2 = F[p, 0, j], F[p, 1, j], F[p, 2, j]
                        F[p, 0, j] = f[i, 0, 0] * F0 + f[i, 0, 1] * F1 + f[i, 0, 2] * F2
                        F[p, 1, j] = f[i, 1, 0] * F0 + f[i, 1, 1] * F1 + f[i, 1, 2] * F2
                        F[p, 2, j] = f[i, 2, 0] * F0 + f[i, 2, 1] * F1 + f[i, 2, 2] * F2
                dJ, J = determinant(f, i), determinant(F, p)
                inside = 0.0 < J < np.inf
                for k in range(dim):
                    t = (x_next[p, k] - nodes.origin[k]) * nodes.per_metre[k]
                    inside = inside and 0.0 <= t <= nodes.shape[k] - 1
                if not inside:
                    bad = p
                # algorithm 1, step 3, with r = 0; eq. 19 with r = 1
                share[i] = V_0[p] * J * ((1.0 - r) * J_bar[p] + r * (J / dJ))
            if average:
                for i in range(n):
                    for a in range(width):
                        for b in range(width):
                            share_b = share[i] * w[i, 0, a] * w[i, 1, b]
                            node = base[i] + a * far + b * near
                            for c in range(depth):
                                add_at(averages, node + c, share_b * w[i, 2, c])
        return bad

    @_inline
    def root(x):
        return math.sqrt(x) if dim == 2 else cube_root(x)

    @_njit
    def finish(first, last, nodes, half, body, average, s, averages, again, sigma, rows):
        """Stresses by the averaged J: to the nodes for the next step, or at last to ``sigma``."""
        x, F, J_bar, L = body.x, body.F, body.J_bar, body.L
        base = np.empty(BLOCK, np.int64)
        w, d = np.ones((BLOCK, 3, width)), np.zeros((BLOCK, 3, width))
        far, near = strides(nodes)
        F_bar, rate = np.zeros((BLOCK, 3, 3)), np.zeros((3, 3))
        F_bar[:, 2, 2] = 1.0
        stress, volume = np.zeros((BLOCK, 3, 3)), np.empty(BLOCK)
        lines = np.zeros((4 * BLOCK, LANES))
        for start in range(first, last, BLOCK):
            n = min(BLOCK, last - start)
            if average:
                fill(x, start, n, nodes, half, base, w, d)
                for i in range(n):
                    mean = 0.0
                    for a in range(width):
                        for b in range(width):
                            node = base[i] + a * far + b * near
                            line = 0.0
                            for c in range(depth):
                                line += w[i, 2, c] * number_at(averages, node + c)
                            mean += w[i, 0, a] * w[i, 1, b] * line
                    J_bar[start + i] = mean
            for i in range(n):
                p = start + i
                J = determinant(F, p)
                if not average:
                    J_bar[p] = J
                elif s > 0.0:
                    J_star = J + s * (J_bar[p] - J)
                    shrink = root(J_star / J)
                    for j in range(dim):
                        for k in range(dim):
                            F[p, j, k] *= shrink
                    J = J_star
                if is_fluid:
                    stretch = root(J)
                    for j in range(dim):
                        for k in range(dim):
                            F[p, j, k] = stretch if j == k else 0.0
                scale = root(J_bar[p] / J) if average else 1.0  # eq. 18
                for j in range(dim):
                    for k in range(dim):
                        F_bar[i, j, k] = scale * F[p, j, k]
                volume[i] = J * body.V_0[p]
            for i in range(n):
                p = start + i
                if rates:
                    for j in range(dim):
                        for k in range(dim):
                            rate[j, k] = L[p, j, k]
                update(F_bar[i], rate, body.parameters, body.state[p], stress[i])
                pack(i, body.mass[p], body.v, volume[i], p, stress, i, lines)
            if again:
                fill(body.x_next, start, n, nodes, half, base, w, d)
                for i in range(n):
                    add_to_nodes(i, base, far, near, w, d, lines, rows)
            else:
                for i in range(n):
                    for j in range(3):
                        for k in range(3):
                            sigma[start + i, j, k] = stress[i, j, k]

    # points of a thread are a range of them: sorted by cell, they share most of their nodes

    @_parallel
    def scatter_all(ranges, nodes, half, body, sigma, rows):
        for t in numba.prange(len(ranges) - 1):
            scatter(ranges[t], ranges[t + 1], nodes, half, body, sigma, rows[t])

    @_parallel
    def gather_all(ranges, nodes, half, body, rows, dt, flip, average, r, averages):
        bad = np.empty(len(ranges) - 1, dtype=np.int64)
        for t in numba.prange(len(ranges) - 1):
            bad[t] = gather(
                ranges[t], ranges[t + 1], nodes, half, body, rows, dt, flip, average, r,
                averages[t],
            )  # fmt: skip
        return bad.max()

    @_parallel
    def finish_all(ranges, nodes, half, body, average, s, averages, again, sigma, rows):
        for t in numba.prange(len(ranges) - 1):
            finish(
                ranges[t], ranges[t + 1], nodes, half, body, average, s, averages, again, sigma,
                rows[t],
            )  # fmt: skip

    return Kernels(scatter_all, gather_all, finish_all)


class Carriers(NamedTuple):
    """What points without material do; see ``carriers``."""

    add_forces: Callable[..., None]
    follow: Callable[..., None]


@functools.cache
def carriers(dim: int, kind: int) -> Carriers:
    """Compile what points do that carry forces through the grid."""
    width, fill = WIDTH[kind], stencils(dim, kind)
    depth = width if dim == 3 else 1

    @_njit
    def add_forces(nodes, half, x, force, rows):
        """External forces of points, ``(n, d)`` [N], to the nodes."""
        base = np.empty(BLOCK, np.int64)
        w, d = np.ones((BLOCK, 3, width)), np.zeros((BLOCK, 3, width))
        far, near = strides(nodes)
        for p in range(len(x)):
            fill(x, p, 1, nodes, half, base, w, d)
            for a in range(width):
                for b in range(width):
                    for c in range(depth):
                        node = base[0] + a * far + b * near + c
                        share = w[0, 0, a] * w[0, 1, b] * w[0, 2, c]
                        for k in range(dim):
                            rows[node, 5 + k] += share * force[p, k]

    @_njit
    def follow(nodes, half, x, rows, dt):
        """Move points with the grid (eq. 17)."""
        base = np.empty(BLOCK, np.int64)
        w, d = np.ones((BLOCK, 3, width)), np.zeros((BLOCK, 3, width))
        far, near = strides(nodes)
        for p in range(len(x)):
            fill(x, p, 1, nodes, half, base, w, d)
            for a in range(width):
                for b in range(width):
                    for c in range(depth):
                        node = base[0] + a * far + b * near + c
                        share = dt * w[0, 0, a] * w[0, 1, b] * w[0, 2, c]
                        for k in range(dim):
                            x[p, k] += share * rows[node, 1 + k]

    return Carriers(add_forces, follow)
