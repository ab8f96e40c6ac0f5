# SPDX-License-Identifier: MIT
"""Flow of an incompressible Newtonian fluid in displacement and pressure."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.materials.law import positive
from fenicsmpm.points import MaterialPoints

VOLUMES = ("start", "step")


class NewtonianFlow:
    """Incompressible Newtonian fluid sigma = 2 mu sym(grad v) + p I, for ``mixed`` (CMN).

    The velocity is that of the time scheme, the unknown of a step its displacement, as for solids.
    Volume is kept since the start, det F = 1, or step by step, det f = 1, in the weak sense of the
    pressure's functions. Points carry the errors of a step into cells where others have different
    ones. The former corrects them, by small pressures; the latter leaves them alone, so that points
    of a shear layer shrink or grow without bound.

    Stabilization sees viscosity and inertia: with the changes of velocity r_v u and of acceleration
    r_a u in a step, 1 / tau_1 = rho r_a + 2 mu r_v / h^2 (R. Codina, CMAME 191, 2002, in terms of
    displacements), and tau_2 = h^2 / tau_1. The inertia in tau_2 asks for triangles whose linear
    functions can be free of divergence, such as crossed ones: on others the flow is too stiff.

    Args:
        mu: dynamic viscosity [Pa s], positive.
        density: [kg/m^d], positive.
        scheme: time scheme of the unknown.
        volume: "start" for det F = 1, "step" for det f = 1 in each step.

    Raises:
        ValueError: for parameters out of range.
    """

    inverse_kappa = 0.0

    def __init__(
        self, mu: float, density: float, scheme: TimeScheme, volume: str = "start"
    ) -> None:
        """Check and store the parameters."""
        positive(mu, "mu", "viscosity", "Pa s")
        positive(density, "density", "density", "kg/m^d")
        if volume not in VOLUMES:
            raise ValueError(f"volume is kept since the 'start' or of each 'step': {volume!r}")
        self.mu, self.density, self.scheme, self.volume = mu, density, scheme, volume

    def deviatoric_power(self, k: Kinematics, U: Any, V: Any) -> Any:
        """Virtual work of viscous stress per volume before the step [J/m^3].

        Args:
            k: ``Kinematics`` of the step.
            U: unknown of the step.
            V: its variation.
        """
        rate = ufl.sym(k.grad(self.scheme.velocity()))
        w = ufl.split(V)[0]
        return 2 * self.mu * k.j * ufl.inner(rate, k.grad(w))

    def volumetric_residual(self, p: Any, k: Kinematics) -> Any:
        """Change of volume [-], of the step or since the start."""
        return (k.j if self.volume == "step" else k.J) - 1

    def modulus(self, h_squared: Any) -> Any:
        """Shear modulus [Pa] to which viscosity and inertia amount in cells of size h."""
        velocity, acceleration = self.scheme.rates
        return self.mu * velocity + self.density * acceleration * h_squared / 2

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New fields that keep of the deformation its volume only, for ``ImplicitMPM``.

        Shears of a flow grow without bound, and with them the round-off of det F.

        Args:
            points: the fluid.
        """
        J = Kinematics(self.scheme.increment, points).J
        return {"F": J ** (1 / 3) * ufl.Identity(3), "J": J}

    def __repr__(self) -> str:
        """Parameters with units."""
        return (
            f"NewtonianFlow(mu={self.mu:g} Pa s, density={self.density:g} kg/m^d, "
            f"volume={self.volume!r})"
        )
