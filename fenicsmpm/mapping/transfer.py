# SPDX-License-Identifier: MIT
"""Transfer from points to the grid (P2G) on any stencil."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm.basis import stencil_of
from fenicsmpm.points import MaterialPoints


def p2g(
    points: MaterialPoints,
    values: npt.NDArray[np.float64],
    space: fem.FunctionSpace,
    least: float = 0.0,
) -> la.Vector:
    """Sum point values to the grid, ``sum_p N_I(x_p) values_p``.

    Args:
        points: the point set.
        values: ``(n_points,)`` or ``(n_points, block size)`` in storage order, such as the weights.
        space: Lagrange space on the points' mesh, scalar or blocked.
        least: what functions that are smaller than this in absolute value are taken for.

    Returns:
        Vector of the space, summed over all ranks, ghosts up to date (collective).
    """
    stencil = stencil_of(points)
    bs = space.dofmap.index_map_bs
    result = la.vector(space.dofmap.index_map, bs)
    result.array[:] = 0.0
    table = stencil.table(_scalar_element(space), 0)
    rows = values.reshape(len(points), bs)[stencil.order]
    nodes = result.array.reshape(-1, bs)
    _scatter(rows, table[:, 0, :], stencil.offsets, stencil.dofs(space), least, nodes)
    result.scatter_reverse(la.InsertMode.add)
    result.scatter_forward()
    return result


def project(
    point_sets: Sequence[MaterialPoints],
    name: str,
    function: fem.Function,
    *,
    gradient: str | None = None,
    mass: str = "mass",
) -> None:
    """Mass-weighted lumped projection of a field to the grid (VMS, algorithm 1, line 7).

    ``f_I = sum_p N_I(x_p) m_p f_p / m_I`` with ``m_I = sum_p N_I(x_p) m_p``; zero at nodes
    without mass. With the field's gradient, f_p is first continued to the node,
    ``f_p + G_p (x_I - x_p)``: linear fields are then exact at nodes with points on one side only,
    too (Nakamura, Matsumura, Mizutani, CMAME 410, 2023). Collective.

    Args:
        point_sets: bodies that have the field.
        name: of the field.
        function: of a Lagrange space, scalar or blocked like the field's values.
        gradient: name of a field of gradients ``(*value_shape, d)`` [1/m], or None.
        mass: name of the field of masses, or "weight" for volumes.
    """
    space = function.function_space
    # A node that points see by round-off only has a mass of any sign. With this share instead it
    # gets a mean of what is near.
    least = 1e-12
    total = fem.Function(space).x.array
    nodal = np.zeros_like(total)
    for points in point_sets:
        weights = points[mass].reshape(len(points), 1)
        values = points[name].reshape(len(points), space.dofmap.index_map_bs)
        if gradient is not None:
            slopes = points[gradient].reshape(*values.shape, points.x.shape[1])
            values = values - np.einsum("pck,pk->pc", slopes, points.x)
            for k, x in enumerate(_nodes(space)):
                total += x * p2g(points, weights * slopes[..., k], space, least).array
        total += p2g(points, weights * values, space, least).array
        masses = np.broadcast_to(weights, values.shape)
        nodal += p2g(points, masses, space, least).array
    function.x.array[:] = np.divide(total, nodal, out=np.zeros_like(total), where=nodal > 0)


def _nodes(space: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """``(d, n_dofs)`` coordinates of the unrolled local dofs [m]."""
    x = space.tabulate_dof_coordinates()[:, : space.mesh.geometry.dim]
    return np.repeat(x, space.dofmap.index_map_bs, axis=0).T


def _scalar_element(space: fem.FunctionSpace) -> Any:
    element = space.ufl_element()
    return (element.sub_elements[0] if element.block_size > 1 else element).basix_element


@numba.njit(cache=True)
def _scatter(values, table, offsets, dofs, least, result):  # type: ignore[no-untyped-def]
    for group in range(len(offsets) - 1):
        for k in range(offsets[group], offsets[group + 1]):
            for a in range(dofs.shape[1]):
                share = table[k, a] if abs(table[k, a]) >= least else least
                for c in range(values.shape[1]):
                    result[dofs[group, a], c] += values[k, c] * share
