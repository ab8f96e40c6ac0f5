# SPDX-License-Identifier: MIT
"""Cost of output: a series that all ranks write, compared with files that rank 0 gathers.

Points in 3D with the fields u and v (vectors) and sigma (a tensor) are written at several times.
Memory is the peak of rank 0 during this, above its memory before. At the end the file is in the
page cache of the system, not yet on the disk.

    ./run mpirun -n 2 python benchmarks/output.py
    ./run mpirun -n 2 python benchmarks/output.py --gathered
"""

import tempfile
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh
from machine import describe

from fenicsmpm import io, points


def cloud(n):
    """Return at least n points with fields."""
    cells = round(np.ceil((n / 8) ** (1 / 3)))
    domain = mesh.create_unit_cube(MPI.COMM_WORLD, *[cells] * 3, mesh.CellType.hexahedron)
    body = points.lattice(domain, 0.5 / cells)
    body.add_field("u", (3,), np.sin(body.x))
    body.add_field("v", (3,), np.cos(body.x))
    body.add_field("sigma", (3, 3), body["u"][:, :, None] * body["v"][:, None, :])
    return body


def memory(name):
    """Return the memory of this process in MB: "VmRSS" at present, "VmHWM" at its peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(name)).split()[1]) / 1024


def main(n: int = 1_000_000, times: int = 5, gathered: bool = False):
    """Print seconds and MB per write."""
    comm, body = MPI.COMM_WORLD, cloud(n)
    io.gather_points(body.select([]))  # imports pyvista
    with tempfile.TemporaryDirectory(dir=".") as name:
        directory = comm.bcast(Path(name).absolute())
        series = io.Series(directory / "body.vtkhdf", body)

        def write(k):
            if gathered:
                io.write(directory / f"{k}.vtp", io.gather_points(body), {"TimeValue": float(k)})
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
        "way".ljust(9): "s", "ranks": "d", "points": "d", "first time [s]": ".2f",
        "later ones [s]": ".2f", "file [MB a time]": ".0f", "rank 0 [MB]": ".0f",
    })  # fmt: skip
    way = ("gathered" if gathered else "series").ljust(9)
    later = float(np.median(seconds[1:]))
    table.row(way, comm.size, body.size_global, seconds[0], later, size, most)


if __name__ == "__main__":
    typer.run(main)
