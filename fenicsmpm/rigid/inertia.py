# SPDX-License-Identifier: MIT
"""Mass, centre and moments of inertia of rigid bodies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Inertia:
    """Mass and moments of inertia of a rigid body.

    Args:
        mass: Mass [kg], in the plane per length [kg/m].
        tensor: Tensor of inertia about the centre ``(3, 3)`` [kg m^2]. In the plane one number, the
            moment about the normal axis per length [kg m].
        centre: Centre of mass at the start ``(d,)`` [m].

    Attributes:
        moments: Moments about the principal axes ``(3,)`` [kg m^2], in the plane [kg m].
        axes: Principal axes at the start ``(3, 3)``, the columns of a rotation matrix.

    Raises:
        ValueError: If the mass is not positive and finite, or the tensor has a wrong shape or is
            not symmetric and positive definite. Also if no body can have the tensor, because a
            principal moment is larger than the sum of the others.
    """

    def __init__(self, mass: float, tensor: npt.ArrayLike, centre: npt.ArrayLike) -> None:
        """Check the arguments, and find the principal axes."""
        self.mass = float(mass)
        self.centre: Array = np.array(centre, dtype=np.float64)
        self.tensor: Array = np.array(tensor, dtype=np.float64)
        d = len(np.atleast_1d(self.centre))
        if not 0 < self.mass < math.inf:
            raise ValueError(f"a free body needs a positive finite mass: {mass} kg")
        if self.centre.shape not in ((2,), (3,)) or not np.isfinite(self.centre).all():
            raise ValueError(f"a centre of mass needs 2 or 3 finite numbers: {self.centre}")
        if self.tensor.shape != ((3, 3) if d == 3 else ()):
            raise ValueError(
                "an inertia is a tensor (3, 3) in space and one number in the plane, not an array "
                f"of shape {self.tensor.shape}"
            )
        full = self.tensor if d == 3 else self.tensor * np.eye(3)
        size = np.abs(full).max()
        if not (np.isfinite(full).all() and np.abs(full - full.T).max() <= 1e-9 * size):
            raise ValueError(f"a tensor of inertia must be symmetric and finite: {self.tensor}")
        moments, axes = np.linalg.eigh(full)
        self.moments: Array = moments
        self.axes: Array = axes
        if not self.moments[0] > 0:
            raise ValueError(
                "a tensor of inertia must be positive definite, but its principal moments are "
                f"{self.moments}"
            )
        if self.moments[2] > (1 + 1e-9) * (self.moments[0] + self.moments[1]):
            raise ValueError(
                f"no body has the principal moments {self.moments}: the largest one must not be "
                "above the sum of the others"
            )
        if np.linalg.det(self.axes) < 0:
            self.axes[:, 0] *= -1

    def __repr__(self) -> str:
        """Mass, moments and centre."""
        return f"Inertia({self.mass}, {self.tensor.tolist()}, {self.centre.tolist()})"


def inertia_of(shape: Any, density: float) -> Inertia:
    """Return the inertia of a homogeneous body.

    Args:
        shape: Shape with ``volume``, ``centroid`` and ``second_moment``, such as those of
            ``fenicsmpm.shapes``.
        density: Density [kg/m^3].

    Raises:
        ValueError: If the density is not positive and finite, or the shape is unbounded.
    """
    if not 0 < density < math.inf:
        raise ValueError(f"the density must be positive and finite: {density} kg/m^3")
    if not np.isfinite(shape.volume):
        raise ValueError(f"an unbounded body has no inertia: {shape}. Use a bounded shape.")
    second = density * shape.second_moment
    trace = float(np.trace(second))
    tensor = trace * np.eye(3) - second if len(second) == 3 else trace
    return Inertia(density * shape.volume, tensor, shape.centroid)
