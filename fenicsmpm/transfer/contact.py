# SPDX-License-Identifier: MIT
"""Rigid boxes that push bodies, by a barrier (numba).

The contact force of a point follows from its gap d by the barrier of M. Li et al. (Incremental
potential contact, ACM Trans. Graph. 39, 2020), as Y. Zhao, C. Jiang, J. Choo use it:

    f = -k r b'(d / r),    b(s) = -(s - 1)^2 ln s  for 0 < s < 1,

zero from the reach r on and infinite at contact. Friction is Coulomb's. Explicit steps are too long
for gaps that are nearly closed: a point that would come nearer than a hundredth of the reach is
put there, and no longer approaches the box. So no point enters a box that is thicker than twice the
way of a step; one that is in it from the beginning is an error.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import OPTIONS, stencils
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import ON_WALL
from fenicsmpm.lanes import LANES
from fenicsmpm.transfer.carriers import node_rows
from fenicsmpm.transfer.grid_rows import FORCE

_njit = njit(**OPTIONS)

# Share of the reach that is kept in any case
_CLOSEST = 0.01


# Arrays of points are indexed by component and point, so that those in blocks of eight, from some
# row on, and transposed ones are served by the same functions.


@_njit
def gap(x, first, i, lower, upper, normal):
    """Distance of a point from a box and the direction away from it; negative inside."""
    outside, nearest, side, sign = 0.0, -np.inf, 0, 1.0
    for k in range(len(lower)):
        x_k = x[first + k, i]
        below, above = lower[k] - x_k, x_k - upper[k]
        normal[k] = max(above, 0.0) - max(below, 0.0)
        outside += normal[k] * normal[k]
        if max(below, above) > nearest:
            nearest, side, sign = max(below, above), k, -1.0 if below > above else 1.0
    if outside > 0.0:
        distance = np.sqrt(outside)
        for k in range(len(lower)):
            normal[k] /= distance
        return distance
    normal[:] = 0.0
    normal[side] = sign
    return nearest


@_njit
def contact_force(
    x, v, first, i, m, lower, upper, velocity, reach, stiffness, friction, dt, normal, force
):
    """Set the force ``(d,)`` of a box on a point of mass m, see above.

    Returns:
        The distance; from the reach on there is no force, and none is set.
    """
    distance = gap(x, first, i, lower, upper, normal)
    if distance >= reach:
        return distance
    s = max(distance / reach, _CLOSEST)
    strength = stiffness * m * reach / (dt * dt)
    f = strength * (s - 1.0) * (2.0 * np.log(s) + (s - 1.0) / s)
    approach = 0.0
    for k in range(len(lower)):
        approach += (v[first + k, i] - velocity[k]) * normal[k]
    slip = 0.0
    for k in range(len(lower)):
        force[k] = v[first + k, i] - velocity[k] - approach * normal[k]
        slip += force[k] * force[k]
    # to stop the slip in one step, or what friction allows
    stop = m * np.sqrt(slip) / dt
    share = min(1.0, friction * f / stop) if stop > 0.0 else 0.0
    for k in range(len(lower)):
        force[k] = f * normal[k] - share * m * force[k] / dt
    return distance


@_njit
def keep_out(x_next, v, first, i, m, lower, upper, velocity, reach, dt, normal, total):
    """Put a point where it is not nearer to a box than it may be, and add the force to a total.

    Returns:
        Whether the point was too near.
    """
    distance = gap(x_next, first, i, lower, upper, normal)
    if distance >= _CLOSEST * reach:
        return False
    approach = 0.0
    for k in range(len(lower)):
        x_next[first + k, i] += (_CLOSEST * reach - distance) * normal[k]
        approach += (v[first + k, i] - velocity[k]) * normal[k]
    if approach < 0.0:
        for k in range(len(lower)):
            v[first + k, i] -= approach * normal[k]
            total[k] -= m * approach * normal[k] / dt
    return True


@njit
def push_points(x, v, mass, lower, upper, velocity, reach, stiffness, friction, dt):
    """Contact forces ``(n, d)`` [N] at points ``(n, d)``.

    Returns:
        The forces, and a point inside of the box, or -1.
    """
    forces, normal, bad = np.zeros(x.shape), np.zeros(x.shape[1]), -1
    for p in range(len(x)):
        distance = contact_force(
            x.T, v.T, 0, p, mass[p], lower, upper, velocity, reach, stiffness, friction, dt,
            normal, forces[p],
        )  # fmt: skip
        if distance < 0.0:
            bad = p
    return forces, bad


@njit
def keep_points_out(x_next, v, mass, lower, upper, velocity, reach, dt):
    """Keep points ``(n, d)`` out of a box at its new place; the force ``(d,)`` that this takes."""
    normal, total = np.zeros(x_next.shape[1]), np.zeros(x_next.shape[1])
    for p in range(len(x_next)):
        keep_out(x_next.T, v.T, 0, p, mass[p], lower, upper, velocity, reach, dt, normal, total)
    return total


class Contact(NamedTuple):
    """Kernels of contact; see ``contact``."""

    push: Callable[..., Any]
    hold_back: Callable[..., Any]


@functools.cache
def contact(dim: int, kind: int) -> Contact:
    """Compile contact of points in blocks with boxes."""
    width, fill = WIDTH[kind], stencils(dim, kind, in_window=False)
    find, count, lattice = node_rows(dim, kind), WIDTH[kind] ** dim, (0.0, 0.0, 0.0)

    @_njit
    def push(
        nodes, ids, half, x, v, mass, lower, upper, velocity, reach, stiffness, friction, dt, rows
    ):
        """Contact forces to the nodes.

        Returns:
            Their sum ``(d,)``, and a block with a point inside of the box, or -1.
        """
        corner, base = np.empty((3, LANES)), np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        normal, force, total = np.zeros(dim), np.zeros(dim), np.zeros(dim)
        places, values = np.empty(count, np.int64), np.empty(count)
        filled, bad = -1, -1
        for block in range(len(mass)):
            for i in range(LANES):
                distance = contact_force(
                    x, v, block * dim, i, mass[block, i], lower, upper, velocity, reach, stiffness,
                    friction, dt, normal, force,
                )  # fmt: skip
                if distance >= reach:
                    continue
                if distance < 0.0:
                    bad = block
                total += force
                if filled != block:
                    fill(x, block, nodes, half, lattice, corner, base, w, d)
                    filled = block
                find(i, base, w, nodes, ids, places, values)
                for n in range(count):
                    for k in range(dim):
                        rows[places[n], FORCE + k] += values[n] * force[k]
        return total, bad

    @_njit
    def hold_back(nodes, units, x_next, v, mass, lower, upper, velocity, reach, dt):
        """Keep points out of a box at its new place.

        Returns:
            The force that this took, ``(d,)``; a block with a point that has left the lattice by
            this, or -1; and whether one has left its window.
        """
        normal, total, bad, strays = np.zeros(dim), np.zeros(dim), -1, False
        for unit in range(len(units.blocks) - 1):
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                for i in range(LANES):
                    if not keep_out(
                        x_next, v, block * dim, i, mass[block, i], lower, upper, velocity, reach,
                        dt, normal, total,
                    ):  # fmt: skip
                        continue
                    for k in range(dim):
                        t = (x_next[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                        if not -ON_WALL <= t <= nodes.shape[k] - 1 + ON_WALL:
                            bad = block
                        strays |= not units.t_low[unit, k] <= t <= units.t_high[unit, k]
        return total, bad, strays

    return Contact(push, hold_back)
