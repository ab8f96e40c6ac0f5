# SPDX-License-Identifier: MIT
"""Incompressible Newtonian flow with displacement and pressure as unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsmpm._numbers import number, positive
from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.point_field import PointField


class NewtonianFlow:
    """Incompressible Newtonian fluid sigma = 2 mu sym(grad v) + p I, for ``mixed`` (CMN).

    The unknown of a step is the displacement increment, as for solids. The time scheme gives the
    velocity. The pressure enforces det f = 1 in each step, weakly with the pressure functions.

    Points keep their volumes. They do not follow det F, which is not 1 at each single point.
    Otherwise, cells whose points have shrunk would resist the surrounding pressure less and shrink
    further, and water at rest would break up at the rate sqrt(p / rho) / h. For the same reason,
    det F = 1 since the start is not enforced.

    The stabilization follows R. Codina, CMAME 191, 2002, written in displacements. The subscales of
    displacement have viscosity and inertia, 1 / tau_1 = rho r_a + 2 mu r_v / h^2. Here r_v u is the
    change of velocity and r_a u the change of acceleration in a step. The subscales of pressure
    have tau_2 = (2 mu + rho c h) r_v with ``c^2 = v^2 + |p| / rho``, the rate at which the points
    become disordered.

    Args:
        mu: Dynamic viscosity [Pa s], positive.
        density: Density [kg/m^d], positive.
        scheme: Time scheme of the unknown.
        correction: Share of the accumulated volume error that one step corrects [-], whatever its
            length. A fluid alone needs no correction. Next to a solid, it compensates the volume
            errors of the solid.

    Attributes:
        inverse_kappa: Inverse of the bulk modulus [1/Pa], zero.

    Raises:
        ValueError: If a parameter is out of range.
    """

    inverse_kappa = 0.0

    def __init__(
        self, mu: float, density: float, scheme: TimeScheme, correction: float = 0.0
    ) -> None:
        """Check and store the parameters."""
        self.mu = positive(mu, "mu", "viscosity", "Pa s")
        self.density = positive(density, "density", "density", "kg/m^d")
        self.correction = number(correction, "correction", "correction of volume", "-")
        if not 0 <= self.correction <= 1:
            raise ValueError(f"the correction of volume must lie in [0, 1]: {correction}")
        self.scheme = scheme

    def deviatoric_power(self, k: Kinematics, U: Any, V: Any) -> Any:
        """Return the virtual work of the viscous stress per volume V_n [J/m^3], UFL.

        Args:
            k: Kinematics of the step.
            U: Function of the whole unknown.
            V: Its variation.

        Raises:
            ValueError: If the unknown is not that of the time scheme.
        """
        if U is not self.scheme.unknown.U:
            raise ValueError(
                "the time scheme of the fluid belongs to another unknown: create the scheme and "
                "the formulation with the same Unknown"
            )
        rate = ufl.sym(k.grad(self.scheme.velocity()))
        w = ufl.derivative(self.scheme.u, U, V)
        return 2 * self.mu * k.j * ufl.inner(rate, k.grad(w))

    def volumetric_residual(self, p: Any, k: Kinematics) -> Any:
        """Return the volume change of the whole step plus a share of earlier errors [-], UFL.

        Args:
            p: Pressure [Pa], which an incompressible fluid does not need here.
            k: Kinematics of the step.

        Raises:
            ValueError: On all ranks, if the density of a point differs from that of the fluid.
        """
        change = Kinematics(self.scheme.increment, k.points).j - 1
        correction = fem.Constant(k.points.mesh, float(self.correction))
        return change + correction * self._dilation(k.points)

    def modulus(self, h_squared: Any) -> Any:
        """Return the shear modulus [Pa] equivalent to viscosity and inertia in cells of size h.

        Args:
            h_squared: Square of the cell size [m^2].
        """
        velocity, acceleration = self.scheme.rates
        return self.mu * velocity + self.density * acceleration * h_squared / 2

    def subscale_modulus(self, points: MaterialPoints, h_squared: Any) -> Any:
        """Return the shear modulus [Pa] equivalent to viscosity, motion and pressure in a cell.

        Args:
            points: The fluid, with the field "v". A missing field "p" is added.
            h_squared: Square of the cell size [m^2].
        """
        if "p" not in points:
            points.add_field("p")
        v, p = points.field("v"), points.field("p")
        squared = ufl.inner(v, v) + abs(p) / self.density
        return (self.mu + self.density * ufl.sqrt(squared * h_squared) / 2) * self.scheme.rates[0]

    def _dilation(self, points: MaterialPoints) -> PointField:
        """Return the sum of det f - 1 so far; its renewal keeps the point volumes. Collective."""
        found = points["mass"] / points["V_0"]
        wrong = found[~(np.abs(found / self.density - 1) < _SAME)]
        error = (
            ValueError(
                f"a point has the density {wrong[0]:g} kg/m^d, but the fluid has "
                f"{self.density:g} kg/m^d: give set_initial_state the density of the fluid"
            )
            if len(wrong)
            else None
        )
        raise_together(points.mesh.comm, error)
        if "dilation" not in points:
            points.add_field("dilation")
        field = points.field("dilation")
        j = Kinematics(self.scheme.increment, points).j
        # The volumes are kept, but a point that a step turns inside out must still be detected.
        J = ufl.conditional(j > 0, points.field("J"), j)
        field.renewals = {"F": points.field("F"), "J": J, "dilation": field + j - 1}
        return field

    def __repr__(self) -> str:
        """Parameters with units."""
        return (
            f"NewtonianFlow(mu={self.mu:g} Pa s, density={self.density:g} kg/m^d, "
            f"correction={self.correction:g})"
        )


_SAME = 1e-6  # relative difference of densities that are meant to be the same
