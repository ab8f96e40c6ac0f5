# SPDX-License-Identifier: MIT
"""Checkpoints: the state of a simulation in a file, to go on from there later.

A checkpoint has what a step leaves behind: all arrays of all points, the time, and what the time
scheme remembers. Mesh, forms and loads come from the script: it builds its simulation as always
and then restores the checkpoint into it.
"""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

import fenicsmpm
from fenicsmpm.io.atomic import replacing
from fenicsmpm.io.fingerprint import layout, mesh_fingerprint
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import do_there

logger = logging.getLogger(__name__)

FORMAT = 2

Arrays = dict[str, npt.NDArray]
Fields = dict[str, tuple[int, ...]]  # shapes of the values at one point


class CheckpointError(ValueError):
    """A file that is no checkpoint, or one of another simulation."""


class Simulation(Protocol):
    """What is saved and restored of a simulation, ``ImplicitMPM`` or ``ExplicitMPM``.

    Attributes:
        time: [s].
        number: of steps done.
        method: name of the time integration.
        memory: other numbers that the next step depends on.
        parameters: what the script has chosen, said in words: laws, grid functions, residual.
        bodies: material points.
        carried: points that move with the grid.
    """

    time: float
    number: int
    method: str
    memory: dict[str, float]
    parameters: dict[str, str]
    bodies: list[MaterialPoints]
    carried: list[MaterialPoints]

    def settle(self) -> None:
        """Have all points up to date, so that a restart goes on as the simulation does."""


@dataclass
class _PointSet:
    """The points of one set, rank after rank."""

    next_id: int
    counts: list[int]
    arrays: Arrays


@dataclass
class _State:
    """Contents of a checkpoint."""

    header: dict[str, Any]
    memory: dict[str, float]
    parameters: dict[str, str]
    sets: list[_PointSet]


def save(path: str | Path, sim: Simulation) -> None:
    """Save the state of a simulation between two steps (collective).

    Rank 0 gathers it in its memory and writes an HDF5 file. The file takes the place of an older
    one only when it is complete: a program that is killed meanwhile leaves the older one.

    Args:
        path: file to write, such as "cook.h5"; missing directories are made.
        sim: the simulation.

    Raises:
        OSError: on all ranks, if the file cannot be written; an older one is as it was.
    """
    path = Path(path)
    comm = _mesh(sim).comm
    sim.settle()
    state = _gather(sim)

    def write() -> None:
        assert state is not None
        try:
            with replacing(path) as stream:
                stream.write(_pack(state))
        except OSError as failure:
            raise OSError(
                failure.errno,
                f"the checkpoint at t = {sim.time:g} s could not be written, an older one is as "
                f"it was: {failure.strerror}; make room or choose another path",
                str(path),
            ) from failure

    do_there(comm, state is not None, write)


def restore(path: str | Path, sim: Simulation) -> None:
    """Bring a simulation to the state that was saved (collective).

    On the same mesh with the same distribution of its cells, in particular on the same number of
    ranks, everything goes on bit by bit as without the interruption, provided that the linear
    solver itself gives the same bits each time, and for explicit steps, with the same number of
    threads. Otherwise the points go to the ranks that own their cells, and results agree to
    round-off, or to the tolerance of Newton's method where systems are solved by iterations. Grid
    functions are not part of the state: the unknown has its values again after the
    next step. What the script has chosen otherwise than before, such as a parameter of a law, is
    logged as a warning: that may be meant.

    Args:
        path: what ``save`` wrote.
        sim: simulation built by the same script; after an error it is as before.

    Raises:
        CheckpointError: on all ranks, if the file is no checkpoint, is incomplete, or was saved
            by a simulation with another mesh, time scheme, point sets or fields.
        OSError: on all ranks, if the file cannot be read.
    """
    path = Path(path)
    comm = _mesh(sim).comm
    header = _header(sim)
    fields = [_fields(points) for points in _point_sets(sim)]

    def read() -> _State:
        state = _read(path, header)
        _check(path, state, header, fields)
        for name in {**state.parameters, **sim.parameters}:
            there, here = (p.get(name, "nothing") for p in (state.parameters, sim.parameters))
            if there != here:
                logger.warning(
                    "%s was saved with the %s %s; here it is %s", path, name, there, here
                )
        return state

    state = do_there(comm, comm.rank == 0, read)
    same = comm.bcast(state and state.header["layout"] == header["layout"])
    new = []
    for k, points in enumerate(_point_sets(sim)):
        next_id, arrays = _scatter(points, state.sets[k] if state else None, same)
        new.append((points, next_id, arrays if same else _located(points, arrays)))
    header, memory = comm.bcast(state and (state.header, state.memory))

    for points, next_id, arrays in new:
        points.restore(arrays)
        points.next_id = next_id
    sim.time, sim.number = header["time"], header["number"]
    sim.memory = memory


