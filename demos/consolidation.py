# SPDX-License-Identifier: MIT
"""Consolidation of saturated soil, with small and with large strains.

A layer of clay lies under a tight membrane on a porous floor, where a pump lowers the pressure of
the pore water by q at once and keeps it there. Water leaves, and as it does, the skeleton takes
over the load q: the problem of Terzaghi (1923), but for a constant pressure. With the load on top
instead of the pump the pore pressure is larger by q everywhere.

Water and grains are incompressible, so that what a piece of soil loses in volume is what flows out
of it, relative to the skeleton and by Darcy's law with the mobility K = permeability / viscosity.
With the effective stress P' of the skeleton by the law, the pore pressure "pore" (positive where it
presses, other than the mean stress "p" of the package), and j = det f of the step,

    (P', Grad w) - (pore, D j[w]) = 0                               balance of momentum,
    (j - 1, s) + dt (K j grad pore, grad s)
               + h^2 / (4 M) (grad (pore - pore_old), grad s) = 0   balance of mass

for all w and s, per volume of the step's beginning. The last term is needed by elements of equal
order in steps shorter than h^2 / (K M), M being the modulus of the skeleton in one dimension;
without it pressures at first swing by more than q (``STABILIZATION = 0``). It is that of Aguilar,
Gaspar, Lisbona and Rodrigo (IJNME 75, 2008). For its pore_old, and for nothing else, the pore
pressure is a history of the points. They take its change (FLIP): mapped to and fro in many short
steps, the values themselves (PIC) would be smeared, and the first settlement too large by half.

A small load must give Terzaghi's degree of consolidation. A large one ends where the law says: with
Hencky's law the stretch l of the layer obeys M ln(l) / l = -q, so ln(l) = -W(q / M), Lambert's W.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh
from scipy.special import lambertw

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.materials import Hencky

HEIGHT, CELLS, PER_SIDE = 1.0, 40, 3  # m; cells in a column, points along a side of a cell
DENSITY, MOBILITY = 2000.0, 1e-13  # kg/m^3, m^2/(Pa s)
SKELETON = Hencky(E=1e6, nu=0.3)  # Pa
LOADS = 1e-3, 0.5  # q / M
STABILIZATION, FLIP = 1.0, 1.0

M = SKELETON.kappa + 4 / 3 * SKELETON.mu  # Pa
UNIT = HEIGHT**2 / (MOBILITY * M)  # s
times = np.geomspace(1e-5, 4, 160)  # in this unit
odd = np.pi / 2 * np.arange(1, 1000, 2)
terzaghi = 1 - np.sum(2 / odd**2 * np.exp(-np.outer(times, odd**2)), axis=1)
h = HEIGHT / CELLS
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

small, large = (degree for _, degree in curves.values())
deviation = np.abs(small / terzaghi - 1)[times > 0.003].max()
io.say(f"largest deviation from Terzaghi's series after a settlement of 6 percent: {deviation:.2%}")
labels = "square root of K M t / H^2 [-]", "settlement / final settlement [-]"
series = {"Terzaghi": (np.sqrt(times), terzaghi)}
io.plot("output/consolidation.png", curves, *labels, reference=series)

assert deviation < 0.02  # K. Terzaghi, Erdbaumechanik, 1925
assert abs(large[-1] - 1) < 0.001  # the law in one dimension
