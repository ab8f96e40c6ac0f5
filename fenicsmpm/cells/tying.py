# SPDX-License-Identifier: MIT
"""Nodes of little mass tied to filled cells, the alternative to the ghost penalty.

Aggregated unfitted finite elements (S. Badia, F. Verdugo, A. F. Martin, Comput. Methods Appl.
Mech. Engrg. 336, 2018): functions that are extrapolated linearly from filled cells to the nodes
at the rim of the body. The system A x = b becomes T^T A T y = T^T b with x = T y.
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
    """Bodies that fill cells together, their active cells, and dofs tied by these; None for all."""

    bodies: list[MaterialPoints]
    cells: ActiveCells
    dofs: npt.NDArray[np.int32] | None


class Tying:
    """Linear extrapolation to the ill nodes of a linear space, all components alike.

    A node of active cells, or whose function is not zero at all points, is ill if none of its
    cells is well filled. Its values are those of the linear function of one well-filled cell, the
    one with the nearest centroid; never of a chain. Several bodies that move with the same
    functions fill cells together.

    Args:
        space: linear Lagrange space, scalar, blocked or mixed.
        bodies: material points with volumes as weights [m^d].
        cells: active cells of the bodies and of boundary points.
        threshold: volume of points per volume of the cell [-] from which it is well filled.

    Attributes:
        bodies: as above.
        matrix: T, rows of the identity but for the tied degrees of freedom (after ``update``).

    Raises:
        ValueError: for spaces that are not linear, a body that is not in the active cells, no
            body, a threshold that is not positive.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        bodies: MaterialPoints | Sequence[MaterialPoints],
        cells: ActiveCells,
        threshold: float = 0.5,
    ) -> None:
        """Find the degrees of freedom of each node, and the first T (collective)."""
        self._prepare(space, [_Rim(_listed(bodies), cells, None)], threshold)

    @classmethod
    def of_each(
        cls,
        unknowns: Sequence[Any],
        bodies: Sequence[MaterialPoints | Sequence[MaterialPoints]],
        cells: Sequence[ActiveCells],
        threshold: float = 0.5,
    ) -> Tying:
        """Tied nodes of coupled unknowns: those of each are tied to cells that its bodies fill.

        Args:
            unknowns: made by ``formulations.coupled_unknowns``.
            bodies: of each unknown, one or several.
            cells: active cells of the bodies of each unknown.
            threshold: as above.

        Raises:
            ValueError: as above, and for sequences of different lengths.
        """
        lengths = [len(unknowns), len(bodies), len(cells)]
        if len({*lengths}) > 1:
            raise ValueError(
                f"{lengths[0]} unknowns, bodies of {lengths[1]} and active cells of {lengths[2]}: "
                "give as many of each, in the same order"
            )
        result = object.__new__(cls)
        rims = [
            _Rim(_listed(b), c, np.concatenate([z.dofs(part.name) for part in z.parts]))
            for z, b, c in zip(unknowns, bodies, cells, strict=True)
        ]
        result._prepare(unknowns[0].space, rims, threshold)
        return result

    def of(self, bodies: Sequence[MaterialPoints], space: fem.FunctionSpace) -> Tying:
        """The same for functions of another space, tied to what some of the bodies fill.

        Args:
            bodies: those of one unknown.
            space: linear Lagrange space, such as that of a part of the unknown.
        """
        if space is self.space:
            return self
        (rim,) = (rim for rim in self._rims if set(rim.bodies) == set(bodies))
        return Tying(space, rim.bodies, rim.cells, self.threshold)

    def _prepare(self, space: fem.FunctionSpace, rims: Sequence[_Rim], threshold: float) -> None:
        for rim in rims:
            known = rim.bodies and all(body in rim.cells.points for body in rim.bodies)
            if not known or space.mesh is not rim.cells.mesh:
                raise ValueError("tying needs active cells of its bodies, ActiveCells(body, ..)")
        if not 0 < threshold < np.inf:
            raise ValueError(f"cells are well filled from a positive fraction on, not {threshold}")
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
        # (n_nodes, n_components) and (n_cells, n_vertices, n_components) local dofs
        self._node_dofs = np.empty((len(space.mesh.geometry.x), len(components)), dtype=np.int32)
        error = None
        for node_dofs, dofs in zip(self._node_dofs.T, components, strict=True):
            if dofs.shape == nodes.shape:
                node_dofs[nodes] = dofs
            if dofs.shape != nodes.shape or not np.array_equal(node_dofs[nodes], dofs):
                error = ValueError(f"tying is for linear functions, not for {space.ufl_element()}")
        raise_together(space.mesh.comm, error)
        self._cell_dofs = self._node_dofs[nodes]
        self._components = [
            np.array(
                [rim.dofs is None or np.isin(c[:1], rim.dofs).any() for c in self._node_dofs.T]
            )
            for rim in rims
        ]
        # PETSc objects of several ranks live until they are destroyed by hand
        self._real_rows, self._tied, self._loose, self._work = (self._vector() for _ in range(4))
        self._products: tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat] | None = None
        self.matrix, self._transposed = PETSc.Mat(), PETSc.Mat()
        self.update()

    def update(self, fixed: npt.ArrayLike = (), inactive: npt.ArrayLike = ()) -> None:
        """Make T anew for the points as they are now (collective).

        Args:
            fixed: local degrees of freedom of Dirichlet conditions, which are not tied.
            inactive: owned local degrees of freedom at which matrices have rows of the identity
                only to be regular, such as those of cells with boundary points only.

        Raises:
            ValueError: on all ranks, if there are ill nodes but no well-filled cell.
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
        """Say which rows of matrices are those of the identity, see ``update``.

        Args:
            inactive: owned local degrees of freedom.
        """
        self._real_rows.array_w[:] = 1.0
        rows = np.asarray(inactive, dtype=np.int64)
        self._real_rows.array_w[rows[self._tied.array_r[rows] > 0]] = 0.0

    @property
    def tied_dofs(self) -> npt.NDArray[np.int64]:
        """Owned local degrees of freedom that follow others, or are fixed at ill nodes."""
        return np.flatnonzero(self._tied.array_r)

    def extend(self, x: PETSc.Vec) -> None:
        """Overwrite the tied entries of a vector by extrapolation, x = T x (collective)."""
        self.matrix.mult(x, self._work)
        x.array_w[:] = self._work.array_r

    def restrict(self, b: PETSc.Vec, constrained: bool = True) -> None:
        """Move the tied entries of a residual to the filled cells, b = T^T b (collective).

        Args:
            b: residual, overwritten.
            constrained: False for the equations of ``product``.
        """
        self.matrix.multTranspose(b, self._work)
        b.array_w[:] = self._work.array_r
        if not constrained:
            b.pointwiseMult(b, self._loose)

    def reduce(self, A: PETSc.Mat, b: PETSc.Vec) -> PETSc.Mat:
        """Matrix T^T A T of the free unknowns; tied and constrained ones have the diagonal 1.

        The same object is overwritten until the next ``update``. Collective.

        Args:
            A: matrix without Dirichlet conditions, whose inactive rows are set to zero; of the same
                pattern until the next ``update``.
            b: restricted right-hand side with the wanted values at the entries constrained by the
                conditions of the last ``update``; their contribution is subtracted elsewhere.
        """
        A.diagonalScale(self._real_rows)
        # two products of two, as PtAP takes ten times as long to find the pattern
        first, product, reduced = self._products or (None, None, None)
        first = A.matMult(self.matrix, first)
        product = self._transposed.matMult(first, product)
        if reduced is None:  # has no entries for what is tied, but for a diagonal
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
        """T^T A T as a new matrix, without diagonals for what is tied (collective).

        Args:
            A: matrix without Dirichlet conditions, whose inactive rows are set to zero.
        """
        A.diagonalScale(self._real_rows)
        first = A.matMult(self.matrix)
        result = self._transposed.matMult(first)
        first.destroy()
        return result

    def product(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = T^T A T x without the conditions of the last ``update`` (collective).

        Tied entries stay. What conditions constrain is free, but zero at ill nodes, where nothing
        would tell its value.

        Args:
            A: matrix, also one that is given by its products only.
            x: vector.
            y: result.
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
        """Owned tied dofs ``(n,)``, global dofs ``(n, n_vertices)`` to take, and their weights.

        The fourth array has owned dofs of ill nodes that are not tied because they are fixed.
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
        """``(n_nodes,)`` whether functions of a node are not zero at all points, however small."""
        space = self._vertices
        seen = np.zeros(len(self.space.mesh.geometry.x), dtype=np.bool_)
        # boundary points, too: where they are off the body, as on walls that they do not touch
        for points in cells.points:
            weight = p2g(points, points.weight, space).array
            seen[_compat.geometry_dofmap(space.mesh)] |= (weight != 0)[space.dofmap.list]
        return seen

    def _gather(self, cells: npt.NDArray) -> tuple[npt.NDArray, npt.NDArray]:
        """Corners and global dofs of cells on all ranks, in the order of their keys."""
        geometry = cell_geometry(self.space.mesh)
        here = (geometry.key[cells], geometry.corners(cells), self._global[self._cell_dofs[cells]])
        gathered = self.space.mesh.comm.allgather(here)
        key, corners, dofs = (np.concatenate(arrays) for arrays in zip(*gathered, strict=True))
        order = np.argsort(key)
        return corners[order], dofs[order]

    def _diagonal(self) -> PETSc.Mat:
        """Ones on the diagonal of what is tied, and no other entries."""
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
    """``(n_cells, n_nodes)`` unrolled local dofs of each scalar component of a space."""
    if space.num_sub_spaces == 0:
        return [space.dofmap.list]
    subspaces = (space.sub(i) for i in range(space.num_sub_spaces))
    return [dofs for subspace in subspaces for dofs in _components(subspace)]


def _listed(bodies: MaterialPoints | Sequence[MaterialPoints]) -> list[MaterialPoints]:
    return [bodies] if isinstance(bodies, MaterialPoints) else list(bodies)


@njit
def _nearest(x, centres):  # type: ignore[no-untyped-def]
    """Index of the centre nearest to each x; of those as near up to round-off, the first."""
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
