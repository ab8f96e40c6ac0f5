# SPDX-License-Identifier: MIT
"""Speed of explicit steps: million particle-steps a second on ranks and threads, and memory.

A block of neo-Hookean material, 2 points a direction in a cell, quadratic B-splines, F-bar, in a
lattice that is little larger than it, or of several times its side. Each case is a process of its
own, or one for each rank, bound to a core; memory is what the process takes beyond dolfinx' mesh
and function space.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time

STAGES = ("P2G", "forces", "grid", "G2P", "stress and P2G", "begin", "convect")


def measure(dim, count, room, repeats, functions):
    """One case, on all ranks that this runs on."""
    from mpi4py import MPI

    import numpy as np
    import ufl
    from dolfinx import fem, mesh

    from fenicsmpm import ExplicitMPM, basis, formulations, points
    from fenicsmpm.materials import NeoHookean
    from fenicsmpm.simulation.explicit_on_lattice import STEPS_OF_A_BLOCK

    comm = MPI.COMM_WORLD
    n = round((count / 2**dim) ** (1 / dim))
    cells = round(room * n) + 4
    corners, shape = [np.full(dim, -2.0), np.full(dim, cells - 2.0)], [cells] * dim
    if dim == 2:
        domain = mesh.create_rectangle(comm, corners, shape, mesh.CellType.quadrilateral)
    else:
        domain = mesh.create_box(comm, corners, shape, mesh.CellType.hexahedron)
    V = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    v, w = fem.Function(V), ufl.TestFunction(V)
    memory = _memory()
    body = points.lattice(domain, 0.5, inside=lambda x: np.all((x > 0) & (x < n), axis=1))
    if functions != "linear":
        basis.use(body, functions)
    # edges move by less than a cell in all steps that are timed
    shear = 0.05 / n * (np.ones((dim, dim)) - np.eye(dim))
    formulations.set_initial_state(body, 1.0, lambda x: (x - n / 2) @ shear)
    law = NeoHookean(E=100.0, nu=0.3)
    R = formulations.internal_force(w, body, law, fbar=formulations.FBar())
    sim = ExplicitMPM(R, v, body)

    def block():
        for _ in sim.run(sim.time + STEPS_OF_A_BLOCK * sim.dt, STEPS_OF_A_BLOCK * sim.dt):
            pass

    block()
    seconds = []
    sim.seconds.clear()
    for _ in range(repeats):
        comm.barrier()
        start, number = time.perf_counter(), sim.number
        block()
        comm.barrier()
        seconds.append((time.perf_counter() - start) / (sim.number - number))
    used = comm.allreduce(_memory() - memory)
    if comm.rank == 0:
        total = sum(sim.seconds.values())
        result = {
            "points": body.size_global,
            "rate": body.size_global / float(np.median(seconds)) / 1e6,
            "bytes": used / body.size_global,
            "shares": {name: value / total for name, value in sim.seconds.items()},
        }
        print(json.dumps(result))


def _memory():
    """Largest memory of this process so far, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def case(dim, count, room, ranks, threads, repeats, functions):
    """Result of a case that runs by itself."""
    arguments = [dim, int(count), room, repeats, functions]
    command = [sys.executable, __file__, "--measure", *map(str, arguments)]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), "--bind-to", "core", *command]
    environment = {**os.environ, "NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--points", type=float, nargs="+", default=[1e4, 1e5, 1e6], help="(default: %(default)s)")
    add("--dimensions", type=int, nargs="+", default=[2, 3], help="(default: %(default)s)")
    add("--rooms", type=float, nargs="+", default=[1, 5], help="lattice's side by the block's")
    add("--functions", default="quadratic", help="(default: %(default)s)")
    add("--repeats", type=int, default=3, help="blocks of steps, of which the median is taken")
    add("--measure", nargs=5, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        dim, count, room, repeats, functions = options.measure
        measure(int(dim), float(count), float(room), int(repeats), functions)
        return
    import machine

    print(machine.describe())
    print(
        f"{'':3}{'points':>9}{'room':>6}{'ranks':>7}{'threads':>9}{'Mp steps/s':>12}"
        f"{'bytes/point':>13}" + "".join(f"{stage:>16}" for stage in STAGES)
    )
    for dim in options.dimensions:
        for count in options.points:
            for room in options.rooms:
                if room > 1 and count > (2e5 if dim == 3 else 2e6):
                    continue  # the mesh alone would take most of the memory
                for ranks, threads in ((1, 1), (2, 1), (1, 2)):
                    found = case(
                        dim, count, room, ranks, threads, options.repeats, options.functions
                    )
                    shares = "".join(f"{found['shares'].get(s, 0.0):16.1%}" for s in STAGES)
                    print(
                        f"{dim}D {found['points']:9d}{room:6g}{ranks:7d}{threads:9d}"
                        f"{found['rate']:12.2f}{found['bytes']:13.0f}{shares}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
