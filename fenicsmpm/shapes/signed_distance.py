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
    """A solid by a function of positions, such as a disc, a torus, or a union of such.

    Attributes:
        dim: d, 2 or 3.
    """

    def __init__(
        self,
        distance: Callable[[Array], Any],
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
    ):
        """Take the function and a box around the solid.

        Args:
            distance: Of positions (3, n) in m, to distances (n,) in m, negative inside.
            lower: Lowest coordinates of a box that contains the solid in m, shape (d,).
            upper: Highest coordinates in m, shape (d,).

        Raises:
            ValueError: For corners of other shapes, not finite, or in the wrong order.
        """
        self._distance = distance
        self._lower: Array = np.array(lower, dtype=np.float64)
        self._upper: Array = np.array(upper, dtype=np.float64)
        corners = np.stack([self._lower, self._upper])
        if self._lower.shape not in ((2,), (3,)) or not np.isfinite(corners).all():
            raise ValueError(f"corners around a solid are 2 or 3 finite numbers each: {corners}")
        if not np.all(self._lower < self._upper):
            raise ValueError(f"corners around a solid in the wrong order: {corners}")
        self.dim = len(self._lower)

    def bounds(self) -> tuple[Array, Array]:
        """Corners of the box that was given, in m, each of shape (d,)."""
        return self._lower, self._upper

    def distance(self, x: npt.ArrayLike) -> Array:
        """What the function says of positions (3, n) in m, shape (n,)."""
        return np.asarray(self._distance(np.asarray(x, dtype=np.float64)), dtype=np.float64)

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which positions (3, n) are inside, as a mask of shape (n,)."""
        return self.distance(x) < 0

    @property
    def volume(self) -> float:
        """In m^d, by cells in which the surface is taken as flat."""
        return self._moments[0]

    @property
    def centroid(self) -> Array:
        """In m, shape (d,)."""
        return self._moments[1]

    @property
    def second_moment(self) -> Array:
        """Integral of (x - centroid) (x - centroid)^T, shape (d, d), in m^(d + 2)."""
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
        """Name of the function, and the box around the solid."""
        name = getattr(self._distance, "__name__", repr(self._distance))
        return f"SignedDistance({name}, {self._lower.tolist()}, {self._upper.tolist()})"
