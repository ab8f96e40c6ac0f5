# SPDX-License-Identifier: MIT
#
# # A viscous bar
#
# Explicit steps take any residual of rank 1. Here an elastic bar gets a term of one's own in UFL, a
# viscous stress that is proportional to the gradient of velocity, and swings until it has lost most
# of its energy. The demo shows how
#
# - the residual of an explicit simulation is written down: internal forces and whatever else acts,
# - the same lines run on a lattice with B-splines, whose internal forces go by fused kernels, and
#   on triangles, where all goes by forms.
#
# ## Formulation
#
# The bar of length $L$ is held at its left end and moves along itself, $\nu = 0$. With the viscous
# stress $\eta \nabla v$ its first mode $\sin k x$, $k = \pi / 2 L$, obeys
#
# $$
# \rho \ddot a + \eta k^2 \dot a + E k^2 a = 0,
# $$
#
# so that its amplitude falls as $e^{-\delta t}$ with $\delta = \eta k^2 / 2 \rho$ while it swings
# with $\omega^2 = E k^2 / \rho - \delta^2$, and the energy as the square of that.
#
# ## Implementation

import argparse
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import Hencky

L, E, RHO, ETA = 1.0, 100.0, 1.0, 0.1  # m, Pa, kg/m^2, Pa s
SPEED = 0.01  # of the right end at the start, m/s
K = np.pi / (2 * L)
DELTA = ETA * K**2 / (2 * RHO)
OMEGA = np.sqrt(E * K**2 / RHO - DELTA**2)


def build(cells, h):
    n = round(1.2 * L / h)
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (n * h, 3 * h)], [n, 3], cells)
    body = points.lattice(domain, h / 2, inside=lambda x: x[:, 0] < L)
    if cells == mesh.CellType.quadrilateral:
        basis.use(body, "quadratic")

    def velocity(x):
        return np.column_stack([SPEED * np.sin(K * x[:, 0]), 0 * x[:, 0]])

    formulations.set_initial_state(body, RHO, velocity)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    v, w = fem.Function(V), ufl.TestFunction(V)
    law = Hencky(E, nu=0.0)
    R = formulations.internal_force(w, body, law)
    R += ETA * ufl.inner(ufl.grad(v), ufl.grad(w)) * body.dx  # the term of one's own

    left = formulations.roller(V, 0, lambda x: np.isclose(x[0], 0))
    sides = formulations.roller(V, 1, lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 3 * h))
    return ExplicitMPM(R, v, body, bcs=[left, sides])


def swing(cells, h, periods=8):
    """Time [s] and share of the energy that is left."""
    sim = build(cells, h)
    io.say(f"{sim}")
    body, law = sim.bodies[0], sim.laws[sim.bodies[0]]
    history = []
    until = periods * 2 * np.pi / OMEGA
    for step in io.watch(sim.run(until), until, cells.name):
        history.append((step.time, kinetic_energy(body) + strain_energy(body, law)))
    t, energy = np.array(history).T
    return t, energy / (0.25 * RHO * SPEED**2 * L * 3 * h)


def main(arguments=None):
    parser = argparse.ArgumentParser(description="An elastic bar with a viscous term in UFL")
    add = parser.add_argument
    add("--short", action="store_true", help="coarse cells, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    h = 0.05 if options.short else 0.025
    kinds = {"B-splines on a lattice": mesh.CellType.quadrilateral}
    kinds["linear functions on triangles"] = mesh.CellType.triangle
    rows = io.Table({"functions": "s", "energy left": ".4f", "exact": ".4f", "deviation": "+.1%"})
    curves, found = {}, {}
    for name, cells in kinds.items():
        curves[name] = t, energy = swing(cells, h)
        found[name] = energy[-1], np.exp(-2 * DELTA * t[-1])
        rows.row(name, *found[name], energy[-1] / found[name][1] - 1)
    curves["exp(-2 delta t)"] = t, np.exp(-2 * DELTA * t)
    io.plot(options.output / "viscous_bar.png", curves, "t [s]", "energy / energy at the start")
    io.say(f"viscous_bar.png is in {options.output}")
    for left, exact in found.values():
        assert abs(left / exact - 1) < 0.01
    return found


if __name__ == "__main__":
    main()
