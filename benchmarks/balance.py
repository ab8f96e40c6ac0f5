# SPDX-License-Identifier: MIT
"""Cost and gain of redistributing points over ranks as they gather.

The water column of ``demos/dam_break.py`` with a low speed of sound runs once on the mesh as
dolfinx distributes it, and once with ``Rebalanced``. Times are taken after the first step, in which
loops are compiled:

    ./run mpirun -n 2 python benchmarks/balance.py --per-metre 16
"""

import time

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.materials import NewtonianFluid
from fenicsmpm.simulation import Rebalanced, imbalance

DENSITY, GRAVITY, WATER = 1000.0, 9.81, NewtonianFluid(kappa=2e6, mu=1e-3)  # kg/m^3, m/s^2, Pa
LENGTH, HEIGHT, WALL, CEILING = 4.0, 2.0, 12.0, 4.0  # of the water and of the box, m


def build(domain, spacing, dt):
    """Build the water column without its gate."""
    water = points.lattice(domain, spacing, inside=lambda x: (x[0] < LENGTH) & (x[1] < HEIGHT))
    formulations.set_initial_state(water, DENSITY)
    basis.use(water, "quadratic")
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], WALL), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], CEILING), component=1)
    R = formulations.internal_force(z.test.v, water, WATER)
    R += formulations.body_force(z.test.v, water, (0.0, -GRAVITY))
    return ExplicitMPM(R, z, water, dt=dt)


def main(per_metre: int = 16, per_side: int = 3, end: float = 0.8, most: float = 1.25):
    """Print points on the fullest rank over the mean, and seconds, with and without rebalancing."""
    comm, h = MPI.COMM_WORLD, 1 / per_metre
    shape = [round(WALL / h), round(CEILING / h)]
    dt = 0.1 * h / np.sqrt(WATER.kappa / DENSITY)
    columns = {"most": "g", "run [s]": ".2f", "rebalance [s]": ".2f", "meshes": "d"}
    columns |= {"fullest rank": ".2f", "at the end": ".2f", "points": "d"}
    table = io.Table(columns)
    for limit in (np.inf, most):
        domain = mesh.create_rectangle(
            comm, [(0, 0), (WALL, CEILING)], shape, mesh.CellType.quadrilateral
        )
        run = Rebalanced(lambda domain: build(domain, h / per_side, dt), domain, most=limit)
        run.sim.step()
        comm.barrier()
        begin, found, meshes = time.perf_counter(), [], [run.mesh]
        for _ in run.run(end, interval=end / 40):
            found.append(imbalance(run.sim))
            if run.mesh is not meshes[-1]:
                meshes.append(run.mesh)
        comm.barrier()
        spent = time.perf_counter() - begin
        lost = run.sim.seconds.get("rebalance", 0.0)
        size = run.sim.bodies[0].size_global
        table.row(limit, spent, lost, len(meshes), np.mean(found), found[-1], size)


if __name__ == "__main__":
    typer.run(main)
