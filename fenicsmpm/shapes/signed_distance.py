# SPDX-License-Identifier: MIT
"""Solids given by a function: the signed distance from their surface."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_CELLS = {2: 512, 3: 96}  # along the longest side, for integrals over the solid


class SignedDistance:
    """Solid given by a signed distance function, such as a disc, a torus, or a union of these.

    Attributes:
        dim: Dimension d, 2 or 3.
    """

    def __init__(
        self,
        distance: Callable[[Array], Any],
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
    ):
        """Create a solid from its signed distance and a box around it.

        Args:
            distance: Function from positions (3, n) in m to distances (n,) in m, negative inside.
            lower: Lowest coordinates in m of a box that contains the solid, shape (d,).
            upper: Highest coordinates in m of this box, shape (d,).

        Raises:
            ValueError: For corners of other shapes, not finite, or in the wrong order.
        """
        self._distance = distance
        self._lower: Array = np.array(lower, dtype=np.float64)
        self._upper: Array = np.array(upper, dtype=np.float64)
        corners = np.stack([self._lower, self._upper])
        if self._lower.shape not in ((2,), (3,)) or not np.isfinite(corners).all():
            raise ValueError(f"corners of the box need 2 or 3 finite numbers each: {corners}")
        if not np.all(self._lower < self._upper):
            raise ValueError(f"corners of the box must be in order, lower below upper: {corners}")
        self.dim = len(self._lower)

    def bounds(self) -> tuple[Array, Array]:
        """Return the corners of the given box in m, each of shape (d,)."""
        return self._lower, self._upper

    def distance(self, x: npt.ArrayLike) -> Array:
        """Return the distance at positions (3, n) in m, shape (n,).

        Args:
            x: Positions in m, shape (3, n) as in dolfinx.
        """
        return np.asarray(self._distance(np.asarray(x, dtype=np.float64)), dtype=np.float64)

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which positions (3, n) are inside, as a mask of shape (n,)."""
        return self.distance(x) < 0

    @property
    def volume(self) -> float:
        """Volume in m^d, by cells in which the surface is approximated by a plane."""
        return self._moments[0]

    @property
    def centroid(self) -> Array:
        """Centroid in m, shape (d,)."""
        return self._moments[1]

    @property
    def second_moment(self) -> Array:
        """Integral of (x - centroid) (x - centroid)^T in m^(d + 2), shape (d, d)."""
        return self._moments[2]

    @functools.cached_property
    def _moments(self) -> tuple[float, Array, Array]:
        size = self._upper - self._lower
        count = np.ceil(_CELLS[self.dim] * size / size.max()).astype(int)
        step = size / count
        axes = [
            a + s * (np.arange(n) + 0.5) for a, s, n in zip(self._lower, step, count, strict=True)
        ]
        x = np.zeros((3, int(np.prod(count))))
        for k, grid in enumerate(np.meshgrid(*axes, indexing="ij")):
            x[k] = grid.ravel()
        share = np.clip(0.5 - self.distance(x) / np.prod(step) ** (1 / self.dim), 0.0, 1.0)
        weight, y = share * np.prod(step), x[: self.dim].T
        volume = float(weight.sum())
        if not volume > 0:
            raise ValueError("the signed distance is negative nowhere: the solid has no volume")
        centroid = weight @ y / volume
        r = y - centroid
        return volume, centroid, (weight[:, None] * r).T @ r

    def __repr__(self) -> str:
        """Return the name of the function and the box around the solid."""
        name = getattr(self._distance, "__name__", repr(self._distance))
        return f"SignedDistance({name}, {self._lower.tolist()}, {self._upper.tolist()})"
