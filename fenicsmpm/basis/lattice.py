# SPDX-License-Identifier: MIT
"""Lattices: meshes of equal axis-parallel boxes that fill a box."""

from __future__ import annotations

import itertools
import weakref

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm import _compat
from fenicsmpm.points.geometry import CellGeometry
from fenicsmpm.points.location import locator

_Indices = npt.NDArray[np.int64]


class Lattice:
    """Numbers of the cells and nodes of a mesh along each direction.

    Attributes:
        origin: Lowest corner of the mesh in m, shape ``(d,)``.
        spacing: Size of the cells in m, shape ``(d,)``.
        shape: Number of cells of the whole mesh in each direction, shape ``(d,)``.
        boxes: Places of this rank's cells, for compiled loops.
        geometry: Shapes of the cells.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Check the lattice; no reference to the mesh is kept. Collective.

        Raises:
            ValueError: On all ranks, if the mesh is no lattice; the message says why.
        """
        self.geometry = geometry = locator(mesh).geometry
        if geometry.boxes is None:
            raise ValueError(_no_boxes(mesh, geometry))
        self.boxes = boxes = geometry.boxes
        self.origin, self.spacing, self.shape = boxes.origin, boxes.spacing, boxes.shape
        topology = mesh.topology
        for what, dim, wanted in (
            ("cells", topology.dim, int(np.prod(self.shape))),
            ("vertices", 0, int(np.prod(self.shape + 1))),
        ):
            n = topology.index_map(dim).size_global
            if n != wanted:
                raise ValueError(
                    f"a lattice of {' x '.join(map(str, self.shape))} cells has {wanted} {what}, "
                    f"but this mesh has {n}: functions over several cells need a mesh without "
                    "holes and cracks"
                )
        self._dofmap = _compat.geometry_dofmap(mesh)

    def numbers(self, cells: npt.NDArray[np.int32]) -> _Indices:
        """Return numbers of local cells ``(n,)`` in each direction, from 0, ``(n, d)``."""
        return self.boxes.numbers(cells)

    def cells(self, index: _Indices) -> npt.NDArray[np.int32]:
        """Return local cells by numbers ``(..., d)``, -1 if not on this rank."""
        return self.boxes.at(index)

    def nodes(
        self, index: _Indices, dofmap: npt.NDArray[np.int32] | None = None
    ) -> npt.NDArray[np.int32]:
        """Return local nodes by numbers ``(..., d)``, -1 if not on this rank.

        Args:
            index: Numbers of the nodes in each direction.
            dofmap: Nodes of each cell in a linear space; None for those of the mesh's geometry.
        """
        dofmap = self._dofmap if dofmap is None else dofmap
        flat = index.reshape(-1, index.shape[-1])
        result = np.full(len(flat), -1, dtype=np.int32)
        # a node is a corner of some cell around it that is on this rank
        for upper in itertools.product((0, 1), repeat=flat.shape[1]):
            missing = np.flatnonzero(result < 0)
            cells = self.cells(flat[missing] - upper)
            found = np.flatnonzero(cells >= 0)
            vertex = self.boxes.vertex(cells[found], np.array(upper))
            result[missing[found]] = dofmap[cells[found], vertex]
        return result.reshape(index.shape[:-1])


def _no_boxes(mesh: Mesh, geometry: CellGeometry) -> str:
    wanted = "a mesh of equal axis-parallel boxes (quadrilaterals, hexahedra) is needed"
    if geometry.is_simplex:
        return f"{wanted}, not one of {mesh.topology.cell_type.name}s"
    return f"{wanted}, not one whose cells differ in size or are not axis-parallel"


_cache: weakref.WeakKeyDictionary[Mesh, Lattice] = weakref.WeakKeyDictionary()


def lattice_of(mesh: Mesh) -> Lattice:
    """Return the lattice of a mesh, computed again only if the mesh has moved. Collective.

    Args:
        mesh: The background mesh.

    Raises:
        ValueError: On all ranks, if the mesh is no lattice, see ``Lattice``.
    """
    if mesh not in _cache or _cache[mesh].geometry is not locator(mesh).geometry:
        _cache[mesh] = Lattice(mesh)
    return _cache[mesh]
