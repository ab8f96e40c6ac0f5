# SPDX-License-Identifier: MIT
"""Checks of the input of explicit simulations."""

from __future__ import annotations

from collections.abc import Sequence

from dolfinx import fem

from fenicsmpm.basis import functions_of, is_linear
from fenicsmpm.points import MaterialPoints
from fenicsmpm.rigid import RigidBody
from fenicsmpm.solvers.checks import require_points

_NEEDED = ("mass", "V_0", "F", "J", "u", "v")


def check_space(V: fem.FunctionSpace) -> None:
    """Raise ValueError unless a space is one of velocities with a lumped mass.

    Args:
        V: The space.
    """
    element, dim = V.ufl_element(), V.mesh.geometry.dim
    if not is_linear(element) or V.dofmap.index_map_bs != dim:
        raise ValueError(
            f"velocities need a linear Lagrange space with {dim} components, not {element}: "
            'fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))'
        )


def check_bodies(
    V: fem.FunctionSpace, bodies: Sequence[MaterialPoints], carried: Sequence[MaterialPoints]
) -> None:
    """Raise ValueError for point sets that do not fit together. Collective.

    Args:
        V: Space of velocities.
        bodies: Material points.
        carried: Further points that move along.
    """
    sets = [*bodies, *carried]
    if not bodies:
        raise ValueError("ExplicitMPM needs a body")
    if len({id(points) for points in sets}) < len(sets):
        raise ValueError(
            "a point set is given twice, as a body or as carried points: select() its loaded "
            "points, which makes a separate set"
        )
    if any(points.mesh is not V.mesh for points in sets):
        raise ValueError(
            "bodies and carried points must be on the mesh of the velocity: bring them there with "
            "points.from_mesh"
        )
    require_points(bodies)
    for body in bodies:
        missing = [name for name in _NEEDED if name not in body]
        if missing:
            raise ValueError(
                f"a body without the fields {', '.join(missing)} cannot move: call "
                "formulations.set_initial_state(points, density) first"
            )


def check_functions(sets: Sequence[MaterialPoints]) -> None:
    """Raise ValueError unless all point sets see the same grid functions."""
    names = {functions_of(points) for points in sets}
    if len(names) > 1:
        raise ValueError(
            "bodies and carried points must see the same grid functions, not "
            f"{', '.join(sorted(names))}: call basis.use for all of them"
        )


def check_rigid(rigid: Sequence[RigidBody], dim: int) -> None:
    """Raise ValueError for rigid bodies of another dimension, or one that is given twice."""
    for body in rigid:
        if body.dim != dim:
            raise ValueError(
                f"the rigid body {body.name} has {body.dim} dimensions, but the mesh has {dim}"
            )
    if len({id(body) for body in rigid}) < len(rigid):
        raise ValueError("a rigid body is given twice: pass each one once")
