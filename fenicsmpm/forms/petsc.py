# SPDX-License-Identifier: MIT
"""Assembly into PETSc objects, with the names and conventions of ``dolfinx.fem.petsc``."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm import _compat
from fenicsmpm._garbage import lasting
from fenicsmpm.forms import assembly
from fenicsmpm.forms.form import Form

# Attribute of a PETSc matrix: the MatrixCSR into which it is assembled before the rows are copied
_WORK = "fenicsmpm_work"

__all__ = [
    "apply_lifting",
    "assemble_matrix",
    "assemble_vector",
    "create_matrix",
    "create_vector",
    "inactive_dofs",
    "set_bc",
    "unreached_rows",
]


def create_vector(L: Form) -> PETSc.Vec:
    """Create a ghosted vector for a form of rank 1, filled with zeros.

    Args:
        L: Compiled form.
    """
    dofmap = L.function_spaces[0].dofmap
    index_map, bs = dofmap.index_map, dofmap.index_map_bs
    size = (index_map.size_local * bs, index_map.size_global * bs)
    ghosts = index_map.ghosts.astype(PETSc.IntType)
    return PETSc.Vec().createGhost(ghosts, size=size, bsize=bs, comm=lasting(L.mesh.comm))


def assemble_vector(
    L: Form, b: PETSc.Vec | None = None, sizes: PETSc.Vec | None = None
) -> PETSc.Vec:
    """Assemble a form of rank 1; as in dolfinx, ghosts are not sent to their owners.

    Args:
        L: Compiled form.
        b: Vector to add to. None for a new one.
        sizes: Vector to which the absolute values of the summed terms are added.

    Returns:
        The vector. After lifting, add up the ghosts with
        ``b.ghostUpdate(InsertMode.ADD, ScatterMode.REVERSE)`` as in dolfinx.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank.
    """
    assembly._check(L, 1)
    b = create_vector(L) if b is None else b
    with b.localForm() as local:
        if sizes is None:
            assembly.add_to_array(local.array_w, L)
        else:
            with sizes.localForm() as local_sizes:
                assembly.add_to_array(local.array_w, L, local_sizes.array_w)
    return b


def create_matrix(a: Form, compact: bool = False) -> PETSc.Mat:
    """Create a matrix for a form of rank 2. Collective.

    Args:
        a: Compiled form.
        compact: See ``fenicsmpm.forms.create_matrix``.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank.
    """
    A = assembly.create_matrix(a, compact)
    maps = [V.dofmap.index_map for V in a.function_spaces]
    bs = [V.dofmap.index_map_bs for V in a.function_spaces]
    sizes = [(m.size_local * b, m.size_global * b) for m, b in zip(maps, bs, strict=True)]
    columns = _global_columns(A)
    owned = A.index_map(0).size_local
    indptr = A.indptr[: owned + 1].astype(PETSc.IntType)
    matrix = PETSc.Mat().createAIJ(sizes, comm=lasting(a.mesh.comm), csr=(indptr, columns))
    matrix.assemble()
    matrix.setAttr(_WORK, A)
    return matrix


def assemble_matrix(
    a: Form,
    bcs: Sequence[fem.DirichletBC] = (),
    diag: float = 1.0,
    A: PETSc.Mat | None = None,
    fill: npt.NDArray[np.bool_] | None = None,
) -> PETSc.Mat:
    """Assemble a form of rank 2; see ``fenicsmpm.forms.assemble_matrix``. Collective.

    Args:
        a: Compiled form.
        bcs: Dirichlet conditions.
        diag: Diagonal entry of constrained degrees of freedom.
        A: Matrix to overwrite, from ``create_matrix``. None for a new one.
        fill: Mask of rows that also get a row of the identity if all their entries are zero.

    Returns:
        The assembled matrix.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank, or the matrix was created for another form.
    """
    A = create_matrix(a) if A is None else A
    work = assembly.assemble_matrix(a, bcs, diag, _work_matrix(a, A), fill)
    owned = work.index_map(0).size_local
    indptr = work.indptr[: owned + 1].astype(PETSc.IntType)
    A.setValuesCSR(indptr, _global_columns(work), work.data[: indptr[-1]])
    A.assemble()
    return A


def inactive_dofs(a: Form, A: PETSc.Mat) -> npt.NDArray[np.int32]:
    """Return ``fenicsmpm.forms.inactive_dofs`` without creating a new matrix. Collective.

    Args:
        a: Compiled form of rank 2.
        A: Its matrix, from ``create_matrix``. The values of A stay the same, but those of its work
            matrix are overwritten.

    Returns:
        Owned local indices, unrolled, ``(n,)``.
    """
    return assembly.inactive_dofs(a, _work_matrix(a, A))


def unreached_rows(A: PETSc.Mat) -> npt.NDArray[np.int64]:
    """Return the owned local rows of the identity, which no integral reached except with zeros.

    Constrained rows may be among them.

    Args:
        A: Matrix from ``assemble_matrix``, of a form with equal spaces.

    Returns:
        Owned local indices, unrolled, ``(n,)``.
    """
    return assembly._unreached[A.getAttr(_WORK)]


def apply_lifting(
    b: PETSc.Vec,
    a: Sequence[Form],
    bcs: Sequence[Sequence[fem.DirichletBC]],
    x0: Sequence[PETSc.Vec] | None = None,
    alpha: float = 1.0,
) -> None:
    """Subtract ``alpha * A (g - x0)``; see ``fenicsmpm.forms.apply_lifting``.

    Args:
        b: Vector, whose ghosts have not been sent to their owners yet.
        a: Compiled forms of rank 2.
        bcs: Dirichlet conditions on the trial space of each form.
        x0: Current solutions with up-to-date ghosts. None for zero.
        alpha: Factor [-].
    """
    arrays = None
    if x0 is not None:
        arrays = []
        for x in x0:
            with x.localForm() as local:
                arrays.append(local.array_r.copy())
    with b.localForm() as local:
        assembly.apply_lifting(local.array_w, a, bcs, arrays, alpha)


def set_bc(
    b: PETSc.Vec,
    bcs: Sequence[fem.DirichletBC],
    x0: PETSc.Vec | None = None,
    alpha: float = 1.0,
) -> None:
    """Set the owned constrained entries of a vector to ``alpha * (g - x0)``.

    Args:
        b: Vector.
        bcs: Dirichlet conditions.
        x0: Vector x0, of which owned entries are used. None for zero.
        alpha: Factor [-].
    """
    for bc in bcs:
        _compat.bc_set(bc, b.array_w, None if x0 is None else x0.array_r, alpha)


def _work_matrix(a: Form, A: PETSc.Mat) -> la.MatrixCSR:
    work = A.getAttr(_WORK)
    if work is None:
        work = assembly.create_matrix(a)
        A.setAttr(_WORK, work)
    return work


def _global_columns(A: la.MatrixCSR) -> np.ndarray:
    owned = A.index_map(0).size_local
    columns = A.indices[: A.indptr[owned]]
    return A.index_map(1).local_to_global(columns).astype(PETSc.IntType)
