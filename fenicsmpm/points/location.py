# SPDX-License-Identifier: MIT
"""Point to cell and reference coordinates, in the part of a mesh that one rank sees.

A point is first looked for from the cell it was in: on simplices by a walk over neighbours towards
the most negative barycentric coordinate, on other cells in that cell only. What is not found so is
looked for in the bins (`fenicsmpm.points.bins`), which are the cells on regular lattices.

A point on a facet, edge or vertex belongs to the containing cell of lowest number (index in the
mesh as it was input). That does not depend on where the walk starts, but that cell may be on a rank
that this one does not see: `Locator.is_sure`.
"""

import weakref
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from dolfinx import la
from dolfinx.mesh import Mesh

from fenicsmpm._njit import njit
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.bins import Bins, lattice_bins, make_bins
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.pullback import reference_point

# A walk of more cells costs more than the bins.
_MAX_STEPS = 20


class _Cells(NamedTuple):
    """What the search needs to know of the cells."""

    coefficients: npt.NDArray[np.float64]
    inverse: npt.NDArray[np.float64]
    tolerance: npt.NDArray[np.float64]
    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    key: npt.NDArray[np.int64]
    neighbours: npt.NDArray[np.int32]


class Locator:
    """Finds points in the cells (owned and ghosts) of one rank.

    Attributes:
        geometry: Shapes of the cells.
        is_lattice: Whether the cells are equal axis-parallel boxes on a lattice.
    """

    def __init__(self, mesh: Mesh):
        """Build the tables; no reference to the mesh is kept. Collective.

        Raises:
            ValueError: For a mesh of unsupported cells.
        """
        self.geometry = cell_geometry(mesh)
        a, corners = self.geometry.coefficients, self.geometry.corners
        flat = np.flatnonzero(np.linalg.det(self.geometry.centre_jacobian) == 0.0)
        raise_together(mesh.comm, _flat_cells(flat, corners) if len(flat) else None)
        inverse = self.geometry.centre_inverse
        tolerance = self.geometry.tolerance
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        margin = 4 * (tolerance * (upper - lower).max(axis=1))[:, None]
        lower, upper = lower - margin, upper + margin
        self._cells = _Cells(
            a, inverse, tolerance, lower, upper, self.geometry.key, _neighbours(mesh)
        )
        self._surrounded = _surrounded(mesh)
        lattice = lattice_bins(a)
        self.is_lattice = lattice is not None
        self._bins = lattice if lattice is not None else make_bins(lower, upper)

    def locate(
        self, x: npt.NDArray[np.float64], cells: npt.NDArray[np.int32] | None = None
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
        """Find the cells of points among those of this rank. Not collective.

        Args:
            x: Positions in m, finite, shape (n, d).
            cells: Local cells (owned or ghost) to start from, -1 for nothing known, shape (n,).

        Returns:
            Local cells, shape (n,), int32, -1 where no cell of this rank contains the point; and
            reference coordinates, shape (n, d), which reproduce x up to round-off.
        """
        x = np.ascontiguousarray(x)
        cell = np.full(len(x), -1, dtype=np.int32) if cells is None else cells.astype(np.int32)
        xi = np.zeros_like(x)
        if self.geometry.num_cells:
            _locate(self._cells, self._bins, x, cell, xi)
        else:
            cell[:] = -1
        return cell, xi

    def is_sure(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        """Whether points located at xi (n, d) in cells (n,) are in no cell that only others see.

        False for cell -1. Points inside of a cell are sure, as are those on facets if all cells
        that touch theirs are on this rank.
        """
        sure = cells >= 0
        sure[sure] = self._surrounded[cells[sure]]
        open_ = np.flatnonzero((cells >= 0) & ~sure)
        at = xi[open_]
        highest = at.sum(axis=1) if self.geometry.is_simplex else at.max(axis=1)
        margin = np.minimum(at.min(axis=1), 1.0 - highest)
        sure[open_] = margin > 2 * self._cells.tolerance[cells[open_]]
        return sure

    def pull_back(
        self, x: npt.NDArray[np.float64], cells: npt.NDArray[np.int32]
    ) -> npt.NDArray[np.float64]:
        """Reference coordinates (n, d) of points x (n, d) in given cells (n,) that contain them."""
        xi = np.zeros_like(x)
        _pull_back(self._cells, x, cells, xi)
        return xi

    def agrees(
        self,
        x: npt.NDArray[np.float64],
        xi: npt.NDArray[np.float64],
        cells: npt.NDArray[np.int32],
    ) -> npt.NDArray[np.bool_]:
        """Whether reference coordinates xi (n, d) in cells (n,) give the points x (n, d)."""
        if not len(x):
            return np.zeros(0, dtype=bool)
        slack = 1e3 * self._cells.tolerance[cells]
        size = (self._cells.upper[cells] - self._cells.lower[cells]).max(axis=1)
        distance = np.abs(self.geometry.push_forward(cells, xi) - x).max(axis=1)
        highest = xi.sum(axis=1) if self.geometry.is_simplex else xi.max(axis=1)
        inside = (xi.min(axis=1) >= -slack) & (highest <= 1.0 + slack)
        return inside & (distance <= slack * size)


_cache: "weakref.WeakKeyDictionary[Mesh, Locator]" = weakref.WeakKeyDictionary()


def locator(mesh: Mesh) -> Locator:
    """The locator of a mesh, built once unless the mesh was moved since. Collective."""
    if mesh not in _cache or _cache[mesh].geometry is not cell_geometry(mesh):
        _cache[mesh] = Locator(mesh)
    return _cache[mesh]


def _flat_cells(flat: npt.NDArray[np.intp], corners: npt.NDArray[np.float64]) -> ValueError:
    return ValueError(
        f"a mesh with {len(flat)} cells of zero volume, first with vertices "
        f"{corners[flat[0]].tolist()}: remove them from the mesh"
    )


def _neighbours(mesh: Mesh) -> npt.NDArray[np.int32]:
    """Cell behind the facet opposite to each vertex, -1 for none; shape (cells, d + 1).

    Empty for cells other than simplices.
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


def _surrounded(mesh: Mesh) -> npt.NDArray[np.bool_]:
    """Whether all cells that touch a cell are on this rank, shape (cells,). Collective."""
    topology = mesh.topology
    cells = topology.index_map(topology.dim)
    corners = topology.connectivity(topology.dim, 0).array
    per_cell = len(corners) // max(cells.size_local + cells.num_ghosts, 1)
    everywhere = la.vector(topology.index_map(0))
    n = len(everywhere.array)
    everywhere.array[:] = np.bincount(corners[: cells.size_local * per_cell], minlength=n)
    everywhere.scatter_reverse(la.InsertMode.add)
    everywhere.scatter_forward()
    complete = np.bincount(corners, minlength=n) == everywhere.array
    return complete[corners].reshape(-1, max(per_cell, 1)).all(axis=1)


@njit
def _pull_back(cells: _Cells, x, cell, xi):  # type: ignore[no-untyped-def]
    for p in range(len(x)):
        reference_point(cells.coefficients, cells.inverse, cell[p], x, p, xi[p])


@njit
def _locate(cells: _Cells, bins: Bins, x, cell, xi):  # type: ignore[no-untyped-def]
    """Overwrite the hints in `cell` by the cells found, and `xi`."""
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
            if margin > cells.tolerance[c]:
                cell[p] = c
                for i in range(d):
                    xi[p, i] = scratch[i]
                break
            if margin >= -cells.tolerance[c] or not simplex:
                break  # on a facet: other cells may contain it too
            worst = 0
            for i in range(d):
                if scratch[i] == margin:
                    worst = i + 1
            c = cells.neighbours[c, worst]
        if cell[p] < 0:
            cell[p] = _search(cells, bins, x, p, scratch, xi)


@njit
def _search(cells: _Cells, bins: Bins, x, p, scratch, xi):  # type: ignore[no-untyped-def]
    """The cell that contains x[p] inside, else the one of lowest key that touches it, else -1."""
    d = x.shape[1]
    best = -1
    i0, i1 = _bin_range(bins, x, p, 0)
    j0, j1 = _bin_range(bins, x, p, 1)
    k0, k1 = _bin_range(bins, x, p, 2) if d == 3 else (0, 0)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(k0, k1 + 1):
                b = i * bins.shape[1] + j
                if d == 3:
                    b = b * bins.shape[2] + k
                for m in range(bins.offsets[b], bins.offsets[b + 1]):
                    c = bins.cells[m]
                    if not _in_box(cells, x, p, c):
                        continue
                    margin = reference_point(cells.coefficients, cells.inverse, c, x, p, scratch)
                    inside = margin > cells.tolerance[c]
                    if inside or (
                        margin >= -cells.tolerance[c]
                        and (best < 0 or cells.key[c] < cells.key[best])
                    ):
                        best = c
                        for q in range(d):
                            xi[p, q] = scratch[q]
                    if inside:
                        return best
    return best


@njit
def _bin_range(bins: Bins, x, p, i):  # type: ignore[no-untyped-def]
    """First and last bin of x[p] in direction i; empty if the point is outside of all bins."""
    t = (x[p, i] - bins.origin[i]) * bins.inverse_size[i]
    last = bins.shape[i] - 1
    if t + bins.slack < 0.0 or t - bins.slack > last + 1.0:
        return 0, -1
    return max(int(t - bins.slack), 0), min(int(t + bins.slack), last)


@njit
def _in_box(cells: _Cells, x, p, c):  # type: ignore[no-untyped-def]
    for i in range(x.shape[1]):
        if x[p, i] < cells.lower[c, i] or x[p, i] > cells.upper[c, i]:
            return False
    return True
