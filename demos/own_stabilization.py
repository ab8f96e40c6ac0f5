# SPDX-License-Identifier: MIT

# # Your own stabilization
#
# A stabilization is a function that returns a few lines of UFL. Its exact tangent follows by
# `ufl.derivative`, so a new idea takes minutes to try, not weeks. This demo writes three classical
# ones and compares them with the ASGS of the package on [Cook's membrane](cooks_membrane.py).
#
# ## Three stabilizations
#
# Integrals over material points are over volumes before the step. `Kinematics` gives gradients and
# volumes after it, $\mathrm dv = j\,\mathrm dv_n$.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import formulations as fm
from fenicsmpm import io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

# -

SIZES, LAW, LIMIT = (8, 16, 32, 64), NeoHookean(E=70.0, nu=0.5), 0.2761  # Pa; m, by P2-P1 elements
ALPHA, GAMMA = 0.5, 0.1

# Penalized pressure gradients are the oldest remedy for linear triangles (F. Brezzi and J.
# Pitkäranta, 1984):
#
# $$
# -\frac{\alpha h^2}{2\mu} (\nabla p, \nabla q) .
# $$


def brezzi_pitkaranta(z, body, law):
    k, h = fm.Kinematics(z.u, body), fm.element_size(body)
    return -ALPHA * h**2 / (2 * law.mu) * k.j * ufl.inner(k.grad(z.p), k.grad(z.test.p)) * body.dx


# Least squares (after T. Hughes, L. Franca and M. Balestra, 1986) make
#
# $$
# -\frac{\tau_1}{2} |\mathbf R_u|^2 + \frac{\tau_2}{2} R_p^2
# $$
#
# stationary, with the residuals and parameters of ASGS and the sign of the saddle point.
# `residuals` returns $j\,\mathbf R_u$, hence the division by $j$. UFL writes the variation, which
# nobody would like to do by hand.


def least_squares(z, body, law):
    (R_u, R_p), (tau_1, tau_2) = fm.residuals(z, body, law), fm.tau(body, law)
    squares = tau_2 / 2 * R_p**2 - tau_1 / 2 * ufl.inner(R_u, R_u) / fm.Kinematics(z.u, body).j
    return ufl.derivative(squares * body.dx, z.U, z.V)


# The continuous interior penalty (E. Burman and P. Hansbo, 2006) punishes kinks of the pressure
# across facets of the background mesh. Forms over points and over facets add up like any UFL:
#
# $$
# -\frac{\gamma h^3}{2\mu} \big([\nabla p\cdot\mathbf n], [\nabla q\cdot\mathbf n]\big) .
# $$


def gradient_jumps(z, body, law):
    n, h = ufl.FacetNormal(body.mesh), ufl.avg(fm.element_size(body))
    jumps = ufl.jump(ufl.grad(z.p), n) * ufl.jump(ufl.grad(z.test.p), n)
    return -GAMMA * h**3 / (2 * law.mu) * jumps * ufl.dS


# ## Comparison
#
# One function solves the membrane with any of them. The tip is what moves up most of all.


def solve(n, stabilization):
    """Displacement of the tip, and the pressure on the grid."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
    x, y, _ = domain.geometry.x.T.copy()
    domain.geometry.x[:, :2] = np.column_stack([48 * x, 44 * x + (44 - 28 * x) * y])
    body = points.quadrature(domain, degree=2)
    edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
    z = fm.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    R = fm.mixed(z, body, LAW) + stabilization(z, body, LAW)
    NewtonSolver(R + fm.dead_load(z.test.u, edge, (0, 0.0625)), z.U, z.bcs).solve()  # Pa
    top = domain.comm.allreduce(z.function("u").x.array[1::2].max(), MPI.MAX)
    return top, z.function("p")


# On coarse meshes the three differ from ASGS. On finer ones the differences must go away.

table = io.Table({"squares": "d", "    stabilization": "s", "tip [m]": ".4f", "by ASGS": ".4f"})
for n in SIZES:
    pressures, tips = {}, []
    for stabilization in (fm.asgs, brezzi_pitkaranta, least_squares, gradient_jumps):
        tip, pressures[stabilization.__name__] = solve(n, stabilization)
        tips.append(tip)
        table.row(n, stabilization.__name__, tips[-1], tips[0])
io.say(f"limit of fine meshes by Taylor-Hood P2-P1 finite elements: {LIMIT} m")

# ## Results
#
# The first panel has no stabilization at all. (ASGS is left out, because it looks like least
# squares.) One that is too weak shows some of this checkerboard. One that is too strong flattens
# the peak at the upper left corner. Try other values of `ALPHA` and `GAMMA`.

_, unstable = solve(SIZES[-1], lambda z, body, law: 0)
panels = {"none": unstable, **pressures}
del panels["asgs"]
io.picture("output/own_stabilization.png", panels, "p", "mean stress p [Pa]", limits=(-0.13, 0.13))

# All displacements are within two percent of the limit.

assert np.all(np.abs(np.array(tips) / LIMIT - 1) < 0.02)  # P2-P1 finite elements
