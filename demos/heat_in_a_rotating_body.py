# SPDX-License-Identifier: MIT

# # Heat in a rotating body
#
# The implicit time loop takes any residual in UFL, and points may carry more than a displacement.
# Here they carry a temperature. A hot square turns in a background mesh that stays, and conducts
# heat. The second field takes a few lines. Neither the rotation nor the crossing of cells smears
# it.
#
# ## Problem
#
# The unknown has the displacement increment $\mathbf u$, which moves the points, and the
# temperature $T$. With the heat capacity $c$, the density $\rho$ at the beginning of the step, and
# the ratio of volumes $j = \det\mathbf f$ in the step, for all $S$,
#
# $$
# \left(c\,\rho\,\frac{T - T_\mathrm{old}}{\Delta t}, S\right)
# + (k\,j\,\nabla T, \nabla S) = 0,
# $$
#
# where $\nabla$ is the gradient in the body as it is at the end of the step. The square of side 2
# is insulated, so heat is kept to round-off. The mode $\sin(\pi X / 2)$ of initial positions $X$
# decays at the rate $k\pi^2/(4 c\rho)$, whatever the square does meanwhile.

# +
from math import cos, exp, pi, sin

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points

# -

CELLS, PER_CELL = 48, 3  # along a side of the mesh; points along a side of a cell
CAPACITY, DENSITY, CONDUCTIVITY = 2.0, 3.0, 1.0  # J/(kg K), kg/m^2, W/K
DT, END, TURNS = 0.01, 1.0, 0.25  # s, s, 1/s
FLIP = 1.0  # 1: points take the change of T; 0: its value, and the mode decays twice as fast

# ## Body
#
# The field `mode` stays with the points, also when they change ranks. At the end it tells the
# amplitude that is left.

domain = mesh.create_rectangle(MPI.COMM_WORLD, [(-2, -2), (2, 2)], [CELLS, CELLS])
body = points.lattice(domain, 4 / CELLS / PER_CELL, inside=lambda x: np.all(np.abs(x) < 1, axis=0))
mode = np.sin(pi / 2 * body.x[:, 0])
body.add_field("mode", (), mode)
body.add_field("T", (), 1 + mode)
formulations.set_initial_state(body, DENSITY)

# ## Weak form
#
# `Part("T")` is a history. At the beginning of a step it is mapped from the points to the grid,
# where it is `z.old.T`. At the end, the points get the change on the grid (`flip=1`), so that
# nothing is smeared. The motion is prescribed at all nodes. It depends on where the body is, and so
# it is given for the beginning and the end of a step.


def turned(x, start, end):
    c, s = cos(2 * pi * TURNS * (end - start)), sin(2 * pi * TURNS * (end - start))
    return np.array([(c - 1) * x[0] - s * x[1], s * x[0] + (c - 1) * x[1]])


z = formulations.Unknown(domain, "u", formulations.Part("T", flip=FLIP))
z.fix("u", lambda x: np.full(x.shape[1], True), turned)
scheme = formulations.QuasiStatic(z, dt=DT)
k = formulations.Kinematics(z.u, body)
stored = CAPACITY * formulations.density(body) * scheme.rate("T")
conducted = CONDUCTIVITY * k.j * ufl.inner(k.grad(z.T), k.grad(z.test.T))
sim = ImplicitMPM((stored * z.test.T + conducted) * body.dx, z, scheme, body)

# ## Time steps


def total(values):
    """Sum over all points, weighted by their heat capacity."""
    return domain.comm.allreduce(float(CAPACITY * body["mass"] @ values))


heat, clouds = [total(body["T"])], {"t = 0": io.gather_points(body)}
for step in io.watch(sim.run(END), END, "heat"):
    heat.append(total(body["T"]))
    if step.number in (round(END / DT) // 2, round(END / DT)):
        clouds[f"t = {step.time:.3g} s"] = io.gather_points(body)

# ## Results

io.picture("output/heat_in_a_rotating_body.png", clouds, "T", "temperature [K]")

# The amplitude is the one of separation of variables, and no heat is lost.

amplitude = total(body["T"] * body["mode"]) / total(body["mode"] ** 2)
rate = CONDUCTIVITY * pi**2 / (4 * CAPACITY * DENSITY)
change = np.ptp(heat) / heat[0]
io.say(f"amplitude {amplitude:.4f}, exact {exp(-rate * END):.4f}; heat changes by {change:.1e}")

assert change < 1e-12  # the square is insulated
assert abs(-np.log(amplitude) / (rate * END) - 1) < 0.01  # separation of variables
