# SPDX-License-Identifier: MIT
"""Contact of a material point with a rigid body: a barrier, and friction that sticks (numba).

The force of a point follows from its gap d by the barrier of M. Li et al. (Incremental potential
contact, ACM Trans. Graph. 39, 2020), as Y. Zhao, C. Jiang, J. Choo use it:

    f = -k r b'(d / r),    b(s) = -(s - 1)^2 ln s  for 0 < s < 1,

zero from the reach r on and infinite at contact. Explicit steps are too long for gaps that are
nearly closed. So the force is at most what would lead the point away by half of the way that it is
too near, within the step and if the force acted on it alone; and a point that would come nearer
than a hundredth of the reach is put there, and no longer approaches the body. So no point enters a
body that is thicker than twice the way of a step; one that is in it from the beginning is an error.

Friction is Coulomb's, elastic up to its limit (P. Wriggers, Computational Contact Mechanics, 2006,
section 5.2): from where it touches first, a point drags a spring along the body, and a damper that
would stop in one step how it has moved in the last one. A spring whose force is at its limit slides
with the point. A force that only acted against the present slip would let a body creep that ought
to rest. The damper does not go by the velocities of points: with FLIP, they have parts that nothing
moves by.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fenicsmpm.basis.blocks import inline
from fenicsmpm.rigid.distance import distance_at

# Share of the reach that is kept in any case
_CLOSEST = 0.01
# Share of the way out of the reach that a point may be led in a step
_OUT = 0.5
# Stiffness of the spring of friction, in units of a point's mass over the square of the time step
_SPRING = 0.25
# Attempts to put a point out of a body, at whose edges the first direction may not be right
_ATTEMPTS = 10


class Contact(NamedTuple):
    """A rigid body as the contact law sees it.

    Attributes:
        field: its ``Distance``.
        rotation: of the body ``(d, d)``.
        centre: where it is ``(d,)`` [m].
        origin: where the centre was when the shape was given.
        rotation_before: at the beginning of the step.
        centre_before: likewise.
        velocity: of the centre ``(d,)`` [m/s].
        spin: ``(d, d)``, with which a place r from the centre moves by spin r [1/s].
        reach: [m].
        stiffness: of the barrier, in units of a point's mass over the square of the time step.
        friction: coefficient.
        share: of the forces, so that points do not throw a free body that is lighter than they are.
    """

    field: Any
    rotation: Any
    centre: Any
    origin: Any
    rotation_before: Any
    centre_before: Any
    velocity: Any
    spin: Any
    reach: Any
    stiffness: Any
    friction: Any
    share: Any


# Arrays of points are indexed by component and point, so that those in blocks of eight, from some
# row on, and transposed ones are served by the same functions. That of slips has two vectors in the
# body's frame: the spring, and the way along the body in the last step. `work` has rows for some
# vectors.


@inline
def gap(x, first, i, body, y, normal):
    """Distance of a point from a body and the direction away from it.

    Sets ``y``, the point in the body's frame.
    """
    for k in range(len(y)):
        y[k] = body.origin[k]
        for j in range(len(y)):
            y[k] += body.rotation[j, k] * (x[first + j, i] - body.centre[j])
    return distance_at(body.field, y, normal)


@inline
def turn(body, vector, work):
    """Turn a vector of the body's frame into space."""
    for k in range(len(vector)):
        work[k] = vector[k]
    for k in range(len(vector)):
        vector[k] = 0.0
        for j in range(len(vector)):
            vector[k] += body.rotation[k, j] * work[j]


@inline
def relative_velocity(x, v, first, i, body, result):
    """Velocity of a point as seen from the body."""
    for k in range(len(result)):
        result[k] = v[first + k, i] - body.velocity[k]
        for j in range(len(result)):
            result[k] -= body.spin[k, j] * (x[first + j, i] - body.centre[j])


@inline
def dot(a, b):
    """Scalar product."""
    result = 0.0
    for k in range(len(a)):
        result += a[k] * b[k]
    return result


