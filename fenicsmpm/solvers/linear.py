# SPDX-License-Identifier: MIT
"""Linear systems by PETSc: directly where that is cheap, by a Krylov method where it is not."""

from __future__ import annotations

import ctypes
import itertools
import logging
import time
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np

from fenicsmpm._garbage import collect_garbage, lasting

logger = logging.getLogger(__name__)

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
# Residuals are true ones (right side), in units in which those of all parts compare (scale)
KRYLOV = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",
    "ksp_gmres_restart": 100,
    "ksp_diagonal_scale": None,
    "ksp_diagonal_scale_fix": None,
    "ksp_max_it": 300,
    "pc_type": "bjacobi",
    "sub_pc_type": "ilu",
}
# For a matrix beside which there are terms that are known by their products only: MUMPS' factors of
# the matrix are the preconditioner
WITH_FACTORS = {**KRYLOV, **DIRECT, "ksp_type": "gmres", "ksp_max_it": 100}
del WITH_FACTORS["sub_pc_type"]
# Unknowns with material from which factors in space cost more than iterations; in the plane they
# do not before there are millions
_MANY = 15_000
# Without a tolerance given, and the best that single systems are solved to
TIGHT = 1e-12
_numbers = itertools.count()


class Products(Protocol):
    """Terms of a matrix that are known by their products with vectors."""

    def operator(self, A: PETSc.Mat) -> PETSc.Mat:
        """A and the terms by their products, which follow a scaling of A (collective)."""

    def matrix(self, A: PETSc.Mat) -> PETSc.Mat:
        """A and the terms as a matrix, which the owner of the terms keeps (collective)."""


class LinearSolverError(RuntimeError):
    """A linear system could not be solved."""


