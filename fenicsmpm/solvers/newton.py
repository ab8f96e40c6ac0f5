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
from fenicsmpm._display import Described, Facts
from fenicsmpm.solvers.checks import check_bcs
from fenicsmpm.solvers.linear import LinearSolver, LinearSolverError
from fenicsmpm.solvers.places import dof_positions, parts_of, sizes_of_cells
from fenicsmpm.solvers.pressure_level import require_pressure_level
from fenicsmpm.solvers.projected_tangent import ProjectedTangent
from fenicsmpm.solvers.stopwatch import Stopwatch
from fenicsmpm.solvers.supports import require_supports

if TYPE_CHECKING:
    from fenicsmpm.cells import Tying

logger = logging.getLogger(__name__)

# Round-off in sums of many terms, relative to the sum of their absolute values: the usual size, and
# the size that is accepted if a step does not reduce the residual
_ROUND_OFF, _MOST_ROUND_OFF = 1e-14, 1e-12
# The same relative to the change of the residual by the last bits of the unknown
_LAST_BITS = 20.0
# A residual that steps still reduce is not round-off if it is above this share of its terms, or
# above this multiple of its change by the last bits
_SMALL, _FAR = 1e-9, 1e3
# If an iteration reduces the residual by this factor or more, the next tangent keeps the terms of
# projections. These terms hardly change any more, and cost as much as the rest of the tangent.
_LAST_CHANGES = 1e-3
# A step of so many cells makes the solver look for what lacks a support
_VERY_FAR = 1e6
# Share of the work at which a line search stops, and its largest number of residuals
_HARDLY, _SEARCH = 0.1, 12


class NewtonError(RuntimeError):
    """Error for a failure of Newton's method; the unknown has its old values again.

    Attributes:
        reason: "diverged", "not finite", "linear solver", "load without material", "no support" or
            "inverted".
        message: What happened, and what to do.
        residuals: Residual norms so far.
    """

    def __init__(self, reason: str, message: str, residuals: Sequence[float]) -> None:
        """Combine reason and message."""
        super().__init__(f"Newton's method failed, {reason}: {message}")
        self.reason, self.message = reason, message
        self.residuals = list(residuals)

    def __reduce__(self) -> Any:
        """Return how to recreate the error on another rank."""
        return type(self), (self.reason, self.message, self.residuals)


@dataclass
class NewtonResult(Described):
    """Statistics of a solution by Newton's method.

    Attributes:
        iterations: Number of linear systems solved.
        linear_iterations: Number of Krylov iterations for these systems, 0 for direct solutions.
        tangents: Number of tangents assembled and factorized.
        residuals: Norms of the residual on free degrees of freedom, before the first and after each
            iteration.
        step_lengths: Factor applied to each Newton step, 1 unless the step was cut.
        seconds: Time spent on "assembly", on the "linear solver" and on the "matrix pattern" [s].
    """

    iterations: int = 0
    linear_iterations: int = 0
    tangents: int = 0
    residuals: list[float] = field(default_factory=list)
    step_lengths: list[float] = field(default_factory=list)
    seconds: Stopwatch = field(default_factory=Stopwatch)

    def _facts(self) -> Facts:
        facts = [
            ("Newton iterations", str(self.iterations)),
            ("tangents", str(self.tangents)),
            ("residuals", ", ".join(f"{norm:.3g}" for norm in self.residuals)),
        ]
        if any(length != 1 for length in self.step_lengths):
            facts.append(("step lengths", ", ".join(f"{s:g}" for s in self.step_lengths)))
        if self.linear_iterations:
            facts.append(("Krylov iterations", str(self.linear_iterations)))
        return [*facts, ("time spent", str(self.seconds))]


