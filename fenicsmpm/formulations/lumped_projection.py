# SPDX-License-Identifier: MIT
"""Projection of what points have to the grid, as a coefficient of UFL forms."""

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
    """Coefficients of a form and of what is projected in it.

    Args:
        form: UFL form.
    """
    for coefficient in form.coefficients():
        yield coefficient
        if isinstance(coefficient, LumpedProjection):
            yield from coefficient.sums.coefficients()


class LumpedProjection(fem.Function):
    """Lumped projection of UFL over points: sum_p N_I(x_p) V_p f_p / sum_p N_I(x_p) V_p, P1.

    It is up to date whenever a form with it is assembled; ``evaluate`` at points takes the last
    values. If f depends on the unknown, so does the
    projection, and ``NewtonSolver`` takes that into the tangent; ``ufl.derivative`` alone does not
    see it. Nodes without points have zero.

    Args:
        points: material points with volumes V_p as weights [m^d].
        expression: f, a scalar or vector, which may have the unknown and fields of the points.

    Attributes:
        points: as above.
        sums: UFL of the sums, rank 1.
        is_held: whether forms leave it as it is.

    Raises:
        ValueError: for a tensor, or if f has another projection in it.
    """

    def __init__(self, points: MaterialPoints, expression: Any) -> None:
        """Compile the sums (collective)."""
        expression = ufl.as_ufl(expression)
        shape = expression.ufl_shape
        if len(shape) > 1:
            raise ValueError(f"a scalar or a vector is projected, not a tensor of shape {shape}")
        space = fem.functionspace(points.mesh, ("Lagrange", 1, shape) if shape else ("Lagrange", 1))
        super().__init__(space, name="projection")
        self.points = points
        self.sums = ufl.inner(expression, ufl.TestFunction(space)) * points.dx
        if any(isinstance(c, LumpedProjection) for c in self.sums.coefficients()):
            raise ValueError("a projection cannot have another projection in it")
        self._compiled = forms.form(self.sums)
        self.is_held = False
        self._volumes: la.Vector | None = None
        self._version = -1
        self._weights: npt.NDArray[np.float64] = np.empty(0)

    def volumes(self) -> la.Vector:
        """Of the points at the nodes, sum_p N_I(x_p) V_p [m^d] (collective)."""
        points = self.points
        known = self._volumes is not None and self._version == points.version
        is_same = known and np.array_equal(self._weights, points.weight)
        if not points.mesh.comm.allreduce(is_same, MPI.LAND):
            self._version, self._weights = points.version, points.weight.copy()
            # what is zero but for round-off would give any mean
            self._volumes = p2g(points, points.weight, self.function_space, rounded=True)
        assert self._volumes is not None
        return self._volumes

    def follow_points(self) -> None:
        """Project anew, unless held; forms do it before each use (collective)."""
        if self.is_held:
            return
        sums = forms.assemble_vector(self._compiled)
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
        volume = self.volumes().array[:, None]
        values = sums.array.reshape(len(volume), self.function_space.dofmap.index_map_bs)
        result = self.x.array.reshape(values.shape)
        result[:] = np.divide(values, volume, out=np.zeros_like(values), where=volume > 0)
