# SPDX-License-Identifier: MIT
"""Matrix-free tangent terms of projections that depend on the unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat, forms
from fenicsmpm._garbage import lasting
from fenicsmpm.formulations.lumped_projection import LumpedProjection
from fenicsmpm.solvers.places import parts_of

if TYPE_CHECKING:
    from fenicsmpm.cells import Tying


class ProjectedTangent:
    """Terms B D^-1 C of projections Pi = D^-1 s(U) in the tangent of a residual R(U, Pi).

    B is the derivative of R with respect to Pi, C that of the sums s with respect to U, and D
    contains the volumes at the nodes. The product couples nodes across two cells, so it is applied
    factor by factor.

    Args:
        R: Residual, UFL. None for no terms.
        U: The unknown in the residual.
        tying: Tied nodes with little mass, which are eliminated from the system. None for none.
    """

    def __init__(self, R: ufl.Form | None, U: fem.Function, tying: Tying | None) -> None:
        """Compile the factors. Collective."""
        self._tying, self._U = tying, U
        self._all = []
        for c in () if R is None else R.coefficients():
            if isinstance(c, LumpedProjection) and U in c.sums.coefficients():
                trial = ufl.TrialFunction(c.function_space)
                pair = ufl.derivative(R, c, trial), ufl.derivative(c.sums, U)
                self._all.append(_Factors(c, *(forms.form(form) for form in pair)))
        self._mask: PETSc.Vec | None = None
        self._whole: PETSc.Mat | None = None
        self._scalars: PETSc.Mat | None = None

    def __bool__(self) -> bool:
        """Return whether there is any such projection."""
        return bool(self._all)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the projections while a tangent is assembled at the state of the residual."""
        for factors in self._all:
            factors.projection.is_held = True
        try:
            yield
        finally:
            for factors in self._all:
                factors.projection.is_held = False

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Give the projections their values back when residuals of another U are known."""
        before = [factors.projection.x.array.copy() for factors in self._all]
        try:
            yield
        finally:
            for factors, values in zip(self._all, before, strict=True):
                factors.projection.x.array[:] = values

    def assemble(self, bcs: Sequence[fem.DirichletBC], stays: bool = False) -> None:
        """Assemble the factors for the current U. Collective.

        Args:
            bcs: Dirichlet conditions, whose rows and columns are omitted.
            stays: Whether to reuse the factors. The points must not have moved since.
        """
        if not self._all:
            return
        if not stays:
            for factors in self._all:
                factors.assemble()
        if self._whole is not None:
            self._whole.destroy()
            self._whole = None
        if self._mask is None:
            self._mask, self._work, self._free = (self._all[0].B.createVecLeft() for _ in range(3))
        mask: npt.NDArray[np.float64] = np.ones(len(self._mask.array_r))
        for bc in bcs:
            _compat.bc_set(bc, mask, np.zeros(len(mask)), 0.0)
        self._fixed = np.flatnonzero(mask == 0.0)
        if self._tying is not None:
            mask[self._tying.tied_dofs] = 0.0
        self._mask.array_w[:] = mask

    def mult(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = B D^-1 C x on dofs that are neither constrained nor tied. Collective.

        Args:
            x: Vector of the unknown.
            y: Result, overwritten.
        """
        assert self._mask is not None
        self._free.pointwiseMult(x, self._mask)
        if self._tying is None:
            self.mult_all(self._free, y)
        else:
            self._tying.product(_Product(self), self._free, y)
        y.pointwiseMult(y, self._mask)

    def mult_all(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = B D^-1 C x, ignoring conditions and tied nodes. Collective.

        Args:
            x: Vector of the unknown.
            y: Result, overwritten.
        """
        y.set(0.0)
        for factors in self._all:
            factors.add(x, y)

    def lift(self, b: PETSc.Vec) -> None:
        """Subtract B D^-1 C s from the free entries of b; s are its fixed entries. Collective.

        Args:
            b: Residual, whose constrained entries s are the steps of constrained dofs.
        """
        if not self._all:
            return
        assert self._mask is not None
        self._free.set(0.0)
        self._free.array_w[self._fixed] = b.array_r[self._fixed]
        if self._tying is not None:
            self._tying.extend(self._free)
        self.mult_all(self._free, self._work)
        if self._tying is not None:
            self._tying.restrict(self._work)
        self._work.pointwiseMult(self._work, self._mask)
        b.axpy(-1.0, self._work)

    def matrix(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return A + B D^-1 C as a matrix, kept until the next ``assemble``. Collective.

        Args:
            A: The rest of the tangent.
        """
        if self._whole is None:
            self._whole = self._added(A, None)
        return self._whole

    def preconditioner(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return A plus the entries of B D^-1 C that couple scalar parts, as a new matrix.

        Without these entries, A stabilizes the pressure by several times too much. With the factors
        of the result, GMRES needs 17 iterations instead of 41 for three systems of Cook's membrane
        in the plane. These factors have 1.5 times as many entries as those of A, and those of the
        whole sum 2.5 times as many. Collective.

        Args:
            A: The rest of the tangent.
        """
        if self._scalars is None:
            self._scalars = _selection(self._U, A)
        return self._added(A, self._scalars)

    def _added(self, A: PETSc.Mat, selection: PETSc.Mat | None) -> PETSc.Mat:
        """Return A + S B D^-1 C S as a new matrix; no selection S means all."""
        assert self._mask is not None
        result = self._all[0].product(selection)
        for factors in self._all[1:]:
            more = factors.product(selection)
            result.axpy(1.0, more)
            more.destroy()
        if self._tying is not None:
            untied = result
            result = self._tying.transformed(untied)
            untied.destroy()
        result.diagonalScale(self._mask, self._mask)
        result.axpy(1.0, A)
        return result

    def operator(self, A: PETSc.Mat, preconditions: bool) -> PETSc.Mat:
        """Return A + B D^-1 C as a matrix-free operator that can be scaled. Collective.

        Args:
            A: The rest of the tangent.
            preconditions: Whether A is also the matrix of the preconditioner. Then PETSc scales A
                by itself.
        """
        return PETSc.Mat().createPython(
            A.getSizes(), _Sum(A, self, preconditions), lasting(self._U.x.index_map.comm)
        )


class _Factors:
    """Factors B, D^-1 and C of one projection."""

    def __init__(self, projection: LumpedProjection, B: forms.Form, C: forms.Form) -> None:
        self.projection, self._forms = projection, (B, C)
        self._versions: Any = None
        self.B, self.C, self._D, self._sums = PETSc.Mat(), PETSc.Mat(), PETSc.Vec(), PETSc.Vec()

    def assemble(self) -> None:
        versions = [form.versions for form in self._forms]
        if versions != self._versions:
            self._versions = versions
            for old in (self.B, self.C, self._D, self._sums):
                old.destroy()
            self.B, self.C = (forms.petsc.create_matrix(f, compact=True) for f in self._forms)
            self._D, self._sums = (self.C.createVecLeft() for _ in range(2))
        for form, matrix in zip(self._forms, (self.B, self.C), strict=True):
            forms.petsc.assemble_matrix(form, A=matrix)
        volume = self.projection.volumes().array
        inverse = np.divide(1.0, volume, out=np.zeros_like(volume), where=volume > 0)
        owned = len(self._D.array_r)
        self._D.array_w[:] = np.repeat(inverse, self.projection.function_space.dofmap.bs)[:owned]

    def add(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self.C.mult(x, self._sums)
        self._sums.pointwiseMult(self._sums, self._D)
        self.B.multAdd(self._sums, y, y)

    def product(self, selection: PETSc.Mat | None) -> PETSc.Mat:
        """Return B D^-1 C, or its part S B D^-1 C S by a selection S."""
        B, C = self.B, self.C.copy()
        C.diagonalScale(self._D)
        if selection is not None:
            whole = C
            B, C = selection.matMult(B), whole.matMult(selection)
            whole.destroy()
        result = B.matMult(C)
        C.destroy()
        if selection is not None:
            B.destroy()
        return result


def _selection(U: fem.Function, like: PETSc.Mat) -> PETSc.Mat:
    """Return the matrix that keeps the dofs of scalar parts of U. Collective."""
    V = U.function_space
    spaces = [V.sub(i) for i in range(V.num_sub_spaces)] or [V]
    scalars = [part for part, s in zip(parts_of(V), spaces, strict=True) if s.num_sub_spaces == 0]
    (owned, size), _ = like.getSizes()
    begin, _ = like.getOwnershipRange()
    rows = np.zeros(owned + 1, dtype=PETSc.IntType)
    kept = np.concatenate([[], *scalars]).astype(PETSc.IntType)
    kept = np.sort(kept[kept < owned])
    rows[kept + 1] = 1
    values = np.ones(len(kept))
    csr = np.cumsum(rows, dtype=PETSc.IntType), kept + begin, values
    sizes = (owned, size), (owned, size)
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=lasting(V.mesh.comm))


class _Product:
    """Operator B D^-1 C for ``Tying.product``."""

    def __init__(self, projected: ProjectedTangent) -> None:
        self._projected = projected

    def mult(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._projected.mult_all(x, y)


class _Sum:
    """Operator A + B D^-1 C for PETSc, whose rows and columns GMRES scales.

    If A is the matrix of the preconditioner, PETSc scales A itself.
    """

    def __init__(self, A: PETSc.Mat, projected: ProjectedTangent, A_is_scaled: bool) -> None:
        self._A, self._projected, self._A_is_scaled = A, projected, A_is_scaled
        self._scale, self._scaled, self._more = (A.createVecLeft() for _ in range(3))
        self._scale.set(1.0)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._scaled.pointwiseMult(x, self._scale)
        self._projected.mult(self._scaled, self._more)
        if not self._A_is_scaled:
            self._A.multAdd(self._scaled, self._more, self._more)
        y.pointwiseMult(self._more, self._scale)
        if self._A_is_scaled:
            self._A.multAdd(x, y, y)

    def diagonalScale(self, mat: PETSc.Mat, left: PETSc.Vec, right: PETSc.Vec) -> None:
        self._scale.pointwiseMult(self._scale, left)

    def destroy(self, mat: PETSc.Mat) -> None:
        for vector in (self._scale, self._scaled, self._more):
            vector.destroy()
