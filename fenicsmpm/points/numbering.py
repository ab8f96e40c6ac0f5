# SPDX-License-Identifier: MIT
"""Ids of points that do not depend on the number of ranks."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.migration import exchange


def ids_in_order(comm: MPI.Intracomm, number: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return ids 0, 1, ... of points in ascending order of their numbers. Collective.

    Args:
        comm: Communicator of the points.
        number: Non-negative number of each point of this rank, distinct over all ranks,
            shape (n,).

    Returns:
        Ids, shape (n,), int64.

    Raises:
        ValueError: On all ranks, for negative numbers and numbers that several points have.
    """
    lowest = comm.allreduce(int(number.min(initial=np.iinfo(np.int64).max)), MPI.MIN)
    highest = comm.allreduce(int(number.max(initial=0)), MPI.MAX)
    if lowest < 0:
        raise ValueError(f"numbers of points must not be negative, but the lowest is {lowest}")
    # Each rank sorts the numbers of one interval and sends ids back in the order received.
    width = max(highest - lowest, 0) // comm.size + 1
    destination = ((number - lowest) // width).astype(np.int32)
    rank = np.full(len(number), comm.rank, dtype=np.int32)
    received = exchange(comm, destination, {"number": number, "rank": rank})
    order = np.argsort(received["number"], kind="stable")
    twice = np.flatnonzero(np.diff(received["number"][order]) == 0)
    error = None
    if len(twice):
        error = ValueError(
            "numbers of points must be distinct, but several points have the number "
            f"{received['number'][order[twice[0]]]}"
        )
    raise_together(comm, error)
    ids = np.empty(len(order), dtype=np.int64)
    ids[order] = (comm.exscan(len(order)) or 0) + np.arange(len(order))
    result = np.empty(len(number), dtype=np.int64)
    result[np.argsort(destination, kind="stable")] = exchange(comm, received["rank"], {"id": ids})[
        "id"
    ]
    return result
