# SPDX-License-Identifier: MIT
"""Lumped projection from the points to the grid, as a coefficient of UFL forms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from fenicsmpm import forms
from fenicsmpm.points import MaterialPoints
from fenicsmpm.transfer.points_to_grid import p2g


def all_coefficients(form: ufl.Form) -> Iterator[Any]:
    """Yield the coefficients of a form, including those of its projected expressions.

    Args:
        form: UFL form.
    """
    for coefficient in form.coefficients():
        yield coefficient
        if isinstance(coefficient, LumpedProjection):
            yield from coefficient.sums.coefficients()


class LumpedProjection(fem.Function):
    """Lumped projection of UFL over points: sum_p N_I(x_p) V_p f_p / sum_p N_I(x_p) V_p, P1.

    The projection is updated whenever a form that contains it is assembled. ``evaluate`` at points
    uses the last values. If f depends on the unknown, so does the projection. ``NewtonSolver``
    includes this dependence in the tangent, but ``ufl.derivative`` alone does not. The projection
    is zero at nodes without points.

    Args:
        points: Material points with the volumes V_p as weights [m^d].
        expression: Scalar or vector f, UFL, which may contain the unknown and fields of the points.

    Attributes:
        points: The material points.
        sums: UFL form of rank 1 for the sums in the numerator.
        is_held: Whether assembly leaves the values unchanged.

    Raises:
        ValueError: If f is a tensor or contains another projection.
    """

    def __init__(self, points: MaterialPoints, expression: Any) -> None:
        """Compile the form of the sums. Collective."""
        expression = ufl.as_ufl(expression)
        shape = expression.ufl_shape
        if len(shape) > 1:
            raise ValueError(
                f"only scalars and vectors can be projected, not a tensor of shape {shape}: "
                "project its components"
            )
        space = fem.functionspace(points.mesh, ("Lagrange", 1, shape) if shape else ("Lagrange", 1))
        super().__init__(space, name="projection")
        self.points = points
        self.sums = ufl.inner(expression, ufl.TestFunction(space)) * points.dx
        if any(isinstance(c, LumpedProjection) for c in self.sums.coefficients()):
            raise ValueError(
                "a projection cannot have another projection in it: project one expression of "
                "functions and point fields"
            )
        self._compiled = forms.form(self.sums)
        self.is_held = False
        self._volumes: la.Vector | None = None
        self._version = -1
        self._weights: npt.NDArray[np.float64] = np.empty(0)

    def volumes(self) -> la.Vector:
        """Return the volumes at the nodes, sum_p N_I(x_p) V_p [m^d]. Collective."""
        points = self.points
        known = self._volumes is not None and self._version == points.version
        is_same = known and np.array_equal(self._weights, points.weight)
        if not points.mesh.comm.allreduce(is_same, MPI.LAND):
            self._version, self._weights = points.version, points.weight.copy()
            # a quotient of sums that are pure round-off could have any value
            self._volumes = p2g(points, points.weight, self.function_space, rounded=True)
        assert self._volumes is not None
        return self._volumes

    def follow_points(self) -> None:
        """Update the projection unless it is held; forms call this before each use. Collective."""
        if self.is_held:
            return
        sums = forms.assemble_vector(self._compiled)
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
        volume = self.volumes().array[:, None]
        values = sums.array.reshape(len(volume), self.function_space.dofmap.index_map_bs)
        result = self.x.array.reshape(values.shape)
        result[:] = np.divide(values, volume, out=np.zeros_like(values), where=volume > 0)
