# SPDX-License-Identifier: MIT

# # 1. Ten points in one cell
#
# In the finite element method the mesh is the body. In the Material Point Method (MPM) it is not.
# The body is a set of *material points*: each has a position, a volume, a mass, and whatever else
# the material remembers. The mesh is a *background grid* on which equations are solved. Points
# move through it from cell to cell, and the grid stays where it is.
#
# This first step has one cell and ten points. It shows what points are, and how numbers travel
# between points and grid.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import fem, mesh

from fenicsmpm import forms, io, points, transfer

domain = mesh.create_unit_square(MPI.COMM_WORLD, 1, 1, mesh.CellType.quadrilateral)
body = points.random(domain, per_cell=10, seed=1)
print(body)
# -

# The `weight` of a point is its volume, here an area: the ten points share the unit square.

# Positions, volumes and fields are arrays with one row a point. A field is added with its shape
# and its initial value, here a mass in kg and a velocity in m/s that grows with x.

# +
body.add_field("mass", (), 2.0 * body["weight"])  # density 2 kg/m^2 in the plane
body.add_field("v", (2,))
body["v"][:, 0] = 3.0 * body.x[:, 0]
print(body.x[:3])
print("mass of all points", body["mass"].sum(), "kg")
# -

# ## Points to grid
#
# The grid has a function $N_I$ for each node $I$: the linear functions of the finite element. A
# point at $\mathbf x_p$ gives each node its share $N_I(\mathbf x_p)$. The nodes then have the
# masses and the momenta
#
# $$m_I = \sum_p N_I(\mathbf x_p)\, m_p, \qquad
#   \mathbf q_I = \sum_p N_I(\mathbf x_p)\, m_p \mathbf v_p .$$
#
# `transfer.p2g` computes such sums. The functions add up to one everywhere, so nothing is lost:
# nodes and points have the same mass and the same momentum.

# +
V = fem.functionspace(domain, ("Lagrange", 1))
nodal_mass = transfer.p2g(body, body["mass"], V).array
nodal_momentum = transfer.p2g(body, body["mass"][:, None] * body["v"], V).array.reshape(-1, 2)
print("masses of the nodes", nodal_mass.round(3))
assert np.isclose(nodal_mass.sum(), body["mass"].sum())
assert np.allclose(nodal_momentum.sum(axis=0), body["mass"] @ body["v"])
# -

# ## Grid to points
#
# The velocity of the grid is momentum over mass, a dolfinx function like any other.
# `forms.evaluate` evaluates a UFL expression at the points, whatever the expression is.

# +
W = fem.functionspace(domain, ("Lagrange", 1, (2,)))
velocity = fem.Function(W)
velocity.x.array[:] = (nodal_momentum / nodal_mass[:, None]).ravel()
back = forms.evaluate(velocity, body)
print("from the points to the grid and back:", back[:3, 0].round(3))
print("velocities of the points:            ", body["v"][:3, 0].round(3))
print(f"largest difference {np.abs(back - body['v']).max():.2f} m/s")
# -

# The two rows differ. An average over a neighbourhood went to the grid, and an interpolation of
# averages came back, so the velocities are smoothed. There are several cures. One of them, FLIP,
# adds only the *change* of the grid velocity to the points. It appears in step 4.

# +
body["v"] = back
io.picture("output/1_ten_points.png", body, "v", "speed [m/s]", bounds=((0, 0), (1, 1)))
# -

# ## Your turn
#
# Take `per_cell=1000` instead of 10. The largest difference stays near 1 m/s: it is the size of
# the cell that counts, not the number of points. Now keep the thousand points and take four
# cells, `create_unit_square(MPI.COMM_WORLD, 2, 2`. What happens to the difference?
