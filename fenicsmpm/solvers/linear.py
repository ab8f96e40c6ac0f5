# SPDX-License-Identifier: MIT
"""Linear systems by PETSc: MUMPS unless the options say otherwise."""

from __future__ import annotations

import itertools
from typing import Any

from petsc4py import PETSc

import numpy as np

from fenicsmpm._garbage import collect_garbage, lasting

# percent by which MUMPS' workspace exceeds its estimate, which pivoting makes too small
_WORKSPACE = "mat_mumps_icntl_14"
DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    _WORKSPACE: 100,
    # a new pattern in each step: AMD finds its order in no time, Scotch and METIS take longer than
    # the few factorizations that follow; AMF, a little faster, does not repeat runs on 3 ranks
    "mat_mumps_icntl_7": 0,
}
_numbers = itertools.count()


class LinearSolverError(RuntimeError):
    """A linear system could not be solved."""


class LinearSolver:
    """A Krylov or direct solver for systems with one matrix after the other.

    Args:
        comm: MPI communicator.
        petsc_options: PETSc options, on top of a direct solution by MUMPS.
        prefix: prefix of the options in PETSc's database, by which options of the command line
            reach the solver; None for one of its own.

    Attributes:
        ksp: the PETSc object.
    """

    def __init__(
        self, comm: Any, petsc_options: dict[str, Any] | None = None, prefix: str | None = None
    ) -> None:
        """Create the solver and hand over its options (collective)."""
        collect_garbage(comm)  # of earlier solvers, or MPI runs out of communicators
        # MUMPS reads its options as late as in the factorization: they stay in the database, so
        # each solver needs a prefix of its own
        prefix = f"fenicsmpm_{next(_numbers)}_" if prefix is None else prefix
        self._options = PETSc.Options(prefix)
        for key, value in (DIRECT | (petsc_options or {})).items():
            if not self._options.hasName(key):
                self._options[key] = value
            if key in DIRECT:
                self._options.getString(key)  # "used", so PETSc does not list it at the end
        self.ksp = PETSc.KSP().create(lasting(comm))
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setFromOptions()

    def solve(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve A x = b (collective).

        Args:
            A: assembled matrix.
            b: right-hand side.
            x: solution, overwritten.

        Returns:
            Number of Krylov iterations.

        Raises:
            LinearSolverError: names PETSc's reason; a singular matrix is the usual one.
        """
        reason = self._try(A, b, x)
        while reason < 0 and self._mumps_wants_memory():
            workspace = 2 * self._options.getInt(_WORKSPACE)
            if workspace > 1000:
                break
            self._options[_WORKSPACE] = workspace
            reason = self._try(A, b, x)
        if reason >= 0 and not np.isfinite(x.norm()):
            raise LinearSolverError(
                "the solution is not finite: the matrix or the right-hand side has NaN or infinite "
                "entries, or the matrix is singular"
            )
        if reason < 0:
            raise LinearSolverError(
                f"the linear solver failed ({_reason(reason)}, "
                f"{self.ksp.getType()} + {self.ksp.getPC().getType()}): the matrix may be "
                "singular; check the Dirichlet conditions, and that equal-order pressure is "
                "stabilized"
            )
        return self.ksp.getIterationNumber()

    def _try(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> int:
        if self.ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED:
            self.ksp.reset()  # PETSc would report the failed set-up again
        self.ksp.setOperators(A)
        self.ksp.solve(b, x)
        return self.ksp.getConvergedReason()

    def _mumps_wants_memory(self) -> bool:
        """Whether MUMPS gave up because pivoting needed more workspace than it had estimated."""
        pc = self.ksp.getPC()
        if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
            return False
        return pc.getFactorMatrix().getMumpsInfog(1) in (-8, -9)


def _reason(number: int) -> str:
    names = PETSc.KSP.ConvergedReason.__dict__
    return next(
        (n for n, v in names.items() if v == number and n.startswith("DIVERGED")), str(number)
    )
