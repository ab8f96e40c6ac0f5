# SPDX-License-Identifier: MIT
"""Transfer from points to the grid (P2G) on any stencil."""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm._njit import njit
from fenicsmpm.basis import stencil_of
from fenicsmpm.points import MaterialPoints

_POSITIONS: weakref.WeakKeyDictionary[fem.Function, npt.NDArray[np.float64]] = (
    weakref.WeakKeyDictionary()
)


def p2g(
    points: MaterialPoints,
    values: npt.NDArray[np.float64],
    space: fem.FunctionSpace,
    *,
    rounded: bool = False,
    positive: bool = False,
) -> la.Vector:
    """Sum point values to the grid, ``sum_p N_I(x_p) values_p``. Collective.

    Args:
        points: The point set.
        values: Values in storage order, such as the weights, ``(n_points,)`` or
            ``(n_points, size)``.
        space: Lagrange space on the points' mesh, scalar or blocked, whose nodes are used.
        rounded: Whether functions that are zero up to round-off count with the size of round-off.
        positive: Whether functions with a slope must not be zero, see
            ``PointStencil.positive_table``; for linear spaces only.

    Returns:
        Vector with ``size`` numbers per node, summed over all ranks, ghosts up to date.
    """
    stencil = stencil_of(points)
    size = 1 if values.ndim == 1 else values.shape[1]
    result = la.vector(space.dofmap.index_map, size)
    result.array[:] = 0.0
    element = _scalar_element(space)
    table = stencil.positive_table(element) if positive else stencil.table(element, 0)[:, 0]
    rows = values.reshape(len(points), size)
    nodes = result.array.reshape(-1, size)
    least = stencil.least if rounded else np.zeros(len(stencil.least))
    dofs = stencil.dofs(space)
    _scatter(rows, stencil.order, table, stencil.offsets, dofs, least, nodes)
    result.scatter_reverse(la.InsertMode.add)
    result.scatter_forward()
    return result


def project(
    point_sets: Sequence[MaterialPoints],
    functions: Mapping[str, fem.Function],
    *,
    gradients: Mapping[str, str] | None = None,
    mass: str = "mass",
) -> None:
    """Project fields to the grid, mass-weighted and lumped (VMS, algorithm 1, line 7). Collective.

    ``f_I = sum_p N_I(x_p) m_p f_p / m_I`` with ``m_I = sum_p N_I(x_p) m_p``; zero at nodes
    without mass. If the gradient G of a field is given, f_p is first extrapolated to the node,
    ``f_p + G_p (x_I - x_p)``. Linear fields are then exact even at nodes with points on one side
    only (Nakamura, Matsumura, Mizutani, CMAME 410, 2023).

    Args:
        point_sets: Bodies that have the fields.
        functions: Lagrange functions by the field's name, scalar or blocked like its values.
        gradients: Names of the fields of gradients ``(*value_shape, d)`` in units of the field per
            m, by the field's name.
        mass: Name of the field of masses, or "weight" for volumes.
    """
    gradients = gradients or {}
    spaces = {id(f.function_space): f.function_space for f in functions.values()}
    for key, space in spaces.items():
        fields = {name: f for name, f in functions.items() if id(f.function_space) == key}
        slopes = {name: gradients[name] for name in fields if name in gradients}
        # A node that points see by round-off only could have a mass of any sign. With a small
        # positive value instead, it gets a mean of what is near.
        sums = sum(
            p2g(points, _columns(points, fields, slopes, mass), space, rounded=True).array
            for points in point_sets
        )
        dim, size = space.mesh.geometry.dim, space.dofmap.index_map_bs
        widths = [1, *(size for _ in fields), *(size * dim for _ in slopes)]
        nodes = np.reshape(sums, (-1, sum(widths)))
        masses, *totals = np.split(nodes, np.cumsum(widths[:-1]), axis=1)
        values = dict(zip(fields, totals, strict=False))
        for name, total in zip(slopes, totals[len(fields) :], strict=True):
            G, x = total.reshape(-1, size, dim), _node_positions(fields[name])
            values[name] += np.einsum("nij,nj->ni", G, x)
        per_mass = np.divide(1.0, masses, out=np.zeros_like(masses), where=masses > 0)
        for name, function in fields.items():
            function.x.array[:] = (values[name] * per_mass).ravel()


def _columns(
    points: MaterialPoints, names: Iterable[str], slopes: Mapping[str, str], mass: str
) -> npt.NDArray[np.float64]:
    """Return for each point mass, m f less m G x of each field, then m G of those with G."""
    n, dim = points.x.shape
    flat = {
        name: points[name].reshape(n, math.prod(points.field_shape(name)))
        for name in (*names, *slopes.values())
    }
    values = {name: flat[name] for name in names}
    steep = [flat[slope] for slope in slopes.values()]
    for name, rows in zip(slopes, steep, strict=True):
        G = rows.reshape(*values[name].shape, dim)
        values[name] = values[name] - np.einsum("pij,pj->pi", G, points.x)
    columns = np.concatenate([np.ones((n, 1)), *values.values(), *steep], axis=1)
    columns *= points[mass][:, None]
    return columns


def _node_positions(function: fem.Function) -> npt.NDArray[np.float64]:
    """Return positions of the nodes of a Lagrange function, ``(n_nodes, d)``; cached."""
    if function not in _POSITIONS:
        space = function.function_space
        _POSITIONS[function] = space.tabulate_dof_coordinates()[:, : space.mesh.geometry.dim]
    return _POSITIONS[function]


def _scalar_element(space: fem.FunctionSpace) -> Any:
    element = space.ufl_element()
    return (element.sub_elements[0] if element.block_size > 1 else element).basix_element


@njit
def _scatter(  # type: ignore[no-untyped-def]
    values, order, table, offsets, dofs, least, result
):
    for group in range(len(offsets) - 1):
        for k in range(offsets[group], offsets[group + 1]):
            value = values[order[k]]
            for a in range(dofs.shape[1]):
                share = table[k, a] if abs(table[k, a]) >= least[group] else least[group]
                node = result[dofs[group, a]]
                for c in range(len(value)):
                    node[c] += value[c] * share
