# SPDX-License-Identifier: MIT
"""Cost of implicit steps in three dimensions, from 5,000 to 1,000,000 unknowns.

A block of incompressible rubber on tetrahedra falls onto its base: ASGS, ghost penalty, Bossak's
scheme, 8 points per cube of the mesh, distributed evenly among ranks. Step lengths are given in
times that a shear wave takes through a cell. Results are medians of some steps after two warm-up
steps. Memory is the peak of one rank.

    NUMBA_NUM_THREADS=1 ./run python benchmarks/implicit_in_space.py --n 16 --waves 10
"""

import resource
import time

from mpi4py import MPI

import machine
import numpy as np
import typer
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Rebalanced

DENSITY, E, NU = 1000.0, 1e5, 0.5  # kg/m^3, Pa


def block(n, *arguments, **options):
    """Return a block of 1 m with n cells along each side, in a mesh that is a quarter larger."""
    corners = [(0, 0, 0), (1.25, 1.25, 1.25)]
    domain = mesh.create_box(MPI.COMM_WORLD, corners, [n + n // 4] * 3)
    run = Rebalanced(lambda domain: block_on(domain, n, *arguments, **options), domain)
    run.rebalance()
    return run.sim


def block_on(domain, n, waves, stabilization="asgs", nu=NU, options=None, tied=False):
    """Return the block on a given mesh."""
    body = points.lattice(domain, 0.5 / n, inside=lambda x: x.max(axis=0) < 1)
    formulations.set_initial_state(body, DENSITY)
    z = formulations.Unknown(domain, "u", "p")
    law = NeoHookean(E, nu)
    scheme = formulations.Bossak(z, dt=waves / n / np.sqrt(law.mu / DENSITY))
    # enough to bend the block without turning it inside out in long steps
    gravity = ufl.as_vector((0.0, 0.0, -9.81 if waves < 2 else -0.3))
    force = scheme.force(body, gravity)
    R = formulations.stabilized(stabilization, z, body, law, force=force)
    cells, newton = ActiveCells(body), {"petsc_options": options}
    if tied:
        newton["tying"] = Tying(z.space, body, cells)
    else:
        R += formulations.ghost_penalty(z, cells, law)
    z.fix("u", lambda x: np.isclose(x[2], 0))
    return ImplicitMPM(R, z, scheme, body, newton=newton)


def main(
    n: list[int] = [8, 16, 24],  # typer copies it
    waves: list[float] = [10.0],
    steps: int = 3,
    direct: bool = False,
    stabilization: str = "asgs",
    nu: float = NU,
):
    """Print time, iterations and memory of a step."""
    io.say(machine.describe())
    columns = ("unknowns", "waves a step", "step [s]", "assembly [s]", "linear [s]", "Newton")
    formats = ("d", "g", ".2f", ".2f", ".2f", ".1f", "s", ".0f", ".0f")
    columns = (*columns, "linear solver", "iterations", "memory [MB]")
    table = io.Table(dict(zip(columns, formats, strict=True)))
    for size in n:
        for length in waves:
            options = {"pc_type": "lu"} if direct else None
            sim = block(size, length, stabilization, nu, options)
            rows = []
            for k in range(2 + steps):
                before, begin = dict(sim.seconds), time.perf_counter()
                step = sim.step()
                now = time.perf_counter() - begin
                spent = {name: value - before.get(name, 0.0) for name, value in sim.seconds.items()}
                newton = step.newton
                each = newton.linear_iterations / max(newton.iterations, 1)
                if k >= 2:
                    rows.append(
                        (now, spent["assembly"], spent["linear solver"], newton.iterations, each)
                    )
            wall, assembly, linear, iterations, each = np.median(rows, axis=0)
            unknowns = sim.unknown.space.dofmap
            count = unknowns.index_map.size_global * unknowns.index_map_bs
            megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            megabytes = MPI.COMM_WORLD.allreduce(megabytes, MPI.MAX)
            method = sim.linear.method
            table.row(count, length, wall, assembly, linear, iterations, method, each, megabytes)


if __name__ == "__main__":
    typer.run(main)
