# SPDX-License-Identifier: MIT
"""Rigid walls that boundary points touch, slide along and leave, anywhere in the mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl

from fenicsmpm.formulations.boundary import modulus_of, require_points
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import MaterialPoints


def wall(
    z: Unknown,
    points: MaterialPoints,
    material: NeoHookean | Hencky | float,
    distance: Callable[[Any], Any],
    *,
    factor: float = 30.0,
    friction: float = 0.0,
    two_sided: bool = False,
) -> ufl.Form:
    """Contact of boundary points with a rigid wall, by a penalty on how deep they are in it.

    With the signed distance d of a point at the end of the motion u and its gradient n, the wall
    presses with p_n = k <-d> along n, k = factor E / h. Coulomb's friction is elastic up to its
    limit, so that it sticks: the point drags a spring of stiffness k along the wall, whose force
    k |s| is at most ``friction`` times p_n (P. Wriggers, Computational Contact Mechanics, 2006,
    section 5.2). Points that stick give way by at most ``friction`` p_n / k.

    Args:
        z: unknown with the increment of displacement u [m].
        points: boundary points with initial areas [m^(d-1)]; with friction they get a field "slip"
            [m], the elastic part s of their way along the wall. Time loops renew it, for schemes
            whose equations hold at the end of a step.
        material: law of the body with E, or a modulus E [Pa].
        distance: from the position of a point, a UFL vector [m], to its distance from the wall, a
            UFL scalar [m], positive outside. A ``fem.Constant`` in it moves the wall.
        factor: of the penalty [-].
        friction: Coulomb's coefficient [-].
        two_sided: whether the wall holds points on both sides: they slide along it.

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: for no points at all, a modulus or factor that is not positive and finite, a
            coefficient of friction that is negative, friction at a two-sided wall, whose pressure
            has no sign, or a distance that is no scalar.
    """
    z.require("u", of="a wall")
    require_points(points, "a wall")
    stiffness = factor * modulus_of(material, factor) / element_size(points)
    if not 0 <= friction < np.inf:
        raise ValueError(f"a coefficient of friction is finite and not negative: {friction}")
    if friction > 0 and two_sided:
        raise ValueError("friction needs a pressure: a wall that also pulls has none")
    place = ufl.variable(ufl.SpatialCoordinate(points.mesh) + z.u)
    d = ufl.as_ufl(distance(place))
    if d.ufl_shape != ():
        raise ValueError(f"a distance is a scalar, but has the shape {d.ufl_shape}")
    normal = ufl.diff(d, place)
    pressure = -stiffness * d
    if not two_sided:
        pressure = ufl.conditional(d < 0, pressure, 0.0)
    traction = pressure * normal
    if friction > 0:
        traction -= stiffness * _slip(z, points, normal, friction * pressure / stiffness)
    return -ufl.inner(traction, z.test.u) * points.dx


def _slip(z: Unknown, points: MaterialPoints, normal: Any, limit: Any) -> Any:
    """Elastic part of the way along the wall at the end of the step, at most as long as a limit."""
    dim = points.mesh.geometry.dim
    if "slip" not in points:
        points.add_field("slip", (dim,))
    field = points.field("slip")
    trial = field + z.u
    trial -= ufl.dot(trial, normal) * normal
    length = ufl.sqrt(ufl.inner(trial, trial) + (_SMALL * element_size(points)) ** 2)
    slip = ufl.conditional(length < limit, 1.0, limit / length) * trial
    field.renew(slip)
    return slip


_SMALL = 1e-12  # of a cell: a length that is never zero has a derivative
