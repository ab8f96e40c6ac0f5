# SPDX-License-Identifier: MIT
"""Partitioners that give each rank all cells that touch its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import cpp
from dolfinx.mesh import GhostMode

from fenicsmpm import _compat

_Array = npt.NDArray[np.int64]


def shared_vertex_partitioner(comm: Any, n_parts: int, cell_types: Any, cells: Any) -> Any:
    """Partition a mesh with dolfinx' own partitioner and ghost cells at all shared vertices.

    dolfinx itself has ghost cells at facets only (``GhostMode.shared_facet``). Pass this function
    as ``partitioner=`` to ``create_box``, ``create_rectangle`` or ``create_mesh``. Collective.

    Args:
        comm: MPI communicator of the ranks that pass cells.
        n_parts: Number of ranks that get cells.
        cell_types: Types of cells; one only.
        cells: Vertices of this rank's cells for each type, int64, flat.

    Returns:
        Adjacency list of the ranks that get each cell, the owner first.
    """
    parts = _compat.cell_partitioner(GhostMode.none)(comm, n_parts, cell_types, cells)
    return with_vertex_ghosts(comm, parts.array[parts.offsets[:-1]], cells)


def with_vertex_ghosts(comm: Any, owner: npt.NDArray[np.int32], cells: Any) -> Any:
    """Add ghosts to a distribution of cells, such that each rank gets all cells that touch its own.

    Cells touch if they share a vertex. Collective.

    Args:
        comm: MPI communicator of the ranks that pass cells.
        owner: Rank that is to own each of this rank's cells, shape ``(n,)``.
        cells: Vertices of these cells for each type, one only, int64, flat.

    Returns:
        Adjacency list of the ranks that get each cell, the owner first.
    """
    owner = owner.astype(np.int64)
    n = len(owner)
    vertices = np.asarray(cells[0], dtype=np.int64).reshape(n, -1 if n else 1)
    pairs = np.stack([vertices, np.broadcast_to(owner[:, None], vertices.shape)], axis=-1)
    ranks = _ranks_at(comm, np.unique(pairs.reshape(-1, 2), axis=0))
    # for each corner of each cell, all ranks that own cells there
    first = np.searchsorted(ranks[:, 0], vertices.ravel(), side="left")
    counts = np.searchsorted(ranks[:, 0], vertices.ravel(), side="right") - first
    cell = np.repeat(np.repeat(np.arange(n), vertices.shape[1]), counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    rank = ranks[np.repeat(first, counts) + within, 1]
    # the owner comes first
    is_ghost = rank != owner[cell]
    found = np.unique(np.column_stack([cell, is_ghost, rank]), axis=0)
    offsets = np.searchsorted(found[:, 0], np.arange(n + 1))
    return cpp.graph.AdjacencyList_int32(found[:, 2].astype(np.int32), offsets.astype(np.int32))


def _ranks_at(comm: Any, pairs: _Array) -> _Array:
    """Return all pairs (vertex, rank) of the vertices in this rank's pairs, sorted."""
    keeper = pairs[:, 0] % comm.size
    received = comm.alltoall([pairs[keeper == r] for r in range(comm.size)])
    known = np.unique(np.concatenate(received), axis=0)
    answers = [known[np.isin(known[:, 0], asked[:, 0])] for asked in received]
    return np.unique(np.concatenate(comm.alltoall(answers)), axis=0)
