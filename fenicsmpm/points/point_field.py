# SPDX-License-Identifier: MIT
"""UFL coefficients with one value per material point."""

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
    """A field of material points as a coefficient in UFL forms over these points.

    It reads the array of the field at each assembly. Forms need not be compiled again when points
    are added, removed or moved. It has values at the points only: taking its gradient raises an
    error, and so does an integral over cells or facets that contains it.

    Args:
        points: The point set.
        name: Name of one of its fields.
        shape: Shape of a value; that of the field if not given.

    Attributes:
        renewals: New values of fields of the points by name, set at the end of each step of a
            time loop whose residual has this field; see ``renew``.
    """

    def __init__(
        self, points: MaterialPoints, name: str, shape: tuple[int, ...] | None = None
    ) -> None:
        """Create the coefficient; users call ``points.field(name)`` instead."""
        mesh = points.mesh.ufl_domain()
        shape = points.field_shape(name) if shape is None else shape
        # A quadrature element is UFL's own way to say "values at points only". Its degree must
        # not be zero, or UFL takes the field for constant in a cell and its gradient for zero.
        element = basix.ufl.quadrature_element(
            points.mesh.basix_cell(), value_shape=shape, degree=2
        )
        super().__init__(ufl.FunctionSpace(mesh, element))
        self.points = points
        self.name = name
        self.renewals: Mapping[str, Any] = {}
        self._said: list[Any] = []

    def renew(self, value: Any) -> PointField:
        """Set the value that the field takes at the end of each step of a time loop.

        A loop that is made later uses it. Calls for one field before that must agree, through
        whatever object they are made, or the loop raises ValueError.

        Args:
            value: One of three: a UFL expression over the points, in which the field itself has
                its value at the beginning of the step; a function that returns a new array of
                shape ``(n_points, *shape)``; a function from the ``Kinematics`` of the step to UFL.

        Returns:
            The field itself.
        """
        self.renewals = {self.name: value}
        self.points.field(self.name)._said.append(value)
        return self

    def take_said(self) -> list[Any]:
        """Return the values of all calls of ``renew`` since the last call of this, and forget them.

        Calls through another object for the same field count if this one is ``points.field(name)``.
        """
        said, self._said = self._said, []
        return said

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """Return the array of the point set, shape ``(n_points, *ufl_shape)``, not a copy."""
        return self.points[self.name]

    def __str__(self) -> str:
        """Return the name of the field, as it appears in printed forms."""
        return self.name


class ComputedField(PointField):
    """Values at points that are computed before each evaluation, such as the stresses of a law.

    Args:
        points: The point set.
        name: Name in printed forms.
        shape: Shape of a value.
        update: Function that computes the values anew. Fields that share it are computed together.
        read: Function that returns the values in storage order, shape ``(n_points, *shape)``.

    Attributes:
        source: The object that computes the values, such as a law; None if nobody needs to know.
        inputs: Fields from which they are computed, if a time loop has to update these.
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
        """Return the values of the last update, shape ``(n_points, *ufl_shape)``, not a copy."""
        return self._read()
