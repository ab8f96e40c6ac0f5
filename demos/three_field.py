# SPDX-License-Identifier: MIT

# # Your own three-field element
#
# An element is what you write down. Here it is the one of J. C. Simo, R. L. Taylor and K. S. Pister
# (CMAME 51, 1985) for nearly incompressible bodies, with displacement, pressure and volumetric
# strain as unknowns, in a time step that conserves energy. Nothing of it is in the package. A
# rubber beam is held at a wall and let go, and falls under its weight by more than its height. Its
# energies must sum up to zero, and they do, to round-off.
#
# ## Formulation
#
# Displacements are bilinear. The pressure $p$, positive in tension, and the volumetric strain
# $\theta$, which is $J - 1$ on average over a cell, are constant in each cell of the background
# mesh. With the energy per initial volume in the plane
#
# $$
# \psi = \frac\mu 2 (\mathbf F : \mathbf F - 3) - \mu\,\theta + \frac\kappa 2 \theta^2
# $$
#
# and the mid-point rule, the equations of a step are, for all $\mathbf w$, $q$ and $s$ and per
# initial volume,
#
# $$
# \begin{aligned}
# (\mu\,\mathbf F_m + p \operatorname{cof}\mathbf F_m, \operatorname{Grad}\mathbf w)
# + (\rho\,\mathbf a - \rho\,\mathbf g, \mathbf w) &= 0, \\
# (\Delta J - \Delta\theta, q) &= 0, \\
# (\kappa\,\theta_m - \mu - p, s) &= 0,
# \end{aligned}
# $$
#
# where the index $m$ stands for the mean of both ends of the step.
#
# Each term of $\psi$ is quadratic. Its change is exactly the stress in the middle times the strain
# of the step. The same holds for $\Delta J = \operatorname{cof}\mathbf F_m : \Delta\mathbf F$ in
# two dimensions. Take $\mathbf w = \Delta\mathbf u$, $q = p$ and $s = \Delta\theta$: what kinetic
# energy and $\psi$ gain in a step is the work of the weight. Mapping by the consistent mass, to the
# grid and back by FLIP, keeps it.

# +
from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy

# -

H, PER_SIDE = 0.2, 3  # size of cells in m; points along a side
DENSITY, GRAVITY = 1000.0, 9.81  # kg/m^2, m/s^2
E, NU = 4e6, 0.49  # Pa
DT, END, TIMES = 0.02, 2.0, (0.24, 0.5)  # s; of pictures
MU = E / (2 * (1 + NU))
KAPPA = E * NU / ((1 + NU) * (1 - 2 * NU)) + MU  # of the plane

# ## Element
#
# The space is made with basix, as in dolfinx.

domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, -4), (5, 2)], [round(5 / H), round(6 / H)], mesh.CellType.quadrilateral
)
cell = domain.basix_cell()
constant = basix.ufl.element("DG", cell, 0)
linear = basix.ufl.element("Lagrange", cell, 1, shape=(2,))
W = fem.functionspace(domain, basix.ufl.mixed_element([linear, constant, constant]))

# `Unknown` takes a function of this space and names its parts. The increment `u` moves the points.
# Parts with `role="grid"` stay on the grid. The points carry $\theta$ in a field that says itself
# how it is renewed after a step: by the increment on the grid.

body = points.lattice(domain, H / PER_SIDE, inside=lambda x: (x[0] < 4) & (np.abs(x[1]) < 0.5))
formulations.set_initial_state(body, DENSITY)
body.add_field("theta", ())
grid_only = [formulations.Part(name, role="grid") for name in ("p", "theta")]
z = formulations.Unknown(fem.Function(W), "u", *grid_only)
z.fix("u", lambda x: np.isclose(x[0], 0))
theta = body.field("theta")
theta.renew(theta + z.theta)
scheme = formulations.Midpoint(z, dt=DT)

# ## Weak form
#
# The equations from above, line by line. `body.dx` is over volumes at the beginning of the step,
# hence the divisions by $J_n$.

k, middle = formulations.Kinematics(z.u, body), formulations.Kinematics(z.u / 2, body)
weight = fem.Constant(domain, (0.0, -GRAVITY))
R = formulations.stress_power(MU * middle.F, z.test.u, body) + scheme.inertia(body)
R += z.p * ufl.inner(middle.cofactor(), ufl.grad(z.test.u)) * body.dx
R -= formulations.density(body) * ufl.inner(weight, z.test.u) * body.dx
R += (k.j - 1 - z.theta / k.J_n) * z.test.p * body.dx
R += (KAPPA * (theta + z.theta / 2) - MU - z.p) * z.test.theta / k.J_n * body.dx
sim = ImplicitMPM(R, z, scheme, body, newton={"rtol": 0.0})  # to round-off, of each part of z

# ## Time steps
#
# The energies are sums over points.

rows, clouds = [], {"t = 0": io.gather_points(body)}
for step in io.watch(sim.run(END), END, "three fields"):
    psi = MU / 2 * (np.sum(body["F"] ** 2, axis=(1, 2)) - 3)
    psi += (KAPPA / 2 * body["theta"] - MU) * body["theta"]
    sums = body["V_0"] @ psi, GRAVITY * body["mass"] @ body["u"][:, 1]
    rows.append((step.time, kinetic_energy(body), *domain.comm.allreduce(np.array(sums))))
    if any(abs(step.time - time) < DT / 2 for time in TIMES):
        clouds[f"t = {step.time:.2g} s"] = io.gather_points(body)

# ## Results

io.picture("output/three_field.png", clouds, "v", "speed [m/s]")

# The energies change by a lot, and their sum by nothing:

t, kinetic, strain, potential = np.array(rows).T
balance = kinetic + strain + potential
drift = np.abs(balance).max() / strain.max()
io.say(f"strain energy up to {strain.max():.4g} J, energies sum up to 0 within {drift:.1e} of it")
names = ["kinetic", "strain", "of the weight", "sum"]
curves = {n: (t, e) for n, e in zip(names, (kinetic, strain, potential, balance), strict=True)}
io.plot("output/three_field_energies.png", curves, "t [s]", "energy [J]")

assert drift < 1e-11  # conservation of energy: nothing dissipates
