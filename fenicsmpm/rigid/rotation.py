# SPDX-License-Identifier: MIT
"""Rotations by quaternions, and the free rotation of a rigid body."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def product(p: Array, q: Array) -> Array:
    """Return the product ``(4,)`` of quaternions with real parts first: rotate by q, then by p.

    Args:
        p: Quaternion ``(4,)``.
        q: Quaternion ``(4,)``.
    """
    a, u, b, v = p[0], p[1:], q[0], q[1:]
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])


def about(vector: Array) -> Array:
    """Return the quaternion ``(4,)`` of the rotation about a vector by its length.

    Args:
        vector: Rotation vector ``(3,)`` [rad].
    """
    angle = math.sqrt(vector @ vector)
    share = math.sin(angle / 2) / angle if angle > 0 else 0.5
    return np.array([math.cos(angle / 2), *(share * vector)])


def matrix(q: Array) -> Array:
    """Return the rotation matrix ``(3, 3)`` of a unit quaternion.

    Args:
        q: Quaternion ``(4,)`` of length one.
    """
    a, (b, c, d) = q[0], q[1:]
    return np.array(
        [
            [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
        ]
    )


def skew(w: Array) -> Array:
    """Return the matrix ``(3, 3)`` of the cross product with a vector.

    Args:
        w: Vector ``(3,)``.
    """
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def spin(q: Array, momentum: Array, axes: Array, moments: Array, dt: float) -> Array:
    """Return the rotation of a torque-free body after a time.

    The body rotates about its principal axes one after the other, with the exact rotation about
    each (A. Dullweber, B. Leimkuhler, R. McLachlan, J. Chem. Phys. 107, 1997). The method is
    symplectic, reversible and of second order. It conserves the angular momentum, and the energy
    oscillates without drift.

    Args:
        q: Quaternion of the rotation since the start ``(4,)``.
        momentum: Angular momentum about the centre in space ``(3,)`` [kg m^2/s], which is constant.
        axes: Principal axes at the start ``(3, 3)``, in columns.
        moments: Moments about these axes ``(3,)`` [kg m^2].
        dt: Time [s].

    Returns:
        Quaternion of the rotation after the time ``(4,)``.
    """
    pi = axes.T @ (matrix(q).T @ momentum)
    for i, share in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        angle = share * dt * pi[i] / moments[i]
        q = product(q, about(angle * axes[:, i]))
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = math.cos(angle), math.sin(angle)
        pi[j], pi[k] = c * pi[j] + s * pi[k], c * pi[k] - s * pi[j]
    length: float = math.sqrt(q @ q)
    return np.asarray(q / length, dtype=np.float64)
