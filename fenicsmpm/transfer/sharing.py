# SPDX-License-Identifier: MIT
"""Tiles that several ranks have: sums over these ranks, and ways from dolfinx' dofs to tiles.

Who has a tile is known to one rank each, by the tile's number. Each rank that has a tile adds what
all of them give to it in the order of ranks, so all have the same sums bit by bit.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

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
def _pack(tiles, chosen, packed):
    for t in range(len(chosen)):
        for i in range(tiles.shape[1]):
            packed[t, i] = tiles[chosen[t], i]


@njit
def copy_rows(values, places, dofs, index, nodal):
    """Rows ``places`` of values to rows ``dofs[index]`` of nodal values."""
    for i in range(len(places)):
        for k in range(values.shape[1]):
            nodal[dofs[index[i]], k] = values[places[i], k]


@njit
def _clear(tiles, chosen):
    for t in range(len(chosen)):
        for i in range(tiles.shape[1]):
            tiles[chosen[t], i] = 0.0


@njit
def _add(tiles, chosen, packed):
    for t in range(len(chosen)):
        for i in range(tiles.shape[1]):
            tiles[chosen[t], i] += packed[t, i]


class Sharing:
    """Who has which tiles, of all bodies or of one.

    Args:
        comm: of the mesh.
        layout: tiles of this rank.

    Attributes:
        counted: ``(n_tiles,)`` whether this rank is the first one that adds to a tile.
    """

    def __init__(self, comm: MPI.Intracomm, layout: Layout) -> None:
        """Ask (collective)."""
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
        keep = self._entries["touched"][giver] & (ranks[giver] != ranks[taker])
        giver, taker = giver[keep], taker[keep]
        gives = exchange(comm, ranks[giver], {"id": ids[giver], "rank": ranks[taker]})
        takes = exchange(comm, ranks[taker], {"id": ids[taker], "rank": ranks[giver]})
        self._give, self._take = self._by_rank(gives), self._by_rank(takes)
        for rank, tiles in self._take.items():
            if rank < comm.rank:
                self.counted[tiles] = False

    def _by_rank(self, pairs: dict[str, npt.NDArray]) -> dict[int, Integers]:
        """Places of tiles in the layout for each other rank, both in ascending order."""
        places = np.searchsorted(self.layout.ids, pairs["id"])
        return {
            int(rank): np.sort(places[pairs["rank"] == rank]) for rank in np.unique(pairs["rank"])
        }

    def holders(self, ids: Integers) -> tuple[Integers, Integers]:
        """Ranks that have tiles, of which this rank is the keeper.

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
    return {"id": layout.ids, "touched": layout.touched, "rank": ranks}


def _keeper(ids: Integers, comm: MPI.Intracomm) -> npt.NDArray[np.int32]:
    """Ranks that know who has tiles."""
    return (ids % comm.size).astype(np.int32)


def _pairs(ids: Integers) -> tuple[Integers, Integers]:
    """All pairs of entries with the same number, which are in ascending order."""
    first = np.searchsorted(ids, ids, side="left")
    count = np.searchsorted(ids, ids, side="right") - first
    one = np.repeat(np.arange(len(ids)), count)
    other = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    return one, other


class Sums:
    """Sums over ranks of the tiles that they share.

    Args:
        sharing: who has which tiles.
        numbers: how many a tile has.
    """

    def __init__(self, sharing: Sharing, numbers: int) -> None:
        """Allocate what is sent and received, once for all steps of a block."""
        comm = sharing.comm
        self._numbers = numbers
        self._give = list(sharing._give.items())
        self._take = dict(sharing._take)
        mine = [np.empty(0, np.int64), *self._take.values()]
        self._take[comm.rank] = np.unique(np.concatenate(mine))
        self._sent = [np.empty((len(tiles), numbers)) for _, tiles in self._give]
        self._taken = {rank: np.empty((len(tiles), numbers)) for rank, tiles in self._take.items()}
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
        """Sum up tiles ``(n_tiles, ...)``, which are contiguous, in place (collective)."""
        if not self._requests:
            return
        flat = tiles.reshape(-1, self._numbers)
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
        """Give the requests back to MPI."""
        for request in self._requests:
            request.Free()
        self._requests = []


