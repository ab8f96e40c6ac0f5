# SPDX-License-Identifier: MIT
"""Initial fields of a body for time loops."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import finite
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.of_position import OfPosition, values_at, vectors_at


def set_initial_state(
    points: MaterialPoints,
    density: npt.ArrayLike | OfPosition,
    velocity: npt.ArrayLike | OfPosition | None = None,
) -> None:
    """Add the fields that any time loop needs to undeformed points. Collective.

    The fields are the mass "mass" [kg], the initial volume "V_0" [m^d], the deformation gradient
    "F" [-], its determinant "J" [-], the displacement "u" [m] and the velocity "v" [m/s]. If a
    velocity is given, its gradient "grad_v" [1/s] is added too. Laws and time schemes add any
    further fields that they need.

    Args:
        points: The body, with its volumes as weights [m^d].
        density: Density [kg/m^d]: one number, an array ``(n,)`` with one value for each point of
            this rank, or a function as in dolfinx, from positions ``(3, n)`` [m] to densities
            ``(n,)``.
        velocity: Initial velocity of all points ``(d,)`` [m/s], or a function as in dolfinx, from
            positions ``(3, n)`` [m] to velocities ``(d, n)`` [m/s]. None for a body at rest.

    Raises:
        ValueError: On all ranks, if densities are not positive and finite, or if densities or
            velocities have a wrong shape. After any error, including one raised by a given function
            on one rank, the points are unchanged.
    """
    error, rho = _density(density, points)
    raise_together(points.mesh.comm, error)
    motion = _motion(velocity, points)
    dim = points.mesh.geometry.dim
    points.add_field("mass", (), rho * points.weight)
    points.add_field("V_0", (), points.weight)
    points.add_field("F", (3, 3), np.eye(3))
    points.add_field("J", (), 1.0)
    points.add_field("u", (dim,))
    points.add_field("v", (dim,), motion["v"])
    if velocity is not None:
        points.add_field("grad_v", (dim, dim), motion["grad_v"])


def _density(
    density: npt.ArrayLike | OfPosition, points: MaterialPoints
) -> tuple[Exception | None, npt.NDArray[np.float64]]:
    """Return densities, ``(n,)`` or ``()``, and an error if they are invalid."""
    n = len(points)
    if callable(density):
        error, density = values_at(density, points.x, ())
        if error is not None:
            return error, density
    try:
        rho = finite(density, "densities")
    except ValueError as wrong:
        return wrong, np.empty(0)
    if rho.shape not in ((), (n,)):
        return ValueError(f"densities of shape {rho.shape} for {n} points: needs () or ({n},)"), rho
    bad = np.flatnonzero(rho <= 0)
    if not len(bad):
        return None, rho
    where = ""
    if rho.shape:
        at = np.array2string(points.x[bad[0]], precision=6)
        where = f" at point {bad[0]} ({len(bad)} of {n} are not), which is at {at}"
    return ValueError(f"the density must be positive: {rho.flat[bad[0]]} kg/m^d{where}"), rho


def _motion(
    velocity: npt.ArrayLike | OfPosition | None, points: MaterialPoints
) -> dict[str, npt.NDArray[np.float64]]:
    """Return velocity "v" and gradient "grad_v", for each point or for all points. Collective."""
    dim = points.mesh.geometry.dim
    if callable(velocity):
        error, v = vectors_at(velocity, points.x)
        raise_together(points.mesh.comm, error)
        lower, upper = points.bounds()
        step = 1e-5 * float(np.max(upper - lower)) or 1.0  # 1.0 for a single point
        return {"v": v, "grad_v": _gradient(velocity, points, step)}
    v = np.zeros(dim) if velocity is None else finite(velocity, "velocities")
    if v.shape != (dim,):
        raise ValueError(
            f"a velocity of all points needs the shape ({dim},), not {v.shape}: give a function of "
            "positions if velocities vary in space"
        )
    return {"v": v, "grad_v": np.zeros((dim, dim))}


def _gradient(velocity: OfPosition, points: MaterialPoints, step: float) -> npt.NDArray[np.float64]:
    """Return the ``(n, d, d)`` gradient at points by central differences. Collective."""
    errors: list[Exception | None] = []
    gradient = np.empty((*points.x.shape, points.x.shape[1]))
    for k, e in enumerate(step * np.eye(points.x.shape[1])):
        ahead, forward = vectors_at(velocity, points.x + e)
        behind, back = vectors_at(velocity, points.x - e)
        errors += [ahead, behind]
        gradient[..., k] = (forward - back) / (2 * step)
    raise_together(points.mesh.comm, next(filter(None, errors), None))
    return gradient


def require_initial_state(points: MaterialPoints, what: str) -> None:
    """Raise ValueError if points lack the fields of ``set_initial_state``.

    Args:
        points: The body.
        what: Name of the feature that needs the fields, for the message.

    Raises:
        ValueError: If a field is missing.
    """
    missing = [name for name in ("F", "J", "mass", "V_0") if name not in points]
    if missing:
        raise ValueError(
            f"a body without the fields {', '.join(missing)} has no {what}: call "
            "set_initial_state(points, density) first"
        )
