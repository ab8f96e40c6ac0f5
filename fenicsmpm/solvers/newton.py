# SPDX-License-Identifier: MIT
"""Newton's method for forms over material points."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat, forms
from fenicsmpm.solvers.checks import check_bcs
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError
from fenicsmpm.solvers.pressure_level import require_pressure_level
from fenicsmpm.solvers.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fenicsmpm.cells import Tying

logger = logging.getLogger(__name__)


class NewtonError(RuntimeError):
    """Newton's method failed; the unknown has its old values again.

    Attributes:
        reason: "diverged", "not finite", "linear solver", "load without material" or "inverted".
        residuals: residual norms so far.
    """

    def __init__(self, reason: str, message: str, residuals: Sequence[float]) -> None:
        """Join reason and message."""
        super().__init__(f"Newton's method failed, {reason}: {message}")
        self.reason, self.message = reason, message
        self.residuals = list(residuals)

    def __reduce__(self) -> Any:
        """How to make it anew, on another rank."""
        return type(self), (self.reason, self.message, self.residuals)


@dataclass
class NewtonResult:
    """How a solution was found.

    Attributes:
        iterations: number of linear systems solved.
        tangents: number of tangents assembled and factorized.
        residuals: norm of the residual on free degrees of freedom before and after each.
        step_lengths: factor applied to each Newton step, 1 unless the line search cut it.
        seconds: time spent on "assembly" and on the "linear solver" [s].
    """

    iterations: int = 0
    tangents: int = 0
    residuals: list[float] = field(default_factory=list)
    step_lengths: list[float] = field(default_factory=list)
    seconds: Stopwatch = field(default_factory=Stopwatch)


class NewtonSolver:
    """Newton's method with true residual norms and, if wanted, a line search.

    Args:
        R: residual, UFL form of rank 1 with integrals over points, cells or facets.
        U: the unknown in it.
        bcs: Dirichlet conditions.
        J: tangent; None for ``ufl.derivative(R, U)``.
        rtol: tolerance of the residual relative to the first one.
        atol: absolute tolerance of the residual.
        max_iterations: linear systems to solve at most.
        keep_tangent: reduction of the residual by an iteration up to which the next one uses the
            same tangent: 0 is Newton's method, and 0.01 saves assembling and factorizing where
            steps are so small that the first tangent serves to the end.
        line_search: halve a step while the residual does not decrease; while it is not finite, a
            step is halved in any case.
        tying: takes nodes of little mass out of the system; residuals are then those of the rest.
        petsc_options: options of the linear solver, see ``LinearSolver``.

    Attributes:
        R: compiled residual.
        J: compiled tangent.
        U: the unknown.
        bcs: Dirichlet conditions, may be replaced between solutions.

    Raises:
        ValueError: for a reduction out of range, and a tying in another space.
    """

    def __init__(
        self,
        R: ufl.Form,
        U: fem.Function,
        bcs: Sequence[fem.DirichletBC] = (),
        *,
        J: ufl.Form | None = None,
        rtol: float = 1e-9,
        atol: float = 1e-12,
        max_iterations: int = 25,
        keep_tangent: float = 0.0,
        line_search: bool = False,
        tying: Tying | None = None,
        petsc_options: dict[str, Any] | None = None,
    ) -> None:
        """Compile the forms (collective)."""
        if not 0 <= keep_tangent < 1:
            raise ValueError(f"keep_tangent must lie in [0, 1): {keep_tangent}")
        if tying is not None and tying.space != U.function_space:
            raise ValueError("nodes are tied in another space than that of the unknown")
        self.R = forms.form(R)
        self.J = forms.form(ufl.derivative(R, U) if J is None else J)
        self.U = U
        self.bcs = list(bcs)
        self.rtol, self.atol = rtol, atol
        self.max_iterations = max_iterations
        self.keep_tangent = keep_tangent
        self.line_search = line_search
        self.tying = tying
        self.linear = LinearSolver(self.J.mesh.comm, petsc_options)
        self._parts = _parts(U.function_space)
        self._is_new = True
        self._A: PETSc.Mat | None = None
        self._versions: Any = None
        self._b = forms.petsc.create_vector(self.R)
        self._step = forms.petsc.create_vector(self.R)

    def solve(self) -> NewtonResult:
        """Find U with R(U) = 0, starting from its present values (collective).

        Returns:
            Iterations and residual norms.

        Raises:
            NewtonError: why it failed; U then has the values that it had before.
            ValueError: for Dirichlet conditions on another space, or on no degrees of freedom, and
                for a pressure whose level nothing holds.
        """
        check_bcs(self.bcs, self.U.function_space)
        result = NewtonResult()
        with result.seconds("matrix pattern"):
            self._prepare_matrix()
        start = self.U.x.array.copy()
        try:
            if self.tying is not None:
                self._tie()
            self._iterate(result)
        except BaseException:
            self.U.x.array[:] = start
            raise
        return result

    def _prepare_matrix(self) -> None:
        """A matrix with room for the points where they are now; cells without any cost nothing."""
        versions = self.J.versions
        if versions != self._versions:
            self._versions = versions
            if self._A is not None:
                self._A.destroy()
            self._A = forms.petsc.create_matrix(self.J, compact=True)

    def _tie(self) -> None:
        """Find the nodes to be tied, and start from a function that obeys."""
        assert self.tying is not None
        self.tying.update(_compat.fixed_dofs(self.bcs), forms.inactive_dofs(self.J))
        owned = len(self._step.array_r)
        self._step.array_w[:] = self.U.x.array[:owned]
        self.tying.extend(self._step)
        self.U.x.array[:owned] = self._step.array_r
        self.U.x.scatter_forward()

    def _iterate(self, result: NewtonResult) -> None:
        self._stagnates = False
        with result.seconds("assembly"):
            norm = self._residual_norm()
        result.residuals.append(norm)
        self._require_finite(norm, result, "at the start")
        reference = norm
        logger.info("Newton       |R|          reduction  step")
        logger.info("  %3d    %.6e", 0, norm)
        reduction = 1.0
        while True:
            has_gap = self._has_gap()
            converged = norm <= max(self.atol, self.rtol * reference) or self._stagnates
            if converged and not has_gap:
                return
            if result.iterations == self.max_iterations:
                raise NewtonError(
                    "diverged",
                    f"|R| = {norm:.3e} after {self.max_iterations} iterations, "
                    f"{self.rtol * reference:.1e} wanted; try smaller load steps or line_search",
                    result.residuals,
                )
            if result.tangents == 0 or has_gap or reduction > self.keep_tangent:
                with result.seconds("assembly"):
                    A = self._tangent()
                result.tangents += 1
            if has_gap:
                # the constrained values are still to be reached: the step moves all of U with them
                with result.seconds("assembly"):
                    norm = self._lifted_norm()
                reference = max(reference, norm)
            if result.iterations == 0:
                self._require_support(reference, result)
                if self._is_new:
                    inactive = forms.inactive_dofs(self.J)
                    if self.tying is not None:
                        inactive = np.union1d(inactive, self.tying.tied_dofs)
                    require_pressure_level(A, self.U.function_space, self._parts, inactive)
                    self._is_new = False
            try:
                with result.seconds("linear solver"):
                    self.linear.solve(A, self._b, self._step)
                    if self.tying is not None:
                        self.tying.extend(self._step)
            except LinearSolverError as error:
                raise NewtonError("linear solver", str(error), result.residuals) from error
            with result.seconds("assembly"):
                previous, norm, length = norm, *self._advance(norm, result)
            result.iterations += 1
            result.residuals.append(norm)
            result.step_lengths.append(length)
            reduction = norm / previous if previous > 0.0 else 1.0
            logger.info("  %3d    %.6e    %.1e    %g", result.iterations, norm, reduction, length)

    def _require_support(self, norm: float, result: NewtonResult) -> None:
        """No load where there is nothing to carry it, which no step would change (collective)."""
        rows = forms.petsc.unreached_rows(self._A)
        loads = np.zeros(len(self._b.array_r))
        loads[rows] = self._b.array_r[rows]
        for bc in self.bcs:
            _compat.bc_set(bc, loads, np.zeros(len(loads)), 0.0)
        comm = self.J.mesh.comm
        size = math.sqrt(comm.allreduce(float(loads @ loads), MPI.SUM))
        # less than that cannot be told from round-off, nor does it keep the method from its end
        if size <= max(self.atol, max(self.rtol, 1e-8) * norm):
            return
        where = _dof_positions(self.U.function_space)[: len(loads)]
        most = np.abs(loads).max(initial=0.0)
        here = (float(most), where[np.abs(loads) == most][:1].ravel().tolist())
        position = ", ".join(f"{x:.6g}" for x in max(comm.allgather(here))[1])
        raise NewtonError(
            "load without material",
            f"|R| = {size:.3e} on nodes of cells without a body, most at ({position}); give "
            "ActiveCells(body, loads=[..]) to the ghost penalty or to cells.Tying",
            result.residuals,
        )

    def _advance(self, norm: float, result: NewtonResult) -> tuple[float, float]:
        """Take the Newton step, or as much of it as the line search allows."""
        old = self.U.x.array.copy()
        with self._step.localForm() as local:
            self._step.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
            step = local.array_r.copy()
        length = 1.0
        while True:
            self.U.x.array[:] = old - length * step
            new = self._residual_norm()
            good = np.isfinite(new)
            if self.line_search:
                good &= new <= max((1 - 1e-4 * length) * norm, self.atol)
            if good or self._is_negligible(step):
                break
            length /= 2
            if length < 1e-3:
                self.U.x.array[:] = old - step
                self._require_finite(self._residual_norm(), result, "after the full step")
                raise NewtonError(
                    "diverged",
                    f"no step length down to {length * 2:g} decreases |R| = {norm:.3e}",
                    result.residuals,
                )
        self._require_finite(new, result, f"in iteration {result.iterations + 1}")
        if length == 1.0:
            for bc in self.bcs:  # round-off of the linear solver must not look like new data
                _compat.bc_set(bc, self.U.x.array, None, 1.0)
            # a residual of round-off from the start cannot be reduced; then steps are round-off
            self._stagnates = self._is_negligible(step)
        return new, length

    def _tangent(self) -> PETSc.Mat:
        """Assemble the tangent; if nodes are tied, b is lifted by the way."""
        if self.tying is None:
            return forms.petsc.assemble_matrix(self.J, self.bcs, A=self._A)
        return self.tying.reduce(forms.petsc.assemble_matrix(self.J, A=self._A), self._b)

    def _lifted_norm(self) -> float:
        """Norm of R less J (g - U), for a step that ends on the Dirichlet data."""
        if self.tying is None:
            return self._residual_norm(lifted=True)
        free = self._b.array_r.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, free, np.zeros(len(free)), 0.0)
        return math.sqrt(self.J.mesh.comm.allreduce(float(free @ free), MPI.SUM))

    def _residual_norm(self, lifted: bool = False) -> float:
        """Assemble R(U) into b; constrained entries become U - g, which the norm leaves out.

        Args:
            lifted: subtract J (g - U) for a step that ends on the Dirichlet data.
        """
        b, x = self._b, self.U.x.array
        with b.localForm() as local:
            local.set(0.0)
        forms.petsc.assemble_vector(self.R, b)
        if lifted:
            with b.localForm() as local:
                forms.apply_lifting(local.array_w, [self.J], [self.bcs], [x], -1.0)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if self.tying is not None:
            self.tying.restrict(b)
        owned = len(b.array_r)
        for bc in self.bcs:
            _compat.bc_set(bc, b.array_w, np.zeros(owned), 0.0)
        norm = b.norm()
        for bc in self.bcs:
            _compat.bc_set(bc, b.array_w, x[:owned], -1.0)
        return norm

    def _has_gap(self) -> bool:
        """Whether U differs from its Dirichlet data anywhere (collective)."""
        x = self.U.x.array
        target = x.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, target, None, 1.0)
        here = bool(np.any(np.abs(target - x) > 1e-14 * np.abs(target)))
        return self.J.mesh.comm.allreduce(here, MPI.LOR)

    def _is_negligible(self, step: npt.NDArray[np.float64]) -> bool:
        """Whether a step changes each part of U by round-off only (collective)."""
        x, comm = self.U.x.array, self.J.mesh.comm
        for dofs in self._parts:
            change = float(np.max(np.abs(step[dofs]), initial=0.0))
            size = float(np.max(np.abs(x[dofs]), initial=0.0))
            if comm.allreduce(change, MPI.MAX) > 1e-12 * comm.allreduce(size, MPI.MAX):
                return False
        return True

    def _require_finite(self, norm: float, result: NewtonResult, when: str) -> None:
        if not np.isfinite(norm):
            where = forms.describe_not_finite(self.R)
            raise NewtonError(
                "not finite",
                f"|R| = {norm} {when}; {where}. Try smaller load steps or line_search",
                result.residuals,
            )


def _dof_positions(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """``(n_dofs, d)`` positions of the local degrees of freedom, unrolled (collective)."""
    bs, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    if V.num_sub_spaces == 0 or bs > 1:
        return np.repeat(V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim], bs, axis=0)
    result = np.empty((index_map.size_local + index_map.num_ghosts, V.mesh.geometry.dim))
    for i in range(V.num_sub_spaces):
        space, dofs = V.sub(i).collapse()
        result[dofs] = _dof_positions(space)
    return result


def _parts(V: fem.FunctionSpace) -> list[npt.NDArray[np.int64]]:
    """Local dofs of the parts of a mixed space, whose values differ in unit; one if not mixed."""
    if V.dofmap.index_map_bs > 1 or V.num_sub_spaces == 0:
        index_map = V.dofmap.index_map
        size = (index_map.size_local + index_map.num_ghosts) * V.dofmap.index_map_bs
        return [np.arange(size)]
    return [np.unique(V.sub(i).dofmap.list) for i in range(V.num_sub_spaces)]
