# SPDX-License-Identifier: MIT
"""Fields that a body carries through a dynamic computation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together


def set_initial_state(
    points: MaterialPoints,
    density: float,
    velocity: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | None = None,
) -> None:
    """Give undeformed points the fields of a body in motion, for any time loop (collective).

    These are "mass" [kg], "V_0" initial volume [m^d], "F" deformation gradient and "J" its
    determinant [-], "u" displacement [m] and "v" velocity [m/s]; where velocities are given, also
    their gradient "grad_v" [1/s]. What a law or a time scheme needs beyond that, it adds itself.

    Args:
        points: the body, with its volumes as weights.
        density: [kg/m^d].
        velocity: function of the positions ``(n, d)`` to initial velocities ``(n, d)``; None for
            a body at rest.

    Raises:
        ValueError: for a density that is not positive and finite, or velocities of another shape
            than the positions; the points are as before.
    """
    if not 0 < density < np.inf:
        raise ValueError(f"the density must be positive and finite: {density}")
    v = np.zeros(points.x.shape) if velocity is None else np.asarray(velocity(points.x))
    error = None
    if v.shape != points.x.shape:
        error = ValueError(f"velocities of shape {v.shape} at points of shape {points.x.shape}")
    raise_together(points.mesh.comm, error)
    dim = points.mesh.geometry.dim
    points.add_field("mass", (), density * points.weight)
    points.add_field("V_0", (), points.weight)
    points.add_field("F", (3, 3), np.eye(3))
    points.add_field("J", (), 1.0)
    points.add_field("u", (dim,))
    points.add_field("v", (dim,), v)
    if velocity is not None:
        lower, upper = points.bounds
        gradient = _gradient(velocity, points.x, 1e-5 * float(np.max(upper - lower)))
        points.add_field("grad_v", (dim, dim), gradient)


def _gradient(
    velocity: Callable[[npt.NDArray[np.float64]], npt.ArrayLike],
    x: npt.NDArray[np.float64],
    step: float,
) -> npt.NDArray[np.float64]:
    """``(n, d, d)`` gradient of a function of positions, by differences over a step [m]."""
    step = step or 1.0  # a single point
    differences = [
        np.asarray(velocity(x + e)) - np.asarray(velocity(x - e)) for e in step * np.eye(x.shape[1])
    ]
    return np.stack(differences, axis=-1) / (2 * step)
