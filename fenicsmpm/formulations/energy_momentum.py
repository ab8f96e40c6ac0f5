# SPDX-License-Identifier: MIT
"""Internal forces of displacement formulations, including energy-conserving stresses."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.forms import evaluate
from fenicsmpm.formulations.initial_state import require_initial_state
from fenicsmpm.formulations.kinematics import Kinematics, embed, gradient_before
from fenicsmpm.formulations.response import Energy, Response
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints


def stress_power(P: Any, w: Any, points: MaterialPoints) -> ufl.Form:
    """Return the internal virtual work of a stress P, the integral of P : Grad w.

    Args:
        P: First Piola-Kirchhoff stress ``(3, 3)`` [Pa], UFL over the points.
        w: Test function of the displacement ``(d,)``.
        points: The body, with the volumes V_n as weights [m^d]. Points without a field "F" are
            undeformed.

    Returns:
        UFL form of rank 1 over the points.
    """
    F_n = gradient_before(points)
    gradient = embed(ufl.grad(w)) * F_n  # gradient with respect to initial positions
    return ufl.inner(P, gradient) / ufl.det(F_n) * points.dx


class EnergyMomentum(Response):
    """Algorithmic stress that conserves energy and momenta with the mid-point rule.

    The stress is that of the conservation paper, equations 47 to 51 (O. Gonzalez, CMAME 190, 2000;
    X. Meng and T. Laursen, CMAME 191, 2002). With the mean stress S_m = (S_n + S_{n+1}) / 2 and
    Delta C = C_{n+1} - C_n, it is

        ``S = S_m + Delta C / |Delta C|^2 (2 (Delta psi + Delta D) - S_m : Delta C)``

    Therefore S : Delta C / 2 equals exactly the free energy gained plus the work dissipated in the
    step.

    For Delta C -> 0 the second term vanishes, but its quotient becomes 0 / 0. Therefore the
    denominator ``c = |Delta C|^2`` is replaced by c + e^4 / (c + e^2) with e = 1e-6, which is
    smooth. The resulting error in the energy of a step, relative to the modulus, is less than e^3.
    For larger steps it is less than ``e^4 / |Delta C|``.

    The body carries the stress "S" [Pa] and the "work" psi + D [J/m^3] of the end of the previous
    step. The constructor adds both fields, computed from the current "F" and state of the body.

    Args:
        material: Law at points with an energy, or UFL energy per initial volume ``psi(F)`` [J/m^3].
        points: The body, with the fields of ``set_initial_state``.
        z: Unknown with the displacement increment u of the step [m].

    Attributes:
        F: Deformation gradient at the end of the step, ``(3, 3)``, UFL.
        P: First Piola-Kirchhoff stress at the end of the step ``(3, 3)`` [Pa], UFL.
        work: Free energy plus dissipated work at the end of the step, per initial volume [J/m^3],
            UFL.
        updates: New values of the point fields after a step. Time loops find and apply them.
        algorithmic_stress: The stress S above ``(3, 3)`` [Pa], UFL.

    Raises:
        ValueError: If the body already has such a stress or lacks the required fields, if
            ``Response`` cannot use the law, or if the law has a state but no field "dissipation".
    """

    def __init__(self, material: Law | Energy, points: MaterialPoints, z: Unknown) -> None:
        """Define the stress and add the fields "S" and "work"."""
        z.require("u", of="an energy-momentum stress")
        require_initial_state(points, "energy-momentum stress")
        if "S" in points:
            raise ValueError(
                "the body already has the fields 'S' and 'work' of another EnergyMomentum: use "
                "one EnergyMomentum in all forms of a body"
            )
        if isinstance(material, Law) and material.state and "dissipation" not in material.state:
            raise ValueError(
                f"{material!r} cannot conserve energy: the state of a law needs a field "
                f"'dissipation' [J/m^3], but has only {', '.join(material.state)}"
            )
        super().__init__(material, points, Kinematics(z.u, points).F)
        self._points, self._z = points, z
        F_n = points.field("F")
        before = Response(material, points, F_n)
        for name, value in {"S": before.S, "work": before.work}.items():
            points.add_field(name, value.ufl_shape, evaluate(value, points))
        S, S_n = self.S, points.field("S")
        S_n.renewals = {"S": S, "work": self.work}
        self.algorithmic_stress = self._discrete_derivative(
            self.work - points.field("work"), (S + S_n) / 2
        )
        self.updates = {**self.updates, **S_n.renewals}

    def _discrete_derivative(self, gain: Any, mean: Any) -> Any:
        """Return the tensor closest to a mean whose product with Delta C / 2 is the gain (47)."""
        F_n = self._points.field("F")
        change = self.F.T * self.F - F_n.T * F_n
        size = ufl.inner(change, change)
        size += _SMALL**4 / (size + _SMALL**2)
        return mean + (2 * gain - ufl.inner(mean, change)) / size * change

    def power(self) -> ufl.Form:
        """Return the internal virtual work at the middle of the step (equation 39).

        Returns:
            UFL form of rank 1 over the points.
        """
        middle = (self.F + self._points.field("F")) / 2
        return stress_power(middle * self.algorithmic_stress, self._z.test.u, self._points)


_SMALL = 1e-6  # see EnergyMomentum
