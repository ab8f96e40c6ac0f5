# SPDX-License-Identifier: MIT

# # 3. An elastic body at rest
#
# Now the points carry a solid. A cantilever of rubber, 4 m long and 1 m high, is clamped on its
# left and loaded by its own weight. It lies in a background mesh that is larger than the body,
# and it does not end where cells end.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import cells, formulations, io, points, solvers

H = 0.25  # m, size of the cells
domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, -2), (5, 2)], [20, 16], mesh.CellType.quadrilateral
)
body = points.lattice(
    domain, H / 3, inside=lambda x: (x[0] < 4.1) & (np.abs(x[1]) < 0.5)
)  # 4.1 m: the last column of cells is not full
print(body)
# -

# ## Weak form
#
# The unknown is the displacement $\mathbf u$, and the weak form is that of nonlinear elasticity:
# find $\mathbf u$ such that
#
# $$\int_\Omega \mathbf P(\mathbf F) : \nabla \mathbf w \,\mathrm d V
#   - \int_\Omega \rho\, \mathbf g \cdot \mathbf w \,\mathrm d V = 0 \quad \forall \mathbf w, \qquad
#   \mathbf F = \mathbf I + \nabla \mathbf u ,$$
#
# with the first Piola-Kirchhoff stress $\mathbf P = \partial \psi / \partial \mathbf F$ of a
# stored energy $\psi$. It is plain UFL, and every term of it is yours to change.

# +
E, NU, RHO, G = 2e7, 0.3, 1000.0, 9.81  # Pa, -, kg/m^3, m/s^2
mu, lmbda = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))

z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0))
F = ufl.variable(ufl.Identity(2) + ufl.grad(z.u))
J = ufl.det(F)
psi = mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + lmbda / 2 * ufl.ln(J) ** 2
P = ufl.diff(psi, F)
R = ufl.inner(P, ufl.grad(z.test.u)) * body.dx
R += RHO * G * z.test.u[1] * body.dx
# -

# ## Nodes without points
#
# A node *sees* a point if its function is not zero there. Most nodes of this mesh see no point at
# all. Their rows in the tangent are empty, and `NewtonSolver` leaves them out by itself. Others
# see only the last column of points, far away from them. They have hardly any stiffness, and the
# tangent is nearly singular. `cells.Tying` makes such nodes follow their neighbours inside the
# body. Cells with points are *active*: `ActiveCells` finds them.

# +
tying = cells.Tying(z.space, body, cells.ActiveCells(body))
result = solvers.NewtonSolver(R, z.U, z.bcs, tying=tying).solve()
print(result)
# -

# ## Result
#
# The displacement is evaluated at the points, and the lowest point gives the deflection of the
# tip. Beam theory says what to expect: the deflection of a slender beam under its weight is $q
# L^4 / (8 E I)$, to which shear adds $q L^2 / (2 \kappa G A)$ with $\kappa = 5/6$. In plane
# strain $E$ becomes $E / (1 - \nu^2)$. Linear functions are a little too stiff in bending.

# +
from fenicsmpm import forms

body.add_field("u", (2,), forms.evaluate(z.u, body))
length = 4.083  # m: the last points are at 4.042 and reach half their spacing further
modulus, q = E / (1 - NU**2), RHO * G
beam = q * length**4 / (8 * modulus / 12) + q * length**2 / (2 * 5 / 6 * mu)
tip = -body["u"][:, 1].min()
print(f"deflection {tip:.3f} m, beam theory {beam:.3f} m")
assert abs(tip / beam - 1) < 0.15
io.picture("output/3_elastic_block.png", body, "u", "displacement [m]", displacement="u")
# -

# ## Your turn
#
# Make the mesh twice as fine: `[40, 32]` and `H = 0.125`. The deflection comes closer to beam
# theory. Then write another energy, with `lmbda / 2 * (J - 1) ** 2` as its last term. Nothing
# else has to change, since `ufl.diff` and `ufl.derivative` do the rest. The deflection is nearly
# the same, because volumes hardly change in bending.
