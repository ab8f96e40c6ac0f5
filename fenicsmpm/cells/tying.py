# SPDX-License-Identifier: MIT
"""Tying of nodes with little mass to well-filled cells, an alternative to the ghost penalty.

The method is that of aggregated unfitted finite elements (S. Badia, F. Verdugo, A. F. Martin,
Comput. Methods Appl. Mech. Engrg. 336, 2018): functions of well-filled cells are extrapolated
linearly to the nodes at the rim of the body. The system A x = b becomes T^T A T y = T^T b with
x = T y.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._garbage import lasting
from fenicsmpm._njit import njit
from fenicsmpm.cells.active_cells import ActiveCells
from fenicsmpm.cells.weight_correction import filled_fractions, nodes_of
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.transfer.points_to_grid import p2g


class _Rim(NamedTuple):
    """Bodies that fill cells together, their active cells, and the dofs to tie; None for all."""

    bodies: list[MaterialPoints]
    cells: ActiveCells
    dofs: npt.NDArray[np.int32] | None


class Tying:
    """Linear extrapolation to ill-supported nodes of a linear space, the same for all components.

    A node is ill if none of its cells is well filled, although it belongs to an active cell or its
    function is not zero at all points. Its values are those of the linear function of one
    well-filled cell, the one with the nearest centroid. Tied nodes never depend on other tied
    nodes. Several bodies that move with the same functions fill cells together.

    Args:
        space: Linear Lagrange space, scalar, blocked or mixed.
        bodies: Material points with volumes as weights in m^d.
        cells: Active cells of the bodies and of boundary points.
        threshold: Volume of points per volume of the cell, from which a cell is well filled.

    Attributes:
        bodies: As above.
        matrix: The matrix T after ``update``: rows of the identity, except at tied dofs.

    Raises:
        ValueError: For spaces that are not linear, a body that is not in the active cells, no
            body, and a threshold that is not positive.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        bodies: MaterialPoints | Sequence[MaterialPoints],
        cells: ActiveCells,
        threshold: float = 0.5,
    ) -> None:
        """Find the degrees of freedom of each node, and the first T. Collective."""
        self._prepare(space, [_Rim(_listed(bodies), cells, None)], threshold)

    @classmethod
    def of_each(
        cls,
        unknowns: Sequence[Any],
        bodies: Sequence[MaterialPoints | Sequence[MaterialPoints]],
        cells: Sequence[ActiveCells],
        threshold: float = 0.5,
    ) -> Tying:
        """Tie nodes of coupled unknowns, each to cells that the bodies of its unknown fill.

        Args:
            unknowns: Unknowns made by ``formulations.coupled_unknowns``.
            bodies: Body or bodies of each unknown, with volumes as weights in m^d.
            cells: Active cells of the bodies of each unknown.
            threshold: As above.

        Returns:
            The tying of all unknowns.

        Raises:
            ValueError: As above, and for sequences of different lengths.
        """
        lengths = [len(unknowns), len(bodies), len(cells)]
        if len({*lengths}) > 1:
            raise ValueError(
                f"there are {lengths[0]} unknowns, bodies of {lengths[1]} and active cells of "
                f"{lengths[2]}: give as many of each, in the same order"
            )
        result = object.__new__(cls)
        rims = [
            _Rim(_listed(b), c, np.concatenate([z.dofs(part.name) for part in z.parts]))
            for z, b, c in zip(unknowns, bodies, cells, strict=True)
        ]
        result._prepare(unknowns[0].space, rims, threshold)
        return result

    def of(self, bodies: Sequence[MaterialPoints], space: fem.FunctionSpace) -> Tying:
        """Return the tying of functions of another space to cells that some of the bodies fill.

        Args:
            bodies: Bodies of one unknown.
            space: Linear Lagrange space, such as that of a part of the unknown.
        """
        if space is self.space:
            return self
        (rim,) = (rim for rim in self._rims if set(rim.bodies) == set(bodies))
        return Tying(space, rim.bodies, rim.cells, self.threshold)

    def _prepare(self, space: fem.FunctionSpace, rims: Sequence[_Rim], threshold: float) -> None:
        for rim in rims:
            known = rim.bodies and all(body in rim.cells.points for body in rim.bodies)
            if not known or space.mesh is not rim.cells.mesh:
                raise ValueError(
                    "tying needs bodies that belong to the active cells: ActiveCells(body, ...)"
                )
        if not 0 < threshold < np.inf:
            raise ValueError(f"the threshold of filled cells must be positive, not {threshold}")
        self.bodies = [body for rim in rims for body in rim.bodies]
        self.space, self.threshold, self._rims = space, threshold, list(rims)
        self._vertices = fem.functionspace(space.mesh, ("Lagrange", 1))
        dofmap = space.dofmap
        bs, blocks = dofmap.index_map_bs, dofmap.index_map
        local = np.arange(blocks.size_local + blocks.num_ghosts, dtype=np.int32)
        self._global = (blocks.local_to_global(local)[:, None] * bs + np.arange(bs)).ravel()
        self._sizes = (blocks.size_local * bs, blocks.size_global * bs)
        nodes = _compat.geometry_dofmap(space.mesh)
        components = _components(space)
        # local dofs (n_nodes, n_components) and (n_cells, n_vertices, n_components)
        self._node_dofs = np.empty((len(space.mesh.geometry.x), len(components)), dtype=np.int32)
        error = None
        for node_dofs, dofs in zip(self._node_dofs.T, components, strict=True):
            if dofs.shape == nodes.shape:
                node_dofs[nodes] = dofs
            if dofs.shape != nodes.shape or not np.array_equal(node_dofs[nodes], dofs):
                error = ValueError(f"tying needs linear functions, not {space.ufl_element()}")
        raise_together(space.mesh.comm, error)
        self._cell_dofs = self._node_dofs[nodes]
        self._components = [
            np.array(
                [rim.dofs is None or np.isin(c[:1], rim.dofs).any() for c in self._node_dofs.T]
            )
            for rim in rims
        ]
        # PETSc objects on several ranks live until they are destroyed explicitly
        self._real_rows, self._tied, self._loose, self._work = (self._vector() for _ in range(4))
        self._products: tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat] | None = None
        self.matrix, self._transposed = PETSc.Mat(), PETSc.Mat()
        self.update()

    def update(self, fixed: npt.ArrayLike = (), inactive: npt.ArrayLike = ()) -> None:
        """Compute T for the current points. Collective.

        Args:
            fixed: Local degrees of freedom of Dirichlet conditions, which are not tied.
            inactive: Owned local degrees of freedom without equations, whose rows of a matrix
                are those of the identity, such as those of cells with boundary points only.

        Raises:
            ValueError: On all ranks, if there are ill nodes but no well-filled cell.
        """
        owned = self._sizes[0]
        fixed = np.asarray(fixed, dtype=np.int32)
        self._fixed = self._global[fixed[fixed < owned]].astype(PETSc.IntType)
        found = [
            self._extrapolation(rim, mask, fixed)
            for rim, mask in zip(self._rims, self._components, strict=True)
        ]
        dofs, columns, weights, bare = (np.concatenate(a) for a in zip(*found, strict=True))
        entries = np.ones(owned, dtype=PETSc.IntType)
        entries[dofs] = weights.shape[1]
        indptr = np.concatenate([[0], np.cumsum(entries)]).astype(PETSc.IntType)
        indices = np.repeat(self._global[:owned], entries).astype(PETSc.IntType)
        values: npt.NDArray[np.float64] = np.ones(len(indices))
        where = indptr[dofs][:, None] + np.arange(weights.shape[1])
        indices[where], values[where] = columns, weights
        self.matrix.destroy()
        self.matrix.createAIJ(
            (self._sizes, self._sizes),
            comm=lasting(self.space.mesh.comm),
            csr=(indptr, indices, values),
        )
        self.matrix.assemble()
        self._transposed.destroy()
        self._transposed = self.matrix.transpose(PETSc.Mat())
        for product in self._products or ():
            product.destroy()
        self._products = None
        self._loose.array_w[:] = 1.0
        self._loose.array_w[bare] = 0.0
        self._tied.array_w[:] = 0.0
        self._tied.array_w[dofs] = 1.0
        self.leave_out(inactive)
        self._tied.array_w[bare] = 1.0

    def leave_out(self, inactive: npt.ArrayLike) -> None:
        """Set which rows of matrices are those of the identity, see ``update``.

        Args:
            inactive: Owned local degrees of freedom.
        """
        self._real_rows.array_w[:] = 1.0
        rows = np.asarray(inactive, dtype=np.int64)
        self._real_rows.array_w[rows[self._tied.array_r[rows] > 0]] = 0.0

    @property
    def tied_dofs(self) -> npt.NDArray[np.int64]:
        """Owned local degrees of freedom that are tied, or fixed at ill nodes."""
        return np.flatnonzero(self._tied.array_r)

    def extend(self, x: PETSc.Vec) -> None:
        """Overwrite the tied entries of a vector by extrapolation, x = T x. Collective."""
        self.matrix.mult(x, self._work)
        x.array_w[:] = self._work.array_r

    def restrict(self, b: PETSc.Vec, constrained: bool = True) -> None:
        """Move the tied entries of a residual to the filled cells, b = T^T b. Collective.

        Args:
            b: Residual, overwritten.
            constrained: False for the equations of ``product``.
        """
        self.matrix.multTranspose(b, self._work)
        b.array_w[:] = self._work.array_r
        if not constrained:
            b.pointwiseMult(b, self._loose)

    def reduce(self, A: PETSc.Mat, b: PETSc.Vec) -> PETSc.Mat:
        """Return T^T A T for the free unknowns, with diagonal 1 for tied and constrained ones.

        The same matrix object is overwritten until the next ``update``. Collective.

        Args:
            A: Matrix without Dirichlet conditions, whose inactive rows are set to zero. Its pattern
                must not change until the next ``update``.
            b: Restricted right-hand side, with prescribed values at the entries constrained in the
                last ``update``. Their contributions are subtracted from the other entries.
        """
        A.diagonalScale(self._real_rows)
        # two products of two matrices: PtAP takes ten times as long to find the pattern
        first, product, reduced = self._products or (None, None, None)
        first = A.matMult(self.matrix, first)
        product = self._transposed.matMult(first, product)
        if reduced is None:  # it has no entries for tied dofs, except a diagonal
            reduced = product.copy()
            diagonal = self._diagonal()
            reduced.axpy(1.0, diagonal, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            diagonal.destroy()
        else:
            reduced.zeroEntries()
            reduced.axpy(1.0, product, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            reduced.setDiagonal(self._tied, PETSc.InsertMode.ADD)
        self._products = first, product, reduced
        self._work.array_w[:] = b.array_r
        reduced.zeroRowsColumns(self._fixed, 1.0, self._work, b)
        return reduced

    def transformed(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return T^T A T as a new matrix, without diagonal entries for tied dofs. Collective.

        Args:
            A: Matrix without Dirichlet conditions, whose inactive rows are set to zero.
        """
        A.diagonalScale(self._real_rows)
        first = A.matMult(self.matrix)
        result = self._transposed.matMult(first)
        first.destroy()
        return result

    def product(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = T^T A T x without the conditions of the last ``update``. Collective.

        Tied entries keep their values. Constrained entries are free, except at ill nodes, where
        nothing determines them: there they are zero.

        Args:
            A: Matrix; it may be given by its products only.
            x: Vector.
            y: Result.
        """
        y.pointwiseMult(x, self._loose)
        self.matrix.mult(y, self._work)
        A.mult(self._work, y)
        y.pointwiseMult(y, self._real_rows)
        self.matrix.multTranspose(y, self._work)
        self._work.pointwiseMult(self._work, self._loose)
        y.pointwiseMult(x, self._tied)
        y.axpy(1.0, self._work)

    def _extrapolation(
        self, rim: _Rim, components: npt.NDArray[np.bool_], fixed: npt.NDArray
    ) -> tuple[npt.NDArray, ...]:
        """Return owned tied dofs ``(n,)``, their global dofs ``(n, n_vertices)``, and weights.

        A fourth array holds owned dofs of ill nodes that are not tied because they are fixed.
        """
        mesh = self.space.mesh
        well = sum(filled_fractions(body) for body in rim.bodies) >= self.threshold
        full, rest = np.flatnonzero(well), np.flatnonzero(~well)
        ill = (nodes_of(mesh, rim.cells.cells()) | self._seen(rim.cells)) & ~nodes_of(mesh, full)
        tied = ill[:, None] & components & (self._node_dofs < self._sizes[0])
        is_fixed = np.isin(self._node_dofs, fixed)
        bare = np.unique(self._node_dofs[tied & is_fixed])
        tied &= ~is_fixed
        nodes, component = np.nonzero(tied)
        edge = full[nodes_of(mesh, rest)[_compat.geometry_dofmap(mesh)[full]].any(axis=1)]
        corners, dofs = self._gather(edge)
        error = None
        if len(nodes) and not len(corners):
            error = ValueError(
                f"no cell is filled to {self.threshold:g} of its volume, so nodes cannot be tied: "
                "take a finer point set, or a lower threshold"
            )
        raise_together(mesh.comm, error)
        x = mesh.geometry.x[nodes, : corners.shape[2]]
        cell = _nearest(x, corners.mean(axis=1))
        # weights that reproduce linear functions: barycentric coordinates on simplices
        linear = np.concatenate([np.ones((*corners.shape[:2], 1)), corners], axis=2)[cell]
        at_node = np.column_stack([np.ones(len(x)), x])
        weights = np.einsum("nki,nk->ni", np.linalg.pinv(linear), at_node)
        return self._node_dofs[nodes, component], dofs[cell, :, component], weights, bare

    def _seen(self, cells: ActiveCells) -> npt.NDArray[np.bool_]:
        """Return whether the function of a node is not zero at all points, ``(n_nodes,)``."""
        space = self._vertices
        seen = np.zeros(len(self.space.mesh.geometry.x), dtype=np.bool_)
        # boundary points count, too: they may lie off the body, as on walls that it does not touch
        for points in cells.points:
            weight = p2g(points, points.weight, space).array
            seen[_compat.geometry_dofmap(space.mesh)] |= (weight != 0)[space.dofmap.list]
        return seen

    def _gather(self, cells: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """Return corners and global dofs of cells on all ranks, in the order of their keys."""
        geometry = cell_geometry(self.space.mesh)
        here = (geometry.key[cells], geometry.corners(cells), self._global[self._cell_dofs[cells]])
        gathered = self.space.mesh.comm.allgather(here)
        key, corners, dofs = (np.concatenate(arrays) for arrays in zip(*gathered, strict=True))
        order = np.argsort(key)
        return corners[order], dofs[order]

    def _diagonal(self) -> PETSc.Mat:
        """Return a matrix with ones on the diagonal of tied dofs, and no other entries."""
        is_tied = self._tied.array_r > 0
        ends = np.concatenate([[0], np.cumsum(is_tied)]).astype(PETSc.IntType)
        columns = self._global[: len(is_tied)][is_tied].astype(PETSc.IntType)
        result = PETSc.Mat().createAIJ(
            (self._sizes, self._sizes),
            comm=lasting(self.space.mesh.comm),
            csr=(ends, columns, np.ones(len(columns))),
        )
        result.assemble()
        return result

    def _vector(self) -> PETSc.Vec:
        return PETSc.Vec().createMPI(self._sizes, comm=lasting(self.space.mesh.comm))


def _components(space: fem.FunctionSpace) -> list[npt.NDArray[np.int32]]:
    """Return unrolled local dofs of each scalar component, ``(n_cells, n_nodes)``."""
    if space.num_sub_spaces == 0:
        return [space.dofmap.list]
    subspaces = (space.sub(i) for i in range(space.num_sub_spaces))
    return [dofs for subspace in subspaces for dofs in _components(subspace)]


def _listed(bodies: MaterialPoints | Sequence[MaterialPoints]) -> list[MaterialPoints]:
    return [bodies] if isinstance(bodies, MaterialPoints) else list(bodies)


@njit
def _nearest(x, centres):  # type: ignore[no-untyped-def]
    """Return the index of the centre nearest to each x; the first of several up to round-off."""
    result = np.zeros(len(x), dtype=np.int64)
    for i in range(len(x)):
        best = np.inf
        for k in range(len(centres)):
            square = 0.0
            for j in range(x.shape[1]):
                square += (x[i, j] - centres[k, j]) ** 2
            if square < best * (1 - 1e-9):
                best, result[i] = square, k
    return result
