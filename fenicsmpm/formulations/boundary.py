# SPDX-License-Identifier: MIT
"""Loads and constraints on boundary points, which move through the grid with the body.

The weights of boundary points are the areas (lengths in 2D) of the undeformed boundary. Pass
boundary points to the time loop as ``carried`` points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm._numbers import number
from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.of_position import OfPosition, vectors_at
from fenicsmpm.points.point_field import PointField


def dead_load(w: Any, points: MaterialPoints, traction: Any) -> ufl.Form:
    """Return the load -(t, w) of a traction per initial area with fixed direction.

    Args:
        w: Test function of displacement or velocity ``(d,)``.
        points: Boundary points with initial areas as weights [m^(d-1)].
        traction: Force per initial area t [Pa], d components or a UFL vector.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: If there are no points on any rank, or the traction has a wrong shape.
    """
    require_points(points, "a load")
    return -ufl.inner(_vector(traction, points, "a traction"), w) * points.dx


def set_normals(
    points: MaterialPoints,
    normals: npt.ArrayLike | OfPosition,
) -> None:
    """Set the field "normal" of boundary points, which ``follower_pressure`` needs. Collective.

    The field is the outer unit normal times the ratio of current to initial area [-]. Points from
    ``points.on_facets`` and ``points.on_curve`` already have normals.

    Args:
        points: Boundary points in their initial state, where the ratio of areas is 1.
        normals: Outer unit normals, ``(d,)`` or ``(n_points, d)`` in storage order, or a function
            as in dolfinx, from positions ``(3, n)`` [m] to normals ``(d, n)``.

    Raises:
        ValueError: If the shape is wrong, or a length is not 1. An error that the function raises
            on one rank is raised on all ranks.
    """
    shape = (len(points), points.mesh.geometry.dim)
    error: Exception | None = None
    if callable(normals):
        error, given = vectors_at(normals, points.x)
    else:
        given = np.asarray(normals, dtype=np.float64)
    raise_together(points.mesh.comm, error)
    if given.shape not in (shape, shape[1:]):
        error = ValueError(
            f"normals need the shape {shape}, one row per point, or {shape[1:]}, not {given.shape}"
        )
    else:
        length = np.linalg.norm(np.broadcast_to(given, shape), axis=1)
        bad = np.flatnonzero(~(np.abs(length - 1) < 1e-6))
        if len(bad):
            error = ValueError(
                f"{len(bad)} of {len(points)} normals do not have the length 1, first "
                f"{length[bad[0]]} at {points.x[bad[0]]}: divide them by their lengths"
            )
    raise_together(points.mesh.comm, error)
    if "normal" not in points:
        points.add_field("normal", shape[1:])
    points["normal"][:] = given


def follower_pressure(z: Unknown, points: MaterialPoints, pressure: Any) -> ufl.Form:
    """Return the load p (cof(f) n, w) of a pressure that follows the surface.

    A positive pressure pushes on the body. In a step, the surface rotates and stretches by Nanson's
    formula, n da = cof(f) n_0 dA. The tangent of the load is not symmetric. Time loops update the
    normals at the end of a step.

    Args:
        z: Unknown with the displacement increment u [m], or in explicit steps with the velocity v
            [m/s].
        points: Boundary points with initial areas as weights [m^(d-1)] and the field "normal"; see
            ``set_normals``.
        pressure: Force per current area [Pa], a number or UFL scalar.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: If there are no points on any rank, normals are missing, zero or not finite, or
            the pressure is not a scalar.
    """
    u, w = motion_of(z, "a pressure that follows")
    require_points(points, "a load")
    pressure = ufl.as_ufl(pressure)
    if pressure.ufl_shape != ():
        raise ValueError(f"a pressure must be a scalar, but has the shape {pressure.ufl_shape}")
    return pressure * ufl.inner(_moved_area(u, points), w) * points.dx


def penalty_dirichlet(
    z: Unknown,
    points: MaterialPoints,
    material: NeoHookean | Hencky | float,
    value: Any = None,
    *,
    factor: float = 30.0,
) -> ufl.Form:
    """Return a penalty for prescribed displacements of boundary points anywhere in the mesh.

    The form is factor E / h (u_n + u - g, w), with the current displacement u_n of the points and
    the prescribed displacement g (B. Chandra et al., Acta Geotechnica 16, 2021: [70] of VMS). Under
    a traction t the points give way by t h / (factor E), so the error is of first order in h.

    Args:
        z: Unknown with the displacement increment u [m], or in explicit steps with the velocity v
            [m/s].
        points: Boundary points with initial areas as weights [m^(d-1)]. Their field "u" [m] is u_n.
            If it is missing, it is added with the value zero.
        material: Law of the body with the attribute E, or a modulus E [Pa].
        value: Prescribed displacement g from the initial position [m], d components or a UFL
            vector, at the end of the motion u (second argument of ``data`` of ``ImplicitMPM``).
            None for zero.
        factor: Penalty factor [-]. With values of 10 to 100, a cantilever has the deflection of a
            fitted mesh. Larger values make cut cells too stiff, since linear functions cannot bend
            and satisfy the condition at all points.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: If there are no points on any rank, the modulus or factor is not positive and
            finite, or the displacement has a wrong shape.
    """
    u, w = motion_of(z, "a Dirichlet condition")
    require_points(points, "a Dirichlet condition")
    stiffness = factor * modulus_of(material, factor) / element_size(points)
    return stiffness * ufl.inner(_gap(u, points, value), w) * points.dx


def nitsche_dirichlet(
    z: Unknown,
    points: MaterialPoints,
    law: NeoHookean,
    value: Any = None,
    *,
    factor: float = 10.0,
    symmetric: bool = True,
    slip: bool = False,
) -> ufl.Form:
    """Return Nitsche's terms for prescribed displacements of boundary points (mixed formulation).

    The form is -(t, w) - (D t[V], u_n + u - g) + 2 factor mu / h (u_n + u - g, w) per initial area.
    Here t = sigma cof(f) n is the traction of the body itself, and D t[V] its derivative in the
    direction of the test functions. The method is consistent: the exact solution satisfies it for
    any factor. The factor must be large enough for stability only (J. Nitsche, 1971; P. Hansbo,
    GAMM-Mitt. 28, 2005).

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Boundary points with initial areas as weights [m^(d-1)] and the field "normal"; see
            ``set_normals``. Their fields "u" [m] (u_n) and "F" (deformation gradient) are added if
            missing. Time loops update them.
        law: Law of the body.
        value: Prescribed displacement g from the initial position [m]; see ``penalty_dirichlet``.
        factor: Penalty factor [-].
        symmetric: False for the opposite sign of the second term, which is stable with any factor.
        slip: Whether only displacements along the normals are prescribed.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: If there are no points on any rank, normals are missing, zero or not finite, the
            factor is not positive and finite, or the displacement has a wrong shape.
    """
    z.require("u", "p", of="Nitsche's method")
    require_points(points, "a Dirichlet condition")
    modulus_of(law, factor)
    area = _moved_area(z.u, points)
    if "F" not in points:
        points.add_field("F", (3, 3), np.eye(3))
        points.field("F").renew(lambda k: k.F)
    dim = points.mesh.geometry.dim
    sigma = law.deviatoric_stress(Kinematics(z.u, points).F)
    in_plane = ufl.as_tensor([[sigma[i, j] for j in range(dim)] for i in range(dim)])
    traction = ufl.dot(in_plane, area) + z.p * area
    gap, w = _gap(z.u, points, value), z.test.u
    if slip:
        normal = area / ufl.sqrt(ufl.inner(area, area))
        traction, gap, w = (ufl.inner(v, normal) for v in (traction, gap, w))
    stiffness = 2 * factor * law.mu / element_size(points)
    consistency = ufl.inner(ufl.derivative(traction, z.U, z.V), gap)
    R = stiffness * ufl.inner(gap, w) - ufl.inner(traction, w)
    return (R - consistency if symmetric else R + consistency) * points.dx


def modulus_of(material: Any, factor: float) -> float:
    """Return the Young's modulus [Pa] of a law, or a given modulus.

    Args:
        material: Law with the attribute E, or a modulus [Pa].
        factor: Penalty factor [-].

    Raises:
        ValueError: If modulus or factor is not positive and finite.
    """
    modulus = number(getattr(material, "E", material), "E", "the modulus", "Pa")
    factor = number(factor, "factor", "the factor of the penalty", "-")
    for what, value in (("modulus", modulus), ("factor of the penalty", factor)):
        if not 0 < value < np.inf:
            raise ValueError(f"the {what} must be positive and finite: {value}")
    return modulus


def motion_of(z: Unknown, what: str) -> tuple[Any, Any]:
    """Return the displacement [m] until forces are evaluated, and its test function.

    In explicit steps, forces are evaluated at the start, so the displacement is zero.

    Args:
        z: Unknown with a displacement u, or in explicit steps with a velocity v.
        what: Name of the feature that needs one of them, for the message.

    Raises:
        ValueError: If the unknown has neither.
    """
    if "v" in z and z.moving is None:
        return ufl.zero(z.mesh.geometry.dim), z.test.v
    z.require("u", of=what)
    return z.u, z.test.u


def _gap(u: Any, points: MaterialPoints, value: Any) -> Any:
    """Return the displacement after a motion u minus a prescribed one [m]."""
    if "u" not in points:
        points.add_field("u", (points.mesh.geometry.dim,))
    gap = points.field("u") + u
    return gap if value is None else gap - _vector(value, points, "a displacement")


def carried_normal(points: MaterialPoints) -> PointField:
    """Return the field "normal" of boundary points, which loops update by Nanson's formula.

    Args:
        points: Boundary points; see ``set_normals``.

    Raises:
        ValueError: For the reasons of ``require_normals``.
    """
    require_normals(points)
    normal = points.field("normal")
    return normal.renew(lambda k: ufl.dot(k.cofactor(), normal))


def require_normals(points: MaterialPoints) -> None:
    """Raise ValueError on all ranks unless all points have normals. Collective.

    Args:
        points: Boundary points; see ``set_normals``.

    Raises:
        ValueError: If there is no field "normal", or a normal is zero or not finite.
    """
    if "normal" not in points:
        raise ValueError("boundary points without normals: call set_normals(points, normals) first")
    length = np.linalg.norm(points["normal"], axis=1)
    bad = np.flatnonzero(~((length > 0) & np.isfinite(length)))
    error = None
    if len(bad):
        error = ValueError(
            f"{len(bad)} of {len(points)} normals are zero or not finite, first at "
            f"{points.x[bad[0]]}: give outer unit normals by set_normals(points, normals)"
        )
    raise_together(points.mesh.comm, error)


def _moved_area(u: Any, points: MaterialPoints) -> Any:
    """Return the normal after a motion u times the ratio of areas [-], by Nanson's formula."""
    return ufl.dot(Kinematics(u, points).cofactor(), carried_normal(points))


def require_points(points: MaterialPoints, what: str) -> None:
    """Raise ValueError if there are no points on any rank.

    Args:
        points: Boundary points.
        what: Name of the feature that needs them, for the message.

    Raises:
        ValueError: If the set is empty.
    """
    if points.size_global == 0:
        raise ValueError(f"{what} on no points: check where these boundary points were seeded")


def _vector(value: Any, points: MaterialPoints, what: str) -> Any:
    """Return a UFL vector with as many components as the mesh has dimensions."""
    vector = ufl.as_vector(list(value)) if isinstance(value, Sequence | np.ndarray) else value
    vector, dim = ufl.as_ufl(vector), points.mesh.geometry.dim
    if vector.ufl_shape != (dim,):
        raise ValueError(f"{what} needs {dim} components, but has the shape {vector.ufl_shape}")
    return vector
