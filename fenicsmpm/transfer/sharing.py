# SPDX-License-Identifier: MIT
"""Tiles whose nodes several ranks share: sums over ranks, and links from dolfinx' dofs to tiles.

For each tile one rank, the keeper, knows which ranks have it; it follows from the tile's number.
Each rank that needs the sums at a node adds the contributions of all ranks in their order. All
ranks thus get the same sums bit by bit.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

import functools
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._njit import njit
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.points.migration import exchange
from fenicsmpm.transfer.tiles import Integers, Layout, Nodes

_TAG = 4711

Floats = npt.NDArray[np.float64]


@njit
def _pack(rows, chosen, packed):
    for n in range(len(chosen)):
        for i in range(rows.shape[1]):
            packed[n, i] = rows[chosen[n], i]


@njit
def _copy(values, places, dofs, index, nodal):
    """Copy rows ``places`` of values to rows ``dofs[index]`` of nodal values."""
    for i in range(len(places)):
        for k in range(values.shape[1]):
            nodal[dofs[index[i]], k] = values[places[i], k]


@njit
def _clear(rows, chosen):
    for n in range(len(chosen)):
        for i in range(rows.shape[1]):
            rows[chosen[n], i] = 0.0


@njit
def _add(rows, chosen, packed):
    for n in range(len(chosen)):
        for i in range(rows.shape[1]):
            rows[chosen[n], i] += packed[n, i]


class Sharing:
    """Ranks that have tiles of all bodies or of one, and that add to their nodes.

    Args:
        comm: Communicator of the mesh.
        layout: Tiles of this rank.

    Attributes:
        counted: Whether this rank is the first one that adds to a node, ``(n_tiles, nodes)``.
    """

    def __init__(self, comm: MPI.Intracomm, layout: Layout) -> None:
        """Exchange tile numbers. Collective."""
        self.comm, self.layout = comm, layout
        self.counted = layout.touched.copy()
        self._give: dict[int, Integers] = {}
        self._take: dict[int, Integers] = {}
        self._entries = _entries_of(layout, comm.rank)
        if comm.size == 1:
            return
        self._entries = exchange(comm, _keeper(layout.ids, comm), self._entries)
        order = np.lexsort((self._entries["rank"], self._entries["id"]))
        self._entries = {name: a[order] for name, a in self._entries.items()}
        ids, ranks = self._entries["id"], self._entries["rank"]
        giver, taker = _pairs(ids)
        nodes = self._entries["touched"][giver] & self._entries["wanted"][taker]
        keep = nodes.any(axis=1) & (ranks[giver] != ranks[taker])
        giver, taker, nodes = giver[keep], taker[keep], nodes[keep]
        # one rank may need nodes that another one adds to
        gives = {"id": ids[giver], "rank": ranks[taker], "nodes": nodes}
        takes = {"id": ids[taker], "rank": ranks[giver], "nodes": nodes}
        self._give = self._by_rank(exchange(comm, ranks[giver], gives))
        self._take = self._by_rank(exchange(comm, ranks[taker], takes))
        for rank, places in self._take.items():
            if rank < comm.rank:
                self.counted.reshape(-1)[places] = False

    def _by_rank(self, pairs: dict[str, npt.NDArray]) -> dict[int, Integers]:
        """Return rows of the nodes in all tiles for each other rank, ascending."""
        places, per_tile = np.searchsorted(self.layout.ids, pairs["id"]), pairs["nodes"].shape[1]
        rows = {}
        for rank in np.unique(pairs["rank"]):
            of_rank = pairs["rank"] == rank
            tile, node = np.nonzero(pairs["nodes"][of_rank])
            rows[int(rank)] = np.sort(places[of_rank][tile] * per_tile + node)
        return rows

    def holders(self, ids: Integers) -> tuple[Integers, Integers]:
        """Return the ranks that have tiles of which this rank is the keeper.

        Returns:
            Indices of the tiles in ``ids``, and a rank for each.
        """
        first = np.searchsorted(self._entries["id"], ids, side="left")
        count = np.searchsorted(self._entries["id"], ids, side="right") - first
        index = np.repeat(np.arange(len(ids)), count)
        entry = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
        return index, self._entries["rank"][entry]


def _entries_of(layout: Layout, rank: int) -> dict[str, npt.NDArray]:
    ranks = np.full(len(layout.ids), rank, dtype=np.int32)
    return {
        "id": layout.ids,
        "rank": ranks,
        "touched": layout.touched,
        "wanted": layout.wanted,
    }


def _keeper(ids: Integers, comm: MPI.Intracomm) -> npt.NDArray[np.int32]:
    """Return the ranks that know who has tiles."""
    return (ids % comm.size).astype(np.int32)


def _pairs(ids: Integers) -> tuple[Integers, Integers]:
    """Return all pairs of entries with the same number; numbers are ascending."""
    first = np.searchsorted(ids, ids, side="left")
    count = np.searchsorted(ids, ids, side="right") - first
    one = np.repeat(np.arange(len(ids)), count)
    other = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    return one, other


class Sums:
    """Sums over ranks at the nodes that they share.

    Args:
        sharing: Ranks that have the tiles.
        columns: Number of values per node.
    """

    def __init__(self, sharing: Sharing, columns: int) -> None:
        """Allocate the buffers, once for all steps of a block."""
        comm = sharing.comm
        self._columns = columns
        self._give = list(sharing._give.items())
        self._take = dict(sharing._take)
        mine = [np.empty(0, np.int64), *self._take.values()]
        self._take[comm.rank] = np.unique(np.concatenate(mine))
        self._sent = [np.empty((len(rows), columns)) for _, rows in self._give]
        self._taken = {rank: np.empty((len(rows), columns)) for rank, rows in self._take.items()}
        self._requests: list[Any] = []
        if comm.size > 1:
            receive = [
                comm.Recv_init(array, rank, _TAG)
                for rank, array in self._taken.items()
                if rank != comm.rank
            ]
            send = [
                comm.Send_init(array, rank, _TAG)
                for (rank, _), array in zip(self._give, self._sent, strict=True)
            ]
            self._requests = receive + send
        self._rank = comm.rank

    def add(self, tiles: Floats) -> None:
        """Sum up tiles ``(n_tiles, nodes, columns)``, contiguous, in place. Collective."""
        if not self._requests:
            return
        flat = tiles.reshape(-1, self._columns)
        for (_, chosen), packed in zip(self._give, self._sent, strict=True):
            _pack(flat, chosen, packed)
        MPI.Prequest.Startall(self._requests)
        mine = self._take[self._rank]
        _pack(flat, mine, self._taken[self._rank])
        _clear(flat, mine)
        MPI.Request.Waitall(self._requests)
        for rank in sorted(self._take):
            _add(flat, self._take[rank], self._taken[rank])

    def free(self) -> None:
        """Return the requests to MPI."""
        for request in self._requests:
            request.Free()
        self._requests = []


@njit
def _fill_vertices(dofs, vertices, vertex):
    """Set ``vertex[dofs] = vertices``; numpy would copy all indices with 8 bytes each."""
    for c in range(len(dofs)):
        for i in range(dofs.shape[1]):
            vertex[dofs[c, i]] = vertices[c, i]


class NodeNumbers:
    """dolfinx' numbers of the nodes of a lattice, for a linear space.

    Args:
        V: Linear space, scalar or blocked, on a lattice. Collective.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        """Read what dolfinx knows of the cells: there may be many nodes, and few with points."""
        self._lattice, self._x = lattice_of(V.mesh), V.mesh.geometry.x
        self._vertices, self._dofs = _compat.geometry_dofmap(V.mesh), V.dofmap.list
        self._owned = V.dofmap.index_map.size_local

    def positions(self, dofs: npt.NDArray[np.integer]) -> Floats:
        """Return positions of nodes in m, ``(n, 3)``."""
        return self._x[self._vertex[dofs]] if len(dofs) else np.empty((0, 3))

    @functools.cached_property
    def _vertex(self) -> npt.NDArray[np.int32]:
        """Geometry node of the mesh of each dof, computed when conditions need it."""
        vertex = np.empty(len(self._x), dtype=np.int32)
        _fill_vertices(self._dofs, self._vertices, vertex)
        return vertex

    def owned_in(self, tiles: Integers, nodes: Nodes) -> tuple[npt.NDArray[np.int32], Floats]:
        """Return owned nodes in some tiles, ascending, and their positions in m, ``(n, 3)``."""
        every = nodes.in_tiles(tiles).reshape(-1, 3)
        index = every[np.all(every < nodes.shape, axis=1)]
        dofs = self._lattice.nodes(index[:, : len(self._lattice.shape)], self._dofs)
        owned = np.flatnonzero((dofs >= 0) & (dofs < self._owned))
        owned = owned[np.argsort(dofs[owned])]
        return dofs[owned], nodes.origin + index[owned] / nodes.per_metre


