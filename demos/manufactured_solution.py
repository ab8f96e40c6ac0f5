# SPDX-License-Identifier: MIT

# # Convergence to a manufactured solution
#
# How fast do stabilized equal-order elements converge in large deformation? And what does it cost
# that material points do not stay where a quadrature rule would put them? This demo prescribes a
# motion and a pressure, lets UFL derive the body force that they need, and measures errors on finer
# and finer meshes. Any formulation of yours can be verified like that, in a page.
#
# The problem is section 6.1 of L. Moreno, R. Wüchner and A. Larese, *A mixed stabilized MPM
# formulation for incompressible hyperelastic materials using Variational Subgrid-Scales* (VMS).
#
# ## Problem
#
# On the unit square, with $s = x + y$,
#
# $$
# \mathbf u = 0.01\,s^2 e^s \begin{pmatrix} 1 \\ -1 \end{pmatrix}, \qquad
# p = \frac E 3 \sin(2\pi x)\cos(2\pi y) .
# $$
#
# The motion preserves volume, $\det(\mathbf I + \nabla\mathbf u) = 1$, and moves points by up to
# 0.4 m, all in one step on the undeformed mesh. The body force is $-\operatorname{Div}\mathbf P$.
# Displacements are prescribed on the whole boundary, so the pressure is known up to a constant: it
# is held at one node, and its mean is removed.
#
# VMS expects the orders 2 for $\mathbf u$ and 1 for $p$, and observes 2 for both. Beyond the paper,
# points are also put at random places. That shows what disorder alone costs, without anything
# moving.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import formulations, io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver, solve_in_load_steps
from fenicsmpm.verification import Convergence, Manufactured

# -

SIZES, LAW = (8, 16, 32), NeoHookean(E=10e6, nu=0.5)  # squares along a side; Pa
SEEDS = {
    "3 points of a rule a cell": lambda domain: points.quadrature(domain, degree=2),
    "12 random points a cell": lambda domain: points.random(domain, per_cell=12, seed=1),
}
EXPECTED = {  # errors of u, p with points of the rule, the last sizes, by an independent prototype
    "ppp": [(1.20e-2, 6.06e-2), (3.08e-3, 1.85e-2)],
    "asgs": [(9.10e-3, 4.04e-2), (2.43e-3, 1.38e-2)],
    "osgs": [(3.99e-3, 3.73e-2), (7.65e-4, 9.15e-3)],
}

# ## Exact solution
#
# Displacement and pressure grow with a load factor `t`, because boundary values that are imposed at
# once may turn cells inside out. The stress follows from the energy of the law.


def displacement(X, t):
    u = 0.01 * t * (X[0] + X[1]) ** 2 * ufl.exp(X[0] + X[1])
    return u, -u


def pressure(X, t):
    return t * LAW.E / 3 * ufl.sin(2 * ufl.pi * X[0]) * ufl.cos(2 * ufl.pi * X[1])


def stress(F, rate):
    return ufl.diff(LAW.energy(F, ufl.det(F)), F)


# ## One solution and its errors
#
# `Manufactured` differentiates the exact solution. `stabilized` adds one of the stabilizations, by
# its name, to the mixed formulation. Errors are integrated over the cells, wherever the material
# points are.


def solve(n, name, seed):
    """Errors of u and p, and both on the grid."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    body = seed(domain)
    z = formulations.Unknown(domain, "u", "p")
    exact = Manufactured(domain, displacement, stress, 1.0, pressure)
    at_boundary = fem.Function(z.part_space("u"))
    z.fix("u", lambda x: np.isclose(x[0] * (1 - x[0]) * x[1] * (1 - x[1]), 0), at_boundary)
    z.fix("p", lambda x: np.isclose(x[0] + x[1], 0))
    R = formulations.stabilized(name, z, body, LAW, force=exact.force(body))

    def set_load(factor):
        exact.set_time(factor)
        at_boundary.x.array[:] = exact.interpolate("u", z.part_space("u")).x.array

    solve_in_load_steps(NewtonSolver(R, z.U, z.bcs, line_search=True), set_load)
    dx = ufl.dx(domain=domain, metadata={"quadrature_degree": 8})

    def integral(f):
        return domain.comm.allreduce(fem.assemble_scalar(fem.form(f * dx)))

    level = integral(z.p - exact.at().p)
    pairs = {"u": (z.u, exact.at().u), "p": (z.p - level, exact.at().p)}
    squares = {k: integral((f - g) ** 2) / integral(g**2) for k, (f, g) in pairs.items()}
    errors = {name: float(np.sqrt(square)) for name, square in squares.items()}
    return errors, io.gather_functions([z.function("u"), z.function("p")])


# ## Tables
#
# Each table has the errors and the orders between two rows. With points of the rule, the errors are
# those of an independent prototype.

grids = {}
for kind, seed in SEEDS.items():
    for name, expected in EXPECTED.items():
        io.say(f"\n{name.upper()}, {kind}")
        convergence = Convergence(["u", "p"])
        for n in SIZES:
            errors, grid = solve(n, name, seed)
            convergence.add(1 / n, **errors)
        if "rule" in kind:
            grids[name.upper()] = grid
            convergence.plot(f"output/manufactured_solution_{name}.png")
            assert np.allclose(convergence.errors[1:], expected, rtol=0.02)
            assert convergence.orders()["u"] > 1.85 and convergence.orders()["p"] > 1.5  # VMS

# ## Results
#
# The pressure on the deformed finest mesh:

io.picture("output/manufactured_solution.png", grids, "p", "mean stress p [Pa]", displacement="u")
