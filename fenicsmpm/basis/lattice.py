# SPDX-License-Identifier: MIT
"""Lattices: meshes of equal axis-parallel boxes that fill a box, and where their nodes are."""

from __future__ import annotations

import weakref

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm import _compat
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.geometry import CellGeometry
from fenicsmpm.points.location import locator

# How far, in units of a cell, nodes may be off the lattice by round-off.
_SLACK = 1e-8

_Indices = npt.NDArray[np.int64]


class Lattice:
    """Numbers of the cells and nodes of a mesh along each direction.

    Attributes:
        origin: ``(d,)`` lowest corner of the mesh, in m.
        spacing: ``(d,)`` size of the cells, in m.
        shape: ``(d,)`` number of cells of the whole mesh in each direction.
        lower: ``(n_cells, d)`` lower corners of the cells (owned and ghosts), in m.
        index: ``(n_cells, d)`` their numbers in each direction, from 0.
        geometry: shapes of the cells.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Find the lattice; no reference to the mesh is kept. Collective.

        Raises:
            ValueError: on all ranks, says why the mesh is no lattice.
        """
        place = locator(mesh)
        self.geometry = geometry = place.geometry
        comm, corners = mesh.comm, geometry.corners
        raise_together(comm, _no_boxes(mesh, geometry, place.is_lattice))
        self.lower = corners.min(axis=1)
        sizes = corners.max(axis=1) - self.lower
        # bounds and size of a cell on each rank with cells
        here = None
        if geometry.num_cells > 0:
            here = (self.lower.min(axis=0), corners.max(axis=(0, 1)), sizes[0])
        known = [ends for ends in comm.allgather(here) if ends is not None]
        self.origin = origin = np.min([lower for lower, _, _ in known], axis=0)
        extent = np.max([upper for _, upper, _ in known], axis=0) - origin
        self.shape: _Indices = np.rint(extent / known[0][2]).astype(np.int64)
        self.spacing = extent / self.shape
        steps = (self.lower - origin) / self.spacing
        self.index: _Indices = np.rint(steps).astype(np.int64)
        off = np.any(np.abs(steps - self.index) > _SLACK)
        off |= np.any(np.abs(sizes - self.spacing) > _SLACK * self.spacing)
        topology = mesh.topology
        error = None
        if off:
            error = ValueError("the cells of different ranks are not on one lattice")
        for what, dim, wanted in (
            ("cells", topology.dim, int(np.prod(self.shape))),
            ("vertices", 0, int(np.prod(self.shape + 1))),
        ):
            n = topology.index_map(dim).size_global
            if error is None and n != wanted:
                error = ValueError(
                    f"a mesh with {n} {what} where a box of {' x '.join(map(str, self.shape))} "
                    f"cells has {wanted}: functions over several cells need a mesh without holes "
                    "and cracks"
                )
        raise_together(comm, error)
        self._first = self.index.min(axis=0, initial=np.iinfo(np.int64).max)
        if geometry.num_cells == 0:
            self._first = np.zeros(geometry.dim, dtype=np.int64)
        self._box = self.index.max(axis=0, initial=-1) - self._first + 2
        self._nodes = np.full(np.prod(self._box), -1, dtype=np.int32)
        self._cells = self._nodes.copy()
        self._cells[self._flat(self.index)] = np.arange(geometry.num_cells)
        above = corners > corners.mean(axis=1, keepdims=True)
        at_corners = self.index[:, None, :] + above
        self._nodes[self._flat(at_corners)] = _compat.geometry_dofmap(mesh)

    def nodes(self, index: _Indices) -> npt.NDArray[np.int32]:
        """Local nodes of the mesh's geometry by numbers ``(..., d)``, -1 for not on this rank."""
        return self._look_up(self._nodes, index)

    def cells(self, index: _Indices) -> npt.NDArray[np.int32]:
        """Local cells by numbers ``(..., d)``, -1 for not on this rank."""
        return self._look_up(self._cells, index)

    def _look_up(self, table: npt.NDArray[np.int32], index: _Indices) -> npt.NDArray[np.int32]:
        inside = np.all((index >= self._first) & (index < self._first + self._box), axis=-1)
        result = np.full(index.shape[:-1], -1, dtype=np.int32)
        result[inside] = table[self._flat(index[inside])]
        return result

    def _flat(self, index: _Indices) -> _Indices:
        """Position in the box of nodes that this rank sees."""
        result = np.zeros(index.shape[:-1], dtype=np.int64)
        for k, n in enumerate(self._box):
            result = result * n + index[..., k] - self._first[k]
        return result


def _no_boxes(mesh: Mesh, geometry: CellGeometry, is_lattice: bool) -> ValueError | None:
    wanted = "a mesh of equal axis-parallel boxes (quadrilaterals, hexahedra) is needed"
    if geometry.is_simplex:
        return ValueError(f"{wanted}, not one of {mesh.topology.cell_type.name}s")
    if not is_lattice and geometry.num_cells > 0:
        return ValueError(f"{wanted}, not one whose cells differ in size or are not axis-parallel")
    return None


_cache: weakref.WeakKeyDictionary[Mesh, Lattice] = weakref.WeakKeyDictionary()


def lattice_of(mesh: Mesh) -> Lattice:
    """The lattice of a mesh, found once unless the mesh was moved since. Collective.

    Raises:
        ValueError: see ``Lattice``.
    """
    if mesh not in _cache or _cache[mesh].geometry is not locator(mesh).geometry:
        _cache[mesh] = Lattice(mesh)
    return _cache[mesh]
