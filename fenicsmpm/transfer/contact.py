# SPDX-License-Identifier: MIT
"""Contact of material points with rigid bodies, for all points (numba).

`fenicsmpm.rigid.contact_law` is the law of one point. Totals ``(8,)`` are the force, its moment
about the body's centre, and mass and polar moment of inertia of the points within reach.
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
from fenicsmpm.rigid.contact_law import contact_force, keep_out
from fenicsmpm.transfer.carriers import node_rows
from fenicsmpm.transfer.grid_rows import FORCE

_njit = njit(**OPTIONS)


@njit
def push_points(x, v, slip, mass, body, dt, total):
    """Return contact forces ``(n, d)`` in N at points ``(n, d)``.

    Args:
        x: Positions in m.
        v: Velocities in m/s.
        slip: Array ``(n, 2 d)``, updated: the friction spring, and the path along the body in the
            last step, in the frame of the body. Without friction it has no rows.
        mass: Masses in kg, ``(n,)``.
        body: The rigid body, a ``Contact``.
        dt: Time step in s.
        total: Totals, which are added to.

    Returns:
        The forces, and a point inside the body, or -1.
    """
    forces, work, bad = np.zeros(x.shape), np.zeros((4, x.shape[1])), -1
    for p in range(len(x)):
        distance = contact_force(x.T, v.T, slip.T, 0, p, mass[p], body, dt, work, forces[p], total)
        if distance < 0.0:
            bad = p
    return forces, bad


@njit
def keep_points_out(x, x_next, v, slip, mass, body, dt, total):
    """Keep points ``(n, d)`` out of a body in its new position, see ``push_points``."""
    force, work = np.zeros(x.shape[1]), np.zeros((4, x.shape[1]))
    for p in range(len(x)):
        keep_out(x.T, x_next.T, v.T, slip.T, 0, p, mass[p], body, dt, work, force, total)


class ContactKernels(NamedTuple):
    """Kernels of contact; see ``contact``."""

    push: Callable[..., Any]
    hold_back: Callable[..., Any]


@functools.cache
def contact(dim: int, kind: int) -> ContactKernels:
    """Compile contact of points in blocks with rigid bodies."""
    width, fill = WIDTH[kind], stencils(dim, kind, in_window=False)
    find, count, lattice = node_rows(dim, kind), WIDTH[kind] ** dim, (0.0, 0.0, 0.0)

    @_njit
    def push(nodes, ids, half, x, v, slip, mass, body, dt, rows, total):
        """Add contact forces to the nodes.

        Returns:
            A block with a point inside the body, or -1.
        """
        corner, base = np.empty((3, LANES)), np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        work, force = np.zeros((4, dim)), np.zeros(dim)
        places, values = np.empty(count, np.int64), np.empty(count)
        filled, bad = -1, -1
        for block in range(len(mass)):
            for i in range(LANES):
                distance = contact_force(
                    x, v, slip, block * dim, i, mass[block, i], body, dt, work, force, total
                )
                if distance >= body.reach:
                    continue
                if distance < 0.0:
                    bad = block
                if filled != block:
                    fill(x, block, nodes, half, lattice, corner, base, w, d)
                    filled = block
                find(i, base, w, nodes, ids, places, values)
                for n in range(count):
                    for k in range(dim):
                        rows[places[n], FORCE + k] += values[n] * force[k]
        return bad

    @_njit
    def hold_back(nodes, units, x, x_next, v, slip, mass, body, dt, total):
        """Keep points out of a body in its new position.

        Returns:
            A block with a point that leaves the lattice by this, or -1; and whether a point has
            left its window.
        """
        work, force, bad, strays = np.zeros((4, dim)), np.zeros(dim), -1, False
        for unit in range(len(units.blocks) - 1):
            for block in range(units.blocks[unit], units.blocks[unit + 1]):
                for i in range(LANES):
                    if not keep_out(
                        x, x_next, v, slip, block * dim, i, mass[block, i], body, dt, work, force,
                        total,
                    ):  # fmt: skip
                        continue
                    for k in range(dim):
                        t = (x_next[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                        if not -ON_WALL <= t <= nodes.shape[k] - 1 + ON_WALL:
                            bad = block
                        strays |= not units.t_low[unit, k] <= t <= units.t_high[unit, k]
        return bad, strays

    return ContactKernels(push, hold_back)
