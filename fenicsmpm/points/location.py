# SPDX-License-Identifier: MIT
"""Search for the cells and reference coordinates of points, in one rank's part of the mesh.

On lattices (`fenicsmpm.points.boxes`) the cell follows from the position. On other meshes the
search starts in the cell in which the point was. On simplices it walks over neighbours towards the
most negative barycentric coordinate; on other cells it tries that cell only. Points not found this
way are searched in bins (`fenicsmpm.points.bins`).

A point on a facet, edge or vertex belongs to the touching cell of lowest number (index in the input
mesh). This does not depend on where the search starts. The cell may be on a rank that this one does
not see, though: see `Locator.is_sure`.
"""

import weakref
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from dolfinx import la
from dolfinx.mesh import Mesh

from fenicsmpm._njit import njit
from fenicsmpm.points.bins import Bins, make_bins
from fenicsmpm.points.boxes import locate_in_boxes, pull_back_to_boxes
from fenicsmpm.points.geometry import CellGeometry, cell_geometry
from fenicsmpm.points.pullback import reference_point

# A longer walk costs more than a search in the bins.
_MAX_STEPS = 20


class _Cells(NamedTuple):
    """Data of the cells for the search."""

    coefficients: npt.NDArray[np.float64]
    inverse: npt.NDArray[np.float64]
    tolerance: npt.NDArray[np.float64]
    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    key: npt.NDArray[np.int64]
    neighbours: npt.NDArray[np.int32]


