# SPDX-License-Identifier: MIT
"""Mixed displacement-pressure formulation (VMS, section 2.4)."""

from __future__ import annotations

from typing import Any, Protocol

import ufl

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class MixedLaw(Protocol):
    """Interface of materials for the mixed formulation and its stabilizations.

    Attributes:
        inverse_kappa: Inverse of the bulk modulus [1/Pa], zero for incompressible materials.
    """

    inverse_kappa: float

    def deviatoric_power(self, k: Kinematics, U: Any, V: Any) -> Any:
        """Return the virtual work of the deviatoric stress per volume V_n [J/m^3], UFL.

        Args:
            k: Kinematics of the step.
            U: Function of the whole unknown.
            V: Its variation.
        """

    def volumetric_residual(self, p: Any, k: Kinematics) -> Any:
        """Return the residual of the volumetric law, per volume V_n [-], UFL.

        Args:
            p: Pressure [Pa], positive in tension.
            k: Kinematics of the step.
        """

    def modulus(self, h_squared: Any) -> Any:
        """Return the shear modulus [Pa] that represents the resistance of a cell of size h.

        Args:
            h_squared: Square of the cell size [m^2].
        """

    def subscale_modulus(self, points: MaterialPoints, h_squared: Any) -> Any:
        """Return the modulus tau_2 / 2 [Pa] by which subscales resist their volumetric residual.

        Args:
            points: The material points.
            h_squared: Square of the cell size [m^2].
        """


def mixed(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
) -> ufl.Form:
    """Return the Galerkin residual of the mixed formulation (VMS, equations 1 and 2 in weak form).

    The residual is (sigma_dev, grad w) + (p, div w) - (rho b, w) per current volume, plus q times
    the volumetric residual of the law per volume V_n at the start of the step. For a solid this
    residual is U'(J)/kappa - p/kappa.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa] (mean stress,
            positive in tension).
        points: Material points with the volumes V_n as weights [m^d].
        law: ``NeoHookean``, ``NewtonianFlow``, or another ``MixedLaw``.
        force: Body force per volume at the start of the step, rho_n b ``(d,)`` [N/m^d]. None for
            none.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If the unknown has no part u or p.
    """
    z.require("u", "p", of="the mixed formulation")
    k = Kinematics(z.u, points)
    # D j[w] = j div w, and the variation of the energy is the stress power j sigma_dev : grad w.
    # In this form the tangent needs no inverse of f, which makes it much cheaper.
    power = law.deviatoric_power(k, z.U, z.V) + z.p * ufl.derivative(k.j, z.U, z.V)
    constraint = law.volumetric_residual(z.p, k) * z.test.p
    residual = (power + constraint) * points.dx
    if force is not None:
        residual -= ufl.inner(force, z.test.u) * points.dx
    return residual
