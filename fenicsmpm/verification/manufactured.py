# SPDX-License-Identifier: MIT
"""Method of manufactured solutions: loads for which a given motion is the exact solution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _jit
from fenicsmpm._compat import interpolation_points
from fenicsmpm.forms import PointExpression
from fenicsmpm.formulations import embed, set_initial_state
from fenicsmpm.points import MaterialPoints


class Manufactured:
    """A chosen motion, and all quantities that follow from it by UFL.

    Given the displacement u(X, t) and the first Piola-Kirchhoff stress P for F = I + du/dX, the
    balance of momentum requires the force per mass b = u'' - Div P / rho_0. UFL computes the
    derivatives with respect to X and t.

    Args:
        mesh: Background mesh.
        displacement: Function from the material position X and the time t to the d components of u
            [m], UFL.
        stress: Function from F and its rate, both ``(3, 3)``, to P ``(3, 3)`` [Pa]. F is a UFL
            variable, so ``lambda F, rate: ufl.diff(law.energy(F, ufl.det(F)), F)`` is valid.
        density: Density of the undeformed body [kg/m^d].
        pressure: Function from X and t to the mean stress p [Pa]. The term J p F^-T is then added
            to P. None for no such term.

    Attributes:
        time: Time at which all quantities are evaluated [s], a ``fem.Constant``.
        mesh: Background mesh.
        density: Density of the undeformed body [kg/m^d].
    """

    def __init__(
        self,
        mesh: Any,
        displacement: Callable[[Any, Any], Sequence[Any]],
        stress: Callable[[Any, Any], Any],
        density: float,
        pressure: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        """Store the functions."""
        self.mesh, self.density, self.time = mesh, float(density), fem.Constant(mesh, 0.0)
        self._displacement, self._stress, self._pressure = displacement, stress, pressure
        self._at: dict[Any, Exact] = {}
        self._forces: dict[MaterialPoints, PointExpression] = {}

    def at(self, points: MaterialPoints | None = None) -> Exact:
        """Return the exact fields at material points, or at positions on the mesh.

        Args:
            points: Material points with their initial positions in the field "X", which is added if
                missing. None for fields in terms of ``ufl.SpatialCoordinate``, which suit places
                that do not move.
        """
        if points not in self._at:
            if points is None:
                X = ufl.SpatialCoordinate(self.mesh)
            else:
                if "X" not in points:
                    points.add_field("X", (self.mesh.geometry.dim,), points.x)
                X = points.field("X")
            self._at[points] = Exact(
                X, self.time, self._displacement, self._stress, self.density, self._pressure
            )
        return self._at[points]

    def force(self, body: MaterialPoints) -> Any:
        """Return the force per mass b ``(d,)`` [m/s^2] as a field of the points.

        ``set_time``, ``at_end`` and the other ``at_...`` functions for time loops update the field.
        Long expressions are then evaluated only once per step, and need no tangent.

        Args:
            body: Material points.
        """
        if body not in self._forces:
            self._forces[body] = PointExpression(self.at(body).b, body)
            body.add_field("body force", (self.mesh.geometry.dim,), self._forces[body].evaluate())
        return body.field("body force")

    def set_time(self, time: float) -> None:
        """Set the time, and update the forces.

        Args:
            time: New time [s].
        """
        self.time.value = time
        for body, force in self._forces.items():
            body["body force"] = force.evaluate()

    def at_beginning(self, start: float, end: float) -> None:
        """Set the time to the start of a step; pass this as ``data`` to explicit loops.

        Args:
            start: Time at the start of the step [s].
            end: Time at the end of the step [s].
        """
        self.set_time(start)

    def at_middle(self, start: float, end: float) -> None:
        """Set the time to the middle of a step; pass this as ``data`` with the mid-point rule.

        Args:
            start: Time at the start of the step [s].
            end: Time at the end of the step [s].
        """
        self.set_time((start + end) / 2)

    def at_end(self, start: float, end: float) -> None:
        """Set the time to the end of a step; pass this as ``data`` to implicit loops.

        Args:
            start: Time at the start of the step [s].
            end: Time at the end of the step [s].
        """
        self.set_time(end)

    def set_initial_state(self, body: MaterialPoints) -> None:
        """Give undeformed points their mass and the exact velocity at time zero. Collective.

        Args:
            body: Material points with volumes as weights [m^d].

        Raises:
            ValueError: If the displacement at time zero is not zero.
        """
        self.time.value = 0.0
        exact = self.at(body)
        u, v, gradient = (
            PointExpression(value, body).evaluate() for value in (exact.u, exact.v, exact.grad_v)
        )
        largest = body.mesh.comm.allreduce(float(np.abs(u).max(initial=0.0)), MPI.MAX)
        extent = float(np.ptp(body.mesh.geometry.x, axis=0).max())
        if largest > 1e-9 * body.mesh.comm.allreduce(extent, MPI.MAX):  # not round-off
            raise ValueError(
                f"the displacement at time zero is {largest:g} m: choose a motion that starts "
                "from the undeformed body"
            )
        set_initial_state(body, self.density)
        body["v"] = v
        body.add_field("grad_v", gradient.shape[1:], gradient)

    def interpolate(self, name: str, space: fem.FunctionSpace) -> fem.Function:
        """Return an exact field on the mesh as a function, for example as a boundary value.

        Args:
            name: Name of an attribute of ``Exact``, such as "u".
            space: Space of the function.
        """
        result = fem.Function(space, name=name)
        value = getattr(self.at(), name)
        result.interpolate(_jit.expression(value, interpolation_points(space), space.mesh.comm))
        return result

    def error(self, body: MaterialPoints, name: str) -> float:
        """Return the relative L2 error of a field of the points, with initial volumes. Collective.

        Args:
            body: Material points at the current ``time``.
            name: Name of a field that is also an attribute of ``Exact``, such as "u", "v", "p" or
                "F".

        Returns:
            Relative error [-].
        """
        exact = PointExpression(getattr(self.at(body), name), body).evaluate()
        weight = body["V_0"]
        parts = [_square(body[name] - exact, weight), _square(exact, weight)]
        total = body.mesh.comm.allreduce(np.array(parts))
        return float(np.sqrt(total[0] / total[1]))


class Exact:
    """Exact fields, in UFL over points or over the mesh; see ``Manufactured``.

    Attributes:
        u: Displacement ``(d,)`` [m].
        v: Velocity ``(d,)`` [m/s].
        grad_v: Spatial gradient of the velocity ``(d, d)`` [1/s].
        a: Acceleration ``(d,)`` [m/s^2].
        F: Deformation gradient ``(3, 3)`` [-].
        J: Determinant of F [-].
        p: Given mean stress [Pa], or None.
        P: First Piola-Kirchhoff stress ``(3, 3)`` [Pa].
        b: Force per mass ``(d,)`` [m/s^2].
    """

    def __init__(
        self, X: Any, time: fem.Constant, displacement: Any, stress: Any, density: float,
        pressure: Any,
    ) -> None:  # fmt: skip
        """Derive all fields from the motion."""
        X, t = ufl.variable(X), ufl.variable(time)
        (dim,) = X.ufl_shape
        self.u = ufl.as_vector(list(displacement(X, t)))
        self.v = ufl.diff(self.u, t)
        self.a = ufl.diff(self.v, t)
        gradient = ufl.diff(self.u, X)
        f = ufl.Identity(dim) + gradient
        rate = ufl.diff(gradient, t)
        self.grad_v = ufl.dot(rate, ufl.inv(f))
        self.F = ufl.variable(ufl.Identity(3) + embed(gradient))
        self.J = ufl.det(self.F)
        self.P = stress(self.F, embed(rate))
        self.p = None if pressure is None else pressure(X, t)
        if self.p is not None:
            self.P += self.J * self.p * ufl.inv(self.F).T
        slope = ufl.diff(self.P, X)
        i, j = ufl.indices(2)
        divergence = ufl.as_vector(slope[i, j, j], i) if dim == 3 else _plane_divergence(slope)
        self.b = self.a - divergence / density


def _plane_divergence(slope: Any) -> Any:
    return ufl.as_vector([slope[i, 0, 0] + slope[i, 1, 1] for i in range(2)])


def _square(values: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]) -> float:
    return float(weight @ np.sum(values**2, axis=tuple(range(1, values.ndim))))
