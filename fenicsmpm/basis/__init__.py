# SPDX-License-Identifier: MIT
"""Grid functions seen from the material points."""

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
    """Choose the grid functions that points see, instead of the finite elements of the mesh.

    Functions of Lagrange spaces of degree 1 are then taken to be sums of these functions, in forms
    and expressions over the points, and in what is summed to the grid. Each point set of a problem
    is to use the same, or uGIMP with a size of its own. Copies and selections take the choice
    along. Collective.

    Args:
        points: the point set, on a mesh of equal axis-parallel boxes that fill a box.
        name: "linear" (those of the finite elements), "quadratic" or "cubic" (B-splines), or
            "gimp" (uGIMP), or "cpgimp", whose points stretch with their field "F" along the axes
            (S. Bardenhagen, E. Kober, CMES 5, 2004), up to the size of a cell.
        half_size: half of the initial size of a point in m, ``(d,)`` or one number; for the last
            two.

    Raises:
        ValueError: on all ranks, for points that are in use already, meshes that are no lattices,
            and sizes that are not positive or larger than half a cell. The first form over the
            points, or sum on the grid, raises one if ranks do not see enough of the mesh for it
            (see ``shared_vertex_partitioner``); explicit steps need none.
    """
    if points in _stencils:
        raise ValueError(
            "grid functions chosen for points that have been used already: choose them before the "
            "first form over the points and the first sum on the grid"
        )
    half_size_in_cells(points.mesh, name, half_size)
    points.grid_functions = (name, half_size)


def functions_of(points: MaterialPoints) -> str:
    """Name of the grid functions that points see: "linear" without ``use``."""
    return "linear" if points.grid_functions is None else points.grid_functions[0]


def stencil_of(points: MaterialPoints) -> PointStencil:
    """The stencil of a point set, made at first use; see ``use``."""
    if points not in _stencils:
        if points.grid_functions is None:
            _stencils[points] = LagrangeStencil(points)
        else:
            _stencils[points] = LatticeStencil(points, *points.grid_functions)
    return _stencils[points]
