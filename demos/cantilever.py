# SPDX-License-Identifier: MIT

# # Cantilever that keeps its energy
#
# A beam is bent down by a force at its end, let go, and swings. Nothing damps it, so its energy
# must stay the same in every step, however long the step is. Most implicit schemes cannot do that
# in large deformation. The energy-momentum method can, to round-off, with steps 15 times as long as
# explicit ones.
#
# The problem is section 7.1, analysis A, of G. Pretti, W. M. Coombs, C. E. Augarde, B. Sims, M.
# Marchena Puigvert and J. A. Reyna Gutiérrez, *A conservation law consistent updated Lagrangian
# material point method for dynamic analysis* (2023), with fewer points.
#
# ## Formulation
#
# The mid-point rule (equations 22 to 24 of the paper) conserves energy if the stress is chosen for
# it (O. Gonzalez, CMAME 190, 2000). With $\mathbf C = \mathbf F^\mathsf T\mathbf F$ and the energy
# $\psi$ of the law, and with indices $n$, $n+1$ and $m$ for the ends and the middle of a step, the
# equations per initial volume are, for all $\mathbf w$,
#
# $$
# (\mathbf F_m \mathbf S, \operatorname{Grad}\mathbf w)
# + (\rho\,\mathbf a - \mathbf f, \mathbf w) = 0
# $$
#
# (equation 39) with the algorithmic stress (equation 47)
#
# $$
# \mathbf S = \mathbf S_a
# + \frac{2\,\Delta\psi - \mathbf S_a : \Delta\mathbf C}{|\Delta\mathbf C|^2}\,\Delta\mathbf C,
# \qquad \mathbf S_a = \tfrac 1 2 (\mathbf S_n + \mathbf S_{n+1}) .
# $$
#
# Multiply by $\Delta\mathbf C / 2$: the work of $\mathbf S$ is exactly the energy $\Delta\psi$ that
# the step gains, for any law. Here it is Hencky's, which is evaluated at points. Velocities are
# mapped to the grid by the consistent mass and come back by FLIP, so that the points gain what the
# grid gains.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import Hencky
from fenicsmpm.solvers import CourantStep

# -

LENGTH, HEIGHT, AXIS = 10.0, 1.0, 10.0  # m
H, PER_SIDE = 0.5, 4  # size of cells in m; points along a side, 12 in the paper
DENSITY, LAW = 7750e3, Hencky(E=1e9, nu=0.2)  # kg/m^3, Pa
FORCE, RELEASE, END = 500e3, 25.0, 150.0  # N, s, s
COURANT = 15.0  # steps, in units of those of explicit dynamics

# ## Body and load
#
# Each point acts on the grid through the box around it (uGIMP). The force acts on the two points at
# the end that are next to the axis; their tag is 1. It grows until it is released.

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
body["tag"] = (body.x[:, 0] > LENGTH - spacing) & (np.abs(body.x[:, 1] - AXIS) < spacing)
force = fem.Constant(domain, np.zeros(2))


def load(start, end):
    middle = (start + end) / 2
    force.value[1] = -FORCE * middle / RELEASE if middle < RELEASE else 0.0


# ## Weak form
#
# `body.dx(1)` sums over the points with tag 1. Divided by the weight of a point, the integral is a
# sum of forces.

z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Midpoint(z, dt=CourantStep({body: LAW}, factor=COURANT)())
R = formulations.EnergyMomentum(LAW, body, z).power() + scheme.inertia(body)
R -= ufl.inner(force / 2, z.test.u) / body.field("weight") * body.dx(1)

# ## Time steps
#
# Energy is kept as well as Newton's method converges, hence the tight tolerance.

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

# ## Results
#
# At the release, the stress is that of bending:

io.picture("output/cantilever.png", clouds, "S", "axial stress [Pa]", component=0)

# After the release, the sum of both energies is a straight line.

t, kinetic, strain = (energies[title] for title in energies.titles)
free = t >= RELEASE
total = kinetic + strain
drift = np.abs(total[free] / total[free][0] - 1).max()
io.say(f"{total[-1] / 1e3:.4g} kJ, which change by {drift:.1e} of it in {free.sum()} steps")
curves = {"kinetic": (t, kinetic / 1e3), "strain": (t, strain / 1e3), "sum": (t, total / 1e3)}
io.plot("output/cantilever_energies.png", curves, "t [s]", "energy [kJ]")

# `studies/conserving.py` has the paper's number of points, and shows what other methods do to the
# energy.

assert total[-1] > 1e5  # J
assert drift < 1e-10  # conservation of energy
