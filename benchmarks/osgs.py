# SPDX-License-Identifier: MIT
"""OSGS beside ASGS: time of a solution of Cook's membrane in the plane, incompressible.

Both are solved in turns from rest by new solvers, whose forms have been compiled before; medians
of five times. For steps in space see benchmarks/implicit_in_space.py --stabilization osgs.

    NUMBA_NUM_THREADS=1 ./run python benchmarks/osgs.py
"""

import time

from mpi4py import MPI

import machine
import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import formulations, io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver


def solver(domain, body, edge, stabilization):
    """Of the problem of demos/cooks_membrane.py."""
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.stabilized(stabilization, z, body, NeoHookean(E=70.0, nu=0.5))  # Pa
    R += formulations.dead_load(z.test.u, edge, (0, 0.0625))  # Pa
    return NewtonSolver(R, z.U, z.bcs)


def main(sizes: list[int] = [64, 128, 256], repeats: int = 5):
    """Seconds of a solution by squares a side."""
    io.say(machine.describe())
    columns = {"squares": "d", "asgs [s]": ".3f", "osgs [s]": ".3f", "ratio": ".2f"}
    table = io.Table({**columns, "Newton": "s", "Krylov": "d"})
    for n in sizes:
        domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
        x, y, _ = domain.geometry.x.T.copy()
        domain.geometry.x[:, :2] = np.column_stack([48 * x, 44 * x + (44 - 28 * x) * y])
        body = points.quadrature(domain, degree=2)
        edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
        spent, results = {"asgs": [], "osgs": []}, {}
        for _ in range(1 + repeats):
            for name, times in spent.items():
                newton = solver(domain, body, edge, name)
                begin = time.perf_counter()
                results[name] = newton.solve()
                times.append(time.perf_counter() - begin)
        asgs, osgs = (np.median(times[1:]) for times in spent.values())
        iterations = " ".join(str(result.iterations) for result in results.values())
        table.row(n, asgs, osgs, osgs / asgs, iterations, results["osgs"].linear_iterations)


if __name__ == "__main__":
    typer.run(main)
