# SPDX-License-Identifier: MIT
"""Lumped volume or mass of the material at the grid nodes, as a coefficient of UFL forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from fenicsmpm import _jit
from fenicsmpm.cells.active_cells import ActiveCells
from fenicsmpm.points import MaterialPoints
from fenicsmpm.transfer.points_to_grid import p2g

_VERTEX_RULE = {"quadrature_rule": "vertex", "quadrature_degree": 1}


class FilledFraction(fem.Function):
    """Volume of the points at each node per volume of the active cells around it, P1.

    With the vertex rule, ``fraction * a * b * fraction.vertex_dx`` is the lumped mass
    ``sum_I m_I a_I b_I`` with the points' own nodal volumes ``m_I = sum_p N_I(x_p) V_p``.

    Args:
        points: The point set.
        field: "weight" for volumes; a field of masses makes the fraction a density in kg/m^d.

    Attributes:
        points: The point set.
        vertex_dx: Measure of the active cells with the vertices as integration points.
    """

    def __init__(self, points: MaterialPoints, field: str = "weight") -> None:
        """Compute the fraction for the current points. Collective."""
        space = fem.functionspace(points.mesh, ("Lagrange", 1))
        super().__init__(space, name="filled_fraction")
        self.points = points
        self._field = field
        self._cells = ActiveCells(points)
        self._share = _vertex_shares(points.mesh)
        self._full: npt.NDArray[np.float64] = np.empty(0)
        self._version: Any = None
        self.vertex_dx = self._cells.dx(metadata=_VERTEX_RULE)
        self.follow_points()

    def follow_points(self) -> None:
        """Compute the fraction anew; forms call this before each use. Collective."""
        space = self.function_space
        if self._version != self._cells.version:
            self._version = self._cells.version
            full = fem.Function(space)
            cells = self._cells.cells()
            np.add.at(full.x.array, space.dofmap.list[cells], self._share[cells])
            full.x.scatter_reverse(la.InsertMode.add)
            full.x.scatter_forward()
            self._full = full.x.array
        filled = p2g(self.points, self.points[self._field], space).array
        where = self._full > 0
        self.x.array[:] = np.divide(filled, self._full, out=np.zeros_like(filled), where=where)


def _vertex_shares(mesh: Any) -> npt.NDArray[np.float64]:
    """Return the weights of the vertex rule in m^d, ``(n_cells, n_vertices)``."""
    space = fem.functionspace(mesh, ("Discontinuous Lagrange", 1))
    dx = ufl.Measure("dx", domain=mesh.ufl_domain(), metadata=_VERTEX_RULE)
    shares = fem.assemble_vector(_jit.mesh_form(ufl.TestFunction(space) * dx))
    return shares.array[space.dofmap.list]
