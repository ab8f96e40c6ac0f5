# SPDX-License-Identifier: MIT
"""Positions, parts and cells to which the degrees of freedom of a space belong."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem


def dof_positions(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Return the ``(n_dofs, d)`` positions [m] of local degrees of freedom, unrolled. Collective.

    Args:
        V: Function space.
    """
    bs, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    if V.num_sub_spaces == 0 or bs > 1:
        return np.repeat(V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim], bs, axis=0)
    result = np.empty((index_map.size_local + index_map.num_ghosts, V.mesh.geometry.dim))
    for i in range(V.num_sub_spaces):
        space, dofs = V.sub(i).collapse()
        result[dofs] = dof_positions(space)
    return result


def parts_of(V: fem.FunctionSpace) -> list[npt.NDArray[np.int64]]:
    """Return the local dofs of each part of a mixed space, or all dofs of another space.

    The values of different parts have different units.

    Args:
        V: Function space.
    """
    if V.dofmap.index_map_bs > 1 or V.num_sub_spaces == 0:
        index_map = V.dofmap.index_map
        size = (index_map.size_local + index_map.num_ghosts) * V.dofmap.index_map_bs
        return [np.arange(size)]
    return [np.unique(V.sub(i).dofmap.list) for i in range(V.num_sub_spaces)]


def sizes_of_cells(
    V: fem.FunctionSpace, parts: list[npt.NDArray[np.int64]]
) -> npt.NDArray[np.float64]:
    """Return the smallest cell size [m] at local dofs of displacements, 0 at others. Collective.

    Gradients of displacements are added to 1, so their round-off is that of positions.

    Args:
        V: Function space.
        parts: Local dofs of the parts of V.
    """
    domain = V.mesh
    dim, cells = domain.topology.dim, domain.topology.index_map(domain.topology.dim)
    h = domain.h(dim, np.arange(cells.size_local, dtype=np.int32))
    smallest = domain.comm.allreduce(float(np.min(h, initial=np.inf)), MPI.MIN)
    result = np.zeros(sum(map(len, parts)))
    spaces = [V] if len(parts) == 1 else [V.sub(i) for i in range(len(parts))]
    for space, dofs in zip(spaces, parts, strict=True):
        if space.dofmap.bs == domain.geometry.dim or space.num_sub_spaces == domain.geometry.dim:
            result[dofs] = smallest
    return result
