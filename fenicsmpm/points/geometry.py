# SPDX-License-Identifier: MIT
"""Maps from the reference cell to all cells of a mesh with straight edges."""

import itertools
import weakref
from collections.abc import Iterator
from functools import cached_property

from mpi4py import MPI

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import CellType, Mesh

from fenicsmpm import _compat
from fenicsmpm._njit import njit
from fenicsmpm.points.boxes import Boxes, find_boxes
from fenicsmpm.points.folded import folded, grid

# Points outside a cell by less than this fraction of its size count as inside.
_TOLERANCE = 1e-12

# Number of cells that are treated at a time.
_BLOCK = 1 << 14

# Dimension and number of vertices of the supported cells.
_CELLS = {
    CellType.triangle: (basix.CellType.triangle, 2, 3),
    CellType.tetrahedron: (basix.CellType.tetrahedron, 3, 4),
    CellType.quadrilateral: (basix.CellType.quadrilateral, 2, 4),
    CellType.hexahedron: (basix.CellType.hexahedron, 3, 8),
}


def monomials(xi: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
    """Evaluate the functions that span the cell map: 1, xi, eta, (zeta), and their products.

    Args:
        xi: Reference coordinates, shape (n, d).
        count: Number of functions: d + 1 (simplex), 4 (quadrilateral) or 8 (hexahedron).

    Returns:
        Values, shape (n, count).
    """
    columns = [np.ones(len(xi)), *xi.T]
    if count > len(columns):
        products: list[tuple[int, ...]] = (
            [(0, 1)] if xi.shape[1] == 2 else [(0, 1), (0, 2), (1, 2), (0, 1, 2)]
        )
        columns += [np.prod(xi[:, p], axis=1) for p in products]
    return np.stack(columns, axis=1)


def monomial_gradients(xi: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
    """Return the gradients of `monomials`, shape (n, count, d)."""
    n, d = xi.shape
    gradients = np.zeros((n, count, d))
    for k in range(d):
        gradients[:, 1 + k, k] = 1.0
    if count == 4 and d == 2:
        gradients[:, 3] = xi[:, ::-1]
    if count == 8:
        a, b, c = xi.T
        zero = np.zeros(n)
        gradients[:, 4] = np.stack([b, a, zero], axis=1)
        gradients[:, 5] = np.stack([c, zero, a], axis=1)
        gradients[:, 6] = np.stack([zero, c, b], axis=1)
        gradients[:, 7] = np.stack([b * c, a * c, a * b], axis=1)
    return gradients


class CellGeometry:
    """Shapes of the cells (owned and ghosts) of a mesh.

    On a lattice they follow from the numbers of the cells; otherwise arrays are stored.

    Attributes:
        cell: Basix cell type.
        dim: Topological and geometrical dimension d, 2 or 3.
        boxes: The lattice of the cells, if they are equal axis-parallel boxes, else None.
        stored: Coefficients of x = sum_k stored[c, k] * monomial_k(xi) in m, shape (cells, k, d);
            None if the shapes follow from `boxes`.
        num_cells: Number of owned and ghost cells.
        num_owned: Number of cells that this rank owns; the cells after them are ghosts.
        first_global: Global index of this rank's cell 0.
        key: Number of each cell, unique in the mesh, int64. It is the index in the input mesh if
            dolfinx knows it (the same on any number of ranks), else the global index.
    """

    def __init__(self, mesh: Mesh):
        """Read the geometry of a mesh; no reference to the mesh is kept. Collective.

        Raises:
            ValueError: On all ranks, for meshes other than straight triangles and quadrilaterals in
                2D or tetrahedra and hexahedra in 3D, for cells without volume, and for cells whose
                Jacobian determinant changes sign.
        """
        cell_type, geometry = mesh.topology.cell_type, mesh.geometry
        nodes = _compat.geometry_dofmap(mesh)
        self.cell, self.dim, self._vertices = _CELLS.get(cell_type, (None, 0, 0))
        known = self.dim, self._vertices
        if known != (geometry.dim, nodes.shape[1]) or geometry.x.dtype != np.float64:
            raise ValueError(
                f"a mesh of unsupported cells: {cell_type.name} with {nodes.shape[1]} nodes in "
                f"{geometry.dim} dimensions, {geometry.x.dtype}; material points need straight "
                "triangles or quadrilaterals in 2 dimensions, tetrahedra or hexahedra in 3, in "
                f"float64{_hint(self.dim, geometry.dim)}"
            )
        self._checksum = _checksum(geometry.x)
        cells = mesh.topology.index_map(self.dim)
        self.num_owned, self.num_cells = cells.size_local, cells.size_local + cells.num_ghosts
        self.first_global = cells.local_range[0]
        self._ghosts = np.array(cells.ghosts, dtype=np.int64)
        try:
            self.key = np.asarray(mesh.topology.original_cell_index, dtype=np.int64)
        except RuntimeError:  # meshes made from other meshes have no input indices
            self.key = self.global_index(np.arange(self.num_cells, dtype=np.int32))

        self.boxes, off = find_boxes(mesh.comm, geometry.x, nodes, self.dim)
        self.stored: npt.NDArray[np.float64] | None = None
        # use the exact shape if nodes are off their lattice places by more than round-off
        if self.boxes is None or off > 0.5 * float(self._box_tolerance()):
            self.stored = np.empty((len(nodes), self._vertices, self.dim))
            for block in self.blocks():
                self.stored[block] = _expand(geometry.x[nodes[block], : self.dim])
            self._check_cells(mesh.comm)

    def _check_cells(self, comm: MPI.Intracomm) -> None:
        """Raise an error unless the maps of all cells are one-to-one. Collective."""
        at = np.full((1, self.dim), 1.0 / (self.dim + 1)) if self.is_simplex else grid(self.dim)
        gradients = monomial_gradients(at, self._vertices)
        flat, bent = np.zeros((2, self.num_owned), dtype=bool)
        for block in self.blocks(self.num_owned):
            # indices: cell, component of x, point, direction of xi
            jacobian = np.tensordot(self.coefficients(block), gradients, (1, 1))
            det = _determinant(np.asarray(jacobian.transpose(1, 3, 0, 2), dtype=np.float64))
            flat[block] = (det == 0.0).all(axis=1)
            if not self.is_simplex:
                bent[block] = folded(det)
        for wrong, what, remedy in (
            (flat, "cells of zero volume", "remove them from the mesh"),
            (
                bent,
                "cells whose Jacobian changes its sign",
                "move their vertices, or split them, so that none is folded",
            ),
        ):
            cells = np.flatnonzero(wrong).astype(np.int32)
            first = cells[np.argsort(self.key[cells])[:1]]
            known = [(int(self.key[c]), self.corners(first)[0].tolist()) for c in first]
            count = comm.allreduce(len(cells))
            if count:
                number, corners = min(itertools.chain(*comm.allgather(known)))
                raise ValueError(
                    f"a mesh with {count} {what}, first number {number} with vertices {corners}: "
                    f"{remedy}"
                )

    @property
    def is_simplex(self) -> bool:
        """Whether the cells are triangles or tetrahedra."""
        return self._vertices == self.dim + 1

    def blocks(self, count: int | None = None) -> Iterator[npt.NDArray[np.int32]]:
        """Yield the first `count` cells (default: all) in blocks, to save memory."""
        count = self.num_cells if count is None else count
        for start in range(0, count, _BLOCK):
            yield np.arange(start, min(start + _BLOCK, count), dtype=np.int32)

    def global_index(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
        """Return global indices of `cells` (n,), owned or ghosts."""
        result = self.first_global + cells.astype(np.int64)
        ghosts = cells >= self.num_owned
        result[ghosts] = self._ghosts[cells[ghosts] - self.num_owned]
        return result

    def has_moved(self, mesh: Mesh) -> bool:
        """Return whether nodes of this rank have moved since this geometry was made."""
        return _checksum(mesh.geometry.x) != self._checksum

    def coefficients(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return coefficients of the maps of `cells` (n,) in `monomials`, in m, shape (n, k, d)."""
        if self.stored is not None:
            return self.stored[cells]
        return _expand(self.corners(cells))

    def corners(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return the vertices of `cells` (n,) in m, shape (n, vertices, d)."""
        if self.stored is None:
            return self._lattice.corners(cells)
        at = monomials(basix.geometry(self.cell), self._vertices)
        return np.einsum("vk,ckd->cvd", at, self.stored[cells])

    def push_forward(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Return positions in m of reference coordinates `xi` (n, d) in `cells` (n,)."""
        if self.stored is None:
            return self._lattice.push_forward(cells, xi)
        return np.einsum("pk,pkd->pd", monomials(xi, self._vertices), self.stored[cells])

    def jacobian(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Return dx/dxi, shape (n, d, d), at reference coordinates `xi` (n, d) in `cells` (n,)."""
        if self.stored is None:
            return self._lattice.jacobian(cells)
        gradients = monomial_gradients(xi, self._vertices)
        return np.einsum("pkj,pki->pij", gradients, self.stored[cells])

    def centre_jacobian(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return dx/dxi at the centres of `cells` (n,), shape (n, d, d); constant in simplices."""
        centre = 1.0 / (self.dim + 1) if self.is_simplex else 0.5
        return self.jacobian(cells, np.full((len(cells), self.dim), centre))

    @cached_property
    def simplex_inverse(self) -> npt.NDArray[np.float64]:
        """dxi/dx in all cells of a mesh of simplices, shape (cells, d, d)."""
        result = np.empty((self.num_cells, self.dim, self.dim))
        for block in self.blocks():
            result[block] = np.linalg.inv(self.centre_jacobian(block))
        return result

    def inverse_jacobian(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Return dxi/dx, shape (n, d, d), at reference coordinates `xi` (n, d) in `cells` (n,)."""
        if self.stored is None:
            return self._lattice.inverse_jacobian(cells)
        if self.is_simplex:
            return self.simplex_inverse[cells]
        return np.asarray(np.linalg.inv(self.jacobian(cells, xi)), dtype=np.float64)

    @cached_property
    def tolerance(self) -> npt.NDArray[np.float64]:
        """Tolerance of reference coordinates in each cell, shape (cells,), read-only.

        Round-off of coordinates is relative to the coordinates, not to the size of the cell. On a
        lattice the tolerance is one number, so that all ranks find the same cells.
        """
        if self.stored is None:
            return np.broadcast_to(self._box_tolerance(), self.num_cells)
        result = np.empty(self.num_cells)
        for block in self.blocks():
            size = np.abs(self.corners(block)).max(axis=(1, 2))
            if self.is_simplex:
                inverse = self.simplex_inverse[block]
            else:
                inverse = np.asarray(np.linalg.inv(self.centre_jacobian(block)))
            result[block] = _tolerance(np.abs(inverse).sum(axis=2).max(axis=1) * size)
        return result

    def _box_tolerance(self) -> npt.NDArray[np.float64]:
        boxes = self._lattice
        upper = boxes.origin + boxes.shape * boxes.spacing
        largest = np.maximum(np.abs(boxes.origin), np.abs(upper)).max()
        return _tolerance(largest / boxes.spacing.min())

    @property
    def _lattice(self) -> Boxes:
        assert self.boxes is not None
        return self.boxes

    def determinant(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Return abs(det dx/dxi) at reference coordinates `xi` (n, d) in `cells` (n,)."""
        if self.stored is None:
            return np.full(len(cells), self._lattice.spacing.prod())
        return np.abs(np.linalg.det(self.jacobian(cells, xi)))

    @cached_property
    def owned_volumes(self) -> npt.NDArray[np.float64]:
        """Volumes of the owned cells in m^d, read-only, computed once."""
        if self.stored is None:
            return np.broadcast_to(self._lattice.spacing.prod(), self.num_owned)
        return np.concatenate([np.empty(0), *map(self.volume, self.blocks(self.num_owned))])

    def volume(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return volumes of `cells` in m^d, exact up to round-off."""
        if self.stored is None:
            return np.full(len(cells), self._lattice.spacing.prod())
        # det dx/dxi is at most quadratic in each coordinate (hexahedra).
        points, weights = basix.make_quadrature(self.cell, 2)
        det = self.determinant(np.repeat(cells, len(weights)), np.tile(points, (len(cells), 1)))
        return det.reshape(len(cells), len(weights)) @ weights


def _hint(dim: int, gdim: int) -> str:
    """Return advice on flat cells in a space of more dimensions."""
    if dim != 2 or gdim != 3:
        return ""
    return (
        ". A plane mesh must have two coordinates per node: pass gdim=2 to the function of dolfinx "
        "that reads it, such as `read_from_msh` or `model_to_mesh` for Gmsh"
    )


def _determinant(A: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return determinants of matrices A (d, d, ...), shape (...)."""
    if len(A) == 2:
        return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    return (
        A[0, 0] * (A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1])
        + A[0, 1] * (A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2])
        + A[0, 2] * (A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0])
    )


def _tolerance(scale: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the tolerance of reference coordinates; `scale` is coordinate size per cell size."""
    return np.asarray(_TOLERANCE + 16 * np.finfo(float).eps * np.asarray(scale))


def _checksum(x: npt.NDArray[np.float64]) -> tuple[int, int]:
    """Return 128 bits that change if any bit of the coordinates x changes. Not collective."""
    return _mixed_sums(np.ascontiguousarray(x).reshape(-1).view(np.uint64))


@njit
def _mixed_sums(words):  # type: ignore[no-untyped-def]
    """Return two sums of the words (n,), each mixed differently at each place.

    Each mixing is one-to-one (the finalizer of splitmix64), so a change of one word never goes
    unnoticed. Changes of several words go unnoticed with a probability of 2^-128.
    """
    first = second = np.uint64(0)
    for i in range(len(words)):
        place = np.uint64(2 * i + 1) * np.uint64(0x9E3779B97F4A7C15)
        bits = words[i] ^ place
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits = bits ^ (bits >> np.uint64(31))
        first += bits
        second += (bits ^ (bits << np.uint64(23))) * place
    return first, second


def _expand(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return coefficients of the cell map in `monomials` from vertices (cells, vertices, d)."""
    a = np.moveaxis(corners, 1, 0)
    if len(a) == corners.shape[2] + 1:
        columns = [a[0], *(a[1:] - a[0])]
    elif len(a) == 4:
        columns = [a[0], a[1] - a[0], a[2] - a[0], (a[3] - a[2]) - (a[1] - a[0])]
    else:
        x, y, z = a[1] - a[0], a[2] - a[0], a[4] - a[0]
        xy, xz, yz = a[3] - a[2] - x, a[5] - a[4] - x, a[6] - a[4] - y
        xyz = (a[7] - a[6]) - (a[5] - a[4]) - xy
        columns = [a[0], x, y, z, xy, xz, yz, xyz]
    return np.ascontiguousarray(np.stack(columns, axis=1))


_cache: "weakref.WeakKeyDictionary[Mesh, CellGeometry]" = weakref.WeakKeyDictionary()


def cell_geometry(mesh: Mesh) -> CellGeometry:
    """Return the geometry of a mesh, computed again only if the mesh has moved. Collective."""
    stale = mesh not in _cache or _cache[mesh].has_moved(mesh)
    if mesh.comm.allreduce(stale, MPI.LOR):
        _cache[mesh] = CellGeometry(mesh)
    return _cache[mesh]
