# SPDX-License-Identifier: MIT
"""Rigid walls anywhere in the mesh, which boundary points can touch, slide along and leave."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

from fenicsmpm.formulations.boundary import modulus_of, motion_of, require_points
from fenicsmpm.formulations.friction import checked_friction, elastic_slip
from fenicsmpm.formulations.rigid_gap import RigidGap
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import MaterialPoints
from fenicsmpm.rigid import RigidBody


def wall(
    z: Unknown,
    points: MaterialPoints,
    material: NeoHookean | Hencky | float,
    distance: Callable[[Any], Any] | RigidBody,
    *,
    factor: float = 30.0,
    friction: float | None = None,
    two_sided: bool = False,
) -> ufl.Form:
    """Return contact forces of a rigid wall on boundary points, with a penalty on penetration.

    Let d be the signed distance of a point at the end of the motion u, and n its gradient. The
    pressure of the wall is p_n = k <-d> along n, with k = factor E / h. Coulomb friction is elastic
    up to its limit, so that points can stick: a point drags a spring of stiffness k along the wall,
    whose force ``k |s|`` is at most ``friction`` times p_n (P. Wriggers, Computational Contact
    Mechanics, 2006, section 5.2). Points that stick give way by at most ``friction`` p_n / k.

    In explicit steps, the forces are those at the start of a step. Waves between a point and the
    wall limit the step to about h / (c sqrt(factor)), with the wave speed c of the body.

    Args:
        z: Unknown with the displacement increment u [m], or in explicit steps with the velocity v
            [m/s].
        points: Boundary points with initial areas as weights [m^(d-1)]. With friction, a field
            "slip" [m] is added, the elastic part s of the displacement along the wall. Time loops
            update it for schemes whose equations hold at the end or at the start of a step.
        material: Law of the body with the attribute E, or a modulus E [Pa].
        distance: Function from the position of a point, a UFL vector [m], to its distance from the
            wall, a UFL scalar [m], positive outside. A ``fem.Constant`` in it moves the wall.
            Alternatively a rigid body, fixed or with prescribed motion. ``ImplicitMPM`` moves it,
            and sticking points follow it. Its reach and stiffness are not used. Pass rigid bodies
            directly to explicit loops.
        factor: Penalty factor [-].
        friction: Coefficient of Coulomb friction [-]. None for that of the rigid body, or 0 for a
            distance function.
        two_sided: Whether the wall holds points from both sides, so that they slide along it.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: If there are no points on any rank, the modulus or factor is not positive and
            finite, the friction is negative or not finite, the distance is not a scalar, or a rigid
            body is free or used in explicit steps. Also for friction at a two-sided wall, whose
            pressure has no sign.
    """
    u, w = motion_of(z, "a wall")
    require_points(points, "a wall")
    stiffness = factor * modulus_of(material, factor) / element_size(points)
    gap: Callable[[Any], Callable[[Any], Any]]
    if isinstance(distance, RigidBody):
        rigid = distance
        _require_prescribed(z, rigid)
        friction = rigid.friction if friction is None else friction

        def gap(u: Any) -> RigidGap:
            return RigidGap(points, u, rigid)
    else:

        def gap(u: Any) -> Callable[[Any], Any]:
            return distance

    friction = checked_friction(0.0 if friction is None else friction)
    if friction > 0 and two_sided:
        raise ValueError(
            "friction needs a pressure, but a two-sided wall also pulls: give two_sided=False or "
            "no friction"
        )
    now = gap(u)
    depth, normal = _depth(points, u, now, two_sided)
    give_way = depth * normal
    if friction > 0:
        if "slip" not in points:
            points.add_field("slip", (points.mesh.geometry.dim,))

        def slip(u: Any, d: Any) -> Any:
            way = u - d.way if isinstance(d, RigidGap) else u
            depth, normal = _depth(points, u, d, two_sided)
            return elastic_slip(points.field("slip"), way, normal, friction * depth)

        points.field("slip").renew(lambda k: slip(k.u, gap(k.u)))
        give_way -= slip(u, now)
    return -stiffness * ufl.inner(give_way, w) * points.dx


def _require_prescribed(z: Unknown, rigid: RigidBody) -> None:
    """Raise ValueError if a form cannot move a rigid body."""
    if z.moving is None:
        raise ValueError(
            f"explicit steps do not support the rigid body {rigid.name} in forms: pass it to "
            "ExplicitMPM(.., rigid=[..])"
        )
    if rigid.is_free:
        raise ValueError(
            f"the rigid body {rigid.name} is free: implicit steps support fixed bodies and "
            "prescribed motions only. Use explicit steps, or leave out the inertia"
        )


def _depth(
    points: MaterialPoints, u: Any, distance: Callable[[Any], Any], two_sided: bool
) -> tuple[Any, Any]:
    """Return the penetration of points after a motion u [m], and the normal of the wall there."""
    place = ufl.variable(ufl.SpatialCoordinate(points.mesh) + u)
    d = ufl.as_ufl(distance(place))
    if d.ufl_shape != ():
        raise ValueError(f"a distance must be a scalar, but has the shape {d.ufl_shape}")
    return -d if two_sided else ufl.conditional(d < 0, -d, 0.0), ufl.diff(d, place)
