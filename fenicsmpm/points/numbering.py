# SPDX-License-Identifier: MIT
"""Ids of points that do not depend on the number of ranks."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.migration import exchange


def ids_in_order(comm: MPI.Intracomm, number: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Ids 0, 1, .. of points in ascending order of their numbers on all ranks. Collective.

    Args:
        comm: Communicator of the points.
        number: Of each point of this rank, from 0, distinct over all ranks, shape (n,).

    Returns:
        Ids, shape (n,), int64.

    Raises:
        ValueError: On all ranks, for negative numbers and those that two points have.
    """
    lowest = comm.allreduce(int(number.min(initial=np.iinfo(np.int64).max)), MPI.MIN)
    highest = comm.allreduce(int(number.max(initial=0)), MPI.MAX)
    if lowest < 0:
        raise ValueError(f"numbers of points start from 0, but there is {lowest}")
    # each rank sorts the numbers of one interval, and sends the ids back in the order received
    width = max(highest - lowest, 0) // comm.size + 1
    destination = ((number - lowest) // width).astype(np.int32)
    rank = np.full(len(number), comm.rank, dtype=np.int32)
    received = exchange(comm, destination, {"number": number, "rank": rank})
    order = np.argsort(received["number"], kind="stable")
    twice = np.flatnonzero(np.diff(received["number"][order]) == 0)
    error = None
    if len(twice):
        error = ValueError(
            "numbers of points must be distinct, but several have "
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
