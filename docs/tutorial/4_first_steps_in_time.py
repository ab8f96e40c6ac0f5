# SPDX-License-Identifier: MIT

# # 4. A time step by hand
#
# Every MPM code does the same four things in a time step.
#
# 1. *Points to grid:* the nodes get mass and momentum of the points.
# 2. *Grid:* the nodes get forces from the stresses at the points, and new velocities.
# 3. *Grid to points:* the points get new velocities and new deformations.
# 4. *Convection:* the points move, and the grid forgets everything.
#
# The package has loops for that. This page writes one by hand, in twenty lines, for the oldest
# test of all: a bar that is held at its left end and swings along its axis. The angular frequency
# of its first mode is $\omega = \frac{\pi}{2 L} \sqrt{E / \rho}$.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, io, points, transfer

L, N, E, RHO = 25.0, 28, 100.0, 1.0  # m, cells, Pa, kg/m^3
V0, DT = 0.1, 0.02  # m/s, s
domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (N, 1)], [N, 1], mesh.CellType.quadrilateral
)
body = points.fill(domain, per_side=2, inside=lambda x: x[0] < L)
body.add_field("mass", (), RHO * body["weight"])
body.add_field("stretch", (), 1.0)
body.add_field("u", ())
body.add_field("v", ())
body["v"] = V0 * np.sin(np.pi * body.x[:, 0] / (2 * L))
# -

# ## Grid
#
# The bar moves along $x$ only, and $\nu = 0$. Its Cauchy stress is $\sigma = E (\lambda - 1)$
# with the stretch $\lambda$ that each point carries. The force of node $I$ is the residual
#
# $$ f_I = - \int_\Omega \sigma \, \frac{\partial N_I}{\partial x} \,\mathrm d V
#        \approx - \sum_p V_p\, \sigma_p \, \frac{\partial N_I}{\partial x}(\mathbf x_p) ,$$
#
# which is a UFL form over the points. It is compiled once, before the loop, as are the
# expressions that go back.

# +
V = fem.functionspace(domain, ("Lagrange", 1))
w = ufl.TestFunction(V)
force_form = forms.form(-E * (body.field("stretch") - 1) * w.dx(0) * body.dx)
velocity, change = fem.Function(V), fem.Function(V)
new_v = forms.PointExpression(body.field("v") + change, body)
new_u = forms.PointExpression(body.field("u") + DT * velocity, body)
new_stretch = forms.PointExpression(body.field("stretch") * (1 + DT * velocity.dx(0)), body)
held = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
# -

# ## Loop
#
# The velocity of the points *changes by the change* of the grid velocity: this is FLIP, and it
# avoids the smoothing of step 1. The positions move with the grid velocity itself.
#
# A node just outside the bar may have hardly any mass. Its velocity then is a force divided by
# nearly nothing, and so is the gradient of the velocity in that cell. Therefore the new velocities
# of the points are mapped to the grid once more, which gives means of them, and the stretch
# follows from these (Sulsky, Zhou and Schreyer, 1995).

# +
t, history = [0.0], [body["v"].mean()]
initial, start = body["weight"].copy(), body.x.copy()


def nodal_velocity(momentum, mass):
    """Momentum over mass, and zero where there is no mass [m/s]."""
    result = np.divide(momentum, mass, out=np.zeros_like(mass), where=mass > 1e-9)
    result[held] = 0.0
    return result


while t[-1] < 40.0:
    mass = transfer.p2g(body, body["mass"], V).array  # 1. points to grid
    momentum = transfer.p2g(body, body["mass"] * body["v"], V).array
    force = forms.assemble_vector(force_form).array  # 2. grid
    velocity.x.array[:] = nodal_velocity(momentum + DT * force, mass)
    change.x.array[:] = velocity.x.array - nodal_velocity(momentum, mass)
    body["u"], body["v"] = new_u.evaluate(), new_v.evaluate()  # 3. grid to points
    momentum = transfer.p2g(body, body["mass"] * body["v"], V).array
    velocity.x.array[:] = nodal_velocity(momentum, mass)
    body["stretch"] = new_stretch.evaluate()
    body["weight"] = initial * body["stretch"]
    body.move(start + np.column_stack([body["u"], np.zeros(len(body))]))  # 4. convection
    t.append(t[-1] + DT)
    history.append(body["v"].mean())
# -

# ## Result
#
# The mean velocity of the bar is $\frac{2}{\pi} v_0 \cos \omega t$, if $v_0$ is small.

# +
t, history = np.array(t), np.array(history)
omega = np.pi / (2 * L) * np.sqrt(E / RHO)
exact = 2 / np.pi * V0 * np.cos(omega * t)
error = np.abs(history - exact).max() / (2 / np.pi * V0)
print(f"{len(t) - 1} steps, largest error {error:.1%} of the amplitude")
assert error < 0.02
curves, reference = {"material points": (t, history)}, {"exact": (t, exact)}
labels = "t [s]", "mean velocity [m/s]"
io.plot("output/4_first_steps_in_time.png", curves, *labels, reference=reference)
# -

# ## Your turn
#
# Take `V0, DT = 1.0, 0.02`, and take out the line `assert error < 0.02`, which is meant for small
# motions. Points now cross from cell to cell. The gradient of a linear function jumps there, and
# so do the forces: the curve becomes rough, and energy is lost. This is the *grid-crossing error*.
# Step 6 and the page on [grid functions](../explanation/grid_functions.md) show what helps.
#
# Which line of the loop would have to become a solver if the step were implicit? Step 7 does it.
