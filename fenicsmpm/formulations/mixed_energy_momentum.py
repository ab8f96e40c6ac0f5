# SPDX-License-Identifier: MIT
"""Conservation of energy and momenta in the mixed displacement-pressure formulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl

from fenicsmpm.basis import functions_of
from fenicsmpm.formulations.energy_momentum import EnergyMomentum
from fenicsmpm.formulations.interior_penalty import GAMMA, require_second_derivatives
from fenicsmpm.formulations.stabilization_parameters import squared_size
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import MaterialPoints


class MixedEnergyMomentum(EnergyMomentum):
    """Energy-momentum stress of nearly or fully incompressible bodies, with pressure unknowns.

    The pressure p of a step acts on the change of volume and does exactly the work p Delta J::

        S = S_iso + p Z,  Z : Delta C / 2 = Delta J
        (Delta J - Delta theta, q) - alpha / mu (Delta r, rough(q)) = 0  per initial volume

    S_iso and Z are the discrete derivatives of the isochoric energy and of J. The points carry two
    further fields. The volumetric strain theta has the energy kappa theta^2 / 2. The pressure r
    stabilizes and has the energy alpha r^2 / (2 mu). Both fields follow from their means over the
    step, kappa (theta_n + theta_{n+1}) / 2 = p and (r_n + r_{n+1}) / 2 = rough(p).

    With linear functions, rough(p) = p - p_K is the part of p that varies within a cell (Dohrmann
    and Bochev). With splines, rough(p) = h^2 grad grad p (``hessian_penalty``).

    With the mid-point rule, the consistent mass and FLIP, the sum of the kinetic energy and these
    three energies is constant. The parts of theta and r that p cannot represent change their sign
    from step to step, and nothing damps them.

    Nodes with few points nearby must be tied in both parts of the space with
    ``cells.Tying(z.space, ...)``, because the pressure is ill-conditioned there.

    Volume is conserved from step to step, not relative to the start. To enforce J = 1, a step would
    have to correct the errors of the cells that points have left, and these corrections do work.

    Args:
        law: neo-Hookean law with volumetric="quadratic", whose p is linear in J. For nu = 0.5 any
            neo-Hookean law will do.
        points: The body, with the fields of ``set_initial_state``.
        z: Unknown with the displacement increment u [m] and the pressure p of the step [Pa].
        alpha: Stabilization factor [-]. None for 1 with linear functions, or 0.025 with splines.

    Attributes:
        algorithmic_stress: The stress S above ``(3, 3)`` [Pa], UFL.
        updates: New values of the point fields after a step, which time loops find and apply. These
            are "theta" [-], "r" [Pa] (initially zero) and the fields of the isochoric part. P, S
            and work belong to the isochoric part only.

    Raises:
        ValueError: If the unknown has no pressure, the volumetric law is another one, alpha is
            negative or not finite, alpha is not zero with uGIMP, or the points already have a field
            "theta" or "r".
    """

    def __init__(
        self, law: NeoHookean, points: MaterialPoints, z: Unknown, *, alpha: float | None = None
    ) -> None:
        """Define the stress and add the fields "theta" and "r"."""
        z.require("u", "p", of="the mixed formulation")
        p = z.p
        if law.inverse_kappa > 0 and law.volumetric != "quadratic":
            raise ValueError(
                f"{law!r} cannot conserve energy: use volumetric='quadratic', whose pressure is "
                "linear in J"
            )
        self._is_smooth = functions_of(points) != "linear"
        if alpha is None:
            alpha = GAMMA / 2 if self._is_smooth else 1.0
        if not 0 <= alpha < float("inf"):
            raise ValueError(f"alpha must be finite and not negative: {alpha}")
        if self._is_smooth and alpha > 0:
            require_second_derivatives(points, "the stabilization (alpha > 0)")
        taken = sorted({"theta", "r"} & set(points.field_names))
        if taken:
            raise ValueError(
                f"the body already has a field {taken[0]!r}, which MixedEnergyMomentum must add: "
                "use one stress object in all forms of a body, or rename your field"
            )
        super().__init__(lambda F: law.energy(F, ufl.det(F)), points, z)
        self._law, self._alpha = law, alpha
        F, F_n = self.F, points.field("F")
        J, J_n = ufl.det(F), ufl.det(F_n)
        mean = (J * ufl.inv(F.T * F) + J_n * ufl.inv(F_n.T * F_n)) / 2
        self.algorithmic_stress += p * self._discrete_derivative(J - J_n, mean)
        is_compressible = law.inverse_kappa > 0
        points.add_field("theta", (), np.linalg.det(points["F"]) - 1 if is_compressible else 0.0)
        means = {"theta": law.inverse_kappa * p}
        if alpha > 0:
            means["r"] = self._rough(p)
            points.add_field("r", means["r"].ufl_shape, 0.0)
        ends = {name: 2 * mean - points.field(name) for name, mean in means.items()}
        for name in ends:
            points.field(name).renewals = ends
        self.updates = {**self.updates, **ends}

    def power(self) -> ufl.Form:
        """Return the internal virtual work and the volumetric constraint in weak form.

        Returns:
            UFL form of rank 1 over the points.
        """
        q = self._z.test.p
        points, F_n = self._points, self._points.field("F")

        def gain(name: str) -> Any:
            return self.updates[name] - points.field(name)

        constraint = (ufl.det(self.F) - ufl.det(F_n) - gain("theta")) * q
        if self._alpha > 0:
            constraint -= self._alpha / self._law.mu * ufl.inner(gain("r"), self._rough(q))
        return super().power() + constraint / ufl.det(F_n) * points.dx

    def _rough(self, f: Any) -> Any:
        """Return the rough part of a scalar grid function, as the stabilization defines it."""
        if self._is_smooth:
            return squared_size(self._points) * ufl.grad(ufl.grad(f))
        return f - ufl.cell_avg(f)

    def volumetric_energy(self) -> float:
        """Return the energy of volumetric strain and stabilization [J]. Collective."""
        points, law = self._points, self._law
        psi = np.zeros(len(points))
        if law.inverse_kappa > 0:
            psi += law.kappa / 2 * points["theta"] ** 2
        if self._alpha > 0:
            r = points["r"]
            psi += self._alpha / (2 * law.mu) * np.sum(r**2, axis=tuple(range(1, r.ndim)))
        return float(points.mesh.comm.allreduce(float(points["V_0"] @ psi)))
