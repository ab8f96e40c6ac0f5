# SPDX-License-Identifier: MIT
"""Mixed displacement-pressure formulation (VMS, section 2.4)."""

from __future__ import annotations

from typing import Any, Protocol

import ufl

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.unknown import Unknown
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


def mixed(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
) -> ufl.Form:
    """Galerkin residual of the mixed formulation, equations 1 and 2 of VMS in weak form.

    (sigma_dev, grad w) + (p, div w) - (rho b, w) per current volume, and the law's volumetric
    residual, of a solid U'(J)/kappa - p/kappa, times q per volume before the step.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa] (mean stress,
            tension positive).
        points: material points with weights V_n [m^d].
        law: ``NeoHookean``, ``NewtonianFlow``, or another ``MixedLaw``.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.

    Returns:
        UFL form of rank 1.
    """
    z.require("u", "p", of="the mixed formulation")
    k = Kinematics(z.u, points)
    # D j[w] = j div w, and the variation of the energy is the stress power j sigma_dev : grad w;
    # written like this, tangents need no inverse of f and cost a fraction
    power = law.deviatoric_power(k, z.U, z.V) + z.p * ufl.derivative(k.j, z.U, z.V)
    constraint = law.volumetric_residual(z.p, k) * z.test.p
    residual = (power + constraint) * points.dx
    if force is not None:
        residual -= ufl.inner(force, z.test.u) * points.dx
    return residual
