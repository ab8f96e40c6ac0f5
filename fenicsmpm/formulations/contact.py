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

# Fields with springs of friction, one for each surface that points rub on
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
    """Contact of two bodies that touch, slide along each other and part, -(t, w - w_other).

    The traction t is that of ``contact_traction``, and acts on both bodies at the points of the
    first one, so their momentum stays. One call is enough for two bodies. Its first body should be
    the one whose surface is smaller or more curved.

    Args:
        z: unknown of the first body, with the increment of displacement u [m].
        points: boundary points of this body, see ``SurfaceGap``.
        other: unknown of the second body, coupled to the first one by ``coupled_unknowns``.
        surface: boundary points of the second body with outer normals, see ``SurfaceGap``.
        material: law of the softer body with E, or a modulus E [Pa].
        factor: of the penalty [-].
        friction: Coulomb's coefficient [-].

    Returns:
        UFL form of rank 1, to be added to the residual.

    Raises:
        ValueError: as ``SurfaceGap`` and ``contact_traction``.
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
    """Traction on the first body per initial area, k (<-g> n - s), UFL ``(d,)`` [Pa].

    The penalty k = factor E / h presses where there is an overlap, and never pulls. With friction,
    points drag a spring s along the other surface, of the same stiffness: they stick up to
    ``friction`` times the pressure, and slip beyond, see ``wall``.

    Args:
        gap: between the bodies.
        material: see ``contact``.
        factor: of the penalty [-].
        friction: Coulomb's coefficient [-]. Then the points get a field "slip on surface i" [m],
            s, which time loops renew, for schemes whose equations hold at the end of a step.

    Raises:
        ValueError: for a modulus or factor that is not positive and finite, and a coefficient of
            friction that is negative or not finite.
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
