# SPDX-License-Identifier: MIT
"""Distribution of cells among ranks by their points: recursive coordinate bisection.

The partitioners that dolfinx calls take no cell weights, and PETSc's pass none on to Python.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

# All cells together count as a twentieth of all points: empty cells cost, too. Numbers of points
# per rank differ by no more than that.
_POINTS_PER_LOAD_OF_CELLS = 20
# Cells at the same place along an axis are ordered by the next axis.
_TILT = 1e-4
# The interval of a cut is halved down to round-off.
_HALVINGS = 54


def bisect(
    comm: MPI.Intracomm, middle: npt.NDArray[np.float64], points: npt.NDArray[np.int64]
) -> npt.NDArray[np.int32]:
    """Distribute cells such that each rank has about as many points. Collective.

    The ranks are halved, and so are the cells, by a cut across the longest side of the box around
    those with points; then the halves are halved, and so on. Loads are integers, so the result does
    not depend on which rank passes which cells. Ranks exchange sums only.

    Args:
        comm: Communicator of the ranks that get the cells.
        middle: Centres of this rank's cells in m, shape ``(n, d)``.
        points: Number of points in each cell, shape ``(n,)``.

    Returns:
        Rank of each cell, shape ``(n,)``. If few cells hold all points, some ranks may get none.
    """
    cells, total = comm.allreduce(len(points)), comm.allreduce(int(points.sum()))
    load = points * (_POINTS_PER_LOAD_OF_CELLS * cells) + max(total, 1)
    place = _places(comm, middle)
    holds = points > 0
    # groups of cells for `count` ranks starting with `first`
    group = np.zeros(len(points), dtype=np.int64)
    first, count = np.array([0]), np.array([comm.size])
    while count.max() > 1:
        low = count // 2
        axis = _longest_side(comm, middle[holds], group[holds], len(count))
        along = place[np.arange(len(place)), axis[group]]
        cut = _cuts(comm, along, load, group, low, count)
        above = (along > cut[group]) | (low == 0)[group]
        group = 2 * group + above
        first = np.stack([first, first + low], axis=1).ravel()
        count = np.stack([low, count - low], axis=1).ravel()
    return first[group].astype(np.int32)


def _places(comm: MPI.Intracomm, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return positions along each axis, from 0 to 1 apart from the tilt, shape ``(n, d)``."""
    lower, upper = _boxes(comm, x, np.zeros(len(x), dtype=np.int64), 1)
    size = upper - lower
    place = (x - lower) / np.where(size > 0, size, 1.0)
    result = place
    for k in range(1, x.shape[1]):
        result = result + _TILT**k * np.roll(place, -k, axis=1)
    return result


def _boxes(
    comm: MPI.Intracomm, x: npt.NDArray[np.float64], group: npt.NDArray[np.int64], n: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return lowest and highest coordinates of n groups on all ranks, each ``(n, d)``."""
    lower, upper = np.full((n, x.shape[1]), np.inf), np.full((n, x.shape[1]), -np.inf)
    np.minimum.at(lower, group, x)
    np.maximum.at(upper, group, x)
    comm.Allreduce(MPI.IN_PLACE, lower, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, upper, MPI.MAX)
    return lower, upper


def _longest_side(
    comm: MPI.Intracomm, x: npt.NDArray[np.float64], group: npt.NDArray[np.int64], n: int
) -> npt.NDArray[np.int64]:
    """Return the longest axis of each group, ``(n,)``; of equal ones, the first."""
    lower, upper = _boxes(comm, x, group, n)
    side = upper - lower
    # ignore round-off, in which equal sides differ
    return np.argmax(side > (1 - 1e-9) * side.max(axis=1, keepdims=True), axis=1)


def _cuts(
    comm: MPI.Intracomm,
    along: npt.NDArray[np.float64],
    load: npt.NDArray[np.int64],
    group: npt.NDArray[np.int64],
    low: npt.NDArray[np.int64],
    count: npt.NDArray[np.int64],
) -> npt.NDArray[np.float64]:
    """Return the cut of each group, ``(n_groups,)``: its first `low` ranks get what is below."""

    def below(cut: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        result = np.zeros(len(count), dtype=np.int64)
        here = along <= cut[group]
        np.add.at(result, group[here], load[here])
        comm.Allreduce(MPI.IN_PLACE, result, MPI.SUM)
        return result

    before, behind = np.full(len(count), -1.0), np.full(len(count), 2.0)
    wanted = below(behind) // np.maximum(count, 1) * low
    for _ in range(_HALVINGS):
        middle = (before + behind) / 2
        less = below(middle) < wanted
        before[less], behind[~less] = middle[less], middle[~less]
    # the cell between both parts goes to the side where it causes less imbalance
    return np.where(wanted - below(before) < below(behind) - wanted, before, behind)