class LinearSolver:
    """Solves systems with one matrix after the other.

    By default MUMPS factorizes, but for large systems in three dimensions. GMRES solves these with
    incomplete factors, ILU(0) of each rank's part and of a layer around it, in 300 iterations at
    most. Where terms are added to a matrix by their products, GMRES solves all systems; MUMPS'
    factors of the matrix are the preconditioner of those that are not large, with 100 iterations at
    most. Where GMRES fails, MUMPS solves the whole system.

    Args:
        comm: MPI communicator.
        petsc_options: PETSc options. Those with a "pc_type" other than "lu" stand alone; otherwise
            they change those of MUMPS, which then solves all systems. None for the choice above.
        prefix: prefix of the options in PETSc's database, by which options of the command line
            reach the solver; None for one of its own.
        dim: dimension of the mesh.

    Attributes:
        ksp: the PETSc object of the options, or of MUMPS.
        method: by which the last system was solved.
        iterations: of the last system; 0 if MUMPS solved it.
        systems: solved so far.
        total_iterations: of all systems so far.
        direct_after_all: systems so far that MUMPS solved where GMRES did not converge.
        seconds: spent so far [s].

    Raises:
        ValueError: for options that PETSc refuses, such as preconditioners that its build lacks.
    """

    def __init__(
        self,
        comm: Any,
        petsc_options: dict[str, Any] | None = None,
        prefix: str | None = None,
        *,
        dim: int = 2,
    ) -> None:
        """Create the solver and hand over its options (collective)."""
        collect_garbage(comm)  # of earlier solvers, or MPI runs out of communicators
        given = petsc_options or {}
        options = DIRECT | given if given.get("pc_type", "lu") == "lu" else given
        self._comm, self._given = comm, list(given)
        self.ksp, self._options = _create(comm, options, prefix)
        self._gmres: dict[str, _Gmres] = {}
        self._is_automatic, self._dim = not given, dim
        self._scale: PETSc.Vec | None = None
        self.method, self.iterations, self.systems = "", 0, 0
        self.total_iterations, self.direct_after_all, self.seconds = 0, 0, 0.0

    def solve(
        self,
        A: PETSc.Mat,
        b: PETSc.Vec,
        x: PETSc.Vec,
        rtol: float = TIGHT,
        products: Products | None = None,
    ) -> int:
        """Solve A x = b (collective).

        Args:
            A: assembled matrix.
            b: right-hand side.
            x: solution, overwritten.
            rtol: tolerance of the residual relative to b, for iterations that were chosen here;
                PETSc options have their own.
            products: terms that are added to the matrix.

        Returns:
            Number of Krylov iterations.

        Raises:
            LinearSolverError: names PETSc's reason; a singular matrix is the usual one.
            ValueError: for options that PETSc did not use, at the first system.
        """
        begin = time.perf_counter()
        try:
            self._solve(A, b, x, rtol, products)
        finally:
            self.seconds += time.perf_counter() - begin
        self.systems += 1
        self.total_iterations += self.iterations
        if self._given:
            self._require_used()
        return self.iterations

    def iterates(self, A: PETSc.Mat) -> bool:
        """Whether GMRES with incomplete factors is tried first (collective).

        Args:
            A: assembled matrix.
        """
        return self._is_automatic and self._dim == 3 and _is_large(A)

    def scaled_norm(self, b: PETSc.Vec) -> float | None:
        """Norm of a residual as GMRES sees it; None if MUMPS solved the system (collective).

        Args:
            b: residual.
        """
        if self._scale is None:
            return None
        scaled = b.duplicate()
        scaled.pointwiseMult(b, self._scale)
        norm = float(scaled.norm())
        scaled.destroy()
        return norm

    def __repr__(self) -> str:
        """What it has done."""
        if not self.systems:
            return "LinearSolver(no system yet)"
        failed = f", {self.direct_after_all} of them without success" * (self.direct_after_all > 0)
        return (
            f"LinearSolver({self.method}, {self.systems} systems, {self.total_iterations} "
            f"iterations{failed}, {self.seconds:.3g} s)"
        )

    def _solve(
        self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, rtol: float, products: Products | None
    ) -> None:
        if self._scale is not None:
            self._scale.destroy()
            self._scale = None
        is_large = self.iterates(A)
        if is_large or (products is not None and self._is_automatic):
            if self._iterate(A, b, x, rtol, products, is_large):
                return
            self.direct_after_all += 1
        self._solve_by_options(A if products is None else products.matrix(A), b, x)

    def _solve_by_options(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        reason = self._try(A, b, x)
        while reason < 0 and self._mumps_wants_memory():
            workspace = 2 * self._options.getInt(_WORKSPACE)
            if workspace > 1000:
                break
            self._options[_WORKSPACE] = workspace
            reason = self._try(A, b, x)
        pc = self.ksp.getPC()
        is_direct = self.ksp.getType() == "preonly"
        self.method = f"{self.ksp.getType()} + {pc.getType()}"
        if pc.getType() in ("lu", "cholesky"):
            self.method = str(pc.getFactorSolverType())
        self.iterations = 0 if is_direct else self.ksp.getIterationNumber()
        if reason >= 0 and not np.isfinite(x.norm()):
            raise LinearSolverError(
                "the solution is not finite: the matrix or the right-hand side has NaN or infinite "
                "entries, or the matrix is singular"
            )
        if reason < 0:
            described = f"{_reason(reason)}, {self.ksp.getType()} + {pc.getType()}"
            if reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
                raise LinearSolverError(
                    f"the linear solver failed ({described}): {self.iterations} iterations did not "
                    "suffice; give it more (ksp_max_it), another preconditioner, or leave the "
                    "choice to the package (no petsc_options)"
                )
            raise LinearSolverError(
                f"the linear solver failed ({described}): the matrix may be singular; check the "
                "Dirichlet conditions, and that equal-order pressure is stabilized"
            )

    def _iterate(
        self,
        A: PETSc.Mat,
        b: PETSc.Vec,
        x: PETSc.Vec,
        rtol: float,
        products: Products | None,
        is_large: bool,
    ) -> bool:
        """Whether GMRES has solved the system."""
        kind = "ILU(0)" if is_large else "mumps"
        if kind not in self._gmres:
            self._gmres[kind] = _Gmres(self._comm, is_large)
        self._scale = A.getDiagonal()
        diagonal = np.abs(self._scale.array_r)
        self._scale.array_w[:] = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        operator = A if products is None else products.operator(A)
        reason, self.iterations = self._gmres[kind].solve(operator, A, b, x, rtol)
        if products is not None:
            operator.destroy()
        self.method = f"GMRES + {kind}"
        if reason > 0 and np.isfinite(x.norm()):
            logger.info("GMRES: %d iterations for a reduction of %.0e", self.iterations, rtol)
            return True
        logger.info(
            "GMRES has failed after %d iterations (%s): MUMPS solves this system",
            self.iterations,
            _reason(reason),
        )
        self._scale.destroy()
        self._scale = None
        return False

    def _require_used(self) -> None:
        """Raise ValueError for options that PETSc has not asked for."""
        prefix = self.ksp.getOptionsPrefix()
        unused = [key for key in self._given if not _is_used(prefix + key)]
        self._given = []
        if unused:
            raise ValueError(
                f"PETSc did not use the option{'s' * (len(unused) > 1)} {', '.join(unused)}: a "
                "slip of the pen, or of another solver than the one chosen"
            )

    def _try(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> int:
        if self.ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED:
            self.ksp.reset()  # PETSc would report the failed set-up again
        self.ksp.setOperators(A)
        try:
            self.ksp.solve(b, x)
        except PETSc.Error as error:
            raise LinearSolverError(f"PETSc: {_last_line(error)}") from error
        return self.ksp.getConvergedReason()

    def _mumps_wants_memory(self) -> bool:
        """Whether MUMPS gave up because pivoting needed more workspace than it had estimated."""
        pc = self.ksp.getPC()
        if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
            return False
        return pc.getFactorMatrix().getMumpsInfog(1) in (-8, -9)


class _Gmres:
    """GMRES with incomplete factors of a matrix, or with those of MUMPS.

    Factors serve as long as the values of the matrix stay. Those of MUMPS serve for the next
    values, too, as long as the iterations that these take more cost less than new factors.
    """

    def __init__(self, comm: Any, is_large: bool) -> None:
        options = WITH_FACTORS
        if is_large:
            # parts that overlap by a layer take two thirds of the iterations
            options = KRYLOV | ({"pc_type": "asm"} if comm.size > 1 else {})
        self._ksp, _ = _create(comm, options, None)
        self._keeps = not is_large
        self._matrix: PETSc.Mat | None = None
        self._state, self._are_of_these_values = -1, False
        # iterations for a tenth of the residual, and those that cost as much as new factors
        self._fresh, self._last, self._worth = 0.0, 0.0, 0.0

    def solve(
        self, operator: PETSc.Mat, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, rtol: float
    ) -> tuple[int, int]:
        """PETSc's reason and the number of iterations (collective)."""
        ksp = self._ksp
        failed = ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
        is_new = failed or A is not self._matrix
        if is_new:
            ksp.reset()  # PETSc keeps the overlap of the first pattern
        self._matrix = A
        more = 4 * (self._last - self._fresh)  # for a usual reduction
        is_same = self._are_of_these_values and not is_new and A.stateGet() == self._state
        reuses = is_same or (self._keeps and not is_new and more <= self._worth)
        ksp.setTolerances(rtol=rtol)
        while True:
            ksp.getPC().setReusePreconditioner(reuses)
            ksp.setOperators(operator, A)
            ksp.solve(b, x)
            reason, iterations = ksp.getConvergedReason(), ksp.getIterationNumber()
            if reason > 0 or not reuses or is_same:
                break
            reuses = False
        ksp.setOperators(A)  # the other one may be destroyed now
        self._are_of_these_values = is_same or not reuses
        self._state = A.stateGet()  # scaling there and back has changed it
        self._last = iterations / -np.log10(rtol)
        if not reuses:
            self._fresh = self._last
            if self._keeps and reason > 0:
                self._worth = _iterations_for_factors(ksp.getPC().getFactorMatrix())
        return reason, iterations


def _iterations_for_factors(F: PETSc.Mat) -> float:
    """Solutions with factors of MUMPS that take as long as to compute them, about (collective).

    By counts, not by the clock, so that runs repeat: factors are computed at the speed of the
    processor, and used at that of memory.
    """
    operations, entries = F.getMumpsRinfog(3), F.getMumpsInfog(29)
    entries = entries if entries > 0 else -1e6 * entries  # millions, where there are many
    return operations / (30 * entries)


def _create(
    comm: Any, options: dict[str, Any], prefix: str | None
) -> tuple[PETSc.KSP, PETSc.Options]:
    """A solver with these options, unless the command line has others."""
    # MUMPS reads its options as late as in the factorization: they stay in the database, so each
    # solver needs a prefix of its own
    prefix = f"fenicsmpm_{next(_numbers)}_" if prefix is None else prefix
    database = PETSc.Options(prefix)
    for key, value in options.items():
        if not database.hasName(key):
            database[key] = value
        if DIRECT.get(key) == value or KRYLOV.get(key) == value:
            database.getString(key, "")  # "used", so PETSc does not list it at the end
    ksp = PETSc.KSP().create(lasting(comm))
    ksp.setOptionsPrefix(prefix)
    try:
        ksp.setFromOptions()
    except PETSc.Error as error:
        ksp.destroy()
        shown = ", ".join(f"{key} = {value}" for key, value in options.items())
        raise ValueError(f"PETSc refuses the options {shown}: {_last_line(error)}") from error
    return ksp, database


def _is_large(A: PETSc.Mat) -> bool:
    """Whether many rows have more than the diagonal (collective)."""
    n = A.getSize()[0]
    if n < _MANY:
        return False
    entries = A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    # rows of the identity have one entry, those of displacements on tetrahedra about 45
    return bool((entries - n) / 45 > _MANY)


def _is_used(name: str) -> bool:
    """Whether PETSc has asked for an option; petsc4py does not tell."""
    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return used.value != 0


def _last_line(error: PETSc.Error) -> str:
    """What PETSc says of an error, without the way to it."""
    return str(error).strip().splitlines()[-1].strip()


def _reason(number: int) -> str:
    names = PETSc.KSP.ConvergedReason.__dict__
    return next(
        (n for n, v in names.items() if v == number and n.startswith("DIVERGED")), str(number)
    )
