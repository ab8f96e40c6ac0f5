# SPDX-License-Identifier: MIT
"""Axis-parallel boxes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Box:
    """Axis-parallel box; with infinite sides also a wall or a half-space.

    Attributes:
        dim: Dimension d, 2 or 3.
        lower: Lowest coordinates in m, shape (d,).
        upper: Highest coordinates in m, shape (d,).
        volume: Volume in m^d.
        centroid: Centroid in m, shape (d,).
        second_moment: Integral of (x - centroid) (x - centroid)^T in m^(d + 2), shape (d, d);
            meaningless for an infinite box.
    """

    def __init__(self, lower: npt.ArrayLike, upper: npt.ArrayLike):
        """Create a box from two opposite corners.

        Args:
            lower: Lowest coordinates in m, shape (d,); they may be infinite.
            upper: Highest coordinates in m, shape (d,); they may be infinite.

        Raises:
            ValueError: For corners of other shapes or in the wrong order.
        """
        self.lower: Array = np.array(lower, dtype=np.float64)
        self.upper: Array = np.array(upper, dtype=np.float64)
        if self.lower.shape != self.upper.shape or self.lower.shape not in ((2,), (3,)):
            raise ValueError(
                f"corners of a box need 2 or 3 numbers each, not {self.lower} and {self.upper}"
            )
        if not np.all(self.lower < self.upper):
            raise ValueError(
                f"corners of a box must be in order, lower below upper: {self.lower}, {self.upper}"
            )
        self.dim = len(self.lower)
        size = self.upper - self.lower
        self.volume = float(np.prod(size))
        with np.errstate(invalid="ignore"):  # an infinite box has none
            self.centroid = (self.lower + self.upper) / 2
            self.second_moment = np.diag(self.volume * size**2 / 12)

    def bounds(self) -> tuple[Array, Array]:
        """Return the lowest and highest coordinates in m, each of shape (d,)."""
        return self.lower, self.upper

    def distance(self, x: npt.ArrayLike) -> Array:
        """Return the signed distance from the surface in m, negative inside, shape (n,).

        Args:
            x: Positions in m, shape (3, n) as in dolfinx; in 2D also (2, n).
        """
        y = np.asarray(x, dtype=np.float64)[: self.dim].T
        beyond = np.maximum(self.lower - y, y - self.upper)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.where(outside > 0, outside, beyond.max(axis=1))

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which positions (3, n) are inside, as a mask of shape (n,)."""
        return self.distance(x) < 0

    def __repr__(self) -> str:
        """Return the corners as text."""
        return f"Box({self.lower.tolist()}, {self.upper.tolist()})"
