# SPDX-License-Identifier: MIT
"""Assembly of forms over points into scalars, dolfinx vectors and MatrixCSR.

The functions follow their counterparts in ``dolfinx.fem``. Unless stated otherwise, contributions
to ghost entries are not communicated until the caller scatters them.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import scipy.sparse
from dolfinx import cpp, fem, la
from dolfinx.fem import petsc

from fenicsmpm import _compat
from fenicsmpm.forms import loops
from fenicsmpm.forms.form import Form
from fenicsmpm.forms.integral import PointIntegral

_Array = npt.NDArray[np.float64]
# Places of the element matrices in rows of each matrix, for the last selected groups
_places: weakref.WeakKeyDictionary[la.MatrixCSR, weakref.WeakKeyDictionary]
_places = weakref.WeakKeyDictionary()
# Values of constant region forms in a matrix, with the state for which they are valid
_constant_parts: weakref.WeakKeyDictionary[la.MatrixCSR, weakref.WeakKeyDictionary]
_constant_parts = weakref.WeakKeyDictionary()
_Indices = npt.NDArray[np.int32]
# Owned rows of a matrix that its last assembly did not reach
_unreached: weakref.WeakKeyDictionary[la.MatrixCSR, npt.NDArray[np.int64]]
_unreached = weakref.WeakKeyDictionary()


def _check(compiled: Form, rank: int) -> None:
    if not isinstance(compiled, Form):
        raise TypeError(
            f"a form compiled by fenicsmpm.forms.form is needed, not {type(compiled).__name__}"
        )
    if compiled.rank != rank:
        raise ValueError(f"a form of rank {rank} is needed, not {compiled!r}")


def _check_size(b: _Array, V: fem.FunctionSpace) -> None:
    size = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
    if len(b) != size * V.dofmap.index_map_bs:
        raise ValueError(
            f"vector of {len(b)} entries for a space of {size * V.dofmap.index_map_bs} local "
            "degrees of freedom, ghosts included: create the vector for this space"
        )


def assemble_scalar(M: Form) -> float:
    """Integrate a form of rank 0. Collective.

    Args:
        M: Compiled form.

    Returns:
        The integral over all ranks. In contrast, dolfinx leaves the sum over ranks to the caller.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank.
    """
    _check(M, 0)
    M.refresh()
    local = sum(fem.assemble_scalar(form) for form in M.mesh_forms())
    for integral in M.point_integrals:
        local += sum(float(np.sum(values)) for _, values in integral.element_tensors())
    return M.mesh.comm.allreduce(local, MPI.SUM)


def assemble_vector(L: Form, b: la.Vector | None = None) -> la.Vector:
    """Assemble a form of rank 1.

    Args:
        L: Compiled form.
        b: Vector to add to. None for a new one.

    Returns:
        The vector. Its ghost entries have not been sent to their owners yet
        (``b.scatter_reverse``).

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank, or the vector another size.
    """
    _check(L, 1)
    if b is None:
        dofmap = L.function_spaces[0].dofmap
        b = la.vector(dofmap.index_map, dofmap.index_map_bs)
        b.array[:] = 0.0
    add_to_array(b.array, L)
    return b


def add_to_array(b: _Array, L: Form, sizes: _Array | None = None) -> None:
    """Add a form of rank 1 to the local array of a vector, ghosts included.

    Args:
        b: Local array of the vector, ghosts included.
        L: Compiled form.
        sizes: Array to which the absolute values of the added terms are added, separately for each
            group of points, and for each form over cells or facets. They give the scale of
            round-off in sums that should be zero.
    """
    _check_size(b, L.function_spaces[0])
    L.refresh()
    for form in L.mesh_forms():
        if sizes is None:
            fem.assemble_vector(b, form)
            continue
        added = np.zeros_like(b)
        fem.assemble_vector(added, form)
        b += added
        sizes += np.abs(added)
    for integral in L.point_integrals:
        dofs = integral.dofs(integral.lowered.arguments[0], L.function_spaces[0])
        for groups, vectors in integral.element_tensors():
            loops.add_vectors(vectors, dofs, integral.groups[groups], b)
            if sizes is not None:
                loops.add_vectors(np.abs(vectors), dofs, integral.groups[groups], sizes)


def create_matrix(a: Form, compact: bool = False) -> la.MatrixCSR:
    """Create a matrix for a form of rank 2, with block size one.

    Args:
        a: Compiled form.
        compact: Whether the matrix only has entries for the cells that contain points now. Direct
            solvers then do not see the empty part of the background mesh. Otherwise, there are
            entries for points in any cell, so that the points may move.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank.
    """
    _check(a, 2)
    maps = [V.dofmap.index_map for V in a.function_spaces]
    sizes = [V.dofmap.index_map_bs for V in a.function_spaces]
    if a.ordinary is not None:
        pattern = fem.create_sparsity_pattern(a.ordinary)
    else:
        pattern = cpp.la.SparsityPattern(a.mesh.comm, maps, sizes)
    for rows, columns in _meetings(a, compact):
        _insert_cliques(pattern, rows, columns)
    if _is_square(a):
        # Ghosts are included, because dolfinx counts constrained ghosts of blocked spaces as owned.
        pattern.insert_diagonal(np.arange(maps[0].size_local + maps[0].num_ghosts, dtype=np.int32))
    pattern.finalize()
    return la.matrix_csr(pattern, cpp.la.BlockMode.expanded)


def _meetings(a: Form, compact: bool) -> Iterator[tuple[_Indices, _Indices]]:
    """Yield blocks of test and trial functions that interact, ``(n, n_blocks)`` each."""
    if compact:
        for integral in a.point_integrals:
            integral.refresh()
        known = [(i.stencil, i.groups) for i in a.point_integrals]
    else:
        stencils = {i.stencil.kind: i.stencil for i in a.point_integrals}.values()
        known = [(stencil, np.arange(stencil.n_owned_groups)) for stencil in stencils]
    for stencil, groups in known:
        rows, columns = (stencil.dofs(V)[groups] for V in a.function_spaces)
        yield rows, columns
    for form in a.region_forms:
        for kind in form.types:
            cells = form.region.blocks(kind)
            if len(cells) > 0:
                lists = [V.dofmap.list[cells] for V in a.function_spaces]
                rows, columns = (blocks.reshape(len(cells), -1) for blocks in lists)
                yield rows, columns


def _insert_cliques(pattern: Any, rows: _Indices, columns: _Indices) -> None:
    """Insert all pairs of the row and column blocks in each line, every pair once."""
    (rows, row_ends, there), (columns, column_ends, here) = map(_together, (rows, columns))
    pairs = (there @ here.T).tocsr()
    # all columns of the column sets that each row set interacts with
    starts, lengths = column_ends[pairs.indices], np.diff(column_ends)[pairs.indices]
    ends = np.concatenate([[0], np.cumsum(lengths)])
    found = columns[np.repeat(starts - ends[:-1], lengths) + np.arange(ends[-1])]
    limits = ends[pairs.indptr]
    for k in range(len(row_ends) - 1):
        pattern.insert(rows[row_ends[k] : row_ends[k + 1]], found[limits[k] : limits[k + 1]])


def _together(blocks: _Indices) -> tuple[_Indices, npt.NDArray[np.int64], Any]:
    """Group blocks that occur in the same lines, such as parts of a mixed space at a node.

    Returns:
        The blocks, set by set; the start of each set and the end; the incidence of sets and lines.
    """
    n, k = blocks.shape
    shape = n, int(blocks.max(initial=-1)) + 1
    one = np.ones(n * k, dtype=np.bool_)
    lines = scipy.sparse.csr_array((one, blocks.ravel(), k * np.arange(n + 1)), shape=shape)
    lines = lines.T.tocsr()
    lines.sum_duplicates()
    order, starts = loops.equal_rows(lines.indptr, lines.indices)
    incidence = lines[order[starts]]
    used = np.flatnonzero(np.diff(incidence.indptr))  # omits blocks that are in no line
    ends = np.append(starts, len(order))
    members = [order[ends[i] : ends[i + 1]] for i in used]
    sizes = np.cumsum([0, *map(len, members)])
    return np.concatenate([*members, np.empty(0, np.int32)]), sizes, incidence[used]


def assemble_matrix(
    a: Form,
    bcs: Sequence[fem.DirichletBC] = (),
    diag: float = 1.0,
    A: la.MatrixCSR | None = None,
    fill: npt.NDArray[np.bool_] | None = None,
) -> la.MatrixCSR:
    """Assemble a form of rank 2. Collective.

    Rows and columns of constrained degrees of freedom are omitted and get ``diag`` on the diagonal.
    Degrees of freedom without points nearby, which no integral reaches, get a row of the identity,
    so that the matrix can be factorized.

    Args:
        a: Compiled form.
        bcs: Dirichlet conditions.
        diag: Diagonal entry of constrained degrees of freedom.
        A: Matrix to overwrite, from ``create_matrix``. None for a new one.
        fill: Mask of rows ``(n_owned_rows,)`` that also get a row of the identity if all their
            entries are zero, such as rows of nodes that only an open contact reaches. None for no
            such rows.

    Returns:
        The matrix. Its ghost rows have already been sent to their owners.

    Raises:
        TypeError: If the form is not compiled by ``form``.
        ValueError: If the form has another rank, or the matrix was created for another form.
    """
    _check(a, 2)
    a.refresh()
    A = create_matrix(a) if A is None else A
    if list(A.block_size) != [1, 1]:
        raise ValueError(
            f"matrix of block sizes {A.block_size}: create it with forms.create_matrix"
        )
    fixed = [_marks(V, bcs) for V in a.function_spaces]
    _set_mesh_forms(A, a, list(bcs), fixed)
    reached = _reached_by_values(A) if a.has_mesh_forms else None
    for integral in a.point_integrals:
        sources = integral.lowered.arguments
        dofs = [integral.dofs(s, V) for s, V in zip(sources, a.function_spaces, strict=True)]
        integral.refresh()
        integral.add_matrices(_csr_places(A, integral, dofs), A.indptr, fixed, A.data)
    A.scatter_reverse()
    if _is_square(a):
        owned = A.index_map(0).size_local
        diagonal = _diagonal_positions(A)
        unreached = _inactive_marks(a, reached)[:owned]
        if fill is not None:
            unreached |= fill & ~_reached_by_values(A)[:owned] & (fixed[0][:owned] == 0)
        _unreached[A] = np.flatnonzero(unreached)
        A.data[diagonal[_unreached[A]]] = 1.0
        A.data[diagonal[fixed[0][:owned] > 0]] = diag
    return A


def inactive_dofs(a: Form, A: la.MatrixCSR | None = None) -> npt.NDArray[np.int32]:
    """Return the degrees of freedom of the test space that no integral reaches. Collective.

    These have no points nearby. For linear forms, integrals over cells and facets are ignored.

    Args:
        a: Compiled form of rank 1 or 2.
        A: Matrix of a form of rank 2, which is overwritten. None for a new one.

    Returns:
        Owned local indices, unrolled, ``(n,)``.
    """
    reached = None
    if a.has_mesh_forms and a.rank == 2:
        A = create_matrix(a) if A is None else A
        _set_mesh_forms(A, a, [], [_marks(V, []) for V in a.function_spaces])
        reached = _reached_by_values(A)
    V = a.function_spaces[0]
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    return np.flatnonzero(_inactive_marks(a, reached)[:owned]).astype(np.int32)


def apply_lifting(
    b: _Array,
    a: Sequence[Form],
    bcs: Sequence[Sequence[fem.DirichletBC]],
    x0: Sequence[_Array] | None = None,
    alpha: float = 1.0,
) -> None:
    """Subtract ``alpha * A (g - x0)`` from a vector, for the constrained columns of each A.

    Args:
        b: Local array of the vector, ghosts included. Scatter it afterwards.
        a: Compiled forms of rank 2.
        bcs: Dirichlet conditions on the trial space of each form.
        x0: Local arrays of the current solutions, ghosts included. None for zero.
        alpha: Factor [-].

    Raises:
        TypeError: If a form is not compiled by ``form``.
        ValueError: If a form has another rank, or the vector another size.
    """
    for k, form in enumerate(a):
        _check(form, 2)
        _check_size(b, form.function_spaces[0])
        form.refresh()
        V = form.function_spaces[1]
        fixed = _marks(V, bcs[k])
        if not form.mesh.comm.allreduce(bool(fixed.any()), MPI.LOR):
            continue
        values = np.zeros(len(fixed))
        for bc in bcs[k]:
            if _compat.is_on(bc, V):
                _compat.bc_set(bc, values, None if x0 is None else x0[k], alpha)
        for ordinary in form.mesh_forms():
            # dolfinx needs all ghost values of x0, and computes g - x0 itself
            own = [bc for bc in bcs[k] if _compat.is_on(bc, V)]
            fem.apply_lifting(b, [ordinary], [own], None if x0 is None else [x0[k]], alpha)
        for integral in form.point_integrals:
            sources = integral.lowered.arguments
            dofs = [integral.dofs(s, W) for s, W in zip(sources, form.function_spaces, strict=True)]
            for groups, matrices in integral.element_tensors():
                loops.lift(matrices, *dofs, integral.groups[groups], fixed, values, b)


def _set_mesh_forms(
    A: la.MatrixCSR, a: Form, bcs: list[fem.DirichletBC], fixed: list[npt.NDArray[np.uint8]]
) -> None:
    """Set a matrix to the integrals over cells and facets.

    Integrals over regions without coefficients are kept until points move or constants change.
    """
    constant = [form for form in a.region_forms if form.is_constant]
    if constant:
        key = (tuple(form.state for form in constant), *(f.tobytes() for f in fixed))
        kept = _constant_parts.setdefault(A, weakref.WeakKeyDictionary())
        is_new = a not in kept or kept[a][0] != key
        # Conditions may have changed on one rank only.
        if a.mesh.comm.allreduce(is_new, MPI.LOR):
            A.set_value(0.0)
            for region_form in constant:
                if not region_form.add_facets(a.function_spaces, fixed, A):
                    _add_ordinary(A, region_form.current(), bcs)
            kept[a] = (key, A.data.copy())
        A.data[:] = kept[a][1]
    else:
        A.set_value(0.0)
    for form in a.mesh_forms(varying=True):
        _add_ordinary(A, form, bcs)


def _add_ordinary(A: la.MatrixCSR, a: fem.Form, bcs: list[fem.DirichletBC]) -> None:
    """Add integrals over cells and facets, without constrained rows and columns."""
    bs = [V.dofmap.index_map_bs for V in a.function_spaces]
    if bs[0] == bs[1] <= 3:
        fem.assemble_matrix(A, a, bcs, 0.0)  # no diagonal
        return
    # dolfinx fills its own matrices with these block sizes only. Other forms go through PETSc.
    matrix = petsc.assemble_matrix(a, bcs, 0.0)
    matrix.assemble()
    indptr, columns, values = matrix.getValuesCSR()
    local = A.index_map(1).global_to_local(columns.astype(np.int64))
    loops.add_rows(indptr, local, values, A.indptr, A.indices, A.data)
    matrix.destroy()


def _is_square(a: Form) -> bool:
    return a.function_spaces[0] == a.function_spaces[1]


def _marks(V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> npt.NDArray[np.uint8]:
    """Return ``(n_dofs,)`` 1 for the constrained local degrees of freedom, ghosts included."""
    size = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
    marks = np.zeros(size * V.dofmap.index_map_bs, dtype=np.uint8)
    for bc in bcs:
        if _compat.is_on(bc, V):
            marks[_compat.bc_dofs(bc)] = 1
    return marks


def _reached_by_values(A: la.MatrixCSR) -> npt.NDArray[np.bool_]:
    """Return ``(n_rows,)`` whether a local row, ghosts included, has a nonzero entry."""
    reached = np.zeros(len(A.indptr) - 1, dtype=np.bool_)
    loops.mark_rows(A.indptr, A.data, reached)
    return reached


def _inactive_marks(a: Form, reached: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.bool_]:
    V = a.function_spaces[0]
    active = la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    active.array[:] = 0.0 if reached is None else reached
    for integral in a.point_integrals:
        integral.refresh()
        active.array[integral.active(integral.lowered.arguments[0], V)] = 1.0
    active.scatter_reverse(la.InsertMode.add)
    active.scatter_forward()
    return active.array == 0.0


def _diagonal_positions(A: la.MatrixCSR) -> npt.NDArray[np.int64]:
    """Return the ``(n_owned,)`` positions of the diagonal entries of the owned rows."""
    result = np.empty(A.index_map(0).size_local, dtype=np.int64)
    loops.diagonal_positions(A.indptr, A.indices, result)
    return result


def _csr_places(
    A: la.MatrixCSR, integral: PointIntegral, dofs: list[npt.NDArray[np.int32]]
) -> npt.NDArray[np.unsignedinteger]:
    """Return the places of entries within their rows for groups with points; see ``csr_places``."""
    cached = _places.setdefault(A, weakref.WeakKeyDictionary())
    groups = integral.groups
    if integral not in cached or not np.array_equal(cached[integral][0], groups):
        layout = integral.lowered.arguments[0].layout
        assert layout is not None
        n = dofs[0].shape[1]
        if n % layout.n_components == 0:
            seen = n // layout.n_components
            if loops.rows_repeat(A.indptr, A.indices, dofs[0], groups, seen):
                n = seen
        longest = np.diff(A.indptr).max(initial=0)
        kind = np.uint16 if longest <= np.iinfo(np.uint16).max else np.uint32
        places = np.empty((len(groups), n, dofs[1].shape[1]), dtype=kind)
        if not loops.csr_places(A.indptr, A.indices, *dofs, groups, places):
            raise ValueError(
                "matrix made for another form: create it with forms.create_matrix for this one"
            )
        cached[integral] = (groups, places)
    return cached[integral][1]
