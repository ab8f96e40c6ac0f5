# SPDX-License-Identifier: MIT
"""Loads and constraints on boundary points, which move through the grid with the body.

Boundary points have the areas (lengths in 2D) of the undeformed boundary as weights, and are
given to the time loop as ``carried`` points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.of_position import OfPosition, vectors_at
from fenicsmpm.points.point_field import PointField


def dead_load(w: Any, points: MaterialPoints, traction: Any) -> ufl.Form:
    """Traction per initial area that keeps its direction, -(t, w).

    Args:
        w: test function of displacement or velocity.
        points: boundary points with initial areas [m^(d-1)].
        traction: force per initial area t [Pa], d components or a UFL vector.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, or a traction of another shape.
    """
    require_points(points, "a load")
    return -ufl.inner(_vector(traction, points, "a traction"), w) * points.dx


def set_normals(
    points: MaterialPoints,
    normals: npt.ArrayLike | OfPosition,
) -> None:
    """Set the field "normal" of boundary points, which ``follower_pressure`` needs (collective).

    It is the outer unit normal times the ratio of present to initial area [-]. The points of
    ``points.on_facets`` and ``points.on_curve`` have normals from the beginning.

    Args:
        points: boundary points at the beginning, when that ratio is 1.
        normals: outer unit normals, ``(d,)`` or ``(n_points, d)`` in storage order; or a function
            as in dolfinx, of positions ``(3, n)`` [m] to normals ``(d, n)``.

    Raises:
        ValueError: for other shapes or lengths other than 1; also what the function raises on any
            rank.
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
            f"normals need the shape {shape} or {shape[1:]}, not {given.shape}: one row a point"
        )
    else:
        length = np.linalg.norm(np.broadcast_to(given, shape), axis=1)
        bad = np.flatnonzero(~(np.abs(length - 1) < 1e-6))
        if len(bad):
            error = ValueError(
                f"{len(bad)} of {len(points)} normals have not the length 1, first {length[bad[0]]}"
                f" at {points.x[bad[0]]}: divide them by their lengths"
            )
    raise_together(points.mesh.comm, error)
    if "normal" not in points:
        points.add_field("normal", shape[1:])
    points["normal"][:] = given


def follower_pressure(z: Unknown, points: MaterialPoints, pressure: Any) -> ufl.Form:
    """Pressure on the surface as it moves, p (cof(f) n, w); a positive one pushes on the body.

    The surface turns and stretches in the step by Nanson's formula, n da = cof(f) n_0 dA. Its
    tangent is not symmetric. Time loops renew the normals at the end of a step.

    Args:
        z: unknown with the increment of displacement u [m]; of explicit steps, the velocity v.
        points: boundary points with initial areas [m^(d-1)] and the field "normal"; see
            ``set_normals``.
        pressure: force per present area [Pa], a number or UFL scalar.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, points without normals, or a pressure with components.
    """
    u, w = motion_of(z, "a pressure that follows")
    require_points(points, "a load")
    pressure = ufl.as_ufl(pressure)
    if pressure.ufl_shape != ():
        raise ValueError(f"a pressure is a scalar, but has the shape {pressure.ufl_shape}")
    return pressure * ufl.inner(_moved_area(u, points), w) * points.dx