class NodeNumbers:
    """Dolfinx' numbers of the nodes of a lattice, for a linear space.

    Args:
        V: linear space, scalar or blocked, on a lattice (collective).
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        """Make tables, of 4 bytes a node each."""
        self._lattice, self._x = lattice_of(V.mesh), V.mesh.geometry.x
        vertices, dofs = _compat.geometry_dofmap(V.mesh), V.dofmap.list
        self._dof = np.empty(len(self._x), dtype=np.int32)
        self._dof[vertices] = dofs
        self._vertex = np.empty_like(self._dof)
        self._vertex[dofs] = vertices
        self._owned = V.dofmap.index_map.size_local

    def positions(self, dofs: npt.NDArray[np.integer]) -> Floats:
        """Where nodes are, ``(n, 3)`` [m]."""
        return self._x[self._vertex[dofs]]

    def owned_in(self, tiles: Integers, nodes: Nodes) -> npt.NDArray[np.int32]:
        """Owned nodes in some tiles, ascending."""
        every = nodes.in_tiles(tiles).reshape(-1, 3)
        index = every[np.all(every < nodes.shape, axis=1)]
        vertices = self._lattice.nodes(index[:, : len(self._lattice.shape)])
        dofs = self._dof[vertices[vertices >= 0]]
        return np.unique(dofs[dofs < self._owned])


class DofLink:
    """From nodal values on dolfinx' owned dofs to the tiles of all ranks, and back.

    Args:
        sharing: who has which tiles.
        nodes: of the lattice.
        x: ``(n, 3)`` where this rank's nodes are that are linked [m].

    Attributes:
        places: ``(m,)`` rows of the nodes in this rank's tiles, counted through.
        index: ``(m,)`` where they are in ``x`` of the rank that owns them.
    """

    def __init__(self, sharing: Sharing, nodes: Nodes, x: Floats) -> None:
        """Find the ways (collective)."""
        comm, ids = sharing.comm, sharing.layout.ids
        self._comm, self._n, self._counted = comm, len(x), sharing.counted
        tile, node = nodes.places(x)
        data = {
            "tile": tile,
            "node": node,
            "index": np.arange(len(x)),
            "owner": np.full(len(x), comm.rank, dtype=np.int32),
        }
        # to the tiles' keepers, and from these to the ranks that have them
        if comm.size > 1:
            data = exchange(comm, _keeper(tile, comm), data)
        which, holder = sharing.holders(data["tile"])
        data = {name: a[which] for name, a in data.items()}
        if comm.size > 1:
            data = exchange(comm, holder.astype(np.int32), data)
        order = np.lexsort((data["index"], data["owner"]))
        self.index, self._owner = data["index"][order], data["owner"][order]
        place = np.searchsorted(ids, data["tile"][order])
        self.places = place * nodes.per_tile + data["node"][order]
        self._tile = place
        # what this rank's owned dofs are asked for, by rank and then in the order of places
        self._to, self._asked = self._owner, self.index
        if comm.size > 1:
            here = np.full(len(self.index), comm.rank, dtype=np.int32)
            asked = exchange(comm, self._owner, {"index": self.index, "rank": here})
            self._to, self._asked = asked["rank"], asked["index"]

    def spread(self, values: Floats) -> Floats:
        """Values ``(n, ...)`` of owned dofs at ``places``, ``(m, ...)`` (collective)."""
        sent = values[self._asked]
        if self._comm.size == 1:
            return sent
        return exchange(self._comm, self._to, {"value": sent})["value"]

    def collect(self, values: Floats) -> Floats:
        """Values ``(m, ...)`` at ``places`` to owned dofs, zero without a tile (collective).

        Where several ranks have a node, the first one that adds to it says what it has.
        """
        result = np.zeros((self._n, *values.shape[1:]))
        told = self._counted[self._tile]
        data = {"index": self.index[told], "value": values[told]}
        if self._comm.size > 1:
            data = exchange(self._comm, self._owner[told], data)
        result[data["index"]] = data["value"]
        return result
