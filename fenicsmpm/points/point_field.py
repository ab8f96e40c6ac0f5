# SPDX-License-Identifier: MIT
"""PointField: a UFL coefficient with one value per material point."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

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
        shape: of a value; that of the field if not given.

    Attributes:
        renewals: new values of fields of the points, by name, at the end of each step of a time
            loop whose residual has this field; see ``renew``.
    """

    def __init__(
        self, points: MaterialPoints, name: str, shape: tuple[int, ...] | None = None
    ) -> None:
        """Create the coefficient; use ``points.field(name)``."""
        mesh = points.mesh.ufl_domain()
        shape = points.field_shape(name) if shape is None else shape
        # A quadrature element is UFL's own notion of "values at points only"; its degree must
        # not be zero, or UFL takes the field for constant in a cell and its gradient for zero.
        element = basix.ufl.quadrature_element(
            points.mesh.basix_cell(), value_shape=shape, degree=2
        )
        super().__init__(ufl.FunctionSpace(mesh, element))
        self.points = points
        self.name = name
        self.renewals: Mapping[str, Any] = {}

    def renew(self, value: Any) -> PointField:
        """Say what the field is to be at the end of each step of a time loop that uses it.

        Args:
            value: UFL over the points, in which the field itself has the value of the beginning of
                the step; a function that returns a new array ``(n_points, *shape)``; or a function
                from the ``Kinematics`` of the step to UFL.

        Returns:
            The field itself.
        """
        self.renewals = {self.name: value}
        return self

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The array of the point set, ``(n_points, *ufl_shape)``, not a copy."""
        return self.points[self.name]

    def __str__(self) -> str:
        """Name of the field, as it appears in printed forms."""
        return self.name


class ComputedField(PointField):
    """Values at points that are computed before each evaluation, such as the stresses of a law.

    Args:
        points: the point set.
        name: to be shown in printed forms.
        shape: of a value.
        update: computes the values anew; fields that share it are computed together.
        read: returns the values, ``(n_points, *shape)`` in storage order.

    Attributes:
        source: what computes the values, such as a law; None if nobody is to know.
        inputs: fields from which they are computed, if a time loop has to renew these.
    """

    source: Any = None
    inputs: tuple[PointField, ...] = ()

    def __init__(
        self,
        points: MaterialPoints,
        name: str,
        shape: tuple[int, ...],
        update: Callable[[], None],
        read: Callable[[], npt.NDArray[np.float64]],
    ) -> None:
        """Create the coefficient; nothing is computed yet."""
        super().__init__(points, name, shape)
        self.update = update
        self._read = read

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The values of the last update, ``(n_points, *ufl_shape)``, not a copy."""
        return self._read()
