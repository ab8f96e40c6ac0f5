# SPDX-License-Identifier: MIT
"""Speed of explicit steps: million particle-steps per second, and where the time goes.

A block of neo-Hookean material, 2 points a direction in a cell, quadratic B-splines, F-bar. The
memory bandwidth is that of copying an array, measured in the same run with as many threads; the
traffic of a step is counted from the arrays that its kernels read and write.
"""

import argparse
import time

from mpi4py import MPI

import machine
import numba
import numpy as np
from dolfinx import fem, mesh

from fenicsmpm import explicit, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation.explicit_on_lattice import STEPS_OF_A_BLOCK

LAW = NeoHookean(E=100.0, nu=0.3).pointwise()


def block(dim, count):
    """A simulation of about so many points."""
    n = round((count / 2**dim) ** (1 / dim))
    corners, cells = [np.full(dim, -2.0), np.full(dim, n + 2.0)], [n + 4] * dim
    if dim == 2:
        domain = mesh.create_rectangle(MPI.COMM_SELF, corners, cells, mesh.CellType.quadrilateral)
    else:
        domain = mesh.create_box(MPI.COMM_SELF, corners, cells, mesh.CellType.hexahedron)
    body = points.lattice(domain, 0.5, inside=lambda x: np.all((x > 0) & (x < n), axis=1))
    # edges move by less than a cell in all steps that are timed
    shear = 0.05 / n * (np.ones((dim, dim)) - np.eye(dim))
    explicit.set_initial_state(body, LAW, 1.0, lambda x: (x - n / 2) @ shear)
    V = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    return explicit.ExplicitMPM(V, {body: LAW})


def traffic(dim):
    """Bytes that a point's arrays cost in a step; what is written is read before."""
    vector, tensor = 8 * dim, 8 * dim**2
    gather = vector + 2 * vector + 2 * vector + 2 * tensor + 16  # x, x_next, v, F, J_bar, V_0
    finish = 3 * vector + tensor + 2 * 8 + 16  # x, x_next, v, F, J_bar, mass, V_0
    return gather + finish


@numba.njit(parallel=True)
def _copy(a, b):
    for i in numba.prange(len(a)):
        b[i] = a[i]


def bandwidth():
    """Bytes per second of copying a large array, reads and writes."""
    a, b = np.ones(20_000_000), np.zeros(20_000_000)
    _copy(a, b)
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        _copy(a, b)
        seconds.append(time.perf_counter() - start)
    return 2 * a.nbytes / min(seconds)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--points", type=float, nargs="+", default=[1e4, 1e5, 1e6], help="(default: %(default)s)")
    add("--threads", type=int, nargs="+", default=[1, 2], help="(default: %(default)s)")
    add("--repeats", type=int, default=5, help="blocks of steps, of which the median is taken")
    options = parser.parse_args()
    print(machine.describe())
    stages = ("gather", "finish", "nodes", "begin", "settle")
    print(
        f"{'':3}{'points':>9}{'threads':>9}{'Mp steps/s':>12}{'bandwidth':>11}"
        + "".join(f"{stage:>9}" for stage in stages)
    )
    for dim in (2, 3):
        for count in options.points:
            for threads in options.threads:
                numba.set_num_threads(threads)
                sim = block(dim, count)
                n = len(sim.bodies[0])
                # as many blocks as take a second or so
                block_steps = STEPS_OF_A_BLOCK
                sim.run(sim.time + block_steps * sim.dt, block_steps * sim.dt).__next__()
                seconds, shares = [], []
                for _ in range(options.repeats):
                    before = dict(sim.seconds)
                    start, number = time.perf_counter(), sim.number
                    for _ in sim.run(sim.time + block_steps * sim.dt, block_steps * sim.dt):
                        pass
                    seconds.append((time.perf_counter() - start) / (sim.number - number))
                    shares.append([sim.seconds[s] - before.get(s, 0.0) for s in stages])
                step = float(np.median(seconds))
                share = np.median(shares, axis=0)
                used = traffic(dim) * n / step / bandwidth()
                print(
                    f"{dim}D {n:9d}{threads:9d}{n / step / 1e6:12.2f}{used:11.0%}"
                    + "".join(f"{s:9.1%}" for s in share / share.sum())
                )


if __name__ == "__main__":
    main()
