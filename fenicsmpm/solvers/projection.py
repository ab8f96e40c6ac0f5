# SPDX-License-Identifier: MIT
"""Projection of point fields to the grid with the consistent or effective mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import forms
from fenicsmpm.mapping import p2g
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError

# The right-hand side is in the range of the mass, also where points are so few that the mass is
# singular. Conjugate gradients then find the solution of least size, and the diagonal takes
# care of nodes of nearly no mass.
_OPTIONS = {
    "ksp_type": "cg",
    "pc_type": "jacobi",
    "ksp_rtol": 1e-14,
    "ksp_atol": 1e-300,
    "ksp_max_it": 2000,
}


class EffectiveProjection:
    """Velocities of nodes from those of points by (1 - epsilon) M + epsilon M_lumped.

    Conservation paper, equations 18 and 26.

    Args:
        point_sets: bodies with the field "mass" [kg].
        space: of the grid functions, blocked Lagrange.
        lumping: share epsilon of the lumped mass [-].
    """

    def __init__(
        self, point_sets: Sequence[MaterialPoints], space: fem.FunctionSpace, lumping: float
    ) -> None:
        """Compile the mass (collective)."""
        self.point_sets, self.space, self.lumping = list(point_sets), space, lumping
        element = space.ufl_element()
        scalar = element.sub_elements[0] if element.block_size > 1 else element
        self._scalar = fem.functionspace(space.mesh, scalar)
        v, w = ufl.TrialFunction(self._scalar), ufl.TestFunction(self._scalar)
        consistent = sum(p.field("mass") / p.field("weight") * v * w * p.dx for p in point_sets)
        self._form = forms.form(consistent)
        self._solver = LinearSolver(space.mesh.comm, _OPTIONS)

    def mass(self) -> PETSc.Mat:
        """The effective mass of the points as they are [kg], one row a node (collective).

        Nodes without points have a row of the identity.
        """
        A = forms.petsc.create_matrix(self._form, compact=True)
        forms.petsc.assemble_matrix(self._form, A=A)
        if self.lumping > 0:
            A.scale(1 - self.lumping)
            diagonal = A.getDiagonal()
            diagonal.array_w[:] += self.lumping * self._sums("mass")[:, 0]
            diagonal.array_w[forms.petsc.unreached_rows(A)] = 1.0
            A.setDiagonal(diagonal)
        return A

    def project(self, functions: Mapping[str, fem.Function]) -> None:
        """Set functions to the projections of fields (collective).

        Args:
            functions: of the space, by the field's name.

        Raises:
            LinearSolverError: if there is no such projection; the functions are as before.
        """
        A = self.mass()
        b, x = A.createVecs()
        results = {}
        for name in functions:
            momenta = self._sums(name)
            result = np.empty_like(momenta)
            for k in range(momenta.shape[1]):
                b.array_w[:] = momenta[:, k]
                self._solve(A, b, x)
                result[:, k] = x.array_r
            results[name] = result
        for name, result in results.items():
            owned = functions[name].x.array[: result.size]
            owned[:] = result.ravel()
            functions[name].x.scatter_forward()
        for item in (A, b, x):
            item.destroy()

    def _solve(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        try:
            self._solver.solve(A, b, x)
        except LinearSolverError as error:
            raise LinearSolverError(
                "the mass of the points is singular or not finite, so that their velocities cannot "
                "be mapped to the grid: check their masses, or use some lumped mass "
                f"(lumping > 0); {error}"
            ) from error

    def _sums(self, name: str) -> npt.NDArray[np.float64]:
        """``(n_owned_nodes, size)`` sums of N_I m f, or of N_I m for "mass"."""
        total: Any = 0.0
        for points in self.point_sets:
            mass = points["mass"]
            values = mass[:, None] if name == "mass" else mass[:, None] * points[name]
            total = total + p2g(points, values, self._scalar).array
        index_map = self._scalar.dofmap.index_map
        return total.reshape(index_map.size_local + index_map.num_ghosts, -1)[
            : index_map.size_local
        ]
