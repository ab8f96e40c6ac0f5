# SPDX-License-Identifier: MIT
"""Linear systems with PETSc, solved directly or, where that is cheaper, by a Krylov method."""

from __future__ import annotations

import ctypes
import itertools
import logging
import time
from collections.abc import Mapping
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np

from fenicsmpm._garbage import collect_garbage, lasting

logger = logging.getLogger(__name__)

# Percentage by which the workspace of MUMPS exceeds its estimate, since pivoting needs more
_WORKSPACE = "mat_mumps_icntl_14"
_ORDERING = "mat_mumps_icntl_7"
DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    _WORKSPACE: 100,
    # Each step has a new sparsity pattern. AMD orders it in almost no time, whereas Scotch and
    # METIS take longer than the few factorizations that follow.
    _ORDERING: 0,
}
# Preconditioning from the right gives true residuals. Diagonal scaling makes the residuals of all
# parts comparable.
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
# Number of unknowns with material above which factorizations in 3D cost more than iterations. In
# 2D this happens only with millions of unknowns.
_MANY = 15_000
# Number of iterations that take as long as ILU(0) of a matrix with 45 entries per row
_ILU = 10.0
# Default tolerance, and the tightest one for single systems
TIGHT = 1e-12
_numbers = itertools.count()
_NOT_POSITIVE = (
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
)
# Errors of PETSc: not supported, unknown type, missing factorization (petscerror.h)
_REFUSED = (56, 86, 92)


