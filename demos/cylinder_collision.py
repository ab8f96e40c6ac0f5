# SPDX-License-Identifier: MIT

# # Colliding plastic cylinders
#
# Two cylinders meet off their centres, are pressed together, turn around each other and fly apart.
# More than half of the energy goes into plastic flow. Kinetic energy, free energy and dissipation
# together stay the same to round-off, and so do both momenta.
#
# The problem is section 7.3, analysis A, of G. Pretti, W. M. Coombs, C. E. Augarde, B. Sims, M.
# Marchena Puigvert and J. A. Reyna Gutiérrez, *A conservation law consistent updated Lagrangian
# material point method for dynamic analysis* (2023), with the paper's coarse cells.
#
# ## Formulation
#
# The formulation is that of the [cantilever](cantilever.py), now with von Mises plasticity. The
# algorithmic stress does the work of the free energy $\psi$ and of what is dissipated, $\mathcal D$
# (equations 47 and 52 of the paper):
#
# $$
# \tfrac 1 2\,\mathbf S : \Delta\mathbf C = \Delta\psi + \Delta\mathcal D,
# \qquad \Delta\mathcal D \ge 0 .
# $$
#
# Any method of this kind conserves linear momentum. Angular momentum needs the consistent mass. The
# paper bounds the norm of the deviatoric stress by 10 Pa (equation 62), hence the factor
# $\sqrt{3/2}$ in the yield stress.

# +
from math import sqrt

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import VonMises
from fenicsmpm.solvers import CourantStep

# -

LEFT, RIGHT, RADIUS = (5.8, 5.5), (14.2, 6.5), 2.0  # m
SPEED, DENSITY = 0.75, 5.0  # m/s towards each other, kg/m^3
LAW = VonMises(E=100.0, nu=0.3, sigma_y=sqrt(3 / 2) * 10.0)  # Pa
H, PER_SIDE = 2.0, 35  # size of cells in m, points along a side
COURANT, END = 5 / 35, 8.0  # s
SHOWN = 2.9, 4.4, 6.7  # s

# ## Bodies
#
# One set of points is enough for both cylinders. They share the background mesh and its velocities,
# and that is all the contact there is. ([Two discs](two_discs.py) shows contact that lets bodies
# slide and part.)


def in_disc(x, centre):
    return np.hypot(x[0] - centre[0], x[1] - centre[1]) < RADIUS


domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (20, 12)], [round(20 / H), round(12 / H)], mesh.CellType.quadrilateral
)
body = points.lattice(domain, H / PER_SIDE, inside=lambda x: in_disc(x, LEFT) | in_disc(x, RIGHT))
formulations.set_initial_state(
    body, DENSITY, lambda x: np.outer((SPEED, 0), np.where(in_disc(x, LEFT), 1, -1))
)

# ## Time steps
#
# The steps follow the condition of Courant, Friedrichs and Lewy, evaluated on the grid (equations
# 58 to 61). The paper takes five times that step, and it sums the moduli of the points at a node
# where `CourantStep` takes their mean. Hence the number of points in `COURANT`.

z = formulations.Unknown(domain, "u")
scheme = formulations.Midpoint(z, dt=1.0)
R = formulations.EnergyMomentum(LAW, body, z).power() + scheme.inertia(body)
history = io.History({
    "kinetic": lambda sim: kinetic_energy(body),
    "free": lambda sim: strain_energy(body, LAW),
    "dissipated": lambda sim: domain.comm.allreduce(body["V_0"] @ body["dissipation"]),
    "angular momentum": lambda sim: angular_momentum(body),
    "momentum": lambda sim: np.linalg.norm(momentum(body)),
})  # fmt: skip
sim = ImplicitMPM(R, z, scheme, body, observers=[history], newton={"rtol": 1e-11})
length = CourantStep({body: LAW}, COURANT)
clouds = {}
for step in io.watch(sim.run(END, step_length=length), END, "collision"):
    if any(step.time - step.dt < time <= step.time for time in SHOWN):
        clouds[f"t = {step.time:.3g} s"] = io.gather_points(body)

# ## Results
#
# The cylinders flow where they touch. The gap between them is about the cell through which they do
# so:

io.picture("output/cylinder_collision.png", clouds, "dissipation", "dissipated [J/m^3]", cut=1)

# The dissipation never decreases, and the sum is constant.

t, dissipated, spin = (history[title] for title in ("t [s]", "dissipated", "angular momentum"))
energies = {title: history[title] for title in ("kinetic", "free", "dissipated")}
total = sum(energies.values())
drift, turned = np.ptp(total) / total[0], np.ptp(spin) / abs(spin[0])
pushed = history["momentum"].max() / (SPEED * domain.comm.allreduce(body["mass"].sum()) / 2)
io.say(f"{dissipated[-1] / total[0]:.1%} dissipated; the sum of energies changes by {drift:.1e}")
io.say(f"angular momentum changes by {turned:.1e}, momentum by {pushed:.1e}")
curves = {title: (t, values) for title, values in {**energies, "sum": total}.items()}
io.plot("output/cylinder_collision_energies.png", curves, "t [s]", "energy [J]")

# `studies/conserving.py` compares methods and has the fine mesh.

assert np.all(np.diff(dissipated) > -1e-12) and dissipated[-1] > 0.5 * total[0]
assert drift < 1e-9 and turned < 1e-9  # conservation of energy and of angular momentum
assert pushed < 1e-12  # conservation of momentum
