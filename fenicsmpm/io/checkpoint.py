# SPDX-License-Identifier: MIT
"""Checkpoints: the state of a simulation in a file, from which it can continue later.

A checkpoint has the state at the end of a step: all arrays of all points, the time, and the memory
of the time scheme. Mesh, forms and loads come from the script. It builds its simulation as always
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
    """Save the state of a simulation between two steps. Collective.

    All ranks write their points into one HDF5 file, so they need a common file system. The file
    replaces an older one only when it is complete: if the program is killed before, the older file
    remains.

    Args:
        path: File to write, such as "cook.h5"; missing directories are created.
        sim: The simulation.

    Raises:
        OSError: On all ranks, if the file cannot be written; an older one stays as it was.
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
    """Restore the saved state of a simulation. Collective.

    On the same number of ranks with the same distribution of cells, the simulation continues bit by
    bit as without the interruption. This requires a linear solver that is itself reproducible, and
    for explicit steps the same number of threads. MUMPS is reproducible on one and two ranks; on
    more, OSGS may change its last bits from run to run. Otherwise the points go to the ranks that
    own their cells, and results agree to round-off, or to the tolerance of Newton's method if
    linear systems are solved iteratively. Grid functions are not part of the state: the unknown has
    its values again after the next step. Choices of the script that differ from the saved run, such
    as a parameter of a law, are logged as a warning, since they may be intended.

    Args:
        path: File that ``save`` wrote.
        sim: Simulation built by the same script; after an error it is unchanged.

    Raises:
        CheckpointError: On all ranks, if the file is no checkpoint, is incomplete, or was saved
            by a simulation with another mesh, time scheme, point sets or fields.
        OSError: On all ranks, if the file cannot be read.
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
        arrays = {name: saved[name] for name in fields_of(points)}  # in the order of the points
        new.append(PointSet(next_id, arrays if same else located(points, arrays)))
    time, number = (contents.header[name] for name in ("time", "number"))
    put(State(time, number, contents.memory, new), sim)


def _mesh(sim: Simulation) -> Mesh:
    return sim.bodies[0].mesh


def _header(sim: Simulation) -> dict[str, Any]:
    """Return the data that tell whether a checkpoint fits, and the time. Collective."""
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
    """Return everything except the rows of points, the same on all ranks. Collective."""
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
    """Raise CheckpointError unless the file was saved by a simulation like this one."""
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
