# SPDX-License-Identifier: MIT

# # 2. Forms over points
#
# A finite element code integrates weak forms by quadrature: it evaluates the integrand at Gauss
# points and adds up the values with weights. MPM does the same with other points. The material
# points are the quadrature points, and their volumes are the weights. So `fenicsmpm` needs no
# language of its own: a set of points has a UFL measure, `body.dx`.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import forms, io, points

domain = mesh.create_unit_square(MPI.COMM_WORLD, 16, 16)
body = points.fill(domain, per_side=2)  # four points in each triangle
x = ufl.SpatialCoordinate(domain)
value = forms.assemble_scalar(forms.form(ufl.sin(np.pi * x[0]) * body.dx))
print(f"integral of sin(pi x): {value:.5f}, exactly {2 / np.pi:.5f}")
# -

# `forms.form` and the functions `assemble_scalar`, `assemble_vector` and `assemble_matrix` have
# the names that they have in dolfinx. Arguments, coefficients and constants are those of dolfinx.
# With points at the places of a Gauss rule they also give the same numbers, to round-off:

# +
V = fem.functionspace(domain, ("Lagrange", 1))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
gauss = points.quadrature(domain, degree=2)
ours = forms.assemble_matrix(forms.form(u * v * gauss.dx)).to_dense()
theirs = fem.assemble_matrix(fem.form(u * v * ufl.dx)).to_dense()
print("largest difference of the mass matrices:", f"{np.abs(ours - theirs).max():.0e}")
assert np.abs(ours - theirs).max() < 1e-15
# -

# ## Fields at points
#
# What a point carries is a coefficient, too: `body.field("k")`. Here it is a conductivity that
# grows from 1 on the left to 10 on the right. It could as well come from a measurement. The
# temperature solves
#
# $$\int_\Omega k \nabla T \cdot \nabla w \,\mathrm d x = 0 \quad \forall w, \qquad
#   T = 0 \text{ at } x = 0, \quad T = 1 \text{ at } x = 1,$$
#
# `formulations.Unknown` makes the function space and the unknown function. Its parts have names:
# `z.T` is the temperature and `z.test.T` the test function, `z.U` is the dolfinx function of all
# parts together. `z.fix` adds a Dirichlet condition. `NewtonSolver` takes a residual and finds
# the tangent by `ufl.derivative`.

# +
from fenicsmpm import formulations, solvers

body.add_field("k", (), 1.0 + 9.0 * body.x[:, 0])
z = formulations.Unknown(domain, "T")  # one part named T, linear functions
z.fix("T", lambda x: np.isclose(x[0], 0), 0.0)
z.fix("T", lambda x: np.isclose(x[0], 1), 1.0)
k = body.field("k")
R = k * ufl.inner(ufl.grad(z.T), ufl.grad(z.test.T)) * body.dx
result = solvers.NewtonSolver(R, z.U, z.bcs).solve()
print(f"Newton iterations: {result.iterations}")

flux = forms.assemble_scalar(forms.form(k * z.T.dx(0) * body.dx))
exact = 9 / np.log(10)
print(f"heat flux {flux:.3f}, exactly {exact:.3f}")
assert abs(flux / exact - 1) < 0.02
# -

# A point set is plotted by its fields. A field that is not there yet can be any UFL expression.

# +
body.add_field("T", (), forms.evaluate(z.T, body))
io.picture("output/2_forms_over_points.png", body, "T", "temperature [-]")
# -

# ## Your turn
#
# Make the conductivity depend on the temperature: `k = body.field("k") * (1 + z.T)`. The problem
# is now nonlinear, and Newton's method needs some iterations. The exact flux is half as large
# again, `exact = 1.5 * 9 / np.log(10)`. Nothing else changes.
