# SPDX-License-Identifier: MIT
"""Motions from the literature for ``Manufactured``, and the bodies that they need."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import ufl

from fenicsmpm.points import MaterialPoints

Motion = Callable[[Any, Any], tuple[Any, ...]]


def axis_aligned_waves(amplitude: float, frequency: float) -> Motion:
    """Return standing waves in a unit square or cube on rollers, one wave for each direction.

    The displacement is u_i = +- A sin(2 pi X_i) sin(pi f t) (P. Wallstedt and J. Guilkey, J.
    Comput. Phys. 227, 2008).

    Args:
        amplitude: Amplitude A [m].
        frequency: F [1/s], for example the wave speed divided by the length of the body.

    Returns:
        Function ``displacement(X, t)`` for ``Manufactured``.
    """

    def displacement(X: Any, t: Any) -> tuple[Any, ...]:
        wave = ufl.sin(ufl.pi * frequency * t)
        signs = (1, -1, 1)[: X.ufl_shape[0]]
        return tuple(
            sign * amplitude * ufl.sin(2 * ufl.pi * X[i]) * wave for i, sign in enumerate(signs)
        )

    return displacement


def generalized_vortex(angle: float, period: float = 1.0) -> Motion:
    """Return a motion in which the layers of a ring rotate about the origin and back.

    The surfaces of the ring do not move and are free of stress, and the volume is conserved. For
    0.75 < R < 1.25 the angle is a sin(pi t / T)^2 (1 - 32 s^2 + 256 s^4) with s = R - 1 (after K.
    Kamojjala, R. Brannon, A. Sadeghirad and J. Guilkey, Eng. Comput. 31, 2015).

    Args:
        angle: Largest angle a [rad], at R = 1 m.
        period: Time T until the ring has returned to its initial state [s].

    Returns:
        Function ``displacement(X, t)`` for ``Manufactured``.
    """

    def displacement(X: Any, t: Any) -> tuple[Any, ...]:
        s = ufl.sqrt(ufl.inner(X, X)) - 1
        turned = angle * ufl.sin(ufl.pi * t / period) ** 2 * (1 - 32 * s**2 + 256 * s**4)
        cos, sin = ufl.cos(turned), ufl.sin(turned)
        return (cos - 1) * X[0] - sin * X[1], sin * X[0] + (cos - 1) * X[1]

    return displacement


def ring(mesh: Any, spacing: float, inner: float = 0.75, outer: float = 1.25) -> MaterialPoints:
    """Return points on circles about the origin, each with its part of the ring as its volume.

    Args:
        mesh: Plane background mesh around the ring.
        spacing: Approximate distance of the points [m].
        inner: Inner radius [m].
        outer: Outer radius [m].
    """
    count = max(1, round((outer - inner) / spacing))
    width = (outer - inner) / count
    x, volume = [], []
    for radius in inner + width * (np.arange(count) + 0.5):
        n = round(2 * math.pi * radius / width)
        angle = 2 * math.pi * (np.arange(n) + 0.5) / n
        x.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        volume.append(np.full(n, 2 * math.pi * radius * width / n))
    here = mesh.comm.rank == 0
    points, volumes = np.concatenate(x), np.concatenate(volume)
    return MaterialPoints(
        mesh, points if here else points[:0], weight=volumes if here else volumes[:0]
    )
