# SPDX-License-Identifier: MIT
"""Two plastic cylinders collide: momenta are kept, and no energy gets lost.

Two cylinders meet off their centres, are pressed together, turn and fly apart. They share the
background mesh and its velocities, which is all the contact there is; one set of points is enough
for both. It is section 7.3 of G. Pretti et al., "A conservation law consistent updated Lagrangian
material point method for dynamic analysis", analysis A with its coarse cells.

The formulation is that of cantilever.py, now with von Mises plasticity. The algorithmic stress then
does the work of the free energy psi and of what is dissipated, D,

    S : Delta C / 2 = Delta psi + Delta D,

so that kinetic energy, free energy and the sum of D keep their sum, and D never decreases. Linear
momentum is kept by any method, angular momentum by the consistent mass. The paper bounds the norm
of the deviatoric stress by 10 Pa (equation 62), hence the root of 3/2 in the yield stress.

Steps follow the condition of Courant, Friedrichs and Lewy on the grid. The paper takes five times
that step, found with the sum of the points' moduli at a node instead of their mean, hence the
number of points in COURANT. studies/conserving.py compares methods, and has the fine mesh.
"""

from math import sqrt

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import VonMises
from fenicsmpm.solvers import CourantStep

LEFT, RIGHT, RADIUS = (5.8, 5.5), (14.2, 6.5), 2.0  # m
SPEED, DENSITY = 0.75, 5.0  # m/s towards each other, kg/m^3
LAW = VonMises(E=100.0, nu=0.3, sigma_y=sqrt(3 / 2) * 10.0)  # Pa
H, PER_SIDE = 2.0, 35  # size of cells in m, points along a side
COURANT, END = 5 / 35, 8.0  # s
SHOWN = 2.9, 4.4, 6.7  # s

domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (20, 12)], [round(20 / H), round(12 / H)], mesh.CellType.quadrilateral
)


def in_disc(x, centre):
    return np.hypot(x[0] - centre[0], x[1] - centre[1]) < RADIUS


body = points.lattice(domain, H / PER_SIDE, inside=lambda x: in_disc(x, LEFT) | in_disc(x, RIGHT))
formulations.set_initial_state(
    body, DENSITY, lambda x: np.outer((SPEED, 0), np.where(in_disc(x, LEFT), 1, -1))
)
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

t, dissipated, spin = (history[title] for title in ("t [s]", "dissipated", "angular momentum"))
energies = {title: history[title] for title in ("kinetic", "free", "dissipated")}
total = sum(energies.values())
drift, turned = np.ptp(total) / total[0], np.ptp(spin) / abs(spin[0])
pushed = history["momentum"].max() / (SPEED * domain.comm.allreduce(body["mass"].sum()) / 2)
io.say(f"{dissipated[-1] / total[0]:.1%} dissipated; the sum of energies changes by {drift:.1e}")
io.say(f"angular momentum changes by {turned:.1e}, momentum by {pushed:.1e}")
curves = {title: (t, values) for title, values in {**energies, "sum": total}.items()}
io.plot("output/cylinder_collision_energies.png", curves, "t [s]", "energy [J]")
io.picture("output/cylinder_collision.png", clouds, "dissipation", "dissipated [J/m^3]", cut=1)

assert np.all(np.diff(dissipated) > -1e-12) and dissipated[-1] > 0.5 * total[0]
assert drift < 1e-9 and turned < 1e-9  # conservation of energy and of angular momentum
assert pushed < 1e-12  # conservation of momentum
