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
from fenicsmpm._garbage import lasting
from fenicsmpm.cells import Tying
from fenicsmpm.formulations import density
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError
from fenicsmpm.transfer import p2g

# The right-hand side lies in the range of the mass matrix, even if points are so few that the
# matrix is singular. Therefore conjugate gradients find a solution. Residuals are measured in the
# energy norm, in which round-off at nodes of little mass does not count more than elsewhere. The
# iterations end when the residual has reached round-off.
_OPTIONS = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",
    "pc_type": "jacobi",  # incomplete factors are not robust for a nearly singular mass
    "ksp_rtol": 1e-14,
    "ksp_atol": 1e-300,
    "ksp_max_it": 5000,
    "ksp_converged_maxits": True,
}
_TOLERANCE = 1e-10  # largest accepted residual, relative to the right-hand side


class EffectiveProjection:
    """Projection of velocities to the grid with the mass (1 - epsilon) M + epsilon M_lumped.

    The mass is that of the conservation paper, equations 18 and 26. With tied nodes, the equation
    holds for test functions that satisfy the ties. The solution lies in the same space, so the
    projection still conserves momenta and the energy that the points gain.

    Args:
        point_sets: Bodies with the field "mass" [kg].
        space: Space of the grid functions, blocked Lagrange.
        lumping: Share epsilon of the lumped mass [-].
        tying: Tied nodes of the space. None for none.

    Raises:
        ValueError: If nodes are tied in another space.
    """

    def __init__(
        self,
        point_sets: Sequence[MaterialPoints],
        space: fem.FunctionSpace,
        lumping: float,
        tying: Tying | None = None,
    ) -> None:
        """Compile the mass form. Collective."""
        if tying is not None and tying.space is not space:
            raise ValueError(
                f"nodes must be tied in the space of the grid functions, {space}, not in "
                f"{tying.space}"
            )
        self.point_sets, self.space, self.lumping = list(point_sets), space, lumping
        self._tying = tying
        # All components have the same mass.
        scalars, dofs = space.sub(0).collapse()
        # dolfinx 0.11 gives a list with one array
        dofs = np.ravel(dofs)[: scalars.dofmap.index_map.size_local]
        self._blocks = dofs // space.dofmap.index_map_bs
        v, w = ufl.TrialFunction(scalars), ufl.TestFunction(scalars)
        self._form = forms.form(sum(density(points) * v * w * points.dx for points in point_sets))
        self._solver = LinearSolver(space.mesh.comm, _OPTIONS)

    def mass(self) -> PETSc.Mat:
        """Return the effective mass of the current points [kg] as an operator. Collective.

        Rows of nodes without points are those of the identity.
        """
        A = forms.petsc.create_matrix(self._form, compact=True)
        forms.petsc.assemble_matrix(self._form, A=A)
        self._unreached = forms.petsc.unreached_rows(A)
        if self.lumping > 0:
            A.scale(1 - self.lumping)
            diagonal = A.getDiagonal()
            diagonal.array_w[:] += self.lumping * self._nodal_mass()[self._blocks]
            diagonal.array_w[self._unreached] = 1.0
            A.setDiagonal(diagonal)
            diagonal.destroy()
        bs = self.space.dofmap.index_map_bs
        return _operator(_ByComponent(A, self._blocks, bs), self.space)

    @property
    def empty_nodes(self) -> npt.NDArray[np.int64]:
        """Owned nodes without points, at the last call of ``mass``."""
        return np.asarray(self._blocks[self._unreached], dtype=np.int64)

    def project(self, functions: Mapping[str, fem.Function], fixed: npt.ArrayLike = ()) -> None:
        """Set functions to the projections of point fields. Collective.

        Args:
            functions: Functions of the space, by field name.
            fixed: Local degrees of freedom with Dirichlet conditions, which are not tied.

        Raises:
            LinearSolverError: If the projection does not exist. The functions are then unchanged.
        """
        A = operator = self.mass()
        b, x = A.createVecs()
        if self._tying is not None:
            bs = self.space.dofmap.index_map_bs
            unreached = self._blocks[self._unreached][:, None] * bs + np.arange(bs)
            self._tying.update(fixed, unreached.ravel())
            operator = _operator(_Tied(A, self._tying), self.space)
        results = {}
        try:
            for name in functions:
                b.array_w[:] = self._sums(name)
                if self._tying is not None:
                    self._tying.restrict(b, constrained=False)
                self._solve(operator, b, x)
                if self._tying is not None:
                    self._tying.extend(x)
                results[name] = x.array_r.copy()
        finally:
            for item in (operator, A, b, x):
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
            "mapped to the grid: check their masses, tie nodes with few points nearby "
            f"(cells.Tying), or use some lumped mass (lumping > 0){why}"
        )

    @staticmethod
    def _residual(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> float:
        """Return the residual relative to the right-hand side, each scaled by the nodal mass."""
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
        """Return the ``(n_owned_dofs,)`` sums of N_I m f."""
        total: Any = 0.0
        for points in self.point_sets:
            total = total + p2g(points, points["mass"][:, None] * points[name], self.space).array
        return total[: len(self._blocks) * self.space.dofmap.index_map_bs]

    def _nodal_mass(self) -> npt.NDArray[np.float64]:
        """Return the ``(n_owned_nodes,)`` sums of N_I m [kg]."""
        total: Any = 0.0
        for points in self.point_sets:
            total = total + p2g(points, points["mass"], self.space).array
        return total[: len(self._blocks)]


class _ByComponent:
    """Operator that applies the same matrix to each component of a blocked space."""

    def __init__(self, A: PETSc.Mat, blocks: npt.NDArray[np.int32], bs: int) -> None:
        self._A, self._blocks = A, blocks
        self._shape = len(blocks), bs
        self._x, self._y = A.createVecs()

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        source, target = x.array_r.reshape(self._shape), y.array_w.reshape(self._shape)
        for k in range(self._shape[1]):
            self._x.array_w[:] = source[self._blocks, k]
            self._A.mult(self._x, self._y)
            target[self._blocks, k] = self._y.array_r

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        self._A.getDiagonal(self._x)
        diagonal.array_w.reshape(self._shape)[self._blocks] = self._x.array_r[:, None]

    def destroy(self, _: PETSc.Mat) -> None:
        for item in (self._A, self._x, self._y):
            item.destroy()


class _Tied:
    """Matrix restricted to functions that satisfy the ties; its diagonal is that of the matrix."""

    def __init__(self, A: PETSc.Mat, tying: Tying) -> None:
        self._A, self._tying = A, tying

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._tying.product(self._A, x, y)

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        self._A.getDiagonal(diagonal)


def _operator(context: Any, space: fem.FunctionSpace) -> PETSc.Mat:
    """Return a matrix-free operator on a blocked space."""
    bs, index_map = space.dofmap.index_map_bs, space.dofmap.index_map
    sizes = index_map.size_local * bs, index_map.size_global * bs
    matrix = PETSc.Mat().createPython((sizes, sizes), context, lasting(space.mesh.comm))
    matrix.setUp()
    return matrix