# --- simulation -----------------------------------------------------------------------------------


def _mesh(sim: Simulation) -> Mesh:
    return sim.bodies[0].mesh


def _point_sets(sim: Simulation) -> list[MaterialPoints]:
    return [*sim.bodies, *sim.carried]


def _header(sim: Simulation) -> dict[str, Any]:
    """All that is not an array (collective)."""
    mesh = _mesh(sim)
    return {
        "format": FORMAT,
        "fenicsmpm": fenicsmpm.__version__,
        "ranks": mesh.comm.size,
        "mesh": mesh_fingerprint(mesh),
        "layout": layout(mesh),
        "scheme": sim.method,
        "time": float(sim.time),
        "number": int(sim.number),
    }


def _fields(points: MaterialPoints) -> Fields:
    return {name: a.shape[1:] for name, a in points.snapshot().items()}


def _gather(sim: Simulation) -> _State | None:
    """The state on rank 0, None on the others (collective)."""
    comm = _mesh(sim).comm
    state = _State(_header(sim), dict(sim.memory), dict(sim.parameters), [])
    for points in _point_sets(sim):
        counts = comm.gather(len(points))
        arrays = {}
        for name, array in points.snapshot().items():  # one by one: a message has at most 2 GB
            parts = comm.gather(array)
            if parts is not None:
                arrays[name] = np.concatenate(parts)
        state.sets.append(_PointSet(points.next_id, counts or [], arrays))
    return state if comm.rank == 0 else None


def _scatter(points: MaterialPoints, saved: _PointSet | None, same: bool) -> tuple[int, Arrays]:
    """Next id, and rows for each rank: those that it had, or any (collective)."""
    comm = points.mesh.comm
    arrays = {}
    for name in points.snapshot():
        parts = None
        if saved is not None:
            where = np.cumsum(saved.counts)[:-1] if same else comm.size
            parts = np.array_split(saved.arrays[name], where)
        arrays[name] = comm.scatter(parts)
    return comm.bcast(saved and saved.next_id), arrays


def _located(points: MaterialPoints, arrays: Arrays) -> Arrays:
    """Arrays of points anywhere, with their cells on the ranks that own them (collective)."""
    n = len(arrays["x"])
    nowhere = {"cell": np.full(n, -1, np.int32), "xi": np.zeros_like(arrays["x"])}
    others = points.select([])
    others.restore({**arrays, **nowhere})
    others.move(arrays["x"])
    return others.snapshot()


def _check(path: Path, saved: _State, header: dict[str, Any], fields: Sequence[Fields]) -> None:
    """Raise CheckpointError unless what was saved is the state of a simulation like this one."""
    differences = [
        f"its {name} is {saved.header[name]}, here it is {header[name]}"
        for name in ("mesh", "scheme")
        if saved.header[name] != header[name]
    ]
    if len(saved.sets) != len(fields):
        differences.append(f"it has {len(saved.sets)} point sets, here are {len(fields)}")
    else:
        for k, (points, here) in enumerate(zip(saved.sets, fields, strict=True)):
            there = {name: a.shape[1:] for name, a in points.arrays.items()}
            if there != here:
                differences.append(f"point set {k} {_difference(there, here)}")
    if differences:
        raise CheckpointError(
            f"checkpoint {path} is of another simulation: {'; '.join(differences)}. Restore it "
            "with the script and the mesh that saved it, after all fields were added"
        )


