# SPDX-License-Identifier: MIT
"""Cells that hold points, and the facets at which cut cells need support from their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import la
from dolfinx.mesh import exterior_facet_indices

from fenicsmpm import _compat
from fenicsmpm.basis import stencil_of
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together


class ActiveCells:
    """The part of the background mesh that holds points, followed as they move.

    A cell is active if some point sees all its nodes: with finite elements, if it holds a point;
    splines and uGIMP see further cells. Cells that load points see are active, too. Where there
    are loads but nothing of a body, all cells around are active, so that there is a way to the body
    over facets. An active cell is cut if it holds nothing of a body, or if one of its facets
    leads to a cell that is not active. The measures are for UFL forms, which are assembled over the
    cells and facets of the moment.

    Args:
        bodies: point sets on one mesh.
        loads: further sets on it, such as boundary points that carry loads.
        touching: boundary points of other bodies on it, which may touch these. They count where
            they are in a cell that has a node with cells of the bodies in common.

    Attributes:
        points: all these sets.
        bodies: the first of them, as above.
        touching: the last of them, as above.
        mesh: the background mesh.
        dx: measure of integrals over the active cells.
        dS: measure of integrals over the facets between two active cells of which one is cut.
        dS_all: the same over all facets between two active cells.

    Raises:
        ValueError: for no bodies, or sets on several meshes. When cells are asked for, on all
            ranks, if no active cells lead from a load to a body; on several ranks that takes a mesh
            whose ranks see their neighbours' cells.
    """

    def __init__(
        self,
        *bodies: MaterialPoints,
        loads: Sequence[MaterialPoints] = (),
        touching: Sequence[MaterialPoints] = (),
    ) -> None:
        """Prepare the topology; cells are found when they are asked for. Collective."""
        points = (*bodies, *loads, *touching)
        if not bodies or any(p.mesh is not points[0].mesh for p in points):
            raise ValueError("active cells need one or more point sets on the same mesh")
        self.points = points
        self.bodies, self._loads, self.touching = bodies, tuple(loads), tuple(touching)
        self.mesh = points[0].mesh
        topology = self.mesh.topology
        dim = topology.dim
        topology.create_connectivity(dim - 1, dim)
        topology.create_connectivity(dim, dim - 1)
        self._facet_cells = _two_cells(topology)
        self._error = _check_ghosts(topology, self._facet_cells)
        unseen = self.mesh.comm.allreduce(self._error is not None, MPI.LOR)
        self._sees_neighbours = not unseen
        domain = self.mesh.ufl_domain()
        self.dx = ufl.Measure("dx", domain=domain, subdomain_data=self)
        self.dS = ufl.Measure("dS", domain=domain, subdomain_data=self)
        self.dS_all = ufl.Measure("dS", domain=domain, subdomain_data=_AllFacets(self))
        self._version: Any = None

    @property
    def version(self) -> Any:
        """Changes whenever points have moved."""
        return tuple(p.version for p in self.points)

    def cells(self) -> npt.NDArray[np.int32]:
        """Owned active cells, ascending (collective)."""
        self._update()
        return self._cells

    def cut_cells(self) -> npt.NDArray[np.int32]:
        """Owned cut cells, ascending (collective)."""
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._cut_cells

    def facets(self) -> npt.NDArray[np.int32]:
        """Owned facets between two active cells, at least one of them cut (collective).

        Raises:
            ValueError: on all ranks, for a mesh whose ranks do not see their neighbours' cells.
        """
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._facets[self._is_cut]

    def all_facets(self) -> npt.NDArray[np.int32]:
        """Owned facets between two active cells (collective).

        Raises:
            ValueError: as ``facets``.
        """
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._facets

    def entities(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Where integrals of a type are to be taken, as dolfinx wants it (collective).

        Args:
            integral_type: "cell" or "interior_facet".
        """
        if integral_type == "cell":
            return self.cells()
        if integral_type == "interior_facet":
            return _compat.facet_entities(self.mesh, self.facets())
        raise ValueError(f"no integrals of type {integral_type!r} over active cells: use dx or dS")

    def blocks(self, integral_type: str) -> npt.NDArray[np.int32]:
        """``(n, 1 or 2)`` cells whose functions meet in an entity of an integral."""
        if integral_type == "cell":
            return self.cells()[:, None]
        return self._facet_cells[self.facets()]

    def _update(self) -> None:
        if self._version == self.version:
            return
        topology = self.mesh.topology
        cell_map = topology.index_map(topology.dim)
        owned = cell_map.size_local
        active = la.vector(cell_map)
        filled = la.vector(cell_map)
        active.array[:] = filled.array[:] = 0.0
        for points in self.bodies:
            filled.array[points.cell] = 1.0
            active.array[stencil_of(points).seen_cells()] = 1.0
        active.scatter_reverse(la.InsertMode.add)
        if self._loads:
            active.array[owned:] = 0.0  # which their owners know now
            loaded = np.unique(np.concatenate([points.cell for points in self._loads]))
            apart = loaded[active.array[loaded] == 0]
            around = nodes_of(self.mesh, apart)[_compat.geometry_dofmap(self.mesh)].any(axis=1)
            active.array[around] = 1.0
            for points in self._loads:
                active.array[stencil_of(points).seen_cells()] = 1.0
            active.scatter_reverse(la.InsertMode.add)
        if self.touching:
            active.array[owned:] = 0.0
            nodes = nodes_of(self.mesh, np.flatnonzero(filled.array[:owned]))
            near = np.asarray(nodes[_compat.geometry_dofmap(self.mesh)].any(axis=1))
            for points in self.touching:
                active.array[stencil_of(points).seen_cells(near[points.cell])] = 1.0
            active.scatter_reverse(la.InsertMode.add)
        active.scatter_forward()
        filled.scatter_forward()
        self._require_way(active, filled)
        # facets of the mesh's own boundary have one cell, repeated: nothing is missing there
        first, second = active.array[self._facet_cells].T > 0
        between = self._facet_cells[first != second]
        cut = la.vector(cell_map)
        cut.array[:] = 0.0
        cut.array[between.ravel()] = 1.0
        cut.array[filled.array == 0] = 1.0  # if active at all, as a way of loads to the body
        # a rank sees all facets of its own cells, so owned values are complete
        cut.scatter_forward()
        is_cut = (cut.array > 0) & (active.array > 0)
        touched = is_cut[self._facet_cells].any(axis=1)
        inner = self._facet_cells[:, 0] != self._facet_cells[:, 1]
        n_owned = topology.index_map(topology.dim - 1).size_local
        self._facets = np.flatnonzero((first & second & inner)[:n_owned]).astype(np.int32)
        self._is_cut = touched[self._facets]
        self._cells = np.flatnonzero(active.array[:owned]).astype(np.int32)
        self._cut_cells = np.flatnonzero(is_cut[:owned]).astype(np.int32)
        self._version = self.version

    def _require_way(self, active: la.Vector, filled: la.Vector) -> None:
        """Raise ValueError for loads from which no active cells lead to a body (collective)."""
        if not self._loads or not self._sees_neighbours:
            return
        comm, pairs = self.mesh.comm, self._facet_cells
        pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (active.array[pairs] > 0).all(axis=1)]
        reached = filled.array > 0
        marks = la.vector(filled.index_map)
        while True:
            known = reached[pairs]
            step = pairs[known.any(axis=1) & ~known.all(axis=1)]
            if not comm.allreduce(len(step) > 0, MPI.LOR):
                break
            reached[step] = True
            marks.array[:] = reached
            marks.scatter_reverse(la.InsertMode.add)
            marks.scatter_forward()
            reached = marks.array > 0
        lost = [points.x[~reached[points.cell]] for points in self._loads]
        found = [x.tolist() for x in np.concatenate(lost)[:1]]
        everywhere = [x for here in comm.allgather(found) for x in here]
        if everywhere:
            place = ", ".join(f"{x:.6g}" for x in min(everywhere))
            raise ValueError(
                f"a load at ({place}) m is too far from the bodies: no active cells lead from its "
                "cell to theirs"
            )


