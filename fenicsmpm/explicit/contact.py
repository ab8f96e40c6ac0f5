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

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit.carriers import to_nodes
from fenicsmpm.explicit.stencils import OPTIONS, stencils
from fenicsmpm.lanes import LANES

_njit = njit(**OPTIONS)
_inline = numba.njit(forceinline=True, **OPTIONS)

# Share of the reach that is kept in any case
_CLOSEST = 0.01


class RigidBox:
    """An axis-parallel rigid box with a prescribed motion.

    Args:
        lower: corner (d,) at the start [m].
        upper: opposite corner (d,) [m]; infinite for boxes without end.
        reach: gap from which on there is a contact force [m], such as half the points' distance.
        velocity: (d,) [m/s], or a function of time [s].
        friction: coefficient; infinite for no slip.
        stiffness: of the barrier, in units of a point's mass over the square of the time step.

    Attributes:
        moved: way of the box so far (d,) [m].
        force: of the box on the bodies in the last step, (d,) [N].

    Raises:
        ValueError: for corners in the wrong order, a reach that is not positive, or negative
            friction or stiffness.
    """

    def __init__(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        reach: float,
        velocity: npt.ArrayLike | Callable[[float], npt.ArrayLike] = 0.0,
        friction: float = 0.0,
        stiffness: float = 0.1,
    ) -> None:
        """Check and copy."""
        self._lower = np.array(lower, dtype=np.float64)
        self._upper = np.array(upper, dtype=np.float64)
        if self._lower.shape != self._upper.shape or not np.all(self._lower < self._upper):
            raise ValueError(f"corners of a box in the wrong order: {self._lower}, {self._upper}")
        if not (0 < reach < np.inf and friction >= 0 and stiffness > 0):
            raise ValueError(
                "a rigid box needs a positive reach and stiffness and no negative friction: "
                f"{reach}, {stiffness}, {friction}"
            )
        self.reach, self.velocity = reach, velocity
        self.friction, self.stiffness = friction, stiffness
        self.moved: npt.NDArray[np.float64] = np.zeros(len(self._lower))
        self.force = np.zeros(len(self._lower))

    @property
    def lower(self) -> npt.NDArray[np.float64]:
        """Corner (d,) now [m]."""
        return self._lower + self.moved

    @property
    def upper(self) -> npt.NDArray[np.float64]:
        """Opposite corner (d,) now [m]."""
        return self._upper + self.moved

    def velocity_at(self, time: float) -> npt.NDArray[np.float64]:
        """Velocity (d,) [m/s].

        Raises:
            ValueError: if it is not finite.
        """
        value = self.velocity(time) if callable(self.velocity) else self.velocity
        velocity = np.broadcast_to(np.asarray(value, dtype=np.float64), self.force.shape).copy()
        if not np.isfinite(velocity).all():
            raise ValueError(f"velocity of a rigid box must be finite: {velocity} at t = {time} s")
        return velocity


class Contact(NamedTuple):
    """Kernels of contact; see ``contact``."""

    push: Callable[..., Any]
    hold_back: Callable[..., Any]


@functools.cache
def contact(dim: int, kind: int) -> Contact:
    """Compile contact of points with boxes."""
    width, fill, add = WIDTH[kind], stencils(dim, kind), to_nodes(dim, kind)

    @_inline
    def gap(x, block, i, lower, upper, normal):
        """Distance from a box and the direction away from it; negative inside."""
        outside, nearest, side, sign = 0.0, -np.inf, 0, 1.0
        for k in range(dim):
            x_k = x[block * dim + k, i]
            below, above = lower[k] - x_k, x_k - upper[k]
            normal[k] = max(above, 0.0) - max(below, 0.0)
            outside += normal[k] * normal[k]
            if max(below, above) > nearest:
                nearest, side, sign = max(below, above), k, -1.0 if below > above else 1.0
        if outside > 0.0:
            distance = np.sqrt(outside)
            for k in range(dim):
                normal[k] /= distance
            return distance
        for k in range(dim):
            normal[k] = 0.0
        normal[side] = sign
        return nearest

    @_njit
    def push(nodes, half, x, v, mass, lower, upper, velocity, reach, stiffness, friction, dt, rows):
        """Contact forces to the nodes; points in blocks.

        Returns:
            Their sum ``(d,)``, and a block with a point inside of the box, or -1.
        """
        base = np.empty(LANES, np.int64)
        w, d = np.empty((3 * width, LANES)), np.empty((3 * width, LANES))
        normal, force, total = np.zeros(3), np.zeros(dim), np.zeros(dim)
        filled, bad = -1, -1
        for block in range(len(mass)):
            for i in range(LANES):
                distance = gap(x, block, i, lower, upper, normal)
                if distance >= reach:
                    continue
                if distance < 0.0:
                    bad = block
                m = mass[block, i]
                s = max(distance / reach, _CLOSEST)
                strength = stiffness * m * reach / (dt * dt)
                f = strength * (s - 1.0) * (2.0 * np.log(s) + (s - 1.0) / s)
                approach = 0.0
                for k in range(dim):
                    approach += (v[block * dim + k, i] - velocity[k]) * normal[k]
                slip = 0.0
                for k in range(dim):
                    force[k] = v[block * dim + k, i] - velocity[k] - approach * normal[k]
                    slip += force[k] * force[k]
                # to stop the slip in one step, or what friction allows
                stop = m * np.sqrt(slip) / dt
                share = min(1.0, friction * f / stop) if stop > 0.0 else 0.0
                for k in range(dim):
                    force[k] = f * normal[k] - share * m * force[k] / dt
                    total[k] += force[k]
                if filled != block:
                    fill(x, block, nodes, half, base, w, d)
                    filled = block
                add(i, nodes, base, w, force, rows)
        return total, bad

    @_njit
    def hold_back(nodes, x_next, v, mass, lower, upper, velocity, reach, dt):
        """Keep points out of a box at its new place.

        Returns:
            The force that this took, ``(d,)``, and a block with a point that has left the lattice
            by this, or -1.
        """
        normal, total, bad = np.zeros(3), np.zeros(dim), -1
        for block in range(len(mass)):
            for i in range(LANES):
                distance = gap(x_next, block, i, lower, upper, normal)
                if distance >= _CLOSEST * reach:
                    continue
                approach = 0.0
                for k in range(dim):
                    x_next[block * dim + k, i] += (_CLOSEST * reach - distance) * normal[k]
                    approach += (v[block * dim + k, i] - velocity[k]) * normal[k]
                    t = (x_next[block * dim + k, i] - nodes.origin[k]) * nodes.per_metre[k]
                    if not 0 <= t <= nodes.shape[k] - 1:
                        bad = block
                if approach < 0.0:
                    for k in range(dim):
                        v[block * dim + k, i] -= approach * normal[k]
                        total[k] -= mass[block, i] * approach * normal[k] / dt
        return total, bad

    return Contact(push, hold_back)
