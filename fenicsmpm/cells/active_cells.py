# SPDX-License-Identifier: MIT
"""Active cells, and the facets at which cut cells are supported by their neighbours."""

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
    """The cells of the background mesh that take part in the solution, updated as points move.

    A cell is active if some point sees all its nodes. With finite elements these are the cells that
    hold a point; splines and uGIMP see further cells. Load points make cells active, too. If a load
    lies off the bodies, all cells around it are active, so that active cells lead from it to the
    body over facets. An active cell is cut if it holds nothing of a body, or if one of its facets
    leads to a cell that is not active. The measures are for UFL forms; they integrate over the
    cells and facets that are active when a form is assembled.

    Args:
        bodies: Point sets on one mesh.
        loads: Further sets on this mesh, such as boundary points that carry loads.
        touching: Boundary points of other bodies on this mesh, which may touch these bodies. They
            count if they are in a cell that shares a node with cells of the bodies.

    Attributes:
        points: All point sets.
        bodies: The point sets of bodies.
        touching: Boundary points of other bodies.
        mesh: The background mesh.
        dx: Measure of integrals over the active cells.
        dS: Measure of integrals over facets between two active cells of which at least one is cut.
        dS_all: Measure of integrals over all facets between two active cells.

    Raises:
        ValueError: If there are no bodies, or sets on several meshes. When cells are needed, on all
            ranks: if no active cells lead from a load to a body. On several ranks this requires a
            mesh with ghost cells at facets.
    """

    def __init__(
        self,
        *bodies: MaterialPoints,
        loads: Sequence[MaterialPoints] = (),
        touching: Sequence[MaterialPoints] = (),
    ) -> None:
        """Prepare the topology; cells are found when they are needed. Collective."""
        points = (*bodies, *loads, *touching)
        if not bodies or any(p.mesh is not points[0].mesh for p in points):
            raise ValueError("active cells need one or more point sets, all on the same mesh")
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
        """Value that changes whenever points have moved."""
        return tuple(p.version for p in self.points)

    def cells(self) -> npt.NDArray[np.int32]:
        """Return the owned active cells, ascending. Collective."""
        self._update()
        return self._cells

    def cut_cells(self) -> npt.NDArray[np.int32]:
        """Return the owned cut cells, ascending. Collective."""
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._cut_cells

    def facets(self) -> npt.NDArray[np.int32]:
        """Return the owned facets between two active cells, at least one of them cut. Collective.

        Raises:
            ValueError: On all ranks, for a mesh without ghost cells at facets.
        """
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._facets[self._is_cut]

    def all_facets(self) -> npt.NDArray[np.int32]:
        """Return the owned facets between two active cells. Collective.

        Raises:
            ValueError: As for ``facets``.
        """
        raise_together(self.mesh.comm, self._error)
        self._update()
        return self._facets

    def entities(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Return the integration entities of a type of integral, in dolfinx' format. Collective.

        Args:
            integral_type: "cell" or "interior_facet".
        """
        if integral_type == "cell":
            return self.cells()
        if integral_type == "interior_facet":
            return _compat.facet_entities(self.mesh, self.facets())
        raise ValueError(f"no integrals of type {integral_type!r} over active cells: use dx or dS")

    def blocks(self, integral_type: str) -> npt.NDArray[np.int32]:
        """Return the cells whose functions meet in an entity of an integral, ``(n, 1 or 2)``."""
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
            active.array[owned:] = 0.0  # their owners know them now
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
        # facets on the boundary of the mesh have their cell twice: nothing is missing there
        first, second = active.array[self._facet_cells].T > 0
        between = self._facet_cells[first != second]
        cut = la.vector(cell_map)
        cut.array[:] = 0.0
        cut.array[between.ravel()] = 1.0
        cut.array[filled.array == 0] = 1.0  # active only as a link from a load to a body
        # each rank has all facets of its own cells, so values of owned cells are complete
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
        """Raise ValueError for loads from which no active cells lead to a body. Collective."""
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
                f"a load at ({place}) m is too far from the bodies: no active cells connect its "
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
    """Return a mask of local mesh nodes that belong to given cells of any rank. Collective.

    Args:
        mesh: The background mesh.
        cells: Owned cells.

    Returns:
        Mask of shape ``(n_nodes,)``.
    """
    marks = la.vector(mesh.geometry.index_map())
    marks.array[:] = 0.0
    marks.array[_compat.geometry_dofmap(mesh)[cells]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return marks.array > 0


def _two_cells(topology: Any) -> npt.NDArray[np.int32]:
    """Return the two cells of each local facet, ``(n_facets, 2)``; equal ones at the boundary."""
    dim = topology.dim
    links = topology.connectivity(dim - 1, dim)
    first = links.array[links.offsets[:-1]]
    last = links.array[links.offsets[1:] - 1]
    return np.column_stack([first, last]).astype(np.int32)


def _check_ghosts(topology: Any, facet_cells: npt.NDArray[np.int32]) -> ValueError | None:
    """Return an error if an owned facet lacks a cell that another rank has."""
    owned = topology.index_map(topology.dim - 1).size_local
    single = np.flatnonzero(facet_cells[:owned, 0] == facet_cells[:owned, 1])
    if len(np.setdiff1d(single, exterior_facet_indices(topology))) == 0:
        return None
    return ValueError(
        "integrals over interior facets need the neighbours' cells on each rank: create the mesh "
        "with ghost cells at facets (dolfinx.mesh.GhostMode.shared_facet)"
    )
