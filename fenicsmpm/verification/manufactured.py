# SPDX-License-Identifier: MIT
"""Manufactured solutions: the loads that make a given motion the exact one."""

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
    """A motion of one's choice, and by UFL all that follows from it.

    With the displacement u(X, t) and the first Piola-Kirchhoff stress P of F = I + du/dX, the
    balance of momentum needs the force per mass b = u'' - Div P / rho_0. Derivatives with respect
    to X and t are UFL's own.

    Args:
        mesh: background mesh.
        displacement: from the material position X and the time t to the d components of u [m], UFL.
        stress: from F and its rate, both 3x3, to P [Pa], 3x3; F may be differentiated by, as in
            ``lambda F, rate: ufl.diff(law.energy(F, ufl.det(F)), F)``.
        density: of the undeformed body [kg/m^d].
        pressure: from X and t to the mean stress p [Pa] whose J p F^-T is added to P; None for a
            stress without a pressure of its own.

    Attributes:
        time: at which all is taken [s], a ``fem.Constant``.
    """

    def __init__(
        self,
        mesh: Any,
        displacement: Callable[[Any, Any], Sequence[Any]],
        stress: Callable[[Any, Any], Any],
        density: float,
        pressure: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        """Take the functions."""
        self.mesh, self.density, self.time = mesh, float(density), fem.Constant(mesh, 0.0)
        self._displacement, self._stress, self._pressure = displacement, stress, pressure
        self._at: dict[Any, Exact] = {}
        self._forces: dict[MaterialPoints, PointExpression] = {}

    def at(self, points: MaterialPoints | None = None) -> Exact:
        """Exact fields at material points, or at the mesh's own positions.

        Args:
            points: with their initial positions in the field "X", which is added if it is missing;
                None for functions of ``ufl.SpatialCoordinate``, where nothing has moved.
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
        """The force per mass b [m/s^2] as a field of the points, renewed by ``at_end`` and so on.

        Long expressions are evaluated once a step in this way, and need no tangent.

        Args:
            body: material points.
        """
        if body not in self._forces:
            self._forces[body] = PointExpression(self.at(body).b, body)
            body.add_field("body force", (self.mesh.geometry.dim,), self._forces[body].evaluate())
        return body.field("body force")

    def set_time(self, time: float) -> None:
        """Take loads of another time.

        Args:
            time: [s].
        """
        self.time.value = time
        for body, force in self._forces.items():
            body["body force"] = force.evaluate()

    def at_beginning(self, start: float, end: float) -> None:
        """``data`` of explicit steps: loads of the beginning of a step."""
        self.set_time(start)

    def at_middle(self, start: float, end: float) -> None:
        """``data`` of the mid-point rule: loads of the middle of a step."""
        self.set_time((start + end) / 2)

    def at_end(self, start: float, end: float) -> None:
        """``data`` of implicit steps: loads of the end of a step."""
        self.set_time(end)

    def set_initial_state(self, body: MaterialPoints) -> None:
        """Give undeformed points mass and velocity of the time zero (collective).

        Args:
            body: material points with volumes as weights [m^d].

        Raises:
            ValueError: for a motion that has displacements at time zero.
        """
        self.time.value = 0.0
        exact = self.at(body)
        u, v, gradient = (
            PointExpression(value, body).evaluate() for value in (exact.u, exact.v, exact.grad_v)
        )
        largest = body.mesh.comm.allreduce(float(np.abs(u).max(initial=0.0)), MPI.MAX)
        extent = float(np.ptp(body.mesh.geometry.x, axis=0).max())
        if largest > 1e-9 * body.mesh.comm.allreduce(extent, MPI.MAX):  # not round-off
            raise ValueError(f"points begin undeformed, but the motion has moved by {largest:g} m")
        set_initial_state(body, self.density)
        body["v"] = v
        body.add_field("grad_v", gradient.shape[1:], gradient)

    def interpolate(self, name: str, space: fem.FunctionSpace) -> fem.Function:
        """A field at the mesh's own positions as a function, such as a boundary value.

        Args:
            name: of an attribute of ``Exact``, such as "u".
            space: of the function.
        """
        result = fem.Function(space, name=name)
        value = getattr(self.at(), name)
        result.interpolate(_jit.expression(value, interpolation_points(space), space.mesh.comm))
        return result

    def error(self, body: MaterialPoints, name: str) -> float:
        """Relative error of a field of the points in L2, by their initial volumes (collective).

        Args:
            body: material points, as they are at ``time``.
            name: of a field that is an attribute of ``Exact``, such as "u", "v", "p" or "F".
        """
        exact = PointExpression(getattr(self.at(body), name), body).evaluate()
        weight = body["V_0"]
        parts = [_square(body[name] - exact, weight), _square(exact, weight)]
        total = body.mesh.comm.allreduce(np.array(parts))
        return float(np.sqrt(total[0] / total[1]))


class Exact:
    """Exact fields, UFL over points or over the mesh; see ``Manufactured``.

    Attributes:
        u: displacement [m].
        v: velocity [m/s].
        grad_v: its spatial gradient [1/s].
        a: acceleration [m/s^2].
        F: deformation gradient, 3x3.
        J: its determinant.
        p: mean stress that was given [Pa]; None without.
        P: first Piola-Kirchhoff stress [Pa], 3x3.
        b: force per mass [m/s^2].
    """

    def __init__(
        self, X: Any, time: fem.Constant, displacement: Any, stress: Any, density: float,
        pressure: Any,
    ) -> None:  # fmt: skip
        """Write down what follows from the motion."""
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
