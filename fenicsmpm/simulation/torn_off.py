# SPDX-License-Identifier: MIT
"""Carried points that have lost contact with their body."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from mpi4py import MPI

import basix
import numpy as np
import numpy.typing as npt

from fenicsmpm import _compat
from fenicsmpm.cells.active_cells import nodes_of
from fenicsmpm.points import MaterialPoints

logger = logging.getLogger(__name__)

# Distance from the cells of the body, as a fraction of a cell, from which on points are off it
_OFF = 0.5


class TornOff:
    """Warning, given once, of carried points that share no cell with their bodies.

    A surface enters a cell before the points inside the body do. Points count as torn off only if
    they are more than half a cell away from the cells that hold something of a body.

    Args:
        bodies: Material points.
        carried: Points that move with them.
    """

    def __init__(self, bodies: Sequence[MaterialPoints], carried: Sequence[MaterialPoints]) -> None:
        """Prepare the check; no warning has been given yet."""
        self._bodies, self._carried, self._has_warned = list(bodies), list(carried), False

    def look(self, time: float) -> None:
        """Log the warning when its condition holds for the first time. Collective.

        Args:
            time: Time in s.
        """
        if self._has_warned or not self._carried or not any(b.size_global for b in self._bodies):
            return
        mesh = self._bodies[0].mesh
        filled = np.unique(np.concatenate([body.cell for body in self._bodies]))
        is_near = nodes_of(mesh, filled)
        for points in self._carried:
            off = np.flatnonzero(_nearness(points, is_near) < 1 - _OFF)
            count = mesh.comm.allreduce(len(off), MPI.SUM)
            if count == 0:
                continue
            here = [points.x[off[0]].tolist()] if len(off) else []
            place = min(x for found in mesh.comm.allgather(here) for x in found)
            self._has_warned = True
            if mesh.comm.rank == 0:
                logger.warning(
                    "%d of %d carried points are more than half a cell away from the cells that "
                    "hold their body at t = %g s, one at (%s) m: their loads, supports or contacts "
                    "no longer act on the body. If they have torn off, tie the nodes around them "
                    "(cells.Tying), as a ghost penalty resists increments only, correct weights "
                    "(cells.correct_weights), or use more points per cell",
                    count, points.size_global, time, ", ".join(f"{x:.6g}" for x in place),
                )  # fmt: skip
            return


def _nearness(points: MaterialPoints, is_near: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return at points the linear function that is 1 at the nodes of the body's cells."""
    if len(points) == 0:  # basix cannot tabulate at no points
        return np.empty(0)
    cell = getattr(basix.CellType, points.mesh.basix_cell().name)
    linear = basix.create_element(basix.ElementFamily.P, cell, 1)
    values = linear.tabulate(0, points.xi)[0, :, :, 0]
    at_nodes = is_near[_compat.geometry_dofmap(points.mesh)[points.cell]]
    return np.einsum("pk,pk->p", values, at_nodes.astype(np.float64))
