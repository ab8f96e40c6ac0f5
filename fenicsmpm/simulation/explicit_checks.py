# SPDX-License-Identifier: MIT
"""Checks of the input of explicit simulations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.classes import Identity, Indexed, Sum
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from fenicsmpm.basis import functions_of, is_linear
from fenicsmpm.formulations.kinematics import embed
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


def check_increments(
    R: ufl.Form, updates: Iterable[Mapping[str, Any]], velocity: fem.Function
) -> None:
    """Raise ValueError for a velocity that ``Kinematics`` takes for an increment of displacement.

    It is found by the sum of the identity and the gradient of the velocity, which have different
    units.

    Args:
        R: Residual.
        updates: New values of fields.
        velocity: Velocity of the nodes.
    """
    gradient = ufl.grad(velocity)
    wrong = {gradient, embed(gradient)}
    found = [integral.integrand() for integral in R.integrals()]
    found += [value for fields in updates for value in fields.values() if isinstance(value, Expr)]
    for node in (node for expression in found for node in unique_pre_traversal(expression)):
        if isinstance(node, Sum):
            # UFL may have moved the indices of a component into the sum
            a, b = (e.ufl_operands[0] if isinstance(e, Indexed) else e for e in node.ufl_operands)
            if (isinstance(a, Identity) and b in wrong) or (isinstance(b, Identity) and a in wrong):
                raise ValueError(
                    "I + grad v adds a rate to a number: Kinematics needs an increment of "
                    'displacement, not a velocity. Forces see the present body.field("F"), and '
                    "PointField.renew gives a function of new values the Kinematics of the step"
                )


def wrong_number(points: MaterialPoints) -> ValueError | None:
    """Return an error for a point of this rank that cannot move, or None.

    Args:
        points: Material points with masses, volumes and velocities.
    """
    for name in ("mass", "V_0", "v"):
        array = points[name]
        good = np.isfinite(array)
        if array.ndim == 1:
            good &= array > 0
        if not good.all():
            i = int(np.argmin(good.reshape(len(array), -1).all(axis=1)))
            kind = "positive and finite" if array.ndim == 1 else "finite"
            return ValueError(
                f"the field {name!r} must be {kind}, but is {array[i]} at point {points.id[i]}"
            )
    return None
