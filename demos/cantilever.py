# SPDX-License-Identifier: MIT
"""A cantilever that swings and keeps its energy.

A beam is bent down by a force at its end, let go, and swings. Nothing damps it, so energy must stay
what it is in every step, however long: section 7.1 of G. Pretti et al., "A conservation law
consistent updated Lagrangian material point method for dynamic analysis", analysis A.

The mid-point rule does so if the stress is the algorithmic one (O. Gonzalez, CMAME 190, 2000). With
C = F^T F and the energy psi of the law, and with n and n+1 for the ends of a step and m for its
middle, the equations of a step are, for all w and per initial volume,

    (F_m S, Grad w) + (rho a - f, w) = 0,
    S = S_a + (2 Delta psi - S_a : Delta C) / |Delta C|^2 Delta C,     S_a = (S_n + S_n+1) / 2,

so that S : Delta C / 2 is exactly the energy that the step gains, for any law: here it is Hencky's,
a law at points. Velocities are mapped to the grid by the consistent mass and come back by FLIP, so
that the points gain what the grid gains.

studies/conserving.py has the paper's number of points, and what other methods do to the energy.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import Hencky
from fenicsmpm.solvers import CourantStep

LENGTH, HEIGHT, AXIS = 10.0, 1.0, 10.0  # m
H, PER_SIDE = 0.5, 4  # size of cells in m; points along a side, 12 in the paper
DENSITY, LAW = 7750e3, Hencky(E=1e9, nu=0.2)  # kg/m^3, Pa
FORCE, RELEASE, END = 500e3, 25.0, 150.0  # N, s, s
COURANT = 15.0  # steps, in units of those of explicit dynamics

domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (11, 20)], [round(11 / H), round(20 / H)],
    mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
spacing = H / PER_SIDE
body = points.lattice(
    domain, spacing, inside=lambda x: (x[0] < LENGTH) & (np.abs(x[1] - AXIS) < HEIGHT / 2)
)
basis.use(body, "gimp", spacing / 2)
formulations.set_initial_state(body, DENSITY)
# the force acts on the two points at the end that are next to the axis
body["tag"] = (body.x[:, 0] > LENGTH - spacing) & (np.abs(body.x[:, 1] - AXIS) < spacing)
force = fem.Constant(domain, np.zeros(2))


def load(start, end):
    middle = (start + end) / 2
    force.value[1] = -FORCE * middle / RELEASE if middle < RELEASE else 0.0


z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Midpoint(z, dt=CourantStep({body: LAW}, factor=COURANT)())
R = formulations.EnergyMomentum(LAW, body, z).power() + scheme.inertia(body)
R -= ufl.inner(force / 2, z.test.u) / body.field("weight") * body.dx(1)
energies = io.History(
    {"kinetic": lambda sim: kinetic_energy(body), "strain": lambda sim: strain_energy(body, LAW)}
)
tying = Tying(z.space, body, ActiveCells(body))
newton = {"rtol": 1e-11, "tying": tying}
sim = ImplicitMPM(R, z, scheme, body, data=load, observers=[energies], newton=newton)

clouds = {"t = 0": io.gather_points(body)}
for step in io.watch(sim.run(END), END, "cantilever"):
    if step.time - step.dt < RELEASE <= step.time or sim.time >= END:
        clouds[f"t = {step.time:.3g} s"] = io.gather_points(body)

t, kinetic, strain = (energies[title] for title in energies.titles)
free = t >= RELEASE
total = kinetic + strain
drift = np.abs(total[free] / total[free][0] - 1).max()
io.say(f"{total[-1] / 1e3:.4g} kJ, which change by {drift:.1e} of it in {free.sum()} steps")
curves = {"kinetic": (t, kinetic / 1e3), "strain": (t, strain / 1e3), "sum": (t, total / 1e3)}
io.plot("output/cantilever_energies.png", curves, "t [s]", "energy [kJ]")
io.picture("output/cantilever.png", clouds, "S", "axial stress [Pa]", component=0)

assert total[-1] > 1e5  # J
assert drift < 1e-10  # conservation of energy
