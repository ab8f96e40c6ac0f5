# SPDX-License-Identifier: MIT
"""What happens to points that leave the background mesh."""

from __future__ import annotations

import logging

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.migration import PointsOutsideError

logger = logging.getLogger(__name__)

ON_EXIT = ("error", "delete", "clamp")


def check_on_exit(on_exit: str) -> None:
    """Raise a ValueError unless this says what happens to points that leave the mesh."""
    if on_exit not in ON_EXIT:
        raise ValueError(f"on_exit must be one of {', '.join(ON_EXIT)}, not {on_exit!r}")


def move(points: MaterialPoints, x: npt.NDArray[np.float64], on_exit: str = "error") -> int:
    """Move points, some of which may leave the mesh. Collective.

    Where a point is held back, so is its field "u" of displacements, if there is one.

    Args:
        points: Point set.
        x: New positions in m, shape (n, d).
        on_exit: For points that leave the mesh: "error" raises, "delete" removes them, "clamp"
            leaves them on their way where they are still inside.

    Returns:
        How many points left the mesh, on all ranks.

    Raises:
        PointsOutsideError: On all ranks, for "error".
        ValueError: For another value of `on_exit`.
    """
    check_on_exit(on_exit)
    try:
        points.move(x)
        return 0
    except PointsOutsideError as error:
        if on_exit == "error":
            raise
        count, outside = error.count, error.indices
    if on_exit == "delete":
        points.remove(outside)
        points.move(np.delete(x, outside, axis=0))
        logger.warning("%d points left the background mesh and were deleted", count)
        return count
    # halve what is left of the way until all are inside
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
            break
        except PointsOutsideError as error:
            outside = error.indices
    logger.warning("%d points left the background mesh and were held back", count)
    return count