@inline
def add_to_total(x, first, i, body, force, total):
    """Add a force on a point and its moment about the body's centre to totals ``(8,)``."""
    d = len(force)
    for k in range(d):
        total[k] += force[k]
        for j in range(d):
            if j != k:
                sign = 1.0 if (j - k) % 3 == 1 else -1.0
                total[6 - j - k] += sign * (x[first + k, i] - body.centre[k]) * force[j]


@inline
def contact_force(x, v, slip, first, i, m, body, dt, work, force, total):
    """Set the force ``(d,)`` of a body on a point of mass m, and add it to totals.

    Returns:
        The distance; from the reach on there is no force, and none is set.
    """
    y, normal, w, t = work[0], work[1], work[2], work[3]
    distance = gap(x, first, i, body, y, normal)
    if distance >= body.reach:
        return distance
    turn(body, normal, y)
    relative_velocity(x, v, first, i, body, w)
    approach = dot(w, normal)
    unit = body.share * m / (dt * dt)
    s = max(distance / body.reach, _CLOSEST)
    f = body.stiffness * unit * body.reach * (s - 1.0) * (2.0 * np.log(s) + (s - 1.0) / s)
    f = min(f, unit * max(_OUT * (body.reach - distance) - dt * approach, 0.0))
    for k in range(len(force)):
        force[k] = f * normal[k]
    if body.friction > 0.0:
        for k in range(len(force)):
            # what would hold the point, in lengths
            t[k] = _SPRING * slip[2 * first + k, i] + slip[2 * first + len(force) + k, i]
        turn(body, t, y)
        along = dot(t, normal)
        for k in range(len(force)):
            t[k] -= along * normal[k]
        length = unit * np.sqrt(dot(t, t))
        limit = body.friction * f if f > 0.0 else 0.0
        slides = length > limit
        ratio = limit / length if slides else 1.0
        for k in range(len(force)):
            force[k] -= ratio * unit * t[k]
            if slides:
                slip[2 * first + k, i] = 0.0
                for j in range(len(force)):
                    slip[2 * first + k, i] += body.rotation[j, k] * ratio * t[j] / _SPRING
    add_to_total(x, first, i, body, force, total)
    return distance


@inline
def keep_out(x, x_next, v, slip, first, i, m, body, dt, work, force, total):
    """End the step of a point: keep it out of a body at its new place, and renew its spring.

    Adds the force that this takes to totals, and a point within reach to what touches the body.

    Returns:
        Whether the point was too near.
    """
    y, normal, w = work[0], work[1], work[2]
    distance = gap(x_next, first, i, body, y, normal)
    if distance >= body.reach:
        if body.friction > 0.0:
            for k in range(2 * len(force)):
                slip[2 * first + k, i] = 0.0
        return False
    was_too_near = distance < _CLOSEST * body.reach
    for _ in range(_ATTEMPTS):
        if distance >= _CLOSEST * body.reach * (1.0 - 1e-6):
            break
        turn(body, normal, y)
        relative_velocity(x_next, v, first, i, body, w)
        approach = min(dot(w, normal), 0.0) * body.share
        for k in range(len(force)):
            x_next[first + k, i] += (_CLOSEST * body.reach - distance) * normal[k]
            v[first + k, i] -= approach * normal[k]
            force[k] = -m * approach / dt * normal[k]
        add_to_total(x_next, first, i, body, force, total)
        distance = gap(x_next, first, i, body, y, normal)
    if body.friction > 0.0:
        for k in range(len(force)):
            way = y[k] - body.origin[k]
            for j in range(len(force)):
                way -= body.rotation_before[j, k] * (x[first + j, i] - body.centre_before[j])
            slip[2 * first + k, i] += way
            slip[2 * first + len(force) + k, i] = way
    total[6] += m
    for k in range(len(force)):
        total[7] += m * (x_next[first + k, i] - body.centre[k]) ** 2
    return was_too_near