class Locator:
    """Search for points in the cells (owned and ghosts) of one rank.

    Attributes:
        geometry: Shapes of the cells.
        is_lattice: Whether the cells are equal axis-parallel boxes on a lattice.
    """

    def __init__(self, mesh: Mesh):
        """Build the tables; no reference to the mesh is kept. Collective.

        Raises:
            ValueError: On all ranks, for unsupported meshes, see `CellGeometry`.
        """
        self.geometry = geometry = cell_geometry(mesh)
        self.is_lattice = geometry.boxes is not None
        self._surrounded = _surrounded(mesh)
        self._search: tuple[_Cells, Bins] | None = None
        if geometry.stored is not None:
            self._search = _tables(geometry, geometry.stored, _neighbours(mesh))

    def locate(
        self,
        x: npt.NDArray[np.float64],
        cells: npt.NDArray[np.int32] | None = None,
        *,
        owned: bool = False,
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
        """Find the cells of points among those of this rank. Not collective.

        Args:
            x: Positions in m, finite, shape (n, d).
            cells: Local cells (owned or ghost) in which the search starts, -1 if unknown,
                shape (n,).
            owned: Whether to search only cells that this rank owns.

        Returns:
            Local cells, shape (n,), int32, -1 if no cell of this rank contains the point; and
            reference coordinates, shape (n, d), which reproduce x up to round-off.
        """
        x = np.ascontiguousarray(x)
        cell = np.full(len(x), -1, dtype=np.int32) if cells is None else cells.astype(np.int32)
        xi = np.zeros_like(x)
        geometry = self.geometry
        count = geometry.num_owned if owned else geometry.num_cells
        if not count:
            cell[:] = -1
        elif self._search is not None:
            _locate(*self._search, count, x, cell, xi)
        else:
            tolerance = float(geometry.tolerance[0])
            locate_in_boxes(geometry.boxes, geometry.key, tolerance, count, x, cell, xi)
        return cell, xi

    def is_sure(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        """Return whether no other rank can have a better cell for points at xi (n, d) in `cells`.

        The answer is false for cell -1. It is true for points inside a cell, and for points on
        facets if all cells that touch theirs are on this rank.
        """
        sure = cells >= 0
        if self._surrounded is None:
            return sure
        sure[sure] = self._surrounded[cells[sure]]
        open_ = np.flatnonzero((cells >= 0) & ~sure)
        at = xi[open_]
        highest = at.sum(axis=1) if self.geometry.is_simplex else at.max(axis=1)
        margin = np.minimum(at.min(axis=1), 1.0 - highest)
        sure[open_] = margin > 2 * self.geometry.tolerance[cells[open_]]
        return sure

    def pull_back(
        self, x: npt.NDArray[np.float64], cells: npt.NDArray[np.int32]
    ) -> npt.NDArray[np.float64]:
        """Return reference coordinates (n, d) of points x (n, d) in given cells (n,)."""
        xi = np.zeros_like(x)
        if self._search is not None:
            _pull_back(self._search[0], x, cells, xi)
        else:
            pull_back_to_boxes(self.geometry.boxes, x, cells, xi)
        return xi

    def agrees(
        self,
        x: npt.NDArray[np.float64],
        xi: npt.NDArray[np.float64],
        cells: npt.NDArray[np.int32],
    ) -> npt.NDArray[np.bool_]:
        """Return whether reference coordinates xi (n, d) in cells (n,) give the points x (n, d)."""
        if not len(x):
            return np.zeros(0, dtype=bool)
        slack = 1e3 * self.geometry.tolerance[cells]
        size = np.ptp(self.geometry.corners(cells), axis=1).max(axis=1)
        distance = np.abs(self.geometry.push_forward(cells, xi) - x).max(axis=1)
        highest = xi.sum(axis=1) if self.geometry.is_simplex else xi.max(axis=1)
        inside = (xi.min(axis=1) >= -slack) & (highest <= 1.0 + slack)
        return inside & (distance <= slack * size)


_cache: "weakref.WeakKeyDictionary[Mesh, Locator]" = weakref.WeakKeyDictionary()


def locator(mesh: Mesh) -> Locator:
    """Return the locator of a mesh, built again only if the mesh has moved. Collective."""
    if mesh not in _cache or _cache[mesh].geometry is not cell_geometry(mesh):
        _cache[mesh] = Locator(mesh)
    return _cache[mesh]


def _tables(
    geometry: CellGeometry,
    coefficients: npt.NDArray[np.float64],
    neighbours: npt.NDArray[np.int32],
) -> tuple[_Cells, Bins]:
    """Return the tables of the search on meshes that are no lattices."""
    lower, upper = np.empty((2, geometry.num_cells, geometry.dim))
    for block in geometry.blocks():
        corners = geometry.corners(block)
        lower[block], upper[block] = corners.min(axis=1), corners.max(axis=1)
    tolerance = np.ascontiguousarray(geometry.tolerance)
    margin = 4 * (tolerance * (upper - lower).max(axis=1))[:, None]
    lower, upper = lower - margin, upper + margin
    inverse = geometry.simplex_inverse if geometry.is_simplex else np.empty((0, 0, 0))
    cells = _Cells(coefficients, inverse, tolerance, lower, upper, geometry.key, neighbours)
    return cells, make_bins(lower, upper)


def _neighbours(mesh: Mesh) -> npt.NDArray[np.int32]:
    """Return the cell behind the facet opposite to each vertex, -1 for none; shape (cells, d + 1).

    The array is empty for cells other than simplices.
    """
    topology = mesh.topology
    d = topology.dim
    geometry = cell_geometry(mesh)
    if not geometry.is_simplex:
        return np.zeros((0, 0), dtype=np.int32)
    topology.create_entities(d - 1)
    topology.create_connectivity(d - 1, d)
    topology.create_connectivity(d, d - 1)
    facets = topology.connectivity(d, d - 1).array.reshape(-1, d + 1)
    to_cells = topology.connectivity(d - 1, d)
    first = to_cells.offsets[:-1]
    inner = np.diff(to_cells.offsets) == 2
    both = np.full(len(first), -1, dtype=np.int64)
    both[inner] = to_cells.array[first[inner]] + to_cells.array[first[inner] + 1].astype(np.int64)
    own = np.arange(len(facets))[:, None]
    return np.where(inner[facets], both[facets] - own, -1).astype(np.int32)


def _surrounded(mesh: Mesh) -> npt.NDArray[np.bool_] | None:
    """Return whether all cells that touch a cell are on this rank, shape (cells,). Collective.

    On a single rank it returns None: the answer is yes for all cells.
    """
    if mesh.comm.size == 1:
        return None
    topology = mesh.topology
    vertices = topology.index_map(0)
    cells = topology.index_map(topology.dim)
    per_cell = len(topology.connectivity(topology.dim, 0).array)
    per_cell //= max(cells.size_local + cells.num_ghosts, 1)
    corners = topology.connectivity(topology.dim, 0).array.reshape(-1, max(per_cell, 1))
    here, everywhere = la.vector(vertices), la.vector(vertices)
    _count(corners, here.array)
    _count(corners[: cells.size_local], everywhere.array)
    everywhere.scatter_reverse(la.InsertMode.add)
    everywhere.scatter_forward()
    return _all_at(corners, here.array == everywhere.array)


@njit
def _count(corners, result):  # type: ignore[no-untyped-def]
    """Add the number of cells at each vertex to `result`."""
    for c in range(len(corners)):
        for vertex in corners[c]:
            result[vertex] += 1.0


@njit
def _all_at(corners, mark):  # type: ignore[no-untyped-def]
    """Return the cells all of whose vertices are marked."""
    result = np.ones(len(corners), dtype=np.bool_)
    for c in range(len(corners)):
        for vertex in corners[c]:
            result[c] &= mark[vertex]
    return result


@njit
def _pull_back(cells: _Cells, x, cell, xi):  # type: ignore[no-untyped-def]
    for p in range(len(x)):
        reference_point(cells.coefficients, cells.inverse, cell[p], x, p, xi[p])


@njit
def _locate(cells: _Cells, bins: Bins, count, x, cell, xi):  # type: ignore[no-untyped-def]
    """Overwrite hints in `cell` with cells among the first `count`, and set `xi`."""
    n, d = x.shape
    simplex = cells.coefficients.shape[1] == d + 1
    scratch = np.empty(d)
    for p in range(n):
        c = cell[p]
        cell[p] = -1
        for _ in range(_MAX_STEPS):
            if c < 0 or not (simplex or _in_box(cells, x, p, c)):
                break
            margin = reference_point(cells.coefficients, cells.inverse, c, x, p, scratch)
            if margin > cells.tolerance[c] and c < count:
                cell[p] = c
                for i in range(d):
                    xi[p, i] = scratch[i]
                break
            if margin >= -cells.tolerance[c] or not simplex:
                break  # on a facet, which other cells may share
            worst = 0
            for i in range(d):
                if scratch[i] == margin:
                    worst = i + 1
            c = cells.neighbours[c, worst]
        if cell[p] < 0:
            cell[p] = _search(cells, bins, count, x, p, scratch, xi)


@njit
def _search(cells: _Cells, bins: Bins, count, x, p, scratch, xi):  # type: ignore[no-untyped-def]
    """Return the cell with x[p] inside, else the touching cell of lowest key, else -1."""
    best = -1
    b = _bin_of(bins, x, p)
    if b < 0:
        return best
    for m in range(bins.offsets[b], bins.offsets[b + 1]):
        c = bins.cells[m]
        if c >= count or not _in_box(cells, x, p, c):
            continue
        margin = reference_point(cells.coefficients, cells.inverse, c, x, p, scratch)
        inside = margin > cells.tolerance[c]
        if inside or (
            margin >= -cells.tolerance[c] and (best < 0 or cells.key[c] < cells.key[best])
        ):
            best = c
            for q in range(x.shape[1]):
                xi[p, q] = scratch[q]
        if inside:
            return best
    return best


@njit
def _bin_of(bins: Bins, x, p):  # type: ignore[no-untyped-def]
    """Return the bin of x[p], -1 if the point is outside of all bins."""
    b = 0
    for i in range(x.shape[1]):
        t = (x[p, i] - bins.origin[i]) * bins.inverse_size[i]
        if not 0.0 <= t <= bins.shape[i]:
            return -1
        b = b * bins.shape[i] + min(int(t), bins.shape[i] - 1)
    return b


@njit
def _in_box(cells: _Cells, x, p, c):  # type: ignore[no-untyped-def]
    for i in range(x.shape[1]):
        if x[p, i] < cells.lower[c, i] or x[p, i] > cells.upper[c, i]:
            return False
    return True
