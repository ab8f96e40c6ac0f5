# SPDX-License-Identifier: MIT
"""Checkpoints: the state of a simulation in a file, to go on from there later.

A checkpoint has what a step leaves behind: all arrays of all points, the time, and what the time
scheme remembers. Mesh, forms and loads come from the script: it builds its simulation as always
and then restores the checkpoint into it.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from dolfinx.mesh import Mesh

import fenicsmpm
from fenicsmpm.io.atomic import replacing_together
from fenicsmpm.io.checkpoint_file import (
    FORMAT,
    CheckpointError,
    Contents,
    digest,
    read_contents,
    read_rows,
    write_rows,
    write_skeleton,
)
from fenicsmpm.io.fingerprint import layout, mesh_fingerprint
from fenicsmpm.points.agreement import do_there
from fenicsmpm.simulation.state import (
    PointSet,
    Simulation,
    State,
    chosen_otherwise,
    differences,
    fields_of,
    located,
    point_sets,
    put,
    take,
)

__all__ = ["CheckpointError", "restore", "save"]

logger = logging.getLogger(__name__)


def save(path: str | Path, sim: Simulation) -> None:
    """Save the state of a simulation between two steps (collective).

    All ranks write their points into one HDF5 file, so they have to see the same directory. The
    file takes the place of an older one only when it is complete: a program that is killed
    meanwhile leaves the older one.

    Args:
        path: file to write, such as "cook.h5"; missing directories are made.
        sim: the simulation.

    Raises:
        OSError: on all ranks, if the file cannot be written; an older one is as it was.
    """
    path = Path(path)
    comm = _mesh(sim).comm
    state = take(sim)
    contents = _contents(sim, state)
    try:
        with replacing_together(comm, path) as unfinished:
            places = comm.bcast(
                do_there(comm, comm.rank == 0, lambda: write_skeleton(unfinished, contents))
            )
            do_there(
                comm, True, lambda: write_rows(unfinished, places, contents, state.sets, comm.rank)
            )
    except OSError as failure:
        raise OSError(
            failure.errno,
            f"the checkpoint at t = {sim.time:g} s could not be written, an older one is as "
            f"it was: {failure.strerror}; make room or choose another path",
            str(path),
        ) from failure


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

    def read() -> Contents:
        contents = read_contents(path, list(header))
        _check(path, contents, header, sim)
        for name, there, here in chosen_otherwise(contents.parameters, sim.parameters):
            logger.warning("%s was saved with the %s %s; here it is %s", path, name, there, here)
        return contents

    contents: Contents = comm.bcast(do_there(comm, comm.rank == 0, read))
    same = contents.header["layout"] == header["layout"]
    rows = do_there(comm, True, lambda: read_rows(path, contents, same, comm.rank, comm.size))
    assert rows is not None
    new = []
    for points, next_id, saved in zip(point_sets(sim), contents.next_ids, rows, strict=True):
        arrays = {name: saved[name] for name in fields_of(points)}  # in their order
        new.append(PointSet(next_id, arrays if same else located(points, arrays)))
    time, number = (contents.header[name] for name in ("time", "number"))
    put(State(time, number, contents.memory, new), sim)


def _mesh(sim: Simulation) -> Mesh:
    return sim.bodies[0].mesh


def _header(sim: Simulation) -> dict[str, Any]:
    """What says whether a checkpoint fits, and the time (collective)."""
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


def _contents(sim: Simulation, state: State) -> Contents:
    """All but the rows of points, the same on all ranks (collective)."""
    comm = _mesh(sim).comm
    here = [(0, len(points.arrays["x"])) for points in state.sets]
    arrays = [points.arrays for points in state.sets]
    known = comm.allgather(([count for _, count in here], digest(arrays, here)))
    return Contents(
        _header(sim),
        state.memory,
        dict(sim.parameters),
        [points.next_id for points in state.sets],
        [list(counts) for counts in zip(*(counts for counts, _ in known), strict=True)],
        [{name: (a.dtype.str, a.shape[1:]) for name, a in rows.items()} for rows in arrays],
        [text for _, text in known],
    )


def _check(path: Path, saved: Contents, header: dict[str, Any], sim: Simulation) -> None:
    """Raise CheckpointError unless what was saved is the state of a simulation like this one."""
    found = []
    if saved.header["mesh"] != header["mesh"]:
        found.append(f"its mesh is {saved.header['mesh']}, here it is {header['mesh']}")
    there = [{name: shape for name, (_, shape) in of.items()} for of in saved.fields]
    here = [fields_of(points) for points in point_sets(sim)]
    found += differences((saved.header["scheme"], there), (header["scheme"], here))
    if found:
        raise CheckpointError(
            f"checkpoint {path} is of another simulation: {'; '.join(found)}. Restore it "
            "with the script and the mesh that saved it, after all fields were added"
        )
