# SPDX-License-Identifier: MIT
"""Exchange of points between ranks: each point is stored on the rank that owns its cell."""

from collections.abc import Mapping

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.location import Locator

_TAG = 4703

# Number of points per rank that all other ranks search for in their cells at a time
_AT_A_TIME = 1 << 15


class PointsOutsideError(ValueError):
    """Error for points that lie in no cell of the background mesh on any rank.

    Attributes:
        count: Number of points outside on all ranks.
        total: Number of points that were located on all ranks.
        first: Position in m of the first point outside, on the lowest rank that has one.
        indices: Indices of the points outside on this rank, int64.
        positions: Their positions in m, shape (len(indices), d).
    """

    def __init__(
        self,
        count: int,
        total: int,
        first: npt.NDArray[np.float64],
        indices: npt.NDArray[np.int64],
        positions: npt.NDArray[np.float64],
    ):
        """Compose the message from the attributes."""
        where = ", ".join(f"{v:.6g}" for v in first)
        super().__init__(
            f"points outside the background mesh: {count} of {total}, first at ({where}); "
            "enlarge the mesh, shorten the step or remove the points"
        )
        self.count = count
        self.total = total
        self.first = first
        self.indices = indices
        self.positions = positions

    def __reduce__(self) -> tuple[object, ...]:
        """Return what pickle needs to recreate the error on another rank."""
        return type(self), (self.count, self.total, self.first, self.indices, self.positions)


