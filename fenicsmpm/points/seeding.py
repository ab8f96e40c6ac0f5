# SPDX-License-Identifier: MIT
"""Where material points come from: cells, regions, other meshes, boundaries.

Functions that take a predicate `inside` call it with positions of shape (n, d) in m and expect a
mask of shape (n,). All functions are collective.
"""

from collections.abc import Callable
from typing import TypeAlias

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.checks import check_selection
from fenicsmpm.points.geometry import CellGeometry, cell_geometry
from fenicsmpm.points.material_points import MaterialPoints

Predicate: TypeAlias = Callable[[npt.NDArray[np.float64]], npt.ArrayLike]


def quadrature(
    mesh: Mesh,
    degree: int,
    cells: npt.ArrayLike | None = None,
    inside: Predicate | None = None,
    tag: int = 0,
) -> MaterialPoints:
    """Points of the quadrature rule that dolfinx uses for integrals of this degree.

    Args:
        mesh: Background mesh.
        degree: Polynomial degree that the rule integrates exactly on affine cells.
        cells: Local cells to fill (those owned by other ranks are left to them); None for all.
        inside: Only points where this is true.
        tag: Tag of the points.

    Raises:
        ValueError: If there are no points at all.
    """
    geometry = cell_geometry(mesh)
    points, weights = basix.make_quadrature(geometry.cell, degree)
    filled = _owned(mesh, geometry, cells)
    cell = np.repeat(filled, len(weights))
    xi = np.tile(points, (len(filled), 1))
    weight = np.tile(weights, len(filled)) * geometry.determinant(cell, xi)
    what = f"quadrature of degree {degree}"
    return _make(mesh, geometry, cell, xi, weight, inside, tag, what)


def _owned(
    mesh: Mesh, geometry: CellGeometry, cells: npt.ArrayLike | None
) -> npt.NDArray[np.int32]:
    """The cells to fill on this rank, ascending."""
    if cells is None:
        return np.arange(geometry.num_owned, dtype=np.int32)
    given = np.unique(np.asarray(cells))
    error = None
    if given.size and (given[0] < 0 or given[-1] >= geometry.num_cells):
        error = ValueError(
            f"cells to fill must be 0 to {geometry.num_cells - 1}, not {given[0]} to {given[-1]}"
        )
    raise_together(mesh.comm, error)
    return given[given < geometry.num_owned].astype(np.int32)


def _make(
    mesh: Mesh,
    geometry: CellGeometry,
    cell: npt.NDArray[np.int32],
    xi: npt.NDArray[np.float64],
    weight: npt.NDArray[np.float64],
    inside: Predicate | None,
    tag: int,
    what: str,
) -> MaterialPoints:
    """Points at known reference coordinates, as far as they are inside."""
    x = geometry.push_forward(cell, xi)
    if inside is not None:
        error, mask = check_selection(inside, x)
        raise_together(mesh.comm, error)
        cell, xi, weight, x = cell[mask], xi[mask], weight[mask], x[mask]
    _check_any(mesh, len(x), what, inside)
    return MaterialPoints(mesh, x, weight, cells=cell, xi=xi, tag=tag)


def _check_any(mesh: Mesh, count: int, what: str, inside: Predicate | None) -> None:
    """Raise on all ranks if there are no points at all. Collective."""
    if mesh.comm.allreduce(count) == 0:
        region = getattr(inside, "__name__", repr(inside)) if inside else "the given cells"
        raise ValueError(f"{what} gives no points in {region}")