class DofLink:
    """Link from nodal values on dolfinx' owned dofs to the tiles of all ranks, and back.

    Args:
        sharing: Ranks that have the tiles.
        nodes: Nodes of the lattice.
        x: Positions in m of this rank's linked nodes, ``(n, 3)``.

    Attributes:
        places: Rows of linked nodes near the points in all tiles of this rank, ``(m,)``.
        index: Index of these nodes in ``x`` of the rank that owns them, ``(m,)``.
        asked: This rank's nodes that others need, by rank and in the order of that rank,
            ``(k,)``.
    """

    def __init__(self, sharing: Sharing, nodes: Nodes, x: Floats) -> None:
        """Find the links. Collective."""
        comm, ids = sharing.comm, sharing.layout.ids
        self._comm = comm
        tile, node = nodes.places(x)
        data = {
            "tile": tile,
            "node": node,
            "index": np.arange(len(x)),
            "owner": np.full(len(x), comm.rank, dtype=np.int32),
        }
        # to the tiles' keepers, and from there to the ranks that have the tiles
        if comm.size > 1:
            data = exchange(comm, _keeper(tile, comm), data)
        which, holder = sharing.holders(data["tile"])
        data = {name: a[which] for name, a in data.items()}
        if comm.size > 1:
            data = exchange(comm, holder.astype(np.int32), data)
        order = np.lexsort((data["index"], data["owner"]))
        self.index, self._owner = data["index"][order], data["owner"][order]
        places = np.searchsorted(ids, data["tile"][order]) * nodes.per_tile + data["node"][order]
        near = sharing.layout.near.reshape(-1)[places]
        self.places, self.index, self._owner = (a[near] for a in (places, self.index, self._owner))
        told = sharing.counted.reshape(-1)[self.places]
        here = told & (self._owner == comm.rank)
        self._here, self._index_here = self.places[here], self.index[here]
        away = told & ~here
        self._away, self._owner_away = self.places[away], self._owner[away]
        self._index_from_away = self.index[away]
        self._to, self.asked = self._owner, self.index
        if comm.size > 1:
            here = np.full(len(self.index), comm.rank, dtype=np.int32)
            asked = exchange(comm, self._owner, {"index": self.index, "rank": here})
            self._to, self.asked = asked["rank"], asked["index"]
            told_to = exchange(comm, self._owner_away, {"index": self._index_from_away})
            self._index_from_away = told_to["index"]

    def spread(self, values: Floats) -> Floats:
        """Send values ``(n, ...)`` of owned dofs to ``places``, ``(m, ...)``. Collective."""
        sent = values[self.asked]
        if self._comm.size == 1:
            return sent
        return exchange(self._comm, self._to, {"value": sent})["value"]

    def collect(self, values: Floats, dofs: npt.NDArray[np.int32], nodal: Floats) -> None:
        """Send values ``(rows of tiles, k)`` to owned dofs of a function. Collective.

        If several ranks have a node, the value of the first one that adds to it counts. Nodes that
        no points touch keep their values.

        Args:
            values: Values of this rank's tiles.
            dofs: Dofs of the nodes ``x``, ``(n,)``.
            nodal: Result ``(owned dofs or more, k)``.
        """
        _copy(values, self._here, dofs, self._index_here, nodal)
        if self._comm.size > 1:
            away = exchange(self._comm, self._owner_away, {"value": values[self._away]})
            nodal[dofs[self._index_from_away]] = away["value"]
