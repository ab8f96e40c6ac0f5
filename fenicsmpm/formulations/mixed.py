# SPDX-License-Identifier: MIT
"""Mixed displacement-pressure formulation (VMS, section 2.4) and its function spaces."""

from __future__ import annotations

from typing import Any, Protocol

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm.basis import is_linear
from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.points import MaterialPoints


class MixedLaw(Protocol):
    """What the mixed formulation and its stabilizations need of a material.

    Attributes:
        inverse_kappa: inverse of the bulk modulus [1/Pa], zero for incompressible materials.
    """

    inverse_kappa: float

    def deviatoric_power(self, k: Kinematics, U: Any, V: Any) -> Any:
        """Virtual work of the deviatoric stress per volume before the step [J/m^3]."""

    def volumetric_residual(self, p: Any, k: Kinematics) -> Any:
        """What is to be zero, per volume before the step [-]."""

    def modulus(self, h_squared: Any) -> Any:
        """Shear modulus [Pa] that stands for the resistance of a cell, by its h^2 [m^2]."""

    def subscale_modulus(self, points: MaterialPoints, h_squared: Any) -> Any:
        """Modulus [Pa] by which subscales resist their volumetric residual: tau_2 / 2."""


def mixed_space(mesh: Any, projections: bool = False, degree: int = 1) -> fem.FunctionSpace:
    """Space of displacement and pressure, of equal order.

    Args:
        mesh: background mesh.
        projections: append spaces for the projections of both residuals, which OSGS needs.
        degree: polynomial degree.

    Returns:
        Space of ``(u, p)`` or ``(u, p, Pi_u, Pi_p)``.
    """
    cell = mesh.basix_cell()
    vector = basix.ufl.element("Lagrange", cell, degree, shape=(mesh.geometry.dim,))
    scalar = basix.ufl.element("Lagrange", cell, degree)
    elements = [vector, scalar] * (2 if projections else 1)
    return fem.functionspace(mesh, basix.ufl.mixed_element(elements))


def mixed(
    U: fem.Function,
    V: Any,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
) -> ufl.Form:
    """Galerkin residual of the mixed formulation, equations 1 and 2 of VMS in weak form.

    (sigma_dev, grad w) + (p, div w) - (rho b, w) per current volume, and the law's volumetric
    residual, of a solid U'(J)/kappa - p/kappa, times q per volume before the step.

    Args:
        U: increment of displacement [m] and pressure [Pa] (mean stress, tension positive), first
            two parts of a mixed space.
        V: test function of the same space.
        points: material points with weights V_n [m^d].
        law: ``NeoHookean``, ``NewtonianFlow``, or another ``MixedLaw``.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.

    Returns:
        UFL form of rank 1.
    """
    u, p = parts(U, 2)[:2]
    w, q = parts(V, 2)[:2]
    k = Kinematics(u, points)
    # D j[w] = j div w, and the variation of the energy is the stress power j sigma_dev : grad w;
    # written like this, tangents need no inverse of f and cost a fraction
    power = law.deviatoric_power(k, U, V) + p * ufl.derivative(k.j, U, V)
    constraint = law.volumetric_residual(p, k) * q
    residual = (power + constraint) * points.dx
    if force is not None:
        residual -= ufl.inner(force, w) * points.dx
    return residual


def parts(U: Any, least: int = 1) -> Any:
    """Split a function or argument into the parts of a formulation's unknown.

    Args:
        U: of a space of displacements, or from ``mixed_space``.
        least: how many parts are needed.

    Returns:
        ``(u,)``, ``(u, p)`` or ``(u, p, Pi_u, Pi_p)``.

    Raises:
        ValueError: for other spaces, or with fewer parts than needed.
    """
    is_blocked = U.ufl_function_space().ufl_element().block_size > 1
    split = (U,) if is_blocked else ufl.split(U)
    shapes = [part.ufl_shape for part in split]
    if len(split) < least or [len(s) for s in shapes] not in ([1], [1, 0], [1, 0, 1, 0]):
        raise ValueError(
            f"a {'mixed ' if least > 1 else ''}space of displacement"
            f"{' and pressure' if least > 1 else ''} is needed, but {U} has parts of shapes "
            f"{shapes}: use mixed_space(mesh)"
        )
    return split


def subspaces(V: fem.FunctionSpace) -> list[tuple[fem.FunctionSpace, npt.NDArray[np.int32]]]:
    """Spaces of the parts of an unknown, and where their dofs are in V (collective).

    Args:
        V: space of displacements, or from ``mixed_space``.
    """
    if V.dofmap.index_map_bs > 1:
        index_map = V.dofmap.index_map
        size = (index_map.size_local + index_map.num_ghosts) * V.dofmap.index_map_bs
        return [(V, np.arange(size, dtype=np.int32))]
    return [V.sub(i).collapse() for i in range(V.num_sub_spaces)]


def require_linear(U: fem.Function, what: str) -> None:
    """Raise ValueError for an unknown of functions that have nodes beside the vertices.

    Args:
        U: unknown.
        what: needs linear functions.
    """
    V = U.function_space
    is_mixed = V.num_sub_spaces > 0 and V.dofmap.index_map_bs == 1
    spaces = [V.sub(i) for i in range(V.num_sub_spaces)] if is_mixed else [V]
    if not all(is_linear(space.ufl_element()) for space in spaces):
        raise ValueError(
            f"{what} is for continuous linear functions, whose nodes are the vertices, not for "
            f"{V.ufl_element()}"
        )
