# SPDX-License-Identifier: MIT
"""Check that supports or inertia hold a body."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse.csgraph
from dolfinx import fem

Array = npt.NDArray[np.float64]

# Relative to products that do not vanish. Inertia may be weak: in steps of thousands of wave times
# it is 1e-9 of the stiffness.
_ROUND_OFF = 1e-13
_CLEAR = 1e-6  # relative size of what is not round-off in a motion


def require_supports(
    A: PETSc.Mat, V: fem.FunctionSpace, x: Array, inactive: npt.NDArray[np.int32]
) -> str | None:
    """Return an error message if the tangent times a rigid motion is zero. Collective.

    A direct solver may find round-off instead of a zero pivot, and iterations find some solution or
    none. Pieces of material without common nodes move independently, so each of them is checked.

    Args:
        A: Tangent.
        V: Function space of the tangent. Its parts with a component for each direction are checked.
        x: Positions of the local degrees of freedom ``(n_dofs, d)`` [m].
        inactive: Local dofs without material.

    Returns:
        A sentence, or None if everything is held.
    """
    dim = V.mesh.geometry.dim
    is_mixed = V.num_sub_spaces > 0 and V.dofmap.index_map_bs == 1
    parts = [V.sub(i) for i in range(V.num_sub_spaces)] if is_mixed else [V]
    parts = [part for part in parts if dim > 1 and part.num_sub_spaces == dim]
    if not parts:
        return None
    pieces = _pieces(A, V.mesh.comm)
    pieces[inactive[inactive < len(pieces)]] = -1
    for part in parts:
        found = [np.unique(part.sub(c).dofmap.list) for c in range(dim)]
        dofs = [some[some < len(pieces)] for some in found]
        dofs = [some[pieces[some] >= 0] for some in dofs]
        free, place = _free_motions(A, dofs, x, pieces, V.mesh.comm)
        if free:
            which = "the body" if place is None else f"the piece of material around {_tuple(place)}"
            return (
                f"nothing holds {which}, which can {', '.join(free)}: the matrix is singular; "
                "check the Dirichlet conditions, or give the body inertia by a time scheme"
            )
    return None


def _pieces(A: PETSc.Mat, comm: MPI.Comm) -> npt.NDArray[np.int64]:
    """Return the number of the piece of each owned row, -1 for rows with no entry off the diagonal.

    Rows belong to one piece if entries other than zero connect them.
    """
    begin, end = A.getOwnershipRange()
    n = end - begin
    indptr, columns, values = A.getValuesCSR()
    rows = np.repeat(np.arange(n), np.diff(indptr))
    used = values != 0.0
    rows, columns = rows[used], columns[used] - begin
    is_here = (columns >= 0) & (columns < n)
    ones = np.ones(np.count_nonzero(is_here), dtype=np.bool_)
    graph = scipy.sparse.csr_array((ones, (rows[is_here], columns[is_here])), shape=(n, n))
    count, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    is_alone = np.ones(n, dtype=np.bool_)
    is_alone[rows[columns != rows]] = False
    if comm.size > 1:
        counts = comm.allgather(count)
        first = sum(counts[: comm.rank])
        elsewhere = np.unique(columns[~is_here]) + begin
        numbers = A.createVecRight()
        numbers.array_w[:] = labels + first
        there = _values_at(numbers, elsewhere)
        places = np.searchsorted(elsewhere, columns[~is_here] + begin)
        pairs = np.unique(
            np.column_stack([labels[rows[~is_here]] + first, there[places].astype(np.int64)]),
            axis=0,
        )  # fmt: skip
        a, b = np.vstack(comm.allgather(pairs)).T
        shape = sum(counts), sum(counts)
        same = scipy.sparse.coo_array((np.ones(len(a)), (a, b)), shape=shape)
        labels = scipy.sparse.csgraph.connected_components(same, directed=False)[1][labels + first]
    return np.where(is_alone, -1, labels.astype(np.int64))


def _values_at(vector: PETSc.Vec, indices: npt.NDArray[np.integer]) -> Array:
    """Return the values of a vector at global indices. Collective."""
    index_set = PETSc.IS().createGeneral(indices.astype(PETSc.IntType), PETSc.COMM_SELF)
    result = PETSc.Vec().createSeq(len(indices), comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(vector, index_set, result, None)
    scatter.scatter(vector, result)
    values = result.array_r.copy()
    for item in (scatter, result, index_set):
        item.destroy()
    return values


def _free_motions(
    A: PETSc.Mat,
    dofs: list[npt.NDArray[np.int32]],
    x: Array,
    pieces: npt.NDArray[np.int64],
    comm: MPI.Comm,
) -> tuple[list[str], Array | None]:
    """Return descriptions of the rigid motions of the first piece whose product with A is zero.

    The second value is the middle of the piece. It is None if there is no other piece.
    """
    dim = len(dofs)
    turns = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)]
    positions = [x[rows] for rows in dofs]
    total = comm.allreduce(np.array([len(x), *x.sum(axis=0)], dtype=np.float64))
    centre = total[1:] / max(total[0], 1.0)
    reach = comm.allreduce(float(np.abs(x - centre).max(initial=0.0)), MPI.MAX) or 1.0
    mode, product = A.createVecs()
    lines: list[Array] = []

    def add(values: Sequence[Array]) -> None:
        """Add a motion and its product to the columns."""
        mode.set(0.0)
        for rows, numbers in zip(dofs, values, strict=True):
            mode.array_w[rows] = numbers
        A.mult(mode, product)
        lines.extend([mode.array_r.copy(), product.array_r.copy()])

    add([np.where(np.arange(len(rows)) % 2 == 0, 1.0, -1.0) for rows in dofs])
    for k in range(dim):
        add([np.full(len(rows), float(c == k)) for c, rows in enumerate(dofs)])
    for i, j in turns:
        turned = [np.zeros(len(rows)) for rows in dofs]
        turned[i] = -(positions[i][:, j] - centre[j]) / reach
        turned[j] = (positions[j][:, i] - centre[i]) / reach
        add(turned)
    mode.destroy()
    product.destroy()
    table = np.column_stack(lines)
    is_moving = np.zeros(len(pieces), dtype=np.bool_)
    is_moving[np.concatenate(dofs)] = True
    # R of a QR decomposition over all ranks has the singular values of the columns. A product with
    # A is in the rows of the pressure, too.
    here = {}
    order = np.argsort(pieces, kind="stable")
    order = order[np.searchsorted(pieces[order], 0) :]
    for rows in np.split(order, np.flatnonzero(np.diff(pieces[order])) + 1) if len(order) else []:
        if is_moving[rows].any():
            sums = [np.count_nonzero(is_moving[rows]), *x[rows[is_moving[rows]]].sum(axis=0)]
            triangles = [np.linalg.qr(table[rows, k::2], mode="r") for k in range(2)]
            here[int(pieces[rows[0]])] = np.array(sums), *triangles
    everywhere = comm.allgather(here)
    known = sorted(set().union(*everywhere))
    for piece in known:
        parts = [each[piece] for each in everywhere if piece in each]
        motions, products = (np.vstack([part[k] for part in parts]) for k in (1, 2))
        scale = float(np.linalg.norm(products[:, 0]))
        if not (np.isfinite(products).all() and scale > 0):
            continue
        free = _null(motions[:, 1:], products[:, 1:], scale)
        if len(free):
            said = _all_described(free, dim, centre, reach)
            middle = sum(part[0] for part in parts)
            return said, None if len(known) == 1 else middle[1:] / middle[0]
    return [], None


def _null(motions: Array, products: Array, scale: float) -> Array:
    """Return combinations of motions ``(n, n_motions)`` that move something without resistance."""
    _, sizes, combinations = np.linalg.svd(motions)
    moving = combinations[: len(sizes)][sizes > _CLEAR * sizes.max(initial=0.0)]
    _, sizes, mixed = np.linalg.svd(products @ moving.T)
    sizes = np.append(sizes, np.zeros(len(mixed) - len(sizes)))
    return mixed[sizes <= _ROUND_OFF * scale] @ moving


def _all_described(free: Array, dim: int, centre: Array, reach: float) -> list[str]:
    """Describe free motions, those along and about axes first."""
    names = [f"move along {axis}" for axis in "xyz"[:dim]]
    names += [f"turn about {axis}" for axis in ("z" if dim == 2 else "xyz")]
    basis = np.linalg.svd(free, full_matrices=False)[2]
    pure = np.flatnonzero(np.linalg.norm(basis, axis=0) > 1 - _CLEAR)
    rest = free.copy()
    rest[:, pure] = 0.0
    _, sizes, others = np.linalg.svd(rest, full_matrices=False)
    described = [_described(m, centre, reach) for m in others[sizes > _CLEAR]]
    return [names[k] for k in pure] + described


def _described(motion: Array, centre: Array, reach: float) -> str:
    """Describe a rigid motion by its velocities along axes, and those of turns about axes."""
    dim = len(centre)
    w = np.zeros(3)
    w[3 - len(motion[dim:]) :] = motion[dim:] / reach
    v = np.zeros(3)
    v[:dim] = motion[:dim]
    if np.linalg.norm(w) * reach < _CLEAR:
        return f"move along {_tuple(v[:dim] / np.linalg.norm(v))}"
    place = centre + (np.cross(w, v) / (w @ w))[:dim]
    if dim == 2:
        return f"turn about {_tuple(place)}"
    return f"turn about an axis along {_tuple(w / np.linalg.norm(w))} through {_tuple(place)}"


def _tuple(values: Array) -> str:
    return "(" + ", ".join(f"{round(value, 6) + 0.0:g}" for value in values) + ")"
