# SPDX-License-Identifier: MIT
"""Time to find the cells of points, from a nearby cell and without a first guess.

Run: python benchmarks/location.py [--points 1000000] [--cells-per-side 26] [--repeat 5]
"""

import argparse
import statistics
import time

from mpi4py import MPI

import machine
import numpy as np
from dolfinx.mesh import CellType, create_unit_cube

from fenicsmpm.points.location import Locator


def seconds(call, repeat):
    call()  # compiles
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def near(x, size, rng):
    """Return positions less than two cells away, still in the unit cube."""
    moved = x + size * rng.uniform(-2.0, 2.0, x.shape) / np.sqrt(3.0)
    return np.abs(np.where(moved > 1.0, 2.0 - moved, moved))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--cells-per-side", type=int, default=26)
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()

    print(f"{machine.describe()}, one core")
    print(f"{args.points} points in the unit cube, median of {args.repeat}")
    n = args.cells_per_side
    for kind, bent in (
        (CellType.tetrahedron, False),
        (CellType.hexahedron, False),
        (CellType.hexahedron, True),
    ):
        mesh = create_unit_cube(MPI.COMM_SELF, n, n, n, kind)
        if bent:  # inside the cube
            s = np.sin(np.pi * mesh.geometry.x).prod(axis=1)
            mesh.geometry.x[:] += 0.05 * s[:, None] * [1.0, -0.5, 0.7]
        start = time.perf_counter()
        locator = Locator(mesh)
        build = time.perf_counter() - start
        rng = np.random.default_rng(1)
        old = rng.random((args.points, 3))
        cells, _ = locator.locate(old)
        new = near(old, 1.0 / n, rng)
        order = np.argsort(cells, kind="stable")
        cases = {
            "from nothing": lambda: locator.locate(new),
            "within two cells": lambda: locator.locate(new, cells),
            "within two cells, points sorted by cell": lambda: locator.locate(
                new[order], cells[order]
            ),
        }
        name = f"bent {kind.name}" if bent else kind.name
        print(f"{locator.geometry.num_cells} cells ({name}), tables built in {build:.2f} s")
        for name, call in cases.items():
            print(f"  {name:40s} {seconds(call, args.repeat):8.3f} s")


if __name__ == "__main__":
    main()