def find_cells(
    comm: MPI.Intracomm,
    locator: Locator,
    x: npt.NDArray[np.float64],
    hint: npt.NDArray[np.int32] | None,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Find the cells of points on all ranks. Collective.

    Args:
        comm: Communicator of the mesh.
        locator: Locator of this rank's part of the mesh.
        x: This rank's points in m, shape (n, d).
        hint: Local cells to start from, shape (n,), or None.

    Returns:
        Global cells, shape (n,); local cells, shape (n,), -1 if the cell is not on this rank; and
        reference coordinates (n, d) in the local cells.

    Raises:
        PointsOutsideError: On all ranks, if some point is in no cell of the mesh.
    """
    cell, xi = locator.locate(x, hint)
    global_cell = np.full(len(x), -1, dtype=np.int64)
    found = cell >= 0
    global_cell[found] = locator.geometry.global_index(cell[found])
    unsure = np.flatnonzero(~locator.is_sure(cell, xi))
    # Most time steps end here, after the reduction of one number.
    most = comm.allreduce(len(unsure), MPI.MAX)
    if most:
        # a few at a time, since every rank searches for the points of all
        parts = np.array_split(unsure, -(-most // _AT_A_TIME))
        better = np.concatenate([_find_elsewhere(comm, locator, x[part]) for part in parts])
        cell[unsure[better != global_cell[unsure]]] = -1
        global_cell[unsure] = better
        outside = np.flatnonzero(global_cell < 0)
        _raise_outside(comm, len(x), outside, x[outside])
    return global_cell, cell, xi


def _find_elsewhere(
    comm: MPI.Intracomm, locator: Locator, x: npt.NDArray[np.float64]
) -> npt.NDArray[np.int64]:
    """Return the global cells of points that may be on any rank, -1 for none. Collective."""
    start = comm.exscan(len(x)) or 0
    everything = np.concatenate(comm.allgather(x))
    geometry = locator.geometry
    cell, _ = locator.locate(everything)
    mine = np.flatnonzero((cell >= 0) & (cell < geometry.num_owned))
    # Several ranks may own a cell that touches the point. The lowest number wins here, too.
    nobody = np.iinfo(np.int64).max
    key = np.full(len(everything), nobody, dtype=np.int64)
    key[mine] = geometry.key[cell[mine]]
    lowest = np.empty_like(key)
    comm.Allreduce(key, lowest, MPI.MIN)
    won = mine[key[mine] == lowest[mine]]
    claim = np.full(len(everything), -1, dtype=np.int64)
    claim[won] = geometry.global_index(cell[won])
    result = np.empty_like(claim)
    comm.Allreduce(claim, result, MPI.MAX)
    return result[start : start + len(x)]


def _raise_outside(
    comm: MPI.Intracomm,
    total: int,
    indices: npt.NDArray[np.int64],
    positions: npt.NDArray[np.float64],
) -> None:
    count = comm.allreduce(len(indices))
    if count:
        total = comm.allreduce(total)
        firsts = comm.allgather(positions[0] if len(positions) else None)
        first = next(f for f in firsts if f is not None)
        raise PointsOutsideError(count, total, first, indices, positions)


def _owners(
    comm: MPI.Intracomm, locator: Locator, global_cell: npt.NDArray[np.int64]
) -> npt.NDArray[np.int32]:
    """Return the ranks that own the given global cells, shape (n,). Collective."""
    starts = np.array(comm.allgather(locator.geometry.first_global))
    return (np.searchsorted(starts, global_cell, side="right") - 1).astype(np.int32)


def send_home(
    comm: MPI.Intracomm,
    locator: Locator,
    global_cell: npt.NDArray[np.int64],
    data: Mapping[str, npt.NDArray],
) -> Mapping[str, npt.NDArray]:
    """Send points to the ranks that own their cells, with all their arrays. Collective.

    Args:
        comm: Communicator of the mesh.
        locator: Locator of this rank's part of the mesh.
        global_cell: Cells of this rank's points, shape (n,).
        data: Arrays of n rows, among them "x", "xi" and the local "cell" (-1 if on another rank).

    Returns:
        Arrays of the points in cells that this rank owns.
    """
    geometry = locator.geometry
    stays = (data["cell"] >= 0) & (data["cell"] < geometry.num_owned)
    leaving = np.flatnonzero(~stays)
    if not comm.allreduce(len(leaving)):
        return data
    sent = {name: a[leaving] for name, a in data.items()}
    sent["global_cell"] = global_cell[leaving]
    new = exchange(comm, _owners(comm, locator, sent["global_cell"]), sent)
    new["cell"] = (new.pop("global_cell") - geometry.first_global).astype(np.int32)
    new["xi"] = locator.pull_back(new["x"], new["cell"])
    return {name: np.concatenate([a[stays], new[name]]) for name, a in data.items()}


def exchange(
    comm: MPI.Intracomm, destination: npt.NDArray[np.int32], arrays: dict[str, npt.NDArray]
) -> dict[str, npt.NDArray]:
    """Send rows of arrays to other ranks, in one message per destination. Collective.

    Args:
        comm: Communicator.
        destination: Rank to which each row goes, shape (n,).
        arrays: Arrays of n rows each; the same names, types and row shapes in the same order on
            all ranks.

    Returns:
        Arrays of the same names with the rows received, ordered by sending rank, then as sent.
    """
    record = np.dtype([(name, a.dtype, a.shape[1:]) for name, a in arrays.items()])
    order = np.argsort(destination, kind="stable")
    packed = np.empty(len(destination), dtype=record)
    for name, a in arrays.items():
        packed[name] = a[order]
    send = np.bincount(destination, minlength=comm.size).astype(np.int64)
    receive = np.empty_like(send)
    comm.Alltoall(send, receive)
    received = np.empty(receive.sum(), dtype=record)

    # Few ranks are neighbours: only those exchange messages.
    row = MPI.BYTE.Create_contiguous(record.itemsize).Commit()
    requests = []
    ends = np.cumsum(receive)
    for rank in np.flatnonzero(receive):
        part = received[ends[rank] - receive[rank] : ends[rank]]
        requests.append(comm.Irecv([part.view(np.uint8), len(part), row], rank, _TAG))
    ends = np.cumsum(send)
    for rank in np.flatnonzero(send):
        part = packed[ends[rank] - send[rank] : ends[rank]]
        requests.append(comm.Isend([part.view(np.uint8), len(part), row], rank, _TAG))
    MPI.Request.Waitall(requests)
    row.Free()
    return {name: np.ascontiguousarray(received[name]) for name in arrays}