def penalty_dirichlet(
    z: Unknown,
    points: MaterialPoints,
    material: NeoHookean | Hencky | float,
    value: Any = None,
    *,
    factor: float = 30.0,
) -> ufl.Form:
    """Prescribed displacement of boundary points anywhere in the mesh, by a penalty.

    factor E / h (u_n + u - g, w), with the points' displacement so far u_n and the prescribed one g
    (B. Chandra et al., Acta Geotechnica 16, 2021: [70] of VMS). Under a traction t the points give
    way by t h / (factor E): the error is of first order in h.

    Args:
        z: unknown with the increment of displacement u [m]; of explicit steps, the velocity v.
        points: boundary points with initial areas [m^(d-1)]; their field "u" [m] is u_n, and is
            added as zero if there is none.
        material: law of the body with E, or a modulus E [Pa].
        value: prescribed displacement g from the initial position [m], d components or a UFL vector
            at the end of the motion u (second argument of ``ImplicitMPM``'s ``data``); None for
            zero.
        factor: of the penalty [-]: 10 to 100 give a cantilever the deflection of a fitted mesh,
            more makes cut cells too stiff, as linear functions cannot bend and obey all points.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, a modulus or factor that is not positive and finite, or a
            displacement of another shape.
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
    """Prescribed displacement of boundary points by Nitsche's method, for the mixed formulation.

    -(t, w) - (D t[V], u_n + u - g) + 2 factor mu / h (u_n + u - g, w) per initial area, with the
    traction t = sigma cof(f) n of the body itself and its derivative D t[V] in direction of the
    test functions. It is consistent: the exact solution fulfils it whatever the factor, which needs
    to be large enough for stability only (J. Nitsche, 1971; P. Hansbo, GAMM-Mitt. 28, 2005).

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: boundary points with initial areas [m^(d-1)] and the field "normal", see
            ``set_normals``; "u" [m] is u_n, "F" the deformation gradient, and both are added where
            they are missing. Time loops renew them.
        law: of the body.
        value: prescribed displacement g from the initial position [m], see ``penalty_dirichlet``.
        factor: of the penalty [-].
        symmetric: False for the other sign of the second term, which is stable with any factor.
        slip: whether only displacements along the normals are prescribed.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, points without normals, a factor that is not positive and
            finite, or a displacement of another shape.
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
    """Young's modulus of a law, or a modulus itself [Pa]; ValueError if the penalty has no sense.

    Args:
        material: law with E, or a modulus [Pa].
        factor: of the penalty [-].
    """
    modulus = getattr(material, "E", material)
    for what, number in (("modulus", modulus), ("factor of the penalty", factor)):
        if not 0 < number < np.inf:
            raise ValueError(f"the {what} must be positive and finite: {number}")
    return float(modulus)


def motion_of(z: Unknown, what: str) -> tuple[Any, Any]:
    """Displacement in the step until forces are taken [m], zero in explicit ones; test function.

    Args:
        z: unknown with a displacement u, or of explicit steps with a velocity v.
        what: needs one of them.
    """
    if "v" in z and z.moving is None:
        return ufl.zero(z.mesh.geometry.dim), z.test.v
    z.require("u", of=what)
    return z.u, z.test.u


def _gap(u: Any, points: MaterialPoints, value: Any) -> Any:
    """Displacement after a motion u less a prescribed one [m]."""
    if "u" not in points:
        points.add_field("u", (points.mesh.geometry.dim,))
    gap = points.field("u") + u
    return gap if value is None else gap - _vector(value, points, "a displacement")


def carried_normal(points: MaterialPoints) -> PointField:
    """Field "normal" of boundary points, see ``set_normals``; loops renew it by Nanson's formula.

    Args:
        points: boundary points.

    Raises:
        ValueError: for points without normals.
    """
    if "normal" not in points:
        raise ValueError("boundary points without normals: call set_normals(points, normals) first")
    normal = points.field("normal")
    return normal.renew(lambda k: ufl.dot(k.cofactor(), normal))


def _moved_area(u: Any, points: MaterialPoints) -> Any:
    """Outer normal after a motion u times the ratio of areas, by Nanson's formula [-]."""
    return ufl.dot(Kinematics(u, points).cofactor(), carried_normal(points))


def require_points(points: MaterialPoints, what: str) -> None:
    """Raise ValueError for sets without points on any rank.

    Args:
        points: boundary points.
        what: needs them.
    """
    if points.size_global == 0:
        raise ValueError(f"{what} on no points: check where these boundary points were seeded")


def _vector(value: Any, points: MaterialPoints, what: str) -> Any:
    """UFL vector with as many components as the mesh has dimensions."""
    vector = ufl.as_vector(list(value)) if isinstance(value, Sequence | np.ndarray) else value
    vector, dim = ufl.as_ufl(vector), points.mesh.geometry.dim
    if vector.ufl_shape != (dim,):
        raise ValueError(f"{what} needs {dim} components, but has the shape {vector.ufl_shape}")
    return vector