class Products(Protocol):
    """Interface of matrix terms that are known by their products with vectors."""

    def operator(self, A: PETSc.Mat, preconditions: bool) -> PETSc.Mat:
        """Return A plus the terms as an operator that can be scaled. Collective.

        Args:
            A: Assembled matrix.
            preconditions: Whether A is also the matrix of the preconditioner. Then PETSc scales A
                by itself.
        """

    def preconditioner(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return A plus those terms that a preconditioner needs, as a new matrix. Collective.

        Args:
            A: Assembled matrix.
        """

    def matrix(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return A plus the terms as a matrix, which the owner of the terms keeps. Collective.

        Args:
            A: Assembled matrix.
        """


class LinearSolverError(RuntimeError):
    """Error for a linear system that could not be solved."""


class LinearSolver:
    """Solver for a sequence of linear systems.

    By default, MUMPS factorizes the matrix. There are two exceptions:

    - Large systems in three dimensions are solved by GMRES with at most 300 iterations. The
      preconditioner is ILU(0) of the part of each rank, extended by an overlap of one layer.
    - Systems with terms that are given by their products are always solved by GMRES. If such a
      system is not large, MUMPS factorizes the matrix and the part of these terms that couples
      scalars. With these factors as preconditioner, GMRES has at most 100 iterations.

    If GMRES fails, MUMPS solves the whole system.

    Args:
        comm: MPI communicator.
        petsc_options: PETSc options. With a "pc_type" other than "lu" they replace the default
            options. Otherwise they modify the options of MUMPS, which then solves all systems. None
            for the automatic choice above.
        prefix: Prefix of the options in the database of PETSc, by which command-line options reach
            the solver. None for a unique prefix.
        dim: Dimension of the mesh.

    Attributes:
        ksp: PETSc solver with the given options, or with those of MUMPS.
        method: Method that solved the last system.
        iterations: Krylov iterations for the last system, 0 if MUMPS solved it.
        systems: Number of systems solved so far.
        total_iterations: Krylov iterations for all systems so far.
        direct_after_all: Number of systems so far that MUMPS solved because GMRES did not converge.
        seconds: Time spent so far [s].

    Raises:
        TypeError: If the options are no dictionary.
        ValueError: If PETSc rejects the options, for example for a preconditioner that its build
            lacks. Some are rejected with the first system only.
    """

    def __init__(
        self,
        comm: Any,
        petsc_options: dict[str, Any] | None = None,
        prefix: str | None = None,
        *,
        dim: int = 2,
    ) -> None:
        """Create the solver and set its options. Collective."""
        collect_garbage(comm)  # frees earlier solvers, or MPI would run out of communicators
        given = petsc_options or {}
        if not isinstance(given, Mapping):
            raise TypeError(f"petsc_options must be a dictionary of options, not {given!r}")
        if int(given.get("ksp_max_it", 1)) < 1:
            raise ValueError(f"ksp_max_it must be at least 1: {given['ksp_max_it']}")
        options = _direct(comm) | given if given.get("pc_type", "lu") == "lu" else given
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
        """Solve A x = b. Collective.

        Args:
            A: Assembled matrix.
            b: Right-hand side.
            x: Solution, overwritten.
            rtol: Tolerance of the residual relative to b [-]. It applies to the automatic choice of
                iterations only; given PETSc options have their own tolerance.
            products: Terms that are added to the matrix.

        Returns:
            Number of Krylov iterations.

        Raises:
            LinearSolverError: If the system could not be solved, with the reason of PETSc. Usually
                the matrix is singular.
            ValueError: After the first system, if PETSc did not use some of the given options.
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
        """Return whether GMRES with incomplete factors is tried first. Collective.

        Args:
            A: Assembled matrix.
        """
        return self._is_automatic and self._dim == 3 and _is_large(A)

    def scaled_norm(self, b: PETSc.Vec) -> float | None:
        """Return the norm of a residual with the scaling of GMRES. Collective.

        Args:
            b: Residual.

        Returns:
            The norm, or None if MUMPS solved the last system.
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
                    "suffice; allow more (ksp_max_it), use another preconditioner, or omit "
                    "petsc_options to let the package choose"
                )
            if reason in _NOT_POSITIVE:
                raise LinearSolverError(
                    f"the linear solver failed ({described}): this method needs a positive "
                    "definite matrix, but a pressure or a loss of stability makes it indefinite; "
                    "take GMRES with an incomplete LU factorization, or omit petsc_options"
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
        """Try to solve the system with GMRES, and return whether it has converged."""
        kind = "ILU(0)" if is_large else "mumps"
        if kind not in self._gmres:
            self._gmres[kind] = _Gmres(self._comm, is_large)
        self._scale = A.getDiagonal()
        diagonal = np.abs(self._scale.array_r)
        self._scale.array_w[:] = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        operator = A if products is None else products.operator(A, preconditions=is_large)
        reason, self.iterations = self._gmres[kind].solve(operator, A, b, x, rtol, products)
        if products is not None:
            operator.destroy()
        self.method = f"GMRES + {kind}"
        if reason > 0 and np.isfinite(x.norm()):
            logger.info("GMRES: %d iterations for a reduction of %.0e", self.iterations, rtol)
            return True
        logger.info(
            "GMRES failed after %d iterations (%s): MUMPS solves this system",
            self.iterations,
            _reason(reason),
        )
        self._scale.destroy()
        self._scale = None
        return False

    def _require_used(self) -> None:
        """Raise ValueError for options that PETSc has not used."""
        prefix = self.ksp.getOptionsPrefix()
        unused = [key for key in self._given if not _is_used(prefix + key)]
        self._given = []
        if unused:
            raise ValueError(
                f"PETSc did not use the option{'s' * (len(unused) > 1)} {', '.join(unused)}: "
                "check the spelling, and that the chosen solver has it"
            )

    def _try(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> int:
        if self.ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED:
            self.ksp.reset()  # PETSc would report the failed set-up again
        self.ksp.setOperators(A)
        try:
            self.ksp.solve(b, x)
        except PETSc.Error as error:
            if error.ierr in _REFUSED:  # shorter steps would not help
                raise ValueError(f"PETSc refuses the options: {_last_line(error)}") from error
            raise LinearSolverError(f"PETSc: {_last_line(error)}") from error
        return self.ksp.getConvergedReason()

    def _mumps_wants_memory(self) -> bool:
        """Return whether MUMPS stopped because pivoting needed more workspace than estimated."""
        pc = self.ksp.getPC()
        if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
            return False
        return pc.getFactorMatrix().getMumpsInfog(1) in (-8, -9)


class _Gmres:
    """GMRES with incomplete factors of a matrix, or with a factorization by MUMPS.

    Factors are reused for new values of the matrix, as long as the additional iterations cost less
    than new factors.
    """

    def __init__(self, comm: Any, is_large: bool) -> None:
        options = dict(KRYLOV)
        if not is_large:
            # few, as factors that need more are out of date
            options |= _direct(comm) | {"ksp_type": "gmres", "ksp_max_it": 100}
            del options["sub_pc_type"]
        elif comm.size > 1:
            # An overlap of one layer reduces the number of iterations to two thirds.
            options["pc_type"] = "asm"
        self._ksp, _ = _create(comm, options, None)
        self._is_incomplete = is_large
        self._matrix: PETSc.Mat | None = None
        self._factorized: PETSc.Mat | None = None
        self._state, self._are_of_these_values = -1, False
        # Iterations per digit with new and with the last factors, and the number of iterations
        # that cost as much as new factors
        self._fresh, self._last, self._worth = 0.0, 0.0, 0.0

    def solve(
        self,
        operator: PETSc.Mat,
        A: PETSc.Mat,
        b: PETSc.Vec,
        x: PETSc.Vec,
        rtol: float,
        products: Products | None,
    ) -> tuple[int, int]:
        """Solve a system; return the reason of PETSc and the number of iterations. Collective."""
        ksp = self._ksp
        failed = ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
        is_new = failed or A is not self._matrix
        if is_new:
            ksp.reset()  # otherwise PETSc would keep the overlap of the first pattern
        self._matrix = A
        more = 4 * (self._last - self._fresh)  # for a typical reduction by 1e-4
        is_same = self._are_of_these_values and not is_new and A.stateGet() == self._state
        reuses = is_same or (not is_new and more <= self._worth)
        ksp.setTolerances(rtol=rtol)
        while True:
            if self._is_incomplete:
                self._factorized = A
            elif not reuses:
                assert products is not None  # systems without them have other factors
                if self._factorized is not None:
                    self._factorized.destroy()
                self._factorized = products.preconditioner(A)
            ksp.getPC().setReusePreconditioner(reuses)
            ksp.setOperators(operator, self._factorized)
            ksp.solve(b, x)
            reason, iterations = ksp.getConvergedReason(), ksp.getIterationNumber()
            if reason > 0 or not reuses or is_same:
                break
            reuses = False
        ksp.setOperators(self._factorized)  # the caller may now destroy the operator
        self._are_of_these_values = is_same or not reuses
        self._state = A.stateGet()  # scaling and unscaling have changed it
        self._last = iterations / -np.log10(rtol)
        if not reuses:
            self._fresh = self._last
            if self._is_incomplete:
                self._worth = _ILU
            elif reason > 0:
                self._worth = _iterations_for_factors(ksp.getPC().getFactorMatrix())
        return reason, iterations


def _direct(comm: Any) -> dict[str, Any]:
    """Return the options of MUMPS."""
    # AMF makes smaller factors than AMD, but runs on several ranks would not be reproducible.
    return DIRECT | ({_ORDERING: 2} if comm.size == 1 else {})


def _iterations_for_factors(F: PETSc.Mat) -> float:
    """Return how many solves with factors of MUMPS cost as much as the factors. Collective.

    The estimate uses operation counts instead of measured times, so that runs are reproducible. The
    speed of the processor limits the factorization, the speed of memory limits the solves.
    """
    operations, entries = F.getMumpsRinfog(3), F.getMumpsInfog(29)
    entries = entries if entries > 0 else -1e6 * entries  # a negative number counts millions
    return operations / (30 * entries)


def _create(
    comm: Any, options: dict[str, Any], prefix: str | None
) -> tuple[PETSc.KSP, PETSc.Options]:
    """Create a solver with these options; options of the command line take precedence."""
    # MUMPS does not read its options before the factorization. They must stay in the database, so
    # each solver needs its own prefix.
    prefix = f"fenicsmpm_{next(_numbers)}_" if prefix is None else prefix
    database = PETSc.Options(prefix)
    for key, value in options.items():
        if not database.hasName(key):
            database[key] = value
        if _direct(comm).get(key) == value or KRYLOV.get(key) == value:
            database.getString(key, "")  # marks it as used, so PETSc does not list it at the end
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
    """Return whether many rows have entries other than the diagonal. Collective."""
    n = A.getSize()[0]
    if n < _MANY:
        return False
    entries = A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    # Rows of the identity have one entry, rows of displacements on tetrahedra about 45.
    return bool((entries - n) / 45 > _MANY)


def _is_used(name: str) -> bool:
    """Return whether PETSc has used an option, which petsc4py cannot tell."""
    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return used.value != 0


def _last_line(error: PETSc.Error) -> str:
    """Return the message of a PETSc error without its traceback."""
    return str(error).strip().splitlines()[-1].strip()


def _reason(number: int) -> str:
    names = PETSc.KSP.ConvergedReason.__dict__
    return next(
        (n for n, v in names.items() if v == number and n.startswith("DIVERGED")), str(number)
    )
