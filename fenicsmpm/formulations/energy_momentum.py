# SPDX-License-Identifier: MIT
"""Displacement formulations, with stresses that conserve energy among them."""

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
    """Internal virtual work of a first Piola-Kirchhoff stress, the integral of P : Grad w.

    Args:
        P: stress [Pa], 3x3, UFL over the points.
        w: test function of the displacement.
        points: the body, with volumes V_n as weights; without a field "F" it is undeformed.

    Returns:
        UFL form of rank 1 over the points.
    """
    F_n = gradient_before(points)
    gradient = embed(ufl.grad(w)) * F_n  # with respect to initial positions
    return ufl.inner(P, gradient) / ufl.det(F_n) * points.dx


class EnergyMomentum(Response):
    """Algorithmic stress that conserves energy and momenta with the mid-point rule.

    Conservation paper, equations 47 to 51 (O. Gonzalez, CMAME 190, 2000; X. Meng and T. Laursen,
    CMAME 191, 2002): with mean stress S_m = (S_n + S_{n+1}) / 2 and Delta C = C_{n+1} - C_n,

        ``S = S_m + Delta C / |Delta C|^2 (2 (Delta psi + Delta D) - S_m : Delta C)``

    so that S : Delta C / 2 is exactly the free energy gained and the work dissipated in the step.

    For Delta C -> 0 the second term vanishes, but its quotient is 0 / 0. Instead of
    ``c = |Delta C|^2`` the denominator is c + e^4 / (c + e^2) with e = 1e-6. That is smooth, and
    the energy of a step is then wrong by less than e^3 of the modulus, and by less than
    ``e^4 / |Delta C|`` for larger steps.

    The body carries the stress "S" [Pa] and the "work" psi + D [J/m^3] of the end of the last step;
    they are added here, for its present fields "F" and state.

    Args:
        material: a law at points with an energy, or an energy per initial volume
            ``psi(F)`` [J/m^3] in UFL.
        points: the body, with the fields of ``set_initial_state``.
        z: unknown with the increment of displacement u of the step [m].

    Attributes:
        F: deformation gradient at the end of the step, 3x3.
        P: first Piola-Kirchhoff stress there [Pa], 3x3.
        work: free energy and what was dissipated there, per initial volume [J/m^3].
        updates: new fields after a step; time loops know them.
        algorithmic_stress: S from above [Pa], 3x3.

    Raises:
        ValueError: for a body that has such a stress already or not the fields that it needs, laws
            that ``Response`` cannot use, or with a state whose dissipation is not known.
    """

    def __init__(self, material: Law | Energy, points: MaterialPoints, z: Unknown) -> None:
        """Write down the stress."""
        z.require("u", of="an energy-momentum stress")
        require_initial_state(points, "energy-momentum stress")
        if "S" in points:
            raise ValueError(
                "the body has the stress and work of another EnergyMomentum: there is one for all "
                "forms of a body"
            )
        if isinstance(material, Law) and material.state and "dissipation" not in material.state:
            raise ValueError(
                f"energy cannot be kept by {material!r}: a law with a state needs a field "
                f"'dissipation' [J/m^3] in it, among {', '.join(material.state)}"
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
        """Tensor nearest to a mean whose product with Delta C / 2 is the gain (equation 47)."""
        F_n = self._points.field("F")
        change = self.F.T * self.F - F_n.T * F_n
        size = ufl.inner(change, change)
        size += _SMALL**4 / (size + _SMALL**2)
        return mean + (2 * gain - ufl.inner(mean, change)) / size * change

    def power(self) -> ufl.Form:
        """Internal virtual work at the middle of the step (equation 39), of rank 1."""
        middle = (self.F + self._points.field("F")) / 2
        return stress_power(middle * self.algorithmic_stress, self._z.test.u, self._points)


_SMALL = 1e-6  # see EnergyMomentum