class _AllFacets:
    """All facets between two active cells, as a region of integrals."""

    def __init__(self, cells: ActiveCells) -> None:
        self.mesh, self._active = cells.mesh, cells

    @property
    def version(self) -> Any:
        return self._active.version

    def entities(self, integral_type: str) -> npt.NDArray[np.int32]:
        return _compat.facet_entities(self.mesh, self._active.all_facets())

    def blocks(self, integral_type: str) -> npt.NDArray[np.int32]:
        return self._active._facet_cells[self._active.all_facets()]


def nodes_of(mesh: Any, cells: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
    """``(n_nodes,)`` mask of the local nodes of the mesh in given cells of any rank (collective).

    Args:
        mesh: background mesh.
        cells: owned cells.
    """
    marks = la.vector(mesh.geometry.index_map())
    marks.array[:] = 0.0
    marks.array[_compat.geometry_dofmap(mesh)[cells]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return marks.array > 0


def _two_cells(topology: Any) -> npt.NDArray[np.int32]:
    """``(n_facets, 2)`` cells of each local facet; the same twice at the boundary."""
    dim = topology.dim
    links = topology.connectivity(dim - 1, dim)
    first = links.array[links.offsets[:-1]]
    last = links.array[links.offsets[1:] - 1]
    return np.column_stack([first, last]).astype(np.int32)


def _check_ghosts(topology: Any, facet_cells: npt.NDArray[np.int32]) -> ValueError | None:
    """What is wrong if an owned facet lacks the cell that another rank has."""
    owned = topology.index_map(topology.dim - 1).size_local
    single = np.flatnonzero(facet_cells[:owned, 0] == facet_cells[:owned, 1])
    if len(np.setdiff1d(single, exterior_facet_indices(topology))) == 0:
        return None
    return ValueError(
        "integrals over interior facets need the neighbours' cells on each rank: create the mesh "
        "with ghost cells at facets (dolfinx.mesh.GhostMode.shared_facet)"
    )
