# SPDX-License-Identifier: MIT
"""Contact of deformable bodies in implicit steps, by a penalty at boundary points."""

from __future__ import annotations

import itertools
from typing import Any

import ufl

from fenicsmpm.formulations.boundary import modulus_of
from fenicsmpm.formulations.friction import checked_friction, elastic_slip
from fenicsmpm.formulations.stabilization_parameters import element_size
from fenicsmpm.formulations.surface_gap import SurfaceGap
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, NeoHookean
from fenicsmpm.points import MaterialPoints

# Prefix of the fields with friction springs, one for each surface that the points may touch
SLIP = "slip on surface"


def contact(
    z: Unknown,
    points: MaterialPoints,
    other: Unknown,
    surface: MaterialPoints,
    material: NeoHookean | Hencky | float,
    *,
    factor: float = 5.0,
    friction: float = 0.0,
) -> ufl.Form:
    """Return the contact forces -(t, w - w_other) of two bodies that touch, slide and separate.

    The traction t is that of ``contact_traction``. It acts on both bodies at the points of the
    first one, so the total momentum is conserved. Call the function once for two bodies. The first
    body should be the one with the smaller or more curved surface.

    Args:
        z: Unknown of the first body, with the displacement increment u [m].
        points: Boundary points of the first body; see ``SurfaceGap``.
        other: Unknown of the second body, coupled to the first one by ``coupled_unknowns``.
        surface: Boundary points of the second body with outer normals; see ``SurfaceGap``.
        material: Law of the softer body with the attribute E, or a modulus E [Pa].
        factor: Penalty factor [-].
        friction: Coefficient of Coulomb friction [-].

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: For the reasons of ``SurfaceGap`` and ``contact_traction``.
    """
    gap = SurfaceGap(z, points, other, surface)
    traction = contact_traction(gap, material, factor=factor, friction=friction)
    return -ufl.inner(traction, gap.test) * points.dx


def contact_traction(
    gap: SurfaceGap,
    material: NeoHookean | Hencky | float,
    *,
    factor: float = 5.0,
    friction: float = 0.0,
) -> Any:
    """Return the traction k (<-g> n - s) on the first body per initial area ``(d,)`` [Pa], UFL.

    The penalty k = factor E / h presses where the bodies overlap, and never pulls. With friction,
    points drag a spring s of the same stiffness along the other surface. They stick up to
    ``friction`` times the pressure, and slide beyond that; see ``wall``.

    Args:
        gap: Gap between the bodies.
        material: Law of the softer body with the attribute E, or a modulus E [Pa].
        factor: Penalty factor [-].
        friction: Coefficient of Coulomb friction [-]. If it is positive, a field "slip on surface
            i" [m] for s is added to the points. Time loops update it for schemes whose equations
            hold at the end of a step.

    Raises:
        ValueError: If the modulus or factor is not positive and finite, or the friction is negative
            or not finite.
    """
    points = gap.points
    stiffness = factor * modulus_of(material, factor) / element_size(points)
    depth = ufl.conditional(gap.gap < 0, -gap.gap, 0.0)
    give_way = depth * gap.normal
    if checked_friction(friction) > 0:
        names = (f"{SLIP} {i}" for i in itertools.count())
        name = next(name for name in names if name not in points)
        points.add_field(name, (points.mesh.geometry.dim,))
        spring = points.field(name)
        slip = elastic_slip(spring, gap.way, gap.normal, friction * depth)
        spring.renew(slip)
        give_way -= slip
    return stiffness * give_way
