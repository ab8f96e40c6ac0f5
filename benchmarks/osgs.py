# SPDX-License-Identifier: MIT
"""OSGS compared with ASGS: time of a solution and of a step of Cook's membrane in 2D.

Both are solved alternately from rest by new solvers, whose forms have been compiled before. Times
are medians of five runs. Steps are those of studies/cooks_membrane_dynamic.py, alternately, too.
For steps in 3D see benchmarks/implicit_in_space.py --stabilization osgs.

    NUMBA_NUM_THREADS=1 ./run python benchmarks/osgs.py
"""

import sys
import time
from pathlib import Path

from mpi4py import MPI

import machine
import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import formulations, io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

sys.path.insert(0, str(Path(__file__).parents[1] / "studies"))
import cooks_membrane_dynamic


def solver(domain, body, edge, stabilization):
    """Return the solver of the problem of demos/cooks_membrane.py."""
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = formulations.stabilized(stabilization, z, body, NeoHookean(E=70.0, nu=0.5))  # Pa
    R += formulations.dead_load(z.test.u, edge, (0, 0.0625))  # Pa
    return NewtonSolver(R, z.U, z.bcs)


def main(sizes: list[int] = [64, 128, 256], repeats: int = 5):
    """Print seconds of a solution by squares per side, and of a step."""
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
    steps(25)


def steps(count: int):
    """Measure seconds per step of bodies that move."""
    sims = {name: cooks_membrane_dynamic.build(name)[0] for name in ("asgs", "osgs")}
    spent, krylov = {name: [] for name in sims}, []
    for _ in range(count):
        for name, sim in sims.items():
            begin = time.perf_counter()
            krylov.append(sim.step().newton.linear_iterations)
            spent[name].append(time.perf_counter() - begin)
    asgs, osgs = (np.median(times[3:]) for times in spent.values())
    unknowns = sims["asgs"].unknown.space.dofmap.index_map.size_global
    columns = {"unknowns": "d", "asgs [s]": ".3f", "osgs [s]": ".3f", "ratio": ".2f", "Krylov": "d"}
    io.Table(columns).row(unknowns, asgs, osgs, osgs / asgs, int(np.median(krylov[7::2])))


if __name__ == "__main__":
    typer.run(main)
