# SPDX-License-Identifier: MIT
"""Flow of an incompressible Newtonian fluid in displacement and pressure."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.materials.law import number, positive
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.point_field import PointField


class NewtonianFlow:
    """Incompressible Newtonian fluid sigma = 2 mu sym(grad v) + p I, for ``mixed`` (CMN).

    The velocity is that of the time scheme, the unknown of a step its displacement, as for solids.
    The pressure keeps the volume of each whole step, det f = 1, in the weak sense of its functions,
    and points keep theirs. Were these to follow det F, which is not 1 at each of them, then cells
    whose points have shrunk would resist the pressure around them less and shrink further: water at
    rest would break up at the rate sqrt(p / rho) / h. For the same reason det F = 1 since the start
    is not asked for.

    Stabilization (after R. Codina, CMAME 191, 2002, in terms of displacements) has for subscales of
    displacement viscosity and inertia, 1 / tau_1 = rho r_a + 2 mu r_v / h^2, with the changes of
    velocity r_v u and of acceleration r_a u in a step; for those of the pressure
    tau_2 = (2 mu + rho c h) r_v with ``c^2 = v^2 + |p| / rho``, the rate at which points are
    brought out of order.

    Args:
        mu: dynamic viscosity [Pa s], positive.
        density: [kg/m^d], positive.
        scheme: time scheme of the unknown.
        correction: share of the errors of volume so far that a step takes back [-], however long it
            is. A fluid alone needs none; beside a solid it makes up for the solid's own errors.

    Raises:
        ValueError: for parameters out of range.
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
            raise ValueError(f"the correction of volume is a share from 0 to 1: {correction}")
        self.scheme = scheme

    def deviatoric_power(self, k: Kinematics, U: Any, V: Any) -> Any:
        """Virtual work of viscous stress per volume before the step [J/m^3].

        Args:
            k: ``Kinematics`` of the step.
            U: function of the unknown.
            V: its variation.

        Raises:
            ValueError: for the unknown of another time scheme.
        """
        if U is not self.scheme.unknown.U:
            raise ValueError("the time scheme of the fluid is one of another unknown")
        rate = ufl.sym(k.grad(self.scheme.velocity()))
        w = ufl.derivative(self.scheme.u, U, V)
        return 2 * self.mu * k.j * ufl.inner(rate, k.grad(w))

    def volumetric_residual(self, p: Any, k: Kinematics) -> Any:
        """Change of volume in the whole step, and the correction of earlier ones [-].

        Raises:
            ValueError: for points of another density.
        """
        change = Kinematics(self.scheme.increment, k.points).j - 1
        correction = fem.Constant(k.points.mesh, float(self.correction))
        return change + correction * self._dilation(k.points)

    def modulus(self, h_squared: Any) -> Any:
        """Shear modulus [Pa] to which viscosity and inertia amount in cells of size h."""
        velocity, acceleration = self.scheme.rates
        return self.mu * velocity + self.density * acceleration * h_squared / 2

    def subscale_modulus(self, points: MaterialPoints, h_squared: Any) -> Any:
        """Shear modulus [Pa] of viscosity, of motion and of pressure in cells of size h."""
        if "p" not in points:
            points.add_field("p")
        v, p = points.field("v"), points.field("p")
        squared = ufl.inner(v, v) + abs(p) / self.density
        return (self.mu + self.density * ufl.sqrt(squared * h_squared) / 2) * self.scheme.rates[0]

    def _dilation(self, points: MaterialPoints) -> PointField:
        """Sum of det f - 1 so far, whose renewal keeps the volumes of the points (collective)."""
        found = points["mass"] / points["V_0"]
        wrong = found[~(np.abs(found / self.density - 1) < _SAME)]
        error = (
            ValueError(
                f"points of a density of {wrong[0]:g} kg/m^d in a fluid of {self.density:g} kg/m^d"
            )
            if len(wrong)
            else None
        )
        raise_together(points.mesh.comm, error)
        if "dilation" not in points:
            points.add_field("dilation")
        field = points.field("dilation")
        j = Kinematics(self.scheme.increment, points).j
        # a point that a step turns inside out must not go unseen
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
