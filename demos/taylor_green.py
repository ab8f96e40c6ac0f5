# SPDX-License-Identifier: MIT

# # Taylor-Green vortex
#
# A viscous fluid turns in a closed box, slips along its walls and comes to rest. It is one of the
# few flows whose velocity and pressure are known at any time, so it tells what a method really
# does: how much its own errors damp, on top of the viscosity. Here the material points move through
# several cells on the way, and the decay is right to a percent.
#
# ## Problem
#
# In the unit square, with $\nu = \mu/\rho$,
#
# $$
# \begin{aligned}
# \mathbf v &= e^{-2\nu\pi^2 t}
# \begin{pmatrix} \sin\pi x \cos\pi y \\ -\cos\pi x \sin\pi y \end{pmatrix}, \\
# p &= -\tfrac \rho 4\,e^{-4\nu\pi^2 t} (\cos 2\pi x + \cos 2\pi y) + p_0 ,
# \end{aligned}
# $$
#
# where $p$ is the mean stress, minus the usual pressure. The fluid is incompressible and Newtonian,
# as in the [dam break](dam_break_implicit.py). Its subgrid scales (ASGS) see the viscosity and the
# inertia of a step.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy

# -

CELLS, PER_SIDE = 12, 6  # squares along the box; points along the side of a triangle
DENSITY, VISCOSITY = 1.0, 0.1  # kg/m^2, Pa s
DT, END = 0.05 / CELLS, 0.5  # s


def exact(x, t):
    a, b = np.pi * x[:2]
    decay = np.exp(-2 * VISCOSITY / DENSITY * np.pi**2 * t)
    return decay * np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])


# ## Weak form
#
# A box full of fluid has no level of pressure. It is held at one node, half way up a side, where
# the exact one is what it is on average. Crossed triangles suit flows better than those with
# diagonals in one direction.

domain = mesh.create_unit_square(MPI.COMM_WORLD, CELLS, CELLS, diagonal=mesh.DiagonalType.crossed)
fluid = points.fill(domain, PER_SIDE)
formulations.set_initial_state(fluid, DENSITY, velocity=lambda x: exact(x, 0.0))
z = formulations.Unknown(domain, "u", "p")
for k in range(2):
    z.fix("u", lambda x, k=k: np.isclose(x[k], 0) | np.isclose(x[k], 1), component=k)
z.fix("p", lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0.5))
scheme = formulations.Newmark(z, dt=DT)
law = formulations.NewtonianFlow(VISCOSITY, DENSITY, scheme)
R = formulations.mixed(z, fluid, law) + scheme.lumped(fluid)
R += formulations.asgs(z, fluid, law, force=scheme.force(fluid))

# ## Time steps
#
# Velocities are continued linearly from the points to the nodes (`taylor=True`).

energy = io.History({"kinetic energy [J]": lambda sim: kinetic_energy(fluid)})
sim = ImplicitMPM(R, z, scheme, fluid, taylor=True, observers=[energy])
clouds = {"t = 0": io.gather_points(fluid)}
for step in io.watch(sim.run(END), END, "vortex"):
    pass
clouds[f"t = {END:g} s"] = io.gather_points(fluid)

# ## Results

io.picture("output/taylor_green.png", clouds, "v", "speed [m/s]")

# The velocity of the points is compared with the exact one at their places. Its projection on the
# exact one tells the rate of decay. Points that have left the places in which they were seeded
# integrate less well. So for second order their number in a cell has to grow on finer meshes:
# `studies/taylor_green.py` measures that.

v = exact(fluid.x.T, END).T
sums = [fluid.weight @ np.sum(a * b, axis=1) for a, b in ((fluid["v"], v), (v, v))]
sums += [fluid.weight @ np.sum((fluid["v"] - v) ** 2, axis=1)]
product, square, deviation = domain.comm.allreduce(np.array(sums))
error, decay = np.sqrt(deviation / square), 2 * VISCOSITY / DENSITY * np.pi**2
rate = decay - np.log(product / square) / END
way = domain.comm.allreduce(np.abs(fluid["u"]).max(initial=0.0), MPI.MAX)
io.say(f"decay at the rate {rate:.4f} 1/s, exact {decay:.4f}; error of the velocity {error:.2%}")
io.say(f"points have moved by up to {way * CELLS:.1f} cells")
t = energy["t [s]"]
reference = {"exact": (t, DENSITY / 4 * np.exp(-2 * decay * t))}
io.plot("output/taylor_green_energy.png", energy, reference=reference)

assert way > 1 / CELLS
assert abs(rate / decay - 1) < 0.01 and error < 0.02  # exact solution
