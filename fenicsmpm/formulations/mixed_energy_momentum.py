# SPDX-License-Identifier: MIT
"""Energy and momenta kept by the mixed formulation of displacement and pressure."""

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
    """Energy-momentum stress of a nearly or fully incompressible body, pressures as unknowns.

    The pressure of a step p acts on the change of volume, and does exactly the work p Delta J:

        S = S_iso + p Z,  Z : Delta C / 2 = Delta J
        (Delta J - Delta theta, q) - alpha / mu (Delta r, rough(q)) = 0  per initial volume

    with S_iso and Z discrete derivatives of the isochoric energy and of J. Points carry the
    volumetric strain theta of energy kappa theta^2 / 2, and a pressure r of energy
    alpha r^2 / (2 mu), which stabilizes: the part of p that varies in a cell, rough(p) = p - p_K
    (Dohrmann and Bochev), or where points see splines, rough(p) = h^2 grad grad p
    (``hessian_penalty``). Both follow from their means over the step,
    kappa (theta_n + theta_{n+1}) / 2 = p and (r_n + r_{n+1}) / 2 = rough(p). With the mid-point
    rule, the consistent mass and FLIP, kinetic energy and all three of these together are constant.
    What p cannot show of theta and r changes its sign from step to step: nothing damps it.

    Nodes that few points see are to be tied, as the pressure is ill there, in both parts of the
    space: ``cells.Tying(z.space, ...)``.

    Volume is kept step by step, not since the start: J = 1 would have to correct what the last
    cells left, and corrections do work.

    Args:
        law: neo-Hookean law with volumetric="quadratic", whose p is linear in J; any for nu = 0.5.
        points: the body, with the fields of ``set_initial_state``.
        z: unknown with the increment of displacement u [m] and the pressure p of the step [Pa].
        alpha: factor of the stabilization [-]; None for 1, or with splines 0.025.

    Attributes:
        algorithmic_stress: S from above [Pa], 3x3.
        updates: new fields after a step, which time loops know: "theta" [-], "r" [Pa] (zero at
            first) and those of the isochoric part. P, S and work are of that part only.

    Raises:
        ValueError: for spaces without pressure, other volumetric laws, a negative alpha, or one
            that is not zero with uGIMP, or points that have a field "theta" or "r".
    """

    def __init__(
        self, law: NeoHookean, points: MaterialPoints, z: Unknown, *, alpha: float | None = None
    ) -> None:
        """Write down stress and strains."""
        z.require("u", "p", of="the mixed formulation")
        p = z.p
        if law.inverse_kappa > 0 and law.volumetric != "quadratic":
            raise ValueError(
                f"energy is kept with volumetric='quadratic' only, as pressures are linear in J "
                f"there: {law!r}"
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
            raise ValueError(f"the body has a field {taken[0]!r} already, which is to be made here")
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
        """Internal virtual work, and the constraint of the volume in weak form, of rank 1."""
        q = self._z.test.p
        points, F_n = self._points, self._points.field("F")

        def gain(name: str) -> Any:
            return self.updates[name] - points.field(name)

        constraint = (ufl.det(self.F) - ufl.det(F_n) - gain("theta")) * q
        if self._alpha > 0:
            constraint -= self._alpha / self._law.mu * ufl.inner(gain("r"), self._rough(q))
        return super().power() + constraint / ufl.det(F_n) * points.dx

    def _rough(self, f: Any) -> Any:
        """What the stabilization takes for the rough part of a scalar function of the grid."""
        if self._is_smooth:
            return squared_size(self._points) * ufl.grad(ufl.grad(f))
        return f - ufl.cell_avg(f)

    def volumetric_energy(self) -> float:
        """Energy of volumetric strain and stabilization [J] (collective)."""
        points, law = self._points, self._law
        psi = np.zeros(len(points))
        if law.inverse_kappa > 0:
            psi += law.kappa / 2 * points["theta"] ** 2
        if self._alpha > 0:
            r = points["r"]
            psi += self._alpha / (2 * law.mu) * np.sum(r**2, axis=tuple(range(1, r.ndim)))
        return float(points.mesh.comm.allreduce(float(points["V_0"] @ psi)))
