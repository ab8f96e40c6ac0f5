# SPDX-License-Identifier: MIT
"""Response of a material to a deformation gradient, in forms over points."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numba
import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm._njit import njit
from fenicsmpm.forms import PointExpression
from fenicsmpm.materials import Law, compiled, state_of
from fenicsmpm.materials.differences import first_piola_kirchhoff, tangent_by_differences
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import ComputedField

Array = npt.NDArray[np.float64]
Energy: TypeAlias = Callable[[Any], Any]


class Response:
    """Stress and work of a material as UFL over the points.

    Args:
        material: Law at points, or UFL energy per initial volume ``psi(F)`` [J/m^3]. If a law has
            no tangent, it is computed by finite differences of the stress.
        points: The body. The state of the law is stored in fields of the same names, which are
            added if missing.
        F: Deformation gradient ``(3, 3)``, UFL. For a law with a state it must be the one at the
            end of the step, where the state is computed. It must not be the one at the middle of
            the step or at the intermediate time of generalized-alpha.

    Attributes:
        F: The deformation gradient ``(3, 3)``, UFL.
        P: First Piola-Kirchhoff stress ``(3, 3)`` [Pa], UFL.
        updates: New values of the state fields after a step that ends with F. Time loops find and
            apply them.

    Raises:
        ValueError: If the law depends on velocities.
    """

    def __init__(self, material: Law | Energy, points: MaterialPoints, F: Any) -> None:
        """Define stress and work."""
        self.F, self._material = F, material
        self.updates: Mapping[str, Any] = {}
        if not isinstance(material, Law):
            variable = ufl.variable(F)
            self._work = material(variable)
            self.P = ufl.diff(self._work, variable)
            return
        for name, (shape, value) in material.state.items():
            if name not in points:
                points.add_field(name, shape, value)
        computed = _Computed(material, points, F)
        self.updates = computed.renewals
        # P is linear in F about the gradient F_0 for which the law was called. F_0 equals F
        # whenever a form is assembled. Therefore values are those of the law, and ufl.derivative
        # finds its tangent.
        change = F - computed.field("F_0", (3, 3))
        P_0, tangent = computed.field("P_0", (3, 3)), computed.field("dPdF", (3, 3, 3, 3))
        i, j, k, m = ufl.indices(4)
        self.P = P_0 + ufl.as_tensor(tangent[i, j, k, m] * change[k, m], (i, j))
        self._work = None
        if material.energy is not None:
            # d work = P : dF if all plastic work is either stored or dissipated
            gradient = P_0
            if material.work_gradient is not None:
                gradient = computed.field("work_gradient", (3, 3))
            self._work = computed.field("work_0", ()) + ufl.inner(gradient, change)

    @property
    def work(self) -> Any:
        """Free energy plus dissipated work, per initial volume [J/m^3], UFL.

        Raises:
            ValueError: If the law has no energy.
        """
        if self._work is None:
            raise ValueError(
                f"work and energy-momentum stress need a law with an energy: {self._material!r}"
            )
        return self._work

    @property
    def S(self) -> Any:
        """Second Piola-Kirchhoff stress F^-1 P ``(3, 3)`` [Pa], UFL."""
        return ufl.inv(self.F) * self.P


class _Computed:
    """Results of a law at all points, recomputed when F, state or parameters have changed."""

    def __init__(self, law: Law, points: MaterialPoints, F: Any) -> None:
        if law.needs_rate:
            raise ValueError(
                f"{law!r} depends on velocities, which is not possible in forms: if its function "
                "does not use L, create it with needs_rate=False"
            )
        self._law, self._points = law, points
        self._F = PointExpression(F, points)
        self._version: Any = None
        self._values: dict[str, Array] = {}
        self._old = self._state = law.initial_state(0)
        self._evaluate = _evaluation(
            law.update, law.tangent or tangent_by_differences(law.update), law.energy or _zero,
            law.work_gradient or _no_gradient,
        )  # fmt: skip
        self._has_dissipation = "dissipation" in law.columns
        self.renewals: dict[str, Callable[[], Array]] = {
            name: self._new_field(name) for name in law.state
        }

    def field(self, name: str, shape: tuple[int, ...]) -> ComputedField:
        """Return one of the results as a coefficient, by its name in ``update``."""
        result = ComputedField(self._points, name, shape, self.update, lambda: self._values[name])
        result.renewals, result.source = self.renewals, self._law
        return result

    def _new_field(self, name: str) -> Callable[[], Array]:
        """Return a function that returns a state field after the step."""

        def read() -> Array:
            self.update()
            return self._law.state_field(self._state, name).copy()

        return read

    def update(self) -> None:
        """Call the law, unless it was already called for the same deformation and state."""
        law, points = self._law, self._points
        F, old = self._F.evaluate(), state_of(law, points)
        known = (points.version, law.parameters.tobytes())
        if (
            self._version == known
            and np.array_equal(F, self._values["F_0"])
            and np.array_equal(old, self._old)
        ):
            return
        n = len(points)
        new = old.copy()
        P, tangent, work = np.empty((n, 3, 3)), np.empty((n, 3, 3, 3, 3)), np.empty(n)
        gradient = np.empty((n, 3, 3))
        self._evaluate(law.parameters, F, old, new, P, tangent, work, gradient)
        if self._has_dissipation:
            work += law.state_field(new, "dissipation")
        self._old, self._state, self._version = old, new, known
        self._values = {
            "F_0": F, "P_0": P, "dPdF": tangent, "work_0": work, "work_gradient": gradient,
        }  # fmt: skip


@compiled
def _zero(F, parameters, state):  # type: ignore[no-untyped-def]
    """Return zero as the energy of a law without an energy; the value is never used."""
    return 0.0


@compiled
def _no_gradient(F, parameters, state, G):  # type: ignore[no-untyped-def]
    """Do nothing, for a law without a work gradient."""


@functools.cache
def _evaluation(update: Any, tangent: Any, energy: Any, work_gradient: Any) -> Any:
    """Compile the loop over points with the functions of a law."""

    @njit(parallel=True)
    def evaluate(
        parameters: Any, F: Any, old: Any, new: Any, P: Any, dPdF: Any, work: Any, gradient: Any
    ) -> None:
        for p in numba.prange(len(F)):
            sigma = np.empty((3, 3))
            update(F[p], np.zeros((3, 3)), parameters, new[p], sigma)
            first_piola_kirchhoff(F[p], sigma, P[p])
            tangent(F[p], parameters, old[p], dPdF[p])
            work_gradient(F[p], parameters, old[p], gradient[p])
            work[p] = energy(F[p], parameters, new[p])

    return evaluate
