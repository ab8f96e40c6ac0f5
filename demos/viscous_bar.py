# SPDX-License-Identifier: MIT
"""A viscous bar.

Explicit steps take any residual of rank 1. Here an elastic bar gets a term of one's own in UFL, a
viscous stress that is proportional to the gradient of velocity, and swings until it has lost most
of its energy. The same lines run on a lattice with B-splines, where internal forces go by fused
kernels, and on triangles, where all goes by forms.

The bar of length L is held at its left end and moves along itself, with nu = 0. With the viscous
stress eta grad v its first mode a sin(k x), k = pi / (2 L), obeys

    rho a'' + eta k^2 a' + E k^2 a = 0,

so that its amplitude falls as exp(-delta t) with delta = eta k^2 / (2 rho) while it swings with
omega^2 = E k^2 / rho - delta^2, and the energy as the square of that.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import Hencky

L, E, RHO, ETA = 1.0, 100.0, 1.0, 0.1  # m, Pa, kg/m^2, Pa s
H, PERIODS = 0.025, 8  # size of cells in m
SPEED = 0.01  # of the right end at the start, m/s
LAW = Hencky(E, nu=0.0)
KINDS = {"quadratic": mesh.CellType.quadrilateral, "linear": mesh.CellType.triangle}
K = np.pi / (2 * L)
DELTA = ETA * K**2 / (2 * RHO)
END = PERIODS * 2 * np.pi / np.sqrt(E * K**2 / RHO - DELTA**2)  # s


def velocity(x):
    return np.array([SPEED * np.sin(K * x[0]), 0 * x[0]])


def energy(sim):
    (body,) = sim.bodies
    return (kinetic_energy(body) + strain_energy(body, LAW)) / (0.25 * RHO * SPEED**2 * L * 3 * H)


curves, deviations = {}, []
for functions, cells in KINDS.items():
    n = round(1.2 * L / H)
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (n * H, 3 * H)], [n, 3], cells)
    body = points.lattice(domain, H / 2, inside=lambda x: x[0] < L)
    if functions == "quadratic":
        basis.use(body, functions)
    formulations.set_initial_state(body, RHO, velocity)

    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 3 * H), component=1)
    R = formulations.internal_force(z.test.v, body, LAW)
    R += ETA * ufl.inner(ufl.grad(z.v), ufl.grad(z.test.v)) * body.dx  # the term of one's own
    history = io.History({"energy / energy at the start": energy})
    sim = ExplicitMPM(R, z, body, observers=[history])
    for _ in io.watch(sim.run(END), END, functions):
        pass

    curves[f"{functions} functions"] = history
    left, exact = history["energy / energy at the start"][-1], np.exp(-2 * DELTA * END)
    deviations.append(abs(left / exact - 1))
    io.say(f"{functions} functions: share of the energy that is left {left:.4f}, exact {exact:.4f}")

t = np.linspace(0, END, 200)
reference = {"exp(-2 delta t)": (t, np.exp(-2 * DELTA * t))}
io.plot("output/viscous_bar.png", curves, reference=reference)

assert max(deviations) < 0.01  # the damped oscillator
