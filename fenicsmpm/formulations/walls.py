# SPDX-License-Identifier: MIT
"""Rigid walls that boundary points touch, slide along and leave, anywhere in the mesh."""

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
    """Contact of boundary points with a rigid wall, by a penalty on how deep they are in it.

    With the signed distance d of a point at the end of the motion u and its gradient n, the wall
    presses with p_n = k <-d> along n, k = factor E / h. Coulomb's friction is elastic up to its
    limit, so that it sticks: the point drags a spring of stiffness k along the wall, whose force
    ``k |s|`` is at most ``friction`` times p_n (P. Wriggers, Computational Contact Mechanics, 2006,
    section 5.2). Points that stick give way by at most ``friction`` p_n / k.

    In explicit steps forces are those at the beginning of a step. Waves between a point and the
    wall limit it to some h / (c sqrt(factor)), with the speed c of waves in the body.

    Args:
        z: unknown with the increment of displacement u [m]; of explicit steps, the velocity v.
        points: boundary points with initial areas [m^(d-1)]; with friction they get a field "slip"
            [m], the elastic part s of their way along the wall. Time loops renew it, for schemes
            whose equations hold at the end or at the beginning of a step.
        material: law of the body with E, or a modulus E [Pa].
        distance: from the position of a point, a UFL vector [m], to its distance from the wall, a
            UFL scalar [m], positive outside. A ``fem.Constant`` in it moves the wall. Or a rigid
            body, fixed or with a prescribed motion; ``ImplicitMPM`` moves it, and points stick to
            what moves. Its reach and stiffness do not matter. Explicit steps take rigid bodies by
            themselves.
        factor: of the penalty [-].
        friction: Coulomb's coefficient [-]; None for that of the rigid body, or none.
        two_sided: whether the wall holds points on both sides: they slide along it.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, a modulus or factor that is not positive and finite, a
            coefficient of friction that is negative, friction at a two-sided wall, whose pressure
            has no sign, a distance that is no scalar, or a rigid body that is free, or in explicit
            steps.
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
        raise ValueError("friction needs a pressure: a wall that also pulls has none")
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
    """Raise ValueError for a rigid body that a form cannot move."""
    if z.moving is None:
        raise ValueError(
            f"explicit steps take the rigid body {rigid.name} by ExplicitMPM(.., rigid=[..])"
        )
    if rigid.is_free:
        raise ValueError(
            f"the rigid body {rigid.name} is free: implicit steps take fixed bodies and prescribed "
            "motions, explicit ones move free bodies"
        )


def _depth(
    points: MaterialPoints, u: Any, distance: Callable[[Any], Any], two_sided: bool
) -> tuple[Any, Any]:
    """How deep points are in the wall after a motion u [m], and its normal there."""
    place = ufl.variable(ufl.SpatialCoordinate(points.mesh) + u)
    d = ufl.as_ufl(distance(place))
    if d.ufl_shape != ():
        raise ValueError(f"a distance is a scalar, but has the shape {d.ufl_shape}")
    return -d if two_sided else ufl.conditional(d < 0, -d, 0.0), ufl.diff(d, place)
