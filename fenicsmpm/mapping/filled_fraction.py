# SPDX-License-Identifier: MIT
"""Lumped volume of the material at the grid nodes, as a coefficient of UFL forms."""

from __future__ import annotations

import ufl
from dolfinx import fem, la

from fenicsmpm.mapping.transfer import p2g
from fenicsmpm.points import MaterialPoints


class FilledFraction(fem.Function):
    """Share of the volume around each node that is filled with material, P1.

    With the vertex rule, ``fraction * a * b * fraction.vertex_dx`` is the lumped mass
    ``sum_I m_I a_I b_I`` with the points' own nodal volumes ``m_I = sum_p N_I(x_p) V_p``.

    Args:
        points: the point set; call ``update`` when the points have moved.

    Attributes:
        points: the point set.
        vertex_dx: cell measure with the vertices as integration points.
    """

    def __init__(self, points: MaterialPoints) -> None:
        """Compute the fraction of the points as they are."""
        mesh = points.mesh
        space = fem.functionspace(mesh, ("Lagrange", 1))
        super().__init__(space, name="filled_fraction")
        self.points = points
        self.vertex_dx = ufl.Measure(
            "dx",
            domain=mesh.ufl_domain(),
            metadata={"quadrature_rule": "vertex", "quadrature_degree": 1},
        )
        one = ufl.TestFunction(space)
        full = fem.assemble_vector(fem.form(one * self.vertex_dx))
        full.scatter_reverse(la.InsertMode.add)
        full.scatter_forward()
        self._full = full.array
        self.update()

    def update(self) -> None:
        """Compute the fraction anew from the points (collective)."""
        filled = p2g(self.points, self.points.weight, self.function_space)
        self.x.array[:] = filled.array / self._full
