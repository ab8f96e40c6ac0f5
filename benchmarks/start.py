# SPDX-License-Identifier: MIT
"""Time from a script's first import to the end of its first step, at its first and second start.

At the first start nothing has been compiled on the machine: caches are new directories. Each start
is a process of its own. Elapsed times are those of the script alone, without the start of Python.
"imports" are those of dolfinx, numba and fenicsmpm. Processor times are given for the second start,
as they depend less on other processes; they include the start of Python.
"""

# ruff: noqa: E402
import time

begin = time.perf_counter()

import argparse
import os
import subprocess
import sys
import tempfile

from mpi4py import MPI

import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, points
from fenicsmpm.materials import (
    Hencky,
    Law,
    NeoHookean,
    NewtonianFluid,
    VonMises,
    compiled,
    from_energy,
)

imported = time.perf_counter()


@compiled
def own_update(F, L, parameters, state, sigma):
    for j in range(3):
        for k in range(3):
            sigma[j, k] = parameters[0] * (F[j, k] - (1.0 if j == k else 0.0))


def stored_energy(F, mu, kappa):
    J = ufl.det(F)
    return mu / 2 * (ufl.tr(F.T * F) - 3 - 2 * ufl.ln(J)) + kappa / 2 * ufl.ln(J) ** 2


LAWS = {
    "NeoHookean": lambda: NeoHookean(E=1e6, nu=0.3).pointwise(),
    "Hencky": lambda: Hencky(E=1e6, nu=0.3),
    "VonMises": lambda: VonMises(E=1e6, nu=0.3, sigma_y=1e4),
    "NewtonianFluid": lambda: NewtonianFluid(kappa=1e6, mu=1e-3),
    "from_energy": lambda: from_energy(stored_energy, [4e5, 1e6]),
    "own": lambda: Law(own_update, [1e6], 1e6),
}


def explicit_step(dim, name):
    cells = (mesh.CellType.quadrilateral, mesh.CellType.hexahedron)[dim - 2]
    create = (mesh.create_rectangle, mesh.create_box)[dim - 2]
    domain = create(MPI.COMM_WORLD, [(0,) * dim, (1,) * dim], [8] * dim, cells)
    body = points.lattice(domain, 1 / 16, inside=lambda x: x.max(axis=0) < 0.75)
    law = LAWS[name]()
    basis.use(body, "quadratic")
    formulations.set_initial_state(body, density=1000.0)
    z = formulations.Unknown(domain, "v")
    R = formulations.internal_force(z.test.v, body, law)
    ExplicitMPM(R, z, body).step()


def starts(dim, name):
    """Return times of the first and second start, of its imports, and of the processor [s]."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": f"{cache}/numba", "XDG_CACHE_HOME": cache}
        command = [sys.executable, __file__, "--start", str(dim), name]
        runs = [subprocess.check_output(command, env=environment, text=True) for _ in range(2)]
    first, second = ([float(number) for number in run.split()] for run in runs)
    return first[1], second[1], second[0], second[2]


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--start", nargs=2, metavar=("DIM", "LAW"), help="run a single start")
arguments = parser.parse_args()
if arguments.start:
    explicit_step(int(arguments.start[0]), arguments.start[1])
    print(imported - begin, time.perf_counter() - begin, time.process_time())
else:
    import machine

    print(machine.describe())
    print("seconds from the first import to the end of the first step of an explicit run")
    print(f"{'':19}{'first start':>12}{'second start':>14}{'of it imports':>15}{'processor':>11}")
    for dim in (2, 3):
        for name in LAWS:
            first, second, imports, processor = starts(dim, name)
            print(f"{dim}D {name:16}{first:12.1f}{second:14.2f}{imports:15.2f}{processor:11.2f}")
