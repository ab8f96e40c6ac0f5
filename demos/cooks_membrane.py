# SPDX-License-Identifier: MIT
"""Cook's membrane.

A tapered panel of an incompressible rubber is clamped on its left edge and pulled upwards on its
right one. It bends and shears at once, which locks plain linear triangles and makes the pressure of
unstabilized mixed ones jump from cell to cell. It is the static example of section 6.2 of Moreno,
Wüchner and Larese, "A mixed stabilized MPM formulation for incompressible hyperelastic materials
using Variational Subgrid-Scales" (in short: VMS).

The displacement u and the mean stress p are continuous P1 functions on the mesh such that

    (sigma_dev, grad w) + (p, div w) = (t, w) on the right edge,   (J - 1, q) = 0

for all w and q, with J = det F and the neo-Hookean sigma_dev = mu J^(-5/3) dev(F F^T). Equal orders
of u and p do not meet the inf-sup condition of this problem. So algebraic subgrid scales (``asgs``)
are added: the residuals grad p and J - 1, times h^2 / (2 mu) and 2 mu, are tested with the adjoint
operator. ``ppp`` and ``osgs`` are other ways, which studies/cooks_membrane.py compares.

Here material points are nothing but the points of a quadrature rule. In the other demos they move.
"""

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import forms, formulations, io, points
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

N = 64  # squares along a side, each cut into two triangles
LAW = NeoHookean(E=70.0, nu=0.5)  # Pa; nu = 0.5: incompressible
TRACTION, TIP = (0.0, 0.0625), (48.0, 60.0)  # Pa, m
CONVERGED = 0.2761  # m, of the tip: limit of fine meshes by Taylor-Hood P2-P1 finite elements

# A unit square that is mapped on the membrane.
domain = mesh.create_unit_square(MPI.COMM_WORLD, N, N, diagonal=mesh.DiagonalType.right)
x = domain.geometry.x
x[:, 1] = 44 * x[:, 0] + (44 - 28 * x[:, 0]) * x[:, 1]
x[:, 0] *= 48

body = points.quadrature(domain, degree=2)
edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
tip = points.at(domain, TIP)

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
R = formulations.mixed(z, body, LAW) + formulations.asgs(z, body, LAW)
R += formulations.dead_load(z.test.u, edge, TRACTION)
newton = NewtonSolver(R, z.U, z.bcs).solve()

for some in (body, tip):  # any UFL expression can be evaluated at points
    some.add_field("u", (2,), forms.evaluate(z.u, some))
    some.add_field("p", (), forms.evaluate(z.p, some))
cloud, grid = io.gather_points(body), io.gather_functions([z.function("u"), z.function("p")])
io.write("output/points.vtp", cloud, {"E [Pa]": LAW.E, "nu": LAW.nu})
io.write("output/grid.vtu", grid, {"E [Pa]": LAW.E, "nu": LAW.nu})
panels = {"on the grid": grid, "at the material points": cloud}
label = "mean stress p [Pa]"
io.picture("output/cooks_membrane.png", panels, "p", label, displacement="u", cut=1)

u_tip = probe(tip, "u")[1]
io.say(f"{body.size_global} material points, {newton.iterations} iterations of Newton's method")
io.say(f"tip {u_tip:.4f} m, finite elements {CONVERGED} m: {u_tip / CONVERGED - 1:+.1%}")
io.say("output/ has cooks_membrane.png, and points.vtp and grid.vtu for ParaView")

assert abs(u_tip / CONVERGED - 1) < 0.02  # P2-P1 finite elements
