# SPDX-License-Identifier: MIT
"""Gaps between points and rigid bodies, in UFL."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.forms import PointExpression
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import ComputedField
from fenicsmpm.rigid import RigidBody

Array = npt.NDArray[np.float64]


class RigidGap:
    """Distance of moving points from a rigid body, and the motion of the body below them.

    UFL has no distance from a sampled shape. Therefore distance and normal are computed at the
    points before each evaluation, and the distance is extrapolated linearly from there. Because it
    is evaluated exactly where it was computed, its values are exact. ``ufl.derivative`` gives the
    tangent without the curvature of the surface.

    Args:
        points: Points that may touch the body.
        u: Displacement increment of the points ``(d,)`` [m], UFL.
        rigid: The rigid body.

    Attributes:
        way: Displacement of the body's material below each point in the step ``(d,)`` [m], UFL.

    Raises:
        ValueError: If rigid body and mesh have different dimensions.
    """

    def __init__(self, points: MaterialPoints, u: Any, rigid: RigidBody) -> None:
        """Compile the new positions of the points. Collective."""
        dim = points.mesh.geometry.dim
        if rigid.dim != dim:
            raise ValueError(
                f"the rigid body {rigid.name} has {rigid.dim} dimensions, but the mesh has {dim}"
            )
        self._points, self._rigid = points, rigid
        self._place = PointExpression(ufl.SpatialCoordinate(points.mesh) + u, points)
        self._values: dict[str, Array] = {}
        self._distance, self._normal = self._field("distance", ()), self._field("normal", (dim,))
        self._found_at, self.way = self._field("place", (dim,)), self._field("way", (dim,))

    def __call__(self, place: Any) -> Any:
        """Return the distance [m], UFL, at a place close to where it was computed.

        Args:
            place: Position ``(d,)`` [m], UFL.
        """
        return self._distance + ufl.dot(self._normal, place - self._found_at)

    def _field(self, name: str, shape: tuple[int, ...]) -> ComputedField:
        field = ComputedField(self._points, name, shape, self._update, lambda: self._values[name])
        field.source = self._rigid  # by which time loops find it
        return field

    def _update(self) -> None:
        x = self._place.evaluate()
        distance, normal = self._rigid.distance(x)
        self._values = {
            "place": x,
            "distance": np.minimum(distance, np.finfo(np.float64).max),
            "normal": normal,
            "way": self._rigid.way(self._points.x),
        }
