# SPDX-License-Identifier: MIT
"""PointField: a UFL coefficient with one value per material point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints


class PointField(ufl.Coefficient):
    """A named array of a point set as a coefficient in UFL forms over these points.

    It reads the array at each assembly, so adding, removing or moving points needs no new form.
    It has values only at the points: its gradient is an error, and so is its use in integrals
    over cells or facets.

    Args:
        points: the point set.
        name: name of one of its fields.
    """

    def __init__(self, points: MaterialPoints, name: str) -> None:
        """Create the coefficient; use ``points.field(name)``."""
        mesh = points.mesh.ufl_domain()
        # A quadrature element is UFL's own notion of "values at points only"; its degree must
        # not be zero, or UFL takes the field for constant in a cell and its gradient for zero.
        element = basix.ufl.quadrature_element(
            points.mesh.basix_cell(), value_shape=points.field_shape(name), degree=2
        )
        super().__init__(ufl.FunctionSpace(mesh, element))
        self.points = points
        self.name = name

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The array of the point set, ``(n_points, *ufl_shape)``, not a copy."""
        return self.points[self.name]

    def __str__(self) -> str:
        """Name of the field, as it appears in printed forms."""
        return self.name
