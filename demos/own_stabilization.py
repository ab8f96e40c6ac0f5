# SPDX-License-Identifier: MIT
"""A stabilization of one's own.

A stabilization is a function that returns a few lines of UFL. The exact tangent follows by
``ufl.derivative``. Three of them are compared with ASGS on Cook's membrane (demos/cooks_membrane.py
says what it is). Integrals over material points are over volumes before the step; gradients and
volumes after it come from ``Kinematics``, so that dv = j dv_n.

1. Penalized pressure gradients, -alpha h^2 / (2 mu) (grad p, grad q), are the oldest remedy for
   linear triangles (F. Brezzi and J. Pitkäranta, 1984).
2. Least squares (after T. Hughes, L. Franca and M. Balestra, 1986) make -tau_1/2 |R_u|^2 + tau_2/2
   R_p^2 stationary, with residuals and parameters of ASGS, and the sign of the saddle point.
   ``residuals`` returns j R_u. UFL writes the variation, which nobody would like to do by hand.
3. Continuous interior penalty (E. Burman and P. Hansbo, 2006) punishes kinks of the pressure across
   facets of the background mesh, -gamma h^3 / (2 mu) ([grad p . n], [grad q . n]).

A stabilization that is too weak shows a checkerboard in the picture, one that is too strong
flattens the peak at the upper left corner: try other values of ``ALPHA`` and ``GAMMA``. Differences
between methods must go away on fine meshes.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import formulations as fm
from fenicsmpm import io, points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver

SIZES, LAW, LIMIT = (8, 16, 32, 64), NeoHookean(E=70.0, nu=0.5), 0.2761  # Pa; m, by P2-P1 elements
ALPHA, GAMMA = 0.5, 0.1


def brezzi_pitkaranta(z, body, law):
    k, h = fm.Kinematics(z.u, body), fm.element_size(body)
    return -ALPHA * h**2 / (2 * law.mu) * k.j * ufl.inner(k.grad(z.p), k.grad(z.test.p)) * body.dx


def least_squares(z, body, law):
    (R_u, R_p), (tau_1, tau_2) = fm.residuals(z, body, law), fm.tau(body, law)
    squares = tau_2 / 2 * R_p**2 - tau_1 / 2 * ufl.inner(R_u, R_u) / fm.Kinematics(z.u, body).j
    return ufl.derivative(squares * body.dx, z.U, z.V)


def gradient_jumps(z, body, law):
    n, h = ufl.FacetNormal(body.mesh), ufl.avg(fm.element_size(body))
    jumps = ufl.jump(ufl.grad(z.p), n) * ufl.jump(ufl.grad(z.test.p), n)
    return -GAMMA * h**3 / (2 * law.mu) * jumps * ufl.dS


table = io.Table({"squares": "d", "    stabilization": "s", "tip [m]": ".4f", "by ASGS": ".4f"})
for n in SIZES:
    pressures, tips = {}, []
    for stabilization in (fm.asgs, brezzi_pitkaranta, least_squares, gradient_jumps):
        domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=mesh.DiagonalType.right)
        x, y, _ = domain.geometry.x.T.copy()
        domain.geometry.x[:, :2] = np.column_stack([48 * x, 44 * x + (44 - 28 * x) * y])
        body = points.quadrature(domain, degree=2)
        edge = points.on_facets(domain, lambda x: np.isclose(x[0], 48))
        z = fm.Unknown(domain, "u", "p")
        z.fix("u", lambda x: np.isclose(x[0], 0))
        R = fm.mixed(z, body, LAW) + stabilization(z, body, LAW)
        NewtonSolver(R + fm.dead_load(z.test.u, edge, (0, 0.0625)), z.U, z.bcs).solve()  # Pa
        pressures[stabilization.__name__] = z.function("p")
        # the tip moves up most of all
        tips.append(domain.comm.allreduce(z.function("u").x.array[1::2].max(), MPI.MAX))
        table.row(n, stabilization.__name__, tips[-1], tips[0])
io.say(f"limit of fine meshes by Taylor-Hood P2-P1 finite elements: {LIMIT} m")
io.picture("output/own_stabilization.png", pressures, "p", "mean stress p [Pa]", cut=1)
assert np.all(np.abs(np.array(tips) / LIMIT - 1) < 0.02)  # P2-P1 finite elements
