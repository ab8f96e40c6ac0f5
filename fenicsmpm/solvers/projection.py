# SPDX-License-Identifier: MIT
"""Projection of point fields to the grid with the consistent or effective mass."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import forms
from fenicsmpm.formulations import density
from fenicsmpm.mapping import Tying, p2g
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError

# The right-hand side is in the range of the mass, also where points are so few that the mass is
# singular: conjugate gradients then find a solution. Residuals are measured by their energy, in
# which round-off at nodes of nearly no mass counts as little as elsewhere. They end at round-off,
# sooner or later.
_OPTIONS = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",
    "pc_type": "jacobi",  # robust; incomplete factors are not, where the mass is nearly singular
    "ksp_rtol": 1e-14,
    "ksp_atol": 1e-300,
    "ksp_max_it": 5000,
    "ksp_converged_maxits": True,
}
_TOLERANCE = 1e-10  # of what is accepted


class EffectiveProjection:
    """Velocities of nodes from those of points by (1 - epsilon) M + epsilon M_lumped.

    Conservation paper, equations 18 and 26. With tied nodes, the equation holds for the functions
    that obey them: momenta, and the energy that points gain, are kept all the same, since these
    functions are among those of the solution.

    Args:
        point_sets: bodies with the field "mass" [kg].
        space: of the grid functions, blocked Lagrange.
        lumping: share epsilon of the lumped mass [-].
        tying: tied nodes of the space; None for none.
        fixed: local degrees of freedom of Dirichlet conditions, which are not tied.

    Raises:
        ValueError: for tied nodes of another space.
    """

    def __init__(
        self,
        point_sets: Sequence[MaterialPoints],
        space: fem.FunctionSpace,
        lumping: float,
        tying: Tying | None = None,
        fixed: npt.ArrayLike = (),
    ) -> None:
        """Compile the mass (collective)."""
        if tying is not None and tying.space is not space:
            raise ValueError(
                f"nodes are tied in the space of the grid functions, {space}, not in {tying.space}"
            )
        self.point_sets, self.space, self.lumping = list(point_sets), space, lumping
        self._tying, self._fixed = tying, fixed
        v, w = ufl.TrialFunction(space), ufl.TestFunction(space)
        consistent = sum(density(points) * ufl.inner(v, w) * points.dx for points in point_sets)
        self._form = forms.form(consistent)
        self._solver = LinearSolver(space.mesh.comm, _OPTIONS)

    def mass(self) -> PETSc.Mat:
        """The effective mass of the points as they are [kg] (collective).

        Nodes without points have a row of the identity.
        """
        A = forms.petsc.create_matrix(self._form, compact=True)
        forms.petsc.assemble_matrix(self._form, A=A)
        if self.lumping > 0:
            A.scale(1 - self.lumping)
            diagonal = A.getDiagonal()
            diagonal.array_w[:] += self.lumping * self._sums("mass")
            diagonal.array_w[forms.petsc.unreached_rows(A)] = 1.0
            A.setDiagonal(diagonal)
            diagonal.destroy()
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
        if self._tying is not None:
            self._tying.update(self._fixed, forms.petsc.unreached_rows(A))
        results = {}
        try:
            for name in functions:
                b.array_w[:] = self._sums(name)
                if self._tying is None:
                    self._solve(A, b, x)
                else:
                    self._tying.restrict(b)
                    self._solve(self._tying.reduce(A, b, constrained=False), b, x)
                    self._tying.extend(x)
                results[name] = x.array_r.copy()
        finally:
            for item in (A, b, x):
                item.destroy()
        for name, result in results.items():
            functions[name].x.array[: len(result)] = result
            functions[name].x.scatter_forward()

    def _solve(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        why = ""
        diagonal = A.getDiagonal()
        has_mass = diagonal.min()[1] > 0
        diagonal.destroy()
        try:
            self._solver.solve(A, b, x)
            if has_mass and self._residual(A, b, x) <= _TOLERANCE:
                return
        except LinearSolverError as error:
            why = f"; {error}"
        raise LinearSolverError(
            "the mass of the points is singular or not finite, so that their velocities cannot be "
            "mapped to the grid: check their masses; where few points see a node, tie it "
            f"(mapping.Tying) or use some lumped mass (lumping > 0){why}"
        )

    @staticmethod
    def _residual(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> float:
        """Residual as a share of the right-hand side, each by node and its own mass."""
        diagonal, residual = A.getDiagonal(), b.duplicate()
        A.mult(x, residual)
        residual.axpy(-1.0, b)
        norms = []
        for vector in (residual, b):
            scaled = vector.duplicate()
            scaled.pointwiseDivide(vector, diagonal)
            norms.append(math.sqrt(abs(scaled.dot(vector))))
            scaled.destroy()
        diagonal.destroy()
        residual.destroy()
        return norms[0] / norms[1] if norms[1] > 0 else 0.0

    def _sums(self, name: str) -> npt.NDArray[np.float64]:
        """``(n_owned_dofs,)`` sums of N_I m f, or of N_I m for "mass"."""
        bs = self.space.dofmap.index_map_bs
        total: Any = 0.0
        for points in self.point_sets:
            values = np.ones((len(points), bs)) if name == "mass" else points[name]
            total = total + p2g(points, points["mass"][:, None] * values, self.space).array
        return total[: self.space.dofmap.index_map.size_local * bs]
