# SPDX-License-Identifier: MIT
"""Cost of output: series and checkpoints that all ranks write, and files that rank 0 gathers.

Points in 3D with two vectors and a tensor are written at several times. A checkpoint also has the
state of an explicit simulation.
Memory is the peak of rank 0 during this, above its memory before. At the end the file is in the
page cache of the system, not yet on the disk.

    ./run mpirun -n 2 python benchmarks/output.py
    ./run mpirun -n 2 python benchmarks/output.py --way gathered
    ./run mpirun -n 2 python benchmarks/output.py --way checkpoint
"""

import tempfile
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh
from machine import describe

from fenicsmpm import ExplicitMPM, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.materials import NeoHookean


def cloud(n):
    """Return at least n points with fields."""
    cells = round(np.ceil((n / 8) ** (1 / 3)))
    domain = mesh.create_unit_cube(MPI.COMM_WORLD, *[cells] * 3, mesh.CellType.hexahedron)
    body = points.lattice(domain, 0.5 / cells)
    body.add_field("displacement", (3,), np.sin(body.x))
    body.add_field("velocity", (3,), np.cos(body.x))
    a, b = body["displacement"], body["velocity"]
    body.add_field("stress", (3, 3), a[:, :, None] * b[:, None, :])
    return body


def memory(name):
    """Return the memory of this process in MB: "VmRSS" at present, "VmHWM" at its peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(name)).split()[1]) / 1024


def simulation(body):
    """Return explicit steps of a body."""
    fm.set_initial_state(body, 1000.0)  # kg/m^3
    z = fm.Unknown(body.mesh, "v")
    return ExplicitMPM(fm.internal_force(z.test.v, body, NeoHookean(1e6, 0.3)), z, body)


def main(n: int = 1_000_000, times: int = 5, way: str = "series"):
    """Print seconds and MB per write of series, gathered, or checkpoint."""
    comm, body = MPI.COMM_WORLD, cloud(n)
    io.gather_points(body.select([]))  # imports pyvista
    with tempfile.TemporaryDirectory(dir=".") as name:
        directory = comm.bcast(Path(name).absolute())
        series = io.Series(directory / "body.vtkhdf", body)
        sim = simulation(body) if way == "checkpoint" else None

        def write(k):
            if way == "gathered":
                io.write(directory / f"{k}.vtp", io.gather_points(body), {"TimeValue": float(k)})
            elif way == "checkpoint":
                io.checkpoint.save(directory / f"{k}.h5", sim)
            else:
                series.write(float(k))

        Path("/proc/self/clear_refs").write_text("5")  # reset the peak of memory
        before, seconds = memory("VmRSS"), []
        for k in range(times):
            comm.barrier()
            begin = time.perf_counter()
            write(k)
            comm.barrier()
            seconds.append(time.perf_counter() - begin)
        most = memory("VmHWM") - before
        size = sum(file.stat().st_size for file in directory.iterdir()) / 2**20 / times
        comm.barrier()
    if comm.rank == 0:
        print(describe())
    table = io.Table({
        "way".ljust(10): "s", "ranks": "d", "points": "d", "first time [s]": ".2f",
        "later ones [s]": ".2f", "file [MB a time]": ".0f", "rank 0 [MB]": ".0f",
    })  # fmt: skip
    later = float(np.median(seconds[1:]))
    table.row(way.ljust(10), comm.size, body.size_global, seconds[0], later, size, most)


if __name__ == "__main__":
    typer.run(main)
