# SPDX-License-Identifier: MIT
"""Transfer between points and grid (P2G) on any stencil."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm.basis import stencil_of
from fenicsmpm.points import MaterialPoints


def p2g(
    points: MaterialPoints, values: npt.NDArray[np.float64], space: fem.FunctionSpace
) -> la.Vector:
    """Sum point values to the grid, ``sum_p N_I(x_p) values_p``.

    Args:
        points: the point set.
        values: ``(n_points,)`` in storage order, such as the weights.
        space: scalar Lagrange space on the points' mesh.

    Returns:
        Vector of the space, summed over all ranks, ghosts up to date (collective).
    """
    stencil = stencil_of(points)
    result = la.vector(space.dofmap.index_map)
    result.array[:] = 0.0
    table = stencil.table(space.ufl_element().basix_element, 0)
    _scatter(
        values[stencil.order], table[:, 0, :], stencil.offsets, stencil.dofs(space), result.array
    )
    result.scatter_reverse(la.InsertMode.add)
    result.scatter_forward()
    return result


@numba.njit(cache=True)
def _scatter(values, table, offsets, dofs, result):  # type: ignore[no-untyped-def]
    for group in range(len(offsets) - 1):
        for k in range(offsets[group], offsets[group + 1]):
            for a in range(dofs.shape[1]):
                result[dofs[group, a]] += values[k] * table[k, a]
