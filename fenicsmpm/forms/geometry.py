# SPDX-License-Identifier: MIT
"""Values of UFL's geometric quantities at material points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat, _jit
from fenicsmpm.points import MaterialPoints


def geometry_values(
    quantity: Any, points: MaterialPoints, order: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    """Return the values at points of a geometric quantity that varies within cells.

    Args:
        quantity: One of the UFL quantities of ``lowering.POINT_GEOMETRY``.
        points: The point set.
        order: Storage indices ``(n,)`` of the points.

    Returns:
        Flattened values ``(n, size)``.
    """
    name = type(quantity).__name__
    if name == "SpatialCoordinate":
        return points.x[order]
    where = points.cell[order], points.xi[order]
    if name == "JacobianInverse":
        values = points.geometry.inverse_jacobian(*where)
    else:
        values = points.geometry.jacobian(*where)
    if name == "JacobianDeterminant":
        values = np.linalg.det(values)
    return values.reshape(len(order), int(np.prod(values.shape[1:], dtype=int)))


def cell_values(quantity: Any, mesh: Any) -> npt.NDArray[np.float64]:
    """Return the ``(n_cells,)`` values of a quantity that is constant in each cell. Collective.

    dolfinx computes the values.

    Args:
        quantity: UFL cell size such as ``CellVolume``.
        mesh: Dolfinx mesh.
    """
    space = fem.functionspace(mesh, ("DG", 0))
    if type(quantity).__name__ == "CellVolume":
        # The integral is also exact for non-affine cells, for which UFL has no formula.
        values = fem.assemble_vector(_jit.mesh_form(ufl.TestFunction(space) * ufl.dx)).array
    else:
        function = fem.Function(space)
        points = _compat.interpolation_points(space)
        function.interpolate(_jit.expression(quantity, points, mesh.comm))
        values = function.x.array
    return values[space.dofmap.list[:, 0]]
