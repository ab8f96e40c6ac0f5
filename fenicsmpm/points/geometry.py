# SPDX-License-Identifier: MIT
"""The map from the reference cell to the cells of a mesh with straight edges, for all cells."""

import weakref
from functools import cached_property

from mpi4py import MPI

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import CellType, Mesh

from fenicsmpm import _compat

# Points outside a cell by less than this part of its size are in it.
_TOLERANCE = 1e-12

# Dimension and number of vertices of the cells that are supported.
_CELLS = {
    CellType.triangle: (basix.CellType.triangle, 2, 3),
    CellType.tetrahedron: (basix.CellType.tetrahedron, 3, 4),
    CellType.quadrilateral: (basix.CellType.quadrilateral, 2, 4),
    CellType.hexahedron: (basix.CellType.hexahedron, 3, 8),
}


def monomials(xi: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
    """The functions in which the cell map is expanded: 1, xi, eta, (zeta), and their products.

    Args:
        xi: Reference coordinates, shape (n, d).
        count: d + 1 (simplex), 4 (quadrilateral) or 8 (hexahedron).

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
    """Gradients of `monomials`, shape (n, count, d)."""
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
    """Shapes of the cells (owned and ghosts) of a mesh, as arrays.

    Attributes:
        cell: basix cell type.
        dim: Topological and geometrical dimension d, 2 or 3.
        corners: Vertices of the cells in m, shape (cells, vertices, d).
        coefficients: x = sum_k coefficients[c, k] * monomial_k(xi), shape (cells, k, d), in m.
        num_owned: Number of cells that this rank owns; cells from there on are ghosts.
        first_global: Global index of this rank's cell 0.
        global_index: Global index of each cell (owned and ghosts), int64.
        key: Number of each cell, unique over the mesh: its index in the mesh as it was input where
            dolfinx knows that (the same on any number of ranks), else its global index. int64.
    """

    def __init__(self, mesh: Mesh):
        """Copy what is needed from a mesh; no reference to the mesh is kept.

        Raises:
            ValueError: For meshes other than straight triangles, tetrahedra, quadrilaterals and
                hexahedra that fill their space.
        """
        cell_type, geometry = mesh.topology.cell_type, mesh.geometry
        nodes = _compat.geometry_dofmap(mesh)
        self.cell, self.dim, vertices = _CELLS.get(cell_type, (None, 0, 0))
        if (self.dim, vertices) != (geometry.dim, nodes.shape[1]) or geometry.x.dtype != np.float64:
            raise ValueError(
                f"a mesh of unsupported cells: {cell_type.name} with {nodes.shape[1]} nodes in "
                f"{geometry.dim} dimensions, {geometry.x.dtype}; material points need straight "
                "triangles or quadrilaterals in 2, tetrahedra or hexahedra in 3 dimensions, in "
                "float64"
            )
        self._nodes = geometry.x.copy()
        self.corners = np.ascontiguousarray(geometry.x[nodes][:, :, : self.dim])
        self.coefficients = _expand(self.corners)

        cells = mesh.topology.index_map(self.dim)
        self.num_owned = cells.size_local
        self.first_global = cells.local_range[0]
        local = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
        self.global_index = cells.local_to_global(local)
        try:
            self.key = np.array(mesh.topology.original_cell_index, dtype=np.int64)
        except RuntimeError:  # meshes made from other meshes do not have it
            self.key = self.global_index

    @property
    def is_simplex(self) -> bool:
        """Whether the cells are triangles or tetrahedra."""
        return self.coefficients.shape[1] == self.dim + 1

    @property
    def num_cells(self) -> int:
        """Number of owned and ghost cells."""
        return len(self.coefficients)

    def has_moved(self, mesh: Mesh) -> bool:
        """Whether this rank's nodes of the mesh have other coordinates than when this was made."""
        return not np.array_equal(self._nodes, mesh.geometry.x)

    def push_forward(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Positions in m of points with reference coordinates `xi` (n, d) in `cells` (n,)."""
        phi = monomials(xi, self.coefficients.shape[1])
        return np.einsum("pk,pkd->pd", phi, self.coefficients[cells])

    def jacobian(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """dx/dxi, shape (n, d, d), at reference coordinates `xi` (n, d) in `cells` (n,)."""
        gradients = monomial_gradients(xi, self.coefficients.shape[1])
        return np.einsum("pkj,pki->pij", gradients, self.coefficients[cells])

    @cached_property
    def centre_jacobian(self) -> npt.NDArray[np.float64]:
        """dx/dxi at the centres of all cells, shape (cells, d, d); in simplices it is constant."""
        centre = 1.0 / (self.dim + 1) if self.is_simplex else 0.5
        cells = np.arange(self.num_cells, dtype=np.int32)
        return self.jacobian(cells, np.full((self.num_cells, self.dim), centre))

    @cached_property
    def centre_inverse(self) -> npt.NDArray[np.float64]:
        """Inverses of `centre_jacobian`."""
        return np.asarray(np.linalg.inv(self.centre_jacobian), dtype=np.float64)

    def inverse_jacobian(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """dxi/dx, shape (n, d, d), at reference coordinates `xi` (n, d) in `cells` (n,)."""
        if self.is_simplex:
            return self.centre_inverse[cells]
        return np.asarray(np.linalg.inv(self.jacobian(cells, xi)), dtype=np.float64)

    @cached_property
    def tolerance(self) -> npt.NDArray[np.float64]:
        """What reference coordinates in each cell may be off by, shape (cells,).

        Coordinates carry round-off relative to their own size, not to that of the cell.
        """
        size = np.abs(self.corners).max(axis=(1, 2))
        scale = np.abs(self.centre_inverse).sum(axis=2).max(axis=1) * size
        return np.asarray(_TOLERANCE + 16 * np.finfo(float).eps * scale)

    def determinant(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """|det dx/dxi| at reference coordinates `xi` (n, d) in `cells` (n,)."""
        return np.abs(np.linalg.det(self.jacobian(cells, xi)))

    @cached_property
    def owned_volumes(self) -> npt.NDArray[np.float64]:
        """Volumes of the owned cells in m^d, computed once."""
        return self.volume(np.arange(self.num_owned, dtype=np.int32))

    def volume(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Volumes of `cells` in m^d, exact up to round-off."""
        # det dx/dxi is at most quadratic in each coordinate (hexahedra).
        points, weights = basix.make_quadrature(self.cell, 2)
        det = self.determinant(np.repeat(cells, len(weights)), np.tile(points, (len(cells), 1)))
        return det.reshape(len(cells), len(weights)) @ weights


def _expand(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Coefficients of the cell map in `monomials` from the vertices (cells, vertices, d)."""
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
    """The geometry of a mesh, computed once unless the mesh was moved since. Collective."""
    stale = mesh not in _cache or _cache[mesh].has_moved(mesh)
    if mesh.comm.allreduce(stale, MPI.LOR):
        _cache[mesh] = CellGeometry(mesh)
    return _cache[mesh]
