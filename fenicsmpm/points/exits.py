# SPDX-License-Identifier: MIT
"""Treatment of points that leave the background mesh."""

from __future__ import annotations

import logging

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.migration import PointsOutsideError

logger = logging.getLogger(__name__)


class Exits:
    """Motion of points some of which may leave the mesh.

    Args:
        on_exit: Treatment of points that leave the mesh: "error" raises, "delete" removes them,
            "clamp" stops them on their way while they are still inside.

    Attributes:
        on_exit: As above.
        held: Ids of the points of each set that were held back so far, on all ranks.

    Raises:
        ValueError: For another value of ``on_exit``.
    """

    def __init__(self, on_exit: str = "error") -> None:
        """Set the treatment; nothing has left yet."""
        if on_exit not in ("error", "delete", "clamp"):
            raise ValueError(f"on_exit must be 'error', 'delete' or 'clamp', not {on_exit!r}")
        self.on_exit = on_exit
        self.held: dict[MaterialPoints, npt.NDArray[np.int64]] = {}
        self._is_said = False

    def move(self, points: MaterialPoints, x: npt.NDArray[np.float64]) -> int:
        """Move points. Collective.

        If a point is held back, its field "u" of displacements is reduced accordingly.

        Args:
            points: The point set.
            x: New positions in m, shape (n, d).

        Returns:
            Number of points that left the mesh on all ranks, except those held back before.

        Raises:
            PointsOutsideError: On all ranks, for "error".
        """
        try:
            points.move(x)
            return 0
        except PointsOutsideError as error:
            if self.on_exit == "error":
                raise
            count, outside = error.count, error.indices
        if self.on_exit == "clamp":
            ids = points.id[outside]
            _hold_back(points, x, outside)
            return self._count(points, ids)
        points.remove(outside)
        points.move(np.delete(x, outside, axis=0))
        logger.warning("%d points left the background mesh and were deleted", count)
        return count

    def _count(self, points: MaterialPoints, ids: npt.NDArray[np.int64]) -> int:
        """Return how many of the points with these ids are held back for the first time."""
        before = self.held.get(points, np.empty(0, dtype=np.int64))
        new = np.concatenate(points.mesh.comm.allgather(np.setdiff1d(ids, before)))
        self.held[points] = np.concatenate([before, new])
        if not self._is_said:
            logger.warning(
                "%d points left the background mesh and were held back; later ones are not "
                "logged, Step.removed counts them",
                len(new),
            )
            self._is_said = True
        return len(new)


def _hold_back(
    points: MaterialPoints, x: npt.NDArray[np.float64], outside: npt.NDArray[np.integer]
) -> None:
    """Move points to x. Halve the way of those outside until all are inside."""
    way = x - points.x
    share = np.ones(len(points))
    u = points["u"] if "u" in points else None
    while True:
        share[outside] = np.where(share[outside] > 1e-3, share[outside] / 2, 0.0)
        held_back = (1.0 - share)[:, None] * way
        if u is not None:
            points.assign({"u": u - held_back})
        try:
            points.move(x - held_back)
            return
        except PointsOutsideError as error:
            outside = error.indices
