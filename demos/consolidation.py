# SPDX-License-Identifier: MIT

# # Consolidation of saturated soil
#
# Clay under load settles for years, because water leaves its pores slowly. K. Terzaghi described it
# in 1923, for small strains. This demo solves his problem with a pore pressure as a second unknown,
# checks the settlement against his series, and goes on to a load that squeezes the layer to less
# than three quarters of its height. There, the final settlement is known from the law.
#
# ## Problem
#
# A layer of clay lies under a tight membrane on a porous floor. A pump lowers the pressure of the
# pore water below by $q$ at once and keeps it there. Water leaves, and the skeleton takes over the
# load $q$. That is Terzaghi's problem but for a constant: with the load on top instead of the pump,
# the pore pressure is larger by $q$ everywhere.
#
# Water and grains are incompressible. What a piece of soil loses in volume flows out of it,
# relative to the skeleton, by Darcy's law with the mobility $K$ = permeability / viscosity. With
# the effective stress $\mathbf P'$ of the skeleton, the pore pressure $\pi$, positive in
# compression, and $j = \det\mathbf f$ of the step, the equations per volume at the beginning of the
# step are, for all $\mathbf w$ and $s$,
#
# $$
# \begin{aligned}
# (\mathbf P', \operatorname{Grad}\mathbf w) - (\pi, \mathrm D j[\mathbf w]) &= 0, \\
# (j - 1, s) + \Delta t\,(K j\,\nabla\pi, \nabla s)
# + \frac{h^2}{4M}\,(\nabla(\pi - \pi_\mathrm{old}), \nabla s) &= 0 .
# \end{aligned}
# $$
#
# The last term stabilizes elements of equal order in steps shorter than $h^2/(KM)$, where $M$ is
# the modulus of the skeleton in one dimension (G. Aguilar, F. Gaspar, F. Lisbona and C. Rodrigo,
# IJNME 75, 2008). Without it, pressures swing by more than $q$ at first: try `STABILIZATION = 0`.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh
from scipy.special import lambertw

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.materials import Hencky

# -

HEIGHT, CELLS, PER_SIDE = 1.0, 40, 3  # m; cells in a column, points along a side of a cell
DENSITY, MOBILITY = 2000.0, 1e-13  # kg/m^3, m^2/(Pa s)
SKELETON = Hencky(E=1e6, nu=0.3)  # Pa
LOADS = 1e-3, 0.5  # q / M
STABILIZATION, FLIP = 1.0, 1.0

# ## Reference
#
# In units of $H^2/(KM)$, Terzaghi's degree of consolidation at the time $T$ is
# $1 - \sum_k 2\,e^{-m_k^2 T} / m_k^2$ with $m_k = (2k + 1)\,\pi/2$. The steps grow with the time.

M = SKELETON.kappa + 4 / 3 * SKELETON.mu  # Pa
UNIT = HEIGHT**2 / (MOBILITY * M)  # s
times = np.geomspace(1e-5, 4, 160)  # in this unit
odd = np.pi / 2 * np.arange(1, 1000, 2)
terzaghi = 1 - np.sum(2 / odd**2 * np.exp(-np.outer(times, odd**2)), axis=1)
h = HEIGHT / CELLS

# ## Simulation
#
# The unknown has two parts, the increment of displacement and `pore`. The pore pressure is a
# history of the points, because the stabilization needs its old value. Points take its change on
# the grid (`flip=1`). If they took its value, many short steps would smear it, and the first
# settlement would be too large by half.
#
# A large load ends where Hencky's law says. The stretch $\lambda$ of the layer obeys
# $M \ln\lambda / \lambda = -q$, so $\ln\lambda = -W(q/M)$ with Lambert's function $W$.

curves = {}
for load in LOADS:
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, HEIGHT)], [1, CELLS], mesh.CellType.quadrilateral
    )
    body = points.fill(domain, PER_SIDE)
    formulations.set_initial_state(body, DENSITY)
    z = formulations.Unknown(domain, "u", formulations.Part("pore", flip=FLIP, initial=0.0))
    z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], h), component=0)
    z.fix("u", lambda x: np.isclose(x[1], 0), component=1)
    z.fix("pore", lambda x: np.isclose(x[1], 0), -load * M)

    scheme = formulations.QuasiStatic(z, dt=times[0] * UNIT)
    k = formulations.Kinematics(z.u, body)
    P = formulations.Response(SKELETON, body, k.F).P
    momentum = formulations.stress_power(P, z.test.u, body)
    momentum -= z.pore * ufl.derivative(k.j, z.U, z.V) * body.dx
    outflow = ufl.inner(scheme.dt * MOBILITY * k.j * k.grad(z.pore), k.grad(z.test.pore))
    gradients = ufl.inner(ufl.grad(z.pore - z.old.pore), ufl.grad(z.test.pore))
    steady = STABILIZATION * h**2 / (4 * M) * gradients
    mass = ((k.j - 1) * z.test.pore + outflow + steady) * body.dx
    sim = ImplicitMPM(momentum - mass, z, scheme, body)  # less: symmetric for small strains

    settlement = []
    for time in io.progress(times, f"q / M = {load:g}"):
        sim.step(time * UNIT - sim.time)
        settlement.append(HEIGHT - body.volume() / h)
    final = HEIGHT * (1 - np.exp(-lambertw(load).real))
    curves[f"q / M = {load:g}"] = np.sqrt(times), np.array(settlement) / final
    io.say(f"q / M = {load:g}: settlement {settlement[-1]:.6f} m, exact {final:.6f} m")

# ## Results
#
# Over the square root of time, the settlement begins as a straight line. With large strains the
# layer gets thinner on the way, and the water's path shorter.

small, large = (degree for _, degree in curves.values())
deviation = np.abs(small / terzaghi - 1)[times > 0.003].max()
io.say(f"largest deviation from Terzaghi's series after a settlement of 6 percent: {deviation:.2%}")
labels = "square root of K M t / H^2 [-]", "settlement / final settlement [-]"
series = {"Terzaghi": (np.sqrt(times), terzaghi)}
io.plot("output/consolidation.png", curves, *labels, reference=series)

assert deviation < 0.02  # K. Terzaghi, Erdbaumechanik, 1925
assert abs(large[-1] - 1) < 0.001  # the law in one dimension
