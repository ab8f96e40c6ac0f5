# SPDX-License-Identifier: MIT
"""Contact of a material point with a rigid body: a barrier, and elastic-slip friction (numba).

The force on a point follows from its gap d by the barrier of M. Li et al. (Incremental potential
contact, ACM Trans. Graph. 39, 2020), as Y. Zhao, C. Jiang and J. Choo use it:

    f = -k r b'(d / r),    b(s) = -(s - 1)^2 ln s  for 0 < s < 1.

It is zero for gaps larger than the reach r, and infinite at contact.

Explicit steps are too long for gaps that are nearly closed, so there are two limits. First, the
force is limited such that, acting alone, it would move the point by at most half of the missing
distance in the step. Second, a point that would come closer than a hundredth of the reach is placed
at that distance and no longer approaches the body. Therefore no point enters a body that is thicker
than twice the displacement of the point in a step. A point that is inside the body from the start
is an error.

Friction is Coulomb's, elastic up to its limit (P. Wriggers, Computational Contact Mechanics, 2006,
section 5.2). From its first contact on, a point drags a spring along the body. It also drags a
damper, which would stop the motion of the last step within one step. When the spring force reaches
its limit, the spring slides with the point. A force that opposed only the current slip would let a
body creep that should be at rest. The damper does not use the velocities of points, because with
FLIP these have components that do not move anything.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fenicsmpm.basis.blocks import inline
from fenicsmpm.rigid.distance import distance_at

# Smallest gap as a share of the reach
_CLOSEST = 0.01
# Largest share of the way out of the reach that a force may move a point in a step
_OUT = 0.5
# Stiffness of the friction spring, in units of the mass of a point over the square of the longest
# time step
_SPRING = 0.25
# Number of attempts to move a point out of a body; near edges the first direction may be wrong
_ATTEMPTS = 10


class Contact(NamedTuple):
    """Data of a rigid body for the contact law.

    Attributes:
        field: Its ``Distance``.
        rotation: Rotation matrix of the body ``(d, d)`` [-].
        centre: Current position of the centre ``(d,)`` [m].
        origin: Position of the centre when the shape was given ``(d,)`` [m].
        rotation_before: Rotation matrix at the start of the step ``(d, d)`` [-].
        centre_before: Position of the centre at the start of the step ``(d,)`` [m].
        velocity: Velocity of the centre ``(d,)`` [m/s].
        spin: Spin matrix ``(d, d)`` [1/s]: a place at r from the centre moves with spin r.
        reach: Reach of the barrier [m].
        stiffness: Stiffness of the barrier, in units of the mass of a point over the square of the
            longest time step [-].
        friction: Coefficient of friction [-].
        share: Factor on the forces [-], so that points do not throw off a free body that is lighter
            than they are.
        longest: Longest allowed time step [s]. Stiffnesses refer to it, because steps are shortened
            to end at a given time, and another stiffness would push what is at rest.
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
    longest: Any


# Arrays over points are indexed by component and point. Therefore the same functions work on blocks
# of eight points, from row `first` on, and on transposed arrays. The array of slips has two vectors
# in the frame of the body: the spring, and the displacement along the body in the last step. `work`
# has rows for temporary vectors.


@inline
def gap(x, first, i, body, y, normal):
    """Return the distance of a point from a body [m], and set the direction away from it.

    Args:
        x: Positions of points [m], by component and point.
        first: Row of the first component.
        i: Column of the point.
        body: The ``Contact``.
        y: Position of the point in the frame of the body ``(d,)`` [m], overwritten.
        normal: Direction in the frame of the body ``(d,)`` [-], overwritten.
    """
    for k in range(len(y)):
        y[k] = body.origin[k]
        for j in range(len(y)):
            y[k] += body.rotation[j, k] * (x[first + j, i] - body.centre[j])
    return distance_at(body.field, y, normal)


@inline
def turn(body, vector, work):
    """Rotate a vector from the frame of the body into space.

    Args:
        body: The ``Contact``.
        vector: Vector ``(d,)``, overwritten.
        work: Temporary vector ``(d,)``.
    """
    for k in range(len(vector)):
        work[k] = vector[k]
    for k in range(len(vector)):
        vector[k] = 0.0
        for j in range(len(vector)):
            vector[k] += body.rotation[k, j] * work[j]


