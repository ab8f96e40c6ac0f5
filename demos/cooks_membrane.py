# SPDX-License-Identifier: MIT

# # Cook's membrane
#
# A tapered panel of rubber is clamped on its left edge and pulled up on its right one. It bends and
# shears at the same time, and it cannot change its volume. Plain linear triangles lock on this
# problem. Mixed ones that are not stabilized give a pressure that jumps from cell to cell. This
# demo solves it with equal-order triangles and algebraic subgrid scales, in one static step. It is
# the place to start: the mesh fits the panel, and the material points do not move yet.
#
# The problem is the static example of section 6.2 of L. Moreno, R. Wüchner and A. Larese, *A mixed
# stabilized MPM formulation for incompressible hyperelastic materials using Variational
# Subgrid-Scales* (VMS from here on).
#
# ## Problem
#
# The unknowns are the displacement $\mathbf u$ and the mean stress $p$, positive in tension, both
# continuous and linear in each triangle. With $J = \det\mathbf F$, the weak form (VMS, equations 8
# to 11, for a static incompressible body) asks that for all $\mathbf w$ and $q$
#
# $$
# \begin{aligned}
# (\boldsymbol\sigma_\mathrm{dev}, \nabla\mathbf w) + (p, \nabla\cdot\mathbf w)
# &= \langle\mathbf t, \mathbf w\rangle_\mathrm{right\ edge}, \\
# (J - 1, q) &= 0,
# \end{aligned}
# $$
#
# with the neo-Hookean stress
# $\boldsymbol\sigma_\mathrm{dev} = \mu J^{-5/3} \operatorname{dev}(\mathbf F\mathbf F^\mathsf T)$.
#
# Equal orders of $\mathbf u$ and $p$ violate the inf-sup condition. Algebraic subgrid scales (ASGS)
# cure this. They weight the residuals of the two equations, $\nabla p$ and $J - 1$, and test them
# with the adjoint operator $\mathcal L^*$ (VMS, equations 19 to 22):
#
# $$
# \begin{gathered}
# \sum_K \langle \tau_1 \nabla p, \mathcal L^*_u(\mathbf w, q)\rangle_K
# + \langle \tau_2 (J - 1), \nabla\cdot\mathbf w\rangle_K, \\
# \tau_1 = \frac{h^2}{2\mu}, \quad \tau_2 = 2\mu .
# \end{gathered}
# $$
#
# $\mathcal L^*_u$ contains $-\nabla q$, so that pressures of neighbouring nodes are coupled. The
# divergence of $\boldsymbol\sigma_\mathrm{dev}$ is missing because it is zero in linear triangles.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import forms, formulations, io, points
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

# -

# Names in capitals are meant to be changed. The tip's displacement on fine meshes was computed once
# with Taylor-Hood finite elements.

N = 64  # squares along a side, each cut into two triangles
LAW = NeoHookean(E=70.0, nu=0.5)  # Pa; nu = 0.5: incompressible
TRACTION, TIP = (0.0, 0.0625), (48.0, 60.0)  # Pa, m
CONVERGED = 0.2761  # m, of the tip: limit of fine meshes by Taylor-Hood P2-P1 finite elements

# ## Mesh and material points
#
# The mesh is a unit square, mapped onto the panel.

domain = mesh.create_unit_square(MPI.COMM_WORLD, N, N, diagonal=mesh.DiagonalType.right)
x = domain.geometry.x
x[:, 1] = 44 * x[:, 0] + (44 - 28 * x[:, 0]) * x[:, 1]
x[:, 0] *= 48

# Three sets of points lie in it: `body` carries the volume, `edge` carries the traction, and `tip`
# only measures. The points of `body` are those of a quadrature rule, so this step is a finite
# element computation. In most other demos the points are placed without regard to the mesh, and
# they move.

body = points.quadrature(domain, degree=2)
edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
tip = points.at(domain, TIP)

# ## Weak form
#
# `Unknown` makes the mixed function space with parts named `u` and `p`. Each function of
# `formulations` returns plain UFL over the points. Print `R`, change it, or add to it. Newton's
# method takes its tangent from `ufl.derivative`.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
R = formulations.mixed(z, body, LAW) + formulations.asgs(z, body, LAW)
R += formulations.dead_load(z.test.u, edge, TRACTION)
newton = NewtonSolver(R, z.U, z.bcs).solve()

# ## Results
#
# `forms.evaluate` gives the values of any UFL expression at points. They become fields of the
# points, and go into files for ParaView together with the functions on the grid.

for some in (body, tip):
    some.add_field("u", (2,), forms.evaluate(z.u, some))
    some.add_field("p", (), forms.evaluate(z.p, some))
cloud, grid = io.gather_points(body), io.gather_functions([z.function("u"), z.function("p")])
io.write("output/points.vtp", cloud, {"E [Pa]": LAW.E, "nu": LAW.nu})
io.write("output/grid.vtu", grid, {"E [Pa]": LAW.E, "nu": LAW.nu})

# The pressure is smooth. Its peak at the upper left corner is a singularity of the exact solution,
# hence `cut=1`: one percent of the values at either end do not count for the range of colours.

panels = {"on the grid": grid, "at the material points": cloud}
label = "mean stress p [Pa]"
io.picture("output/cooks_membrane.png", panels, "p", label, displacement="u", cut=1)

# The tip must agree with the finite elements. The script `studies/cooks_membrane.py` repeats this
# for coarser and finer meshes and for other stabilizations.

u_tip = probe(tip, "u")[1]
io.say(f"{body.size_global} material points, {newton.iterations} iterations of Newton's method")
io.say(f"tip {u_tip:.4f} m, finite elements {CONVERGED} m: {u_tip / CONVERGED - 1:+.1%}")
io.say("output/ has cooks_membrane.png, and points.vtp and grid.vtu for ParaView")

assert abs(u_tip / CONVERGED - 1) < 0.02  # P2-P1 finite elements
