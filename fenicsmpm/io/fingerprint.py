# SPDX-License-Identifier: MIT
"""Checksums that tell whether two meshes are the same and distributed in the same way."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm import _compat
from fenicsmpm.points.geometry import cell_geometry


def mesh_fingerprint(mesh: Mesh) -> str:
    """Return numbers of cells and nodes and a checksum of their positions. Collective.

    The text depends neither on the number of ranks, nor on the order of cells and nodes, nor on the
    last digits of coordinates, which may differ between machines: they are rounded to single
    precision.

    Args:
        mesh: Mesh of straight cells.
    """
    geometry = cell_geometry(mesh)
    largest = max((float(np.abs(c).max()) for c in _corners(mesh, geometry.num_owned)), default=0.0)
    largest = mesh.comm.allreduce(largest, MPI.MAX)
    total = np.uint64(0)
    for corners in _corners(mesh, geometry.num_owned):
        corners = np.where(np.abs(corners) < 1e-7 * largest, 0.0, corners)  # round-off of zero
        bits = corners.astype(np.float32).view(np.uint32).astype(np.uint64)
        node = np.zeros(bits.shape[:2], dtype=np.uint64)
        for k in range(geometry.dim):
            node = _mix(node + bits[:, :, k])
        # sums do not depend on the order
        cell = _mix(node.sum(axis=1, dtype=np.uint64))
        total = np.sum([total, cell.sum(dtype=np.uint64)], dtype=np.uint64)
    checksum = mesh.comm.allreduce(int(total)) % 2**64
    cells = mesh.topology.index_map(geometry.dim).size_global
    nodes = mesh.geometry.index_map().size_global
    kind = mesh.topology.cell_type.name
    return f"{cells} cells ({kind}), {nodes} nodes, checksum {checksum:016x}"


def layout(mesh: Mesh) -> list[str]:
    """Return a checksum of the cells of each rank, bit by bit and in their order. Collective.

    Args:
        mesh: Mesh of straight cells.
    """
    geometry = cell_geometry(mesh)
    digest = hashlib.sha256()
    for corners in _corners(mesh, geometry.num_cells):
        digest.update(corners.tobytes())
    digest.update(np.array([geometry.num_owned, geometry.first_global]).tobytes())
    return mesh.comm.allgather(digest.hexdigest()[:16])


def _corners(mesh: Mesh, count: int) -> Iterator[npt.NDArray[np.float64]]:
    """Yield vertices in m of the first cells in blocks, ``(n_cells, n_vertices, d)``."""
    nodes, x = _compat.geometry_dofmap(mesh), mesh.geometry.x
    for cells in cell_geometry(mesh).blocks(count):
        yield np.ascontiguousarray(x[nodes[cells]][:, :, : mesh.geometry.dim])


def _mix(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Mix the bits of each number (the finalizer of splitmix64)."""
    bits = bits + np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