class NewtonSolver:
    """Newton's method with true residual norms and an optional line search.

    Args:
        R: Residual, a UFL form of rank 1 with integrals over points, cells or facets.
        U: The unknown in the residual.
        bcs: Dirichlet conditions.
        J: Tangent, a UFL form of rank 2. None for ``ufl.derivative(R, U)`` plus the contribution of
            each ``LumpedProjection`` in R.
        rtol: Tolerance of the residual relative to the first one [-]. A residual as small as the
            round-off in its own terms also counts as zero, whatever its units.
        atol: Absolute tolerance of the residual, in its units.
        max_iterations: Maximum number of linear systems to solve.
        keep_tangent: If an iteration reduces the residual to less than this fraction [-], the next
            iteration reuses the tangent. 0 is Newton's method. 0.01 saves assembly and
            factorization in steps so short that the first tangent suffices.
        line_search: Whether to shorten steps that do not decrease the residual: to the length at
            which the residual does no work on the step, if the step goes beyond that, and otherwise
            by halving. A step with a residual that is not finite is always halved.
        tying: Tied nodes with little mass, which are eliminated from the system. Residuals are then
            those of the remaining degrees of freedom.
        petsc_options: Options of the linear solver; see ``LinearSolver``. Without options, the
            tolerance of the linear solver is no tighter than Newton's method needs. For quadratic
            convergence to the end, give a Krylov method with "ksp_rtol", or use MUMPS with
            ``{"pc_type": "lu"}``.

    Attributes:
        R: Compiled residual.
        J: Compiled tangent.
        U: The unknown.
        bcs: Dirichlet conditions, which may be replaced between solutions.

    Raises:
        ValueError: If a tolerance or a number of iterations is impossible, or nodes are tied in
            another space.
    """

    def __init__(
        self,
        R: ufl.Form,
        U: fem.Function,
        bcs: Sequence[fem.DirichletBC] = (),
        *,
        J: ufl.Form | None = None,
        rtol: float = 1e-9,
        atol: float = 0.0,
        max_iterations: int = 25,
        keep_tangent: float = 0.0,
        line_search: bool = False,
        tying: Tying | None = None,
        petsc_options: dict[str, Any] | None = None,
    ) -> None:
        """Compile the forms. Collective."""
        if not 0 <= keep_tangent < 1:
            raise ValueError(f"keep_tangent must lie in [0, 1): {keep_tangent}")
        if not (0 <= rtol < 1 and 0 <= atol < math.inf):
            raise ValueError(
                "rtol must lie in [0, 1), and atol must be finite and not negative: "
                f"rtol = {rtol}, atol = {atol}"
            )
        if max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1: {max_iterations}")
        if not isinstance(U, fem.Function):
            raise TypeError(
                f"the unknown of Newton's method must be a dolfinx function, such as z.U, not {U}"
            )
        if tying is not None and tying.space != U.function_space:
            raise ValueError(
                "nodes are tied in another space than that of the unknown: create "
                "cells.Tying with the space of the unknown"
            )
        self.R = forms.form(R)
        self.J = forms.form(ufl.derivative(R, U) if J is None else J)
        self.U = U
        self.bcs = list(bcs)
        self.rtol, self.atol = rtol, atol
        self.max_iterations = max_iterations
        self.keep_tangent = keep_tangent
        self.line_search = line_search
        self.tying = tying
        mesh = self.J.mesh
        self._projected = ProjectedTangent(R if J is None else None, U, tying)
        self.linear = LinearSolver(mesh.comm, petsc_options, dim=mesh.geometry.dim)
        self._parts = parts_of(U.function_space)
        self._least = sizes_of_cells(U.function_space, self._parts)
        self._is_new = True
        self._A: PETSc.Mat | None = None
        self._versions: Any = None
        self._b = forms.petsc.create_vector(self.R)
        self._step = forms.petsc.create_vector(self.R)
        self._sizes = forms.petsc.create_vector(self.R)
        self._bits: npt.NDArray[np.float64] = np.full(len(self._parts), np.nan)

    def solve(self) -> NewtonResult:
        """Find U with R(U) = 0, starting from its current values. Collective.

        Returns:
            Iterations, residual norms and times.

        Raises:
            NewtonError: If the method fails. U then has its previous values.
            ValueError: If a Dirichlet condition is defined on another space or has no degrees of
                freedom, or if nothing fixes the level of the pressure.
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
        """Create a matrix for the current positions of the points; empty cells cost nothing."""
        versions = self.J.versions
        if versions != self._versions:
            self._versions = versions
            if self._A is not None:
                self._A.destroy()
            self._A = forms.petsc.create_matrix(self.J, compact=True)

    def _tie(self) -> None:
        """Find the nodes to tie, and start from a function that satisfies the ties."""
        assert self.tying is not None
        self.tying.update(_compat.fixed_dofs(self.bcs), forms.petsc.inactive_dofs(self.J, self._A))
        owned = len(self._step.array_r)
        self._step.array_w[:] = self.U.x.array[:owned]
        self.tying.extend(self._step)
        self.U.x.array[:owned] = self._step.array_r
        self.U.x.scatter_forward()

    def _iterate(self, result: NewtonResult) -> None:
        with result.seconds("assembly"):
            norm = self._first_norm()
        result.residuals.append(norm)
        self._require_finite(norm, result, "at the start")
        reference = norm
        logger.info("Newton       |R|          reduction  step")
        logger.info("  %3d    %.6e", 0, norm)
        reduction, scaled, first_scaled = 1.0, 0.0, 0.0
        while True:
            has_gap = self._has_gap()
            tolerance = max(self.atol, self.rtol * reference)
            # GMRES leaves a residual in all parts. The norm is dominated by forces and would miss
            # the residual of the volumes, hence the scaled norm.
            if norm <= tolerance and scaled <= self.rtol * first_scaled and not has_gap:
                return
            was_no_use = result.iterations > 0 and reduction > 0.5
            if not has_gap and self._is_round_off(was_no_use):
                logger.info("Newton: |R| is round-off of the terms in its sums")
                return
            if result.iterations == self.max_iterations:
                raise NewtonError(
                    "diverged",
                    f"|R| = {norm:.3e} after {self.max_iterations} iterations, above the tolerance "
                    f"{tolerance:.1e} (round-off at the start: about {self._round_off:.1e}); try "
                    "smaller load steps or line_search",
                    result.residuals,
                )
            if result.tangents == 0 or has_gap or reduction > self.keep_tangent:
                # Large systems are solved to a few digits only, so the last changes of projections
                # have no effect.
                stay = result.tangents > 0 and not has_gap and reduction <= _LAST_CHANGES
                with result.seconds("assembly"):
                    A = self._tangent(stay and self.linear.iterates(self._A))
                result.tangents += 1
            if has_gap:
                # U has not reached its constrained values yet. The step moves all of U with them.
                with result.seconds("assembly"):
                    norm = self._lifted_norm()
                reference = max(reference, norm)
            if result.iterations == 0:
                self._require_support(reference, result)
                if self._is_new:
                    V = self.U.function_space
                    require_pressure_level(A, V, self._parts, self._inactive())
                    self._require_held(A, result)
                    self._is_new = False
            try:
                with result.seconds("linear solver"):
                    products = self._projected if self._projected else None
                    rtol = 1e-4 if was_no_use else _forcing(norm, tolerance)
                    self.linear.solve(A, self._b, self._step, rtol, products)
                    first_scaled = max(first_scaled, self.linear.scaled_norm(self._b) or 0.0)
                    if self.tying is not None:
                        self.tying.extend(self._step)
            except LinearSolverError as error:
                self._require_held(A, result)
                raise NewtonError("linear solver", str(error), result.residuals) from error
            if self._is_far():
                self._require_held(A, result)
            with result.seconds("assembly"):
                previous, (norm, length) = norm, self._advance(norm, result)
            scaled = self.linear.scaled_norm(self._b) or 0.0
            result.iterations += 1
            result.linear_iterations += self.linear.iterations
            result.residuals.append(norm)
            result.step_lengths.append(length)
            reduction = norm / previous if previous > 0.0 else 1.0
            logger.info("  %3d    %.6e    %.1e    %g", result.iterations, norm, reduction, length)

    def _require_support(self, norm: float, result: NewtonResult) -> None:
        """Raise NewtonError for a load on nodes without material. Collective.

        No step could balance such a load.
        """
        rows = forms.petsc.unreached_rows(self._A)
        loads = np.zeros(len(self._b.array_r))
        loads[rows] = self._b.array_r[rows]
        for bc in self.bcs:
            _compat.bc_set(bc, loads, np.zeros(len(loads)), 0.0)
        comm = self.J.mesh.comm
        size = math.sqrt(comm.allreduce(float(loads @ loads), MPI.SUM))
        # Smaller loads cannot be distinguished from round-off, and do not prevent convergence.
        if size <= max(self.atol, self._round_off, max(self.rtol, 1e-8) * norm):
            return
        where = dof_positions(self.U.function_space)[: len(loads)]
        most = np.abs(loads).max(initial=0.0)
        here = (float(most), where[np.abs(loads) == most][:1].ravel().tolist())
        position = ", ".join(f"{x:.6g}" for x in max(comm.allgather(here))[1])
        raise NewtonError(
            "load without material",
            f"|R| = {size:.3e} on nodes of cells without a body, most at ({position}); give "
            "ActiveCells(body, loads=[..]) to the ghost penalty or to cells.Tying",
            result.residuals,
        )

    def _inactive(self) -> npt.NDArray[np.int32]:
        """Return the local dofs without material, and those of tied nodes. Collective."""
        inactive = forms.petsc.inactive_dofs(self.J, self._A)
        return inactive if self.tying is None else np.union1d(inactive, self.tying.tied_dofs)

    def _is_far(self) -> bool:
        """Return whether the step moves a node by very many cells. Collective."""
        step = np.abs(self._step.array_r)
        cells = self._least[: len(step)]
        here = bool(np.any((cells > 0) & (step > _VERY_FAR * cells)))
        return self.J.mesh.comm.allreduce(here, MPI.LOR)

    def _require_held(self, A: PETSc.Mat, result: NewtonResult) -> None:
        """Raise NewtonError if a rigid motion of the body has no resistance. Collective."""
        V = self.U.function_space
        error = require_supports(A, V, dof_positions(V), self._inactive())
        if error is not None:
            raise NewtonError("no support", error, result.residuals)

    def _advance(self, norm: float, result: NewtonResult) -> tuple[float, float]:
        """Take the Newton step, or the part of it that the line search allows."""
        old = self.U.x.array.copy()
        at_round_off = False
        with self._step.localForm() as local:
            self._step.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
            step = local.array_r.copy()
        length, work = 1.0, self._work(step) if self.line_search else 0.0
        while True:
            self.U.x.array[:] = old - length * step
            if length == 1.0:  # errors of the linear solver must not look like new Dirichlet data
                for bc in self.bcs:
                    _compat.bc_set(bc, self.U.x.array, None, 1.0)
            new = self._residual_norm()
            good = np.isfinite(new)
            if self.line_search:
                good &= new <= max((1 - 1e-4 * length) * norm, self.atol, self._round_off)
            if not good and length == 1.0 and np.isfinite(new):
                at_round_off = self._is_round_off(was_no_use=True)
            if good or at_round_off:
                break
            if self.line_search and np.isfinite(new) and self._work(step) < 0 < work:
                length, new = self._length_without_work(old, step, length, work)
                break
            length /= 2
            if length < 1e-3:
                self.U.x.array[:] = old - step
                self._require_finite(self._residual_norm(), result, "after the full step")
                raise NewtonError(
                    "diverged",
                    f"no step length down to {length * 2:g} decreases |R| = {norm:.3e}; try "
                    "smaller load steps, and check the tangent",
                    result.residuals,
                )
        self._require_finite(new, result, f"in iteration {result.iterations + 1}")
        return new, length

    def _work(self, step: npt.NDArray[np.float64]) -> float:
        """Return the work of the residual in b on a step, on free entries. Collective."""
        free = self._b.array_r.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, free, np.zeros(len(free)), 0.0)
        return self.J.mesh.comm.allreduce(float(free @ step[: len(free)]), MPI.SUM)

    def _length_without_work(
        self,
        old: npt.NDArray[np.float64],
        step: npt.NDArray[np.float64],
        length: float,
        work: float,
    ) -> tuple[float, float]:
        """Return the step length at which the residual does hardly any work, and its norm there.

        At the given ``length`` the work is negative, and b contains the residual. The sign of the
        work shows that a step is too long even where the residual grows for any length, such as
        across the corner between sticking and slipping (M. Crisfield, Non-linear Finite Element
        Analysis of Solids and Structures 1, 1991, section 9.2). The length is found by the regula
        falsi (Illinois).
        """
        low, high, at_low, at_high, before = 0.0, length, work, self._work(step), 0.0
        for _ in range(_SEARCH):
            length = (low * at_high - high * at_low) / (at_high - at_low)
            self.U.x.array[:] = old - length * step
            new, here = self._residual_norm(), self._work(step)
            if abs(here) <= _HARDLY * work:
                break
            again = 0.5 if here * before > 0 else 1.0
            if here > 0:
                low, at_low, at_high = length, here, again * at_high
            else:
                high, at_high, at_low = length, here, again * at_low
            before = here
        return length, new

    def _tangent(self, projections_stay: bool = False) -> PETSc.Mat:
        """Assemble the tangent; if nodes are tied, also lift b.

        Args:
            projections_stay: Whether to reuse the terms of projections from the last tangent.
        """
        with self._projected.held():
            self._projected.assemble(self.bcs, projections_stay)
            # An open contact reaches nodes with zeros only.
            idle = self._b.array_r == 0.0
            if self.tying is None:
                return forms.petsc.assemble_matrix(self.J, self.bcs, A=self._A, fill=idle)
            A = forms.petsc.assemble_matrix(self.J, A=self._A, fill=idle)
            self.tying.leave_out(forms.petsc.unreached_rows(A))
            A = self.tying.reduce(A, self._b)
            self._projected.lift(self._b)
            return A

    def _lifted_norm(self) -> float:
        """Return the norm of R - J (g - U), for a step that ends on the Dirichlet data."""
        if self.tying is None:
            self._residual_norm(lifted=True)
            self._projected.lift(self._b)
        free = self._b.array_r.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, free, np.zeros(len(free)), 0.0)
        return math.sqrt(self.J.mesh.comm.allreduce(float(free @ free), MPI.SUM))

    def _first_norm(self) -> float:
        """Return the norm of the residual, and store the size of its terms. Collective."""
        sizes = self._sizes
        with sizes.localForm() as local:
            local.set(0.0)
        norm = self._residual_norm(sizes=sizes)
        sizes.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        self._of_parts = self._norms_of_parts(sizes)
        self._round_off = _ROUND_OFF * float(np.linalg.norm(self._of_parts))
        # Once is enough: the size hardly changes, and each evaluation costs a residual.
        if not np.all(np.isfinite(self._bits)):
            self._bits = self._last_bits()
        return norm

    def _norms_of_parts(self, vector: PETSc.Vec) -> npt.NDArray[np.float64]:
        """Return the norm of each part of the unknown, on free degrees of freedom. Collective."""
        free = vector.array_r.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, free, np.zeros(len(free)), 0.0)
        owned = len(free)
        squares = np.array([np.sum(free[dofs[dofs < owned]] ** 2) for dofs in self._parts])
        return np.sqrt(self.J.mesh.comm.allreduce(squares, MPI.SUM))

    def _is_round_off(self, was_no_use: bool) -> bool:
        """Return whether the residual of each part is of the size of round-off. Collective.

        Args:
            was_no_use: Whether the last step did not reduce the residual.
        """
        norms, terms = self._norms_of_parts(self._b), self._of_parts
        if np.all(norms <= _ROUND_OFF * terms):
            return True
        if not was_no_use and not _is_near(norms, terms, self._bits):
            return False
        self._bits = self._last_bits()
        share = _MOST_ROUND_OFF if was_no_use else _ROUND_OFF
        return bool(np.all(norms <= share * terms + _LAST_BITS * self._bits))

    def _last_bits(self) -> npt.NDArray[np.float64]:
        """Return the change of each part's residual by the last bits of U. Collective."""
        b, x, present = self._b.copy(), self.U.x.array, self.U.x.array.copy()
        # The signs are irregular, since derivatives would not see a regular pattern. They agree on
        # all ranks.
        index_map, bs = self.U.function_space.dofmap.index_map, self.U.function_space.dofmap.bs
        blocks = index_map.local_to_global(np.arange(len(x) // bs, dtype=np.int32))
        indices = (blocks[:, None] * bs + np.arange(bs)).ravel()
        sign = np.where(np.sin(12.9898 * indices) > 0, 1.0, -1.0)
        x += sign * np.spacing(np.maximum(np.abs(x), self._least))
        with self._projected.kept():  # the next tangent takes them, as U is that of before
            self._residual_norm()
        x[:] = present
        self._b.axpy(-1.0, b)
        result = self._norms_of_parts(self._b)
        b.copy(self._b)
        b.destroy()
        return result

    def _residual_norm(self, lifted: bool = False, sizes: PETSc.Vec | None = None) -> float:
        """Assemble R(U) into b; constrained entries become U - g, which the norm omits.

        Args:
            lifted: Whether to subtract J (g - U), for a step that ends on the Dirichlet data.
            sizes: Vector to which the absolute values of the summed terms are added.
        """
        b, x = self._b, self.U.x.array
        self._assemble(lifted, sizes)
        owned = len(b.array_r)
        for bc in self.bcs:
            _compat.bc_set(bc, b.array_w, np.zeros(owned), 0.0)
        norm = b.norm()
        for bc in self.bcs:
            _compat.bc_set(bc, b.array_w, x[:owned], -1.0)
        return norm

    def _assemble(self, lifted: bool = False, sizes: PETSc.Vec | None = None) -> None:
        """Assemble R(U) into b, ignoring Dirichlet conditions."""
        b = self._b
        with b.localForm() as local:
            local.set(0.0)
        forms.petsc.assemble_vector(self.R, b, sizes)
        if lifted:
            with b.localForm() as local:
                forms.apply_lifting(local.array_w, [self.J], [self.bcs], [self.U.x.array], -1.0)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if self.tying is not None:
            self.tying.restrict(b)

    def residual(self) -> npt.NDArray[np.float64]:
        """Return R(U) on owned degrees of freedom, including reactions. Collective."""
        self._assemble()
        return self._b.array_r.copy()

    def _has_gap(self) -> bool:
        """Return whether U differs from its Dirichlet data anywhere. Collective."""
        x = self.U.x.array
        target = x.copy()
        for bc in self.bcs:
            _compat.bc_set(bc, target, None, 1.0)
        here = bool(np.any(np.abs(target - x) > 1e-14 * np.abs(target)))
        return self.J.mesh.comm.allreduce(here, MPI.LOR)

    def _require_finite(self, norm: float, result: NewtonResult, when: str) -> None:
        if not np.isfinite(norm):
            where = forms.describe_not_finite(self.R)
            raise NewtonError(
                "not finite",
                f"|R| = {norm} {when}; {where}. Try smaller load steps or line_search",
                result.residuals,
            )


def _forcing(norm: float, tolerance: float) -> float:
    """Return the tolerance of a linear system in an inexact Newton method.

    Three systems solved to 1e-4 are usually as good as three exact solutions, and need half the
    iterations. If one more system suffices to reach the tolerance, it is solved just accurately
    enough for that. GMRES measures the residual in other units than Newton's method, hence the
    margin.
    """
    wanted = 0.03 * tolerance / norm if norm > 0 else 0.0
    return min(0.01, wanted) if wanted > 1e-7 else 1e-4


def _is_near(
    norms: npt.NDArray[np.float64],
    terms: npt.NDArray[np.float64],
    last_bits: npt.NDArray[np.float64],
) -> bool:
    """Return whether residuals are so small that the test for round-off is worth its cost."""
    size, *limits = (float(np.linalg.norm(v)) for v in (norms, _SMALL * terms, _FAR * last_bits))
    return size <= max(limits)
