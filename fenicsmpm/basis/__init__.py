# SPDX-License-Identifier: MIT
"""Grid functions at material points: finite elements, splines, GIMP."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy.typing as npt

from fenicsmpm.basis.lagrange import LagrangeStencil, is_linear
from fenicsmpm.basis.lattice_stencil import LatticeStencil, half_size_in_cells
from fenicsmpm.basis.partition import shared_vertex_partitioner
from fenicsmpm.basis.stencil import PointStencil

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints

__all__ = [
    "LagrangeStencil",
    "LatticeStencil",
    "PointStencil",
    "functions_of",
    "is_linear",
    "shared_vertex_partitioner",
    "stencil_of",
    "use",
]

_stencils: weakref.WeakKeyDictionary[MaterialPoints, PointStencil] = weakref.WeakKeyDictionary()


def use(points: MaterialPoints, name: str, half_size: npt.ArrayLike | None = None) -> None:
    """Choose the grid functions of points, instead of the finite elements of the mesh. Collective.

    The new functions replace those of Lagrange spaces of degree 1 wherever points are involved: in
    forms and expressions over the points, and in sums on the grid. All point sets of a problem must
    use the same functions; only the sizes of uGIMP points may differ. Copies and selections of
    points keep the choice.

    Args:
        points: The point set, on a mesh of equal axis-parallel boxes that fill a box.
        name: One of "linear" (those of the finite elements), "quadratic" or "cubic" (B-splines),
            "gimp" (uGIMP) or "cpgimp". Domains of cpGIMP points stretch along the axes with the
            field "F", up to the size of a cell (S. Bardenhagen, E. Kober, CMES 5, 2004).
        half_size: Half of the initial size of a point in m, shape ``(d,)`` or one number; for
            "gimp" and "cpgimp" only.

    Raises:
        ValueError: On all ranks, for points that are in use already, meshes that are no lattices,
            and sizes that are not positive or larger than half a cell. The first form over the
            points, or the first sum on the grid, raises it if ranks do not have the ghost cells
            that it needs (see ``shared_vertex_partitioner``). Explicit steps need none.
    """
    if points in _stencils:
        raise ValueError(
            "grid functions chosen for points that have been used already: choose them before the "
            "first form over the points and the first sum on the grid"
        )
    half_size_in_cells(points.mesh, name, half_size)
    points.grid_functions = (name, half_size)


def functions_of(points: MaterialPoints) -> str:
    """Return the name of the grid functions of points: "linear" without ``use``.

    Args:
        points: The point set.

    Returns:
        One of the names that ``use`` takes.
    """
    return "linear" if points.grid_functions is None else points.grid_functions[0]


def stencil_of(points: MaterialPoints) -> PointStencil:
    """Return the stencil of a point set, made at first use; see ``use``.

    Args:
        points: The point set.

    Returns:
        The stencil.
    """
    if points not in _stencils:
        if points.grid_functions is None:
            _stencils[points] = LagrangeStencil(points)
        else:
            _stencils[points] = LatticeStencil(points, *points.grid_functions)
    return _stencils[points]