@inline
def relative_velocity(x, v, first, i, body, result):
    """Set the velocity of a point relative to the body.

    Args:
        x: Positions of points [m], by component and point.
        v: Velocities of points [m/s], by component and point.
        first: Row of the first component.
        i: Column of the point.
        body: The ``Contact``.
        result: Relative velocity ``(d,)`` [m/s], overwritten.
    """
    for k in range(len(result)):
        result[k] = v[first + k, i] - body.velocity[k]
        for j in range(len(result)):
            result[k] -= body.spin[k, j] * (x[first + j, i] - body.centre[j])


@inline
def dot(a, b):
    """Return the scalar product.

    Args:
        a: Vector ``(d,)``.
        b: Vector ``(d,)``.
    """
    result = 0.0
    for k in range(len(a)):
        result += a[k] * b[k]
    return result


@inline
def add_to_total(x, first, i, body, force, total):
    """Add a force on a point, and its moment about the centre of the body, to totals.

    Args:
        x: Positions of points [m], by component and point.
        first: Row of the first component.
        i: Column of the point.
        body: The ``Contact``.
        force: Force on the point ``(d,)`` [N].
        total: Totals ``(8,)``; see ``body.TOTALS``.
    """
    d = len(force)
    for k in range(d):
        total[k] += force[k]
        for j in range(d):
            if j != k:
                sign = 1.0 if (j - k) % 3 == 1 else -1.0
                total[6 - j - k] += sign * (x[first + k, i] - body.centre[k]) * force[j]


@inline
def contact_force(x, v, slip, first, i, m, body, dt, work, force, total):
    """Set the force of a body on a point, and add it to totals.

    Args:
        x: Positions of points [m], by component and point.
        v: Velocities of points [m/s], by component and point.
        slip: Springs and displacements along the body [m], two vectors per point.
        first: Row of the first component.
        i: Column of the point.
        m: Mass of the point [kg].
        body: The ``Contact``.
        dt: Time step [s].
        work: At least four temporary vectors ``(d,)``.
        force: Force on the point ``(d,)`` [N], overwritten.
        total: Totals ``(8,)``; see ``body.TOTALS``.

    Returns:
        The distance [m]. If it is not less than the reach, there is no force, and none is set.
    """
    y, normal, w, t = work[0], work[1], work[2], work[3]
    distance = gap(x, first, i, body, y, normal)
    if distance >= body.reach:
        return distance
    turn(body, normal, y)
    relative_velocity(x, v, first, i, body, w)
    approach = dot(w, normal)
    unit = body.share * m / (body.longest * body.longest)
    s = max(distance / body.reach, _CLOSEST)
    f = body.stiffness * unit * body.reach * (s - 1.0) * (2.0 * np.log(s) + (s - 1.0) / s)
    most = max(_OUT * (body.reach - distance) - dt * approach, 0.0)
    f = min(f, body.share * m / (dt * dt) * most)
    for k in range(len(force)):
        force[k] = f * normal[k]
    if body.friction > 0.0:
        for k in range(len(force)):
            # force that would hold the point, in units of length
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
    """End the step of a point: keep it outside a body at its new position, and update its spring.

    The force that this requires is added to totals. So are the mass and polar moment of a point
    within reach.

    Args:
        x: Positions of points at the start of the step [m], by component and point.
        x_next: Positions at the end of the step [m], corrected in place.
        v: Velocities of points [m/s], corrected in place.
        slip: Springs and displacements along the body [m], two vectors per point.
        first: Row of the first component.
        i: Column of the point.
        m: Mass of the point [kg].
        body: The ``Contact``.
        dt: Time step [s].
        work: At least three temporary vectors ``(d,)``.
        force: Temporary vector ``(d,)`` for the force [N].
        total: Totals ``(8,)``; see ``body.TOTALS``.

    Returns:
        Whether the point was too close.
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