def _difference(there: Fields, here: Fields) -> str:
    said = []
    if missing := [name for name in there if name not in here]:
        said.append(f"has fields that are missing here: {', '.join(missing)}")
    if more := [name for name in here if name not in there]:
        said.append(f"lacks fields that are here: {', '.join(more)}")
    said += [
        f"has {name!r} of shape {there[name]}, here it is {here[name]}"
        for name in there
        if name in here and there[name] != here[name]
    ]
    return " and ".join(said)


# --- file -----------------------------------------------------------------------------------------


def _pack(state: _State) -> memoryview:
    """The state as an HDF5 file in memory.

    HDF5 itself cannot close a file that it could not write, and crashes in the end.
    """
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.attrs.update({**state.header, "checksum": _checksum(state)})
        file.create_group("memory").attrs.update(state.memory)
        file.create_group("parameters").attrs.update(state.parameters)
        for k, points in enumerate(state.sets):
            group = file.create_group(f"points/{k}")
            group.attrs.update(next_id=points.next_id, counts=points.counts)
            for name, array in points.arrays.items():
                group[name] = array
    return stream.getbuffer()


def _read(path: Path, header: dict[str, Any]) -> _State:
    """Read a checkpoint whose header has the names of the one given."""
    import h5py

    with open(path, "rb") as stream:
        try:
            with h5py.File(stream, "r") as file:
                return _unpack(path, file, header)
        except CheckpointError:
            raise
        except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{path} is no checkpoint or is incomplete: {error}; restore another one"
            ) from error


def _unpack(path: Path, file: Any, header: dict[str, Any]) -> _State:
    found = file.attrs.get("format")
    if found is None:
        raise CheckpointError(f"{path} is an HDF5 file, but no checkpoint of fenicsmpm")
    if found != FORMAT:
        raise CheckpointError(
            f"checkpoint {path} has format {found} (fenicsmpm {file.attrs['fenicsmpm']}), this is "
            f"fenicsmpm {fenicsmpm.__version__}, which reads format {FORMAT}: restore it with the "
            "version that saved it"
        )
    header = {name: _plain(file.attrs[name]) for name in header}
    memory = {name: float(value) for name, value in file["memory"].attrs.items()}
    parameters = {name: str(value) for name, value in file["parameters"].attrs.items()}
    sets = []
    for k in range(len(file["points"])):
        group = file[f"points/{k}"]
        counts = _plain(group.attrs["counts"])
        arrays = {name: data[()] for name, data in group.items()}
        for name, array in arrays.items():
            if len(array) != sum(counts):
                raise CheckpointError(
                    f"checkpoint {path} is damaged: {len(array)} values of {name!r} for "
                    f"{sum(counts)} points; restore another one"
                )
        sets.append(_PointSet(int(group.attrs["next_id"]), counts, arrays))
    state = _State(header, memory, parameters, sets)
    if file.attrs["checksum"] != _checksum(state):
        raise CheckpointError(
            f"checkpoint {path} is damaged: it does not have its checksum; restore another one"
        )
    return state


def _checksum(state: _State) -> str:
    """Of all that is saved but for the layout, of which any other one is as good."""
    digest = hashlib.sha256()
    header = {name: value for name, value in state.header.items() if name != "layout"}
    for named in (header, state.memory, state.parameters):
        digest.update(repr(sorted(named.items())).encode())
    for points in state.sets:
        digest.update(repr((points.next_id, points.counts)).encode())
        for name, array in sorted(points.arrays.items()):
            digest.update(f"{name} {array.dtype} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    """Python's own number, text or list instead of numpy's."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
