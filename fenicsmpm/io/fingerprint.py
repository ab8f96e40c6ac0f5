# SPDX-License-Identifier: MIT
"""Whether two meshes are the same, and distributed in the same way."""

from __future__ import annotations

import hashlib

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm.points.geometry import cell_geometry


def mesh_fingerprint(mesh: Mesh) -> str:
    """Numbers of cells and nodes and a checksum of their positions (collective).

    It depends on neither the number of ranks nor the order of cells and nodes, nor on the last
    digits of coordinates, in which machines may differ: they are rounded to single precision.

    Args:
        mesh: mesh of straight cells.
    """
    geometry = cell_geometry(mesh)
    corners = geometry.corners[: geometry.num_owned]
    largest = mesh.comm.allreduce(float(np.abs(corners).max(initial=0.0)), MPI.MAX)
    corners = np.where(np.abs(corners) < 1e-7 * largest, 0.0, corners)  # round-off of zero
    bits = corners.astype(np.float32).view(np.uint32).astype(np.uint64)
    node = np.zeros(bits.shape[:2], dtype=np.uint64)
    for k in range(geometry.dim):
        node = _mix(node + bits[:, :, k])
    # sums do not depend on the order
    cell = _mix(node.sum(axis=1, dtype=np.uint64))
    checksum = mesh.comm.allreduce(int(cell.sum(dtype=np.uint64))) % 2**64
    cells = mesh.topology.index_map(geometry.dim).size_global
    nodes = mesh.geometry.index_map().size_global
    kind = mesh.topology.cell_type.name
    return f"{cells} cells ({kind}), {nodes} nodes, checksum {checksum:016x}"


def layout(mesh: Mesh) -> list[str]:
    """A checksum for each rank of its cells, bit by bit and in their order (collective).

    Args:
        mesh: mesh of straight cells.
    """
    geometry = cell_geometry(mesh)
    digest = hashlib.sha256(geometry.corners.tobytes())
    digest.update(np.array([geometry.num_owned, geometry.first_global]).tobytes())
    return mesh.comm.allgather(digest.hexdigest()[:16])


def _mix(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Scatter the bits of each number (the finalizer of splitmix64)."""
    bits = bits + np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
