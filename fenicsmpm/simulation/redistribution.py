# SPDX-License-Identifier: MIT
"""Meshes of the same cells, distributed over the ranks by the points in them."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import cpp, graph
from dolfinx.io import distribute_entity_data
from dolfinx.mesh import (
    Mesh,
    MeshTags,
    create_mesh,
    entities_to_geometry,
    meshtags_from_entities,
)

from fenicsmpm import _compat
from fenicsmpm.basis.bisection import bisect
from fenicsmpm.basis.partition import with_vertex_ghosts
from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.migration import exchange


class Redistribution:
    """New distribution of a mesh, before it is made.

    Cells keep their numbers, which decide to which cell points on facets belong. Nodes keep their
    order in cells. The old global numbers of nodes are the ``input_global_indices`` of the new
    mesh.

    Args:
        mesh: The present mesh, of straight cells.
        points: Number of points in each cell that this rank owns, ``(n,)``.

    Attributes:
        points: Number of points that each rank would have, ``(size,)``, the same on all ranks.
    """

    def __init__(self, mesh: Mesh, points: npt.NDArray[np.int64]) -> None:
        """Distribute the cells. Collective."""
        self._old, comm, geometry = mesh, mesh.comm, cell_geometry(mesh)
        nodes = _compat.geometry_dofmap(mesh)[: geometry.num_owned]
        number = mesh.geometry.index_map().local_to_global
        key = geometry.key[: geometry.num_owned]
        cells = {
            "key": key,
            "nodes": number(nodes.ravel()).reshape(nodes.shape),
            "middle": mesh.geometry.x[nodes, : geometry.dim].mean(axis=1),
            "points": points.astype(np.int64),
        }
        cells = exchange(comm, _keeper(mesh, key), cells)
        order = np.argsort(cells["key"])
        self._nodes = cells["nodes"][order]
        self._owner = bisect(comm, cells["middle"][order], cells["points"][order])
        self.points = np.zeros(comm.size, dtype=np.int64)
        np.add.at(self.points, self._owner, cells["points"][order])
        comm.Allreduce(MPI.IN_PLACE, self.points)

    def make(self) -> Mesh:
        """Return the new mesh. Collective.

        A mesh without ghost cells gets none. Otherwise each rank gets all cells that share a vertex
        with its own, which include those that share a facet.
        """
        old, owner = self._old, self._owner
        has_ghosts = _has_ghosts(old)

        def partitioner(comm: Any, n_parts: int, cell_types: Any, cells: Any) -> Any:
            if has_ghosts:
                return with_vertex_ghosts(comm, owner, cells)
            return cpp.graph.AdjacencyList_int32(owner, np.arange(len(owner) + 1, dtype=np.int32))

        x = old.geometry.x[: old.geometry.index_map().size_local, : old.geometry.dim]
        # a UFL mesh belongs to one mesh of dolfinx: the new one needs its own
        element = old.ufl_domain().ufl_coordinate_element()
        new = create_mesh(old.comm, cells=self._nodes, x=x, e=element, partitioner=partitioner)
        new.name = old.name
        return new


def tags_on(tags: MeshTags, old: Mesh, new: Mesh) -> MeshTags:
    """Transfer tags to a mesh made by ``Redistribution``. Collective.

    Args:
        tags: Tags of entities, such as cells or facets.
        old: Mesh of the tags.
        new: The new mesh.
    """
    topology, dim = old.topology, tags.dim
    for pair in ((dim, topology.dim), (topology.dim, dim)):
        topology.create_connectivity(*pair)
    owned = tags.indices < topology.index_map(dim).size_local
    kind = cpp.mesh.cell_entity_type(topology.cell_type, dim, 0)
    nodes = np.empty((0, cpp.mesh.cell_num_vertices(kind)), dtype=np.int32)
    if np.any(owned):  # dolfinx 0.9 would divide by zero otherwise
        nodes = entities_to_geometry(old, dim, tags.indices[owned])
    number = old.geometry.index_map().local_to_global
    found, values = distribute_entity_data(
        new, dim, number(nodes.ravel()).reshape(nodes.shape), tags.values[owned]
    )
    new.topology.create_connectivity(dim, 0)
    moved = meshtags_from_entities(new, dim, graph.adjacencylist(found), values)
    moved.name = tags.name
    return moved


def cells_on(old: Mesh, new: Mesh) -> npt.NDArray[np.int64]:
    """Return where the cells of a mesh are on one made by ``Redistribution``. Collective.

    Args:
        old: The old mesh.
        new: The new mesh.

    Returns:
        Global cell of the new mesh for each cell of the old one that this rank owns, ``(n,)``.
    """
    comm, (before, after) = old.comm, (cell_geometry(mesh) for mesh in (old, new))
    number = after.global_index(np.arange(after.num_owned, dtype=np.int32))
    key = after.key[: after.num_owned]
    known = exchange(comm, _keeper(new, key), {"key": key, "cell": number})
    order = np.argsort(known["key"])

    key = before.key[: before.num_owned]
    asked: dict[str, npt.NDArray] = {
        "key": key,
        "asker": np.full(len(key), comm.rank, dtype=np.int32),
        "cell": np.arange(len(key)),
    }
    asked = exchange(comm, _keeper(old, key), asked)
    found = known["cell"][order][np.searchsorted(known["key"], asked["key"], sorter=order)]
    answer = exchange(comm, asked["asker"], {"cell": asked["cell"], "number": found})
    result = np.empty(len(key), dtype=np.int64)
    result[answer["cell"]] = answer["number"]
    return result


def _keeper(mesh: Mesh, key: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
    """Return the rank that keeps track of each cell, by equal shares of the numbers."""
    cells = mesh.topology.index_map(mesh.topology.dim).size_global
    return (key * mesh.comm.size // cells).astype(np.int32)


def _has_ghosts(mesh: Mesh) -> bool:
    """Return whether ranks have ghost cells where their cells meet; True without such places."""
    topology = mesh.topology
    vertices, cells = (topology.index_map(dim).num_ghosts for dim in (0, topology.dim))
    vertices, cells = mesh.comm.allreduce(vertices), mesh.comm.allreduce(cells)
    return cells > 0 or vertices == 0
