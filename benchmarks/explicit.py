# SPDX-License-Identifier: MIT
"""Speed of explicit steps: million particle-steps per second on ranks and threads, and memory.

A block of neo-Hookean material, with 2 points per direction in a cell, quadratic B-splines and
F-bar, lies in the middle of a lattice. The lattice is little larger than the block, or several
times its side. Each case is a process of its own, or one per rank, bound to a core; ``Rebalanced``
distributes the points. Memory is the peak during the timed steps, above that of dolfinx' mesh and
function space, without compiled code. "each step" is the time of a step if every step is yielded,
over that of a step in a block.
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import time
from pathlib import Path

STAGES = ("P2G", "forces", "grid", "G2P", "stress and P2G", "begin", "convect")


def lattice(dim, n, room):
    """Return a lattice around a block of n cells per direction, with one corner at 0."""
    from mpi4py import MPI

    import numpy as np
    from dolfinx import mesh

    around = (round((room - 1) * n) + 4) // 2
    corners, shape = [np.full(dim, -around), np.full(dim, n + around)], [n + 2 * around] * dim
    if dim == 2:
        return mesh.create_rectangle(MPI.COMM_WORLD, corners, shape, mesh.CellType.quadrilateral)
    return mesh.create_box(MPI.COMM_WORLD, corners, shape, mesh.CellType.hexahedron)


def simulation(domain, n, functions, way):
    """Return a slightly sheared block, by kernels or by forms, with steps of equal length."""
    import numpy as np

    from fenicsmpm import ExplicitMPM, basis, formulations, points
    from fenicsmpm.materials import NeoHookean

    dim = domain.geometry.dim
    z = formulations.Unknown(domain, "v")
    body = points.lattice(
        domain, 0.5, inside=lambda x: np.all((x[:dim] > 0) & (x[:dim] < n), axis=0)
    )
    if functions != "linear":
        basis.use(body, functions)
    # edges move by less than a cell in all timed steps
    shear = 0.05 / n * (np.ones((dim, dim)) - np.eye(dim))
    formulations.set_initial_state(body, 1.0)
    body["v"] = (body.x - n / 2) @ shear  # explicit steps need no gradient of these
    law = NeoHookean(E=100.0, nu=0.3).pointwise()
    R = formulations.internal_force(z.test.v, body, law, fbar=formulations.FBar())
    # points that may leave the mesh are treated by forms
    on_exit = "error" if way == "kernels" else "clamp"
    return ExplicitMPM(R, z, body, on_exit=on_exit, dt=0.4 / law.wave_speed_modulus**0.5)


def measure(dim, count, room, repeats, functions, way):
    """Measure one case on all ranks."""
    from mpi4py import MPI

    import numpy as np
    from dolfinx import fem

    from fenicsmpm.simulation import Rebalanced

    steps, comm = 100 if way == "kernels" else 5, MPI.COMM_WORLD
    n = round((count / 2**dim) ** (1 / dim))

    def run(spread, singly=False):
        """Return seconds per step, with steps yielded together or one by one."""
        comm.barrier()
        start, number = time.perf_counter(), spread.sim.number
        until = spread.sim.time + steps * spread.sim.dt
        for _ in spread.run(until, interval=None if singly else until - spread.sim.time):
            pass
        comm.barrier()
        return (time.perf_counter() - start) / (spread.sim.number - number)

    small = simulation(lattice(dim, 8, 1.0), 8, functions, way)  # compiles
    for _ in small.run(steps * small.dt):
        pass
    domain = lattice(dim, n, room)
    space = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    memory = _memory("VmRSS")
    del space
    spread = Rebalanced(lambda domain: simulation(domain, n, functions, way), domain, most=1.1)
    del domain
    run(spread)
    sim = spread.sim
    sim.seconds.clear()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # reset the peak of memory
    blocks = [run(spread) for _ in range(repeats)]
    used = comm.allreduce(_memory("VmHWM") - memory)
    shares = dict(sim.seconds)
    singly = [run(spread, singly=True) for _ in range(repeats)]
    if comm.rank == 0:
        total, count = sum(shares.values()), sim.bodies[0].size_global
        result = {
            "points": count,
            "rate": count / float(np.median(blocks)) / 1e6,
            "bytes": used / count,
            "each": float(np.median(singly) / np.median(blocks)),
            "shares": {name: value / total for name, value in shares.items()},
        }
        print(json.dumps(result))


def _memory(name):
    """Return the memory of this process in bytes: "VmRSS" at present, "VmHWM" at its peak."""
    ctypes.CDLL(None).malloc_trim(0)
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    raise RuntimeError(f"no {name} in /proc/self/status")


def case(dim, count, room, ranks, threads, options):
    """Run a case as a process of its own and return its result."""
    arguments = [dim, int(count), room, options.repeats, options.functions, options.way]
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
    add("--rooms", type=float, nargs="+", default=[1, 5], help="lattice's side over the block's")
    add("--functions", default="quadratic", help="(default: %(default)s)")
    add("--way", choices=["kernels", "forms"], default="kernels", help="(default: %(default)s)")
    add("--repeats", type=int, default=3, help="number of blocks of steps for the median")
    add("--measure", nargs=6, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        dim, count, room, repeats, *names = options.measure
        measure(int(dim), float(count), float(room), int(repeats), *names)
        return
    import machine

    print(machine.describe())
    print(
        f"{'':3}{'points':>9}{'room':>6}{'ranks':>7}{'threads':>9}{'Mp steps/s':>12}"
        f"{'bytes/point':>13}{'each step':>11}" + "".join(f"{stage:>16}" for stage in STAGES)
    )
    for dim in options.dimensions:
        for count in options.points:
            for room in options.rooms:
                if room > 1 and count > (2e5 if dim == 3 else 2e6):
                    continue  # the mesh alone would take most of the memory
                for ranks, threads in ((1, 1), (2, 1), (1, 2)):
                    found = case(dim, count, room, ranks, threads, options)
                    shares = "".join(f"{found['shares'].get(s, 0.0):16.1%}" for s in STAGES)
                    print(
                        f"{dim}D {found['points']:9d}{room:6g}{ranks:7d}{threads:9d}"
                        f"{found['rate']:12.2f}{found['bytes']:13.0f}{found['each']:11.2f}{shares}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
