# SPDX-License-Identifier: MIT
"""A slope whose strength is reduced until it fails.

Soil with an inclination of 45 degrees lies there with the stress at rest under its surface, which
is not in equilibrium along the slope: the first load step finds that. Then cohesion and tan(phi)
are divided by a factor that grows. The slope moves by millimetres until there is no equilibrium
any more, and by decimetres thereafter: the factor between is the factor of safety. It should be 1:
limit analysis by W. F. Chen (Limit Analysis and Soil Plasticity, 1975) has failure at gamma H / c =
16.16 for phi = 20 degrees and flow normal to the yield surface; here gamma = 20 kN/m^3, H = 10 m
and c = 12.38 kPa. E. M. Dawson, W. H. Roth, A. Drescher (Geotechnique 49, 1999) have reduced it in
finite differences.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import MohrCoulomb

H, PER_SIDE = 0.5, 2  # m; points along a side of a cell
WIDTH, BASE, TOE, HEIGHT = 26.0, 2.0, 6.0, 10.0  # m
COHESION, FRICTION = 12.38e3, 20.0  # Pa, degrees
DENSITY, GRAVITY = 20e3 / 9.81, 9.81  # kg/m^3, m/s^2
K0 = 1 - np.sin(np.radians(FRICTION))  # Jaky
FIRST, LAST, STEP = 0.9, 1.1, 0.01  # of the factor
MOVED, GONE = 0.01, 0.1  # largest displacements of a slope that stands, and when to stop, m


def surface(x):
    return BASE + np.clip(x[0] - TOE, 0, HEIGHT)


def at_rest(x):
    vertical = -DENSITY * GRAVITY * (surface(x) - x[1])
    return np.multiply.outer(np.diag([K0, 1.0, K0]), vertical)


def soil(factor):
    angle = np.degrees(np.arctan(np.tan(np.radians(FRICTION)) / factor))
    return MohrCoulomb(1e8, 0.3, COHESION / factor, friction=angle, dilatancy=angle)


top = BASE + HEIGHT + 2 * H
domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (WIDTH, top)], [round(WIDTH / H), round(top / H)],
    mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
slope, law = points.lattice(domain, H / PER_SIDE, inside=lambda x: x[1] < surface(x)), soil(FIRST)
basis.use(slope, "quadratic")
formulations.set_initial_state(slope, DENSITY)
formulations.initial_stress(slope, law, at_rest)

z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], WIDTH), component=0)
z.fix("u", lambda x: np.isclose(x[1], 0))
P = formulations.Response(law, slope, formulations.Kinematics(z.u, slope).F).P
weight = formulations.density(slope) * ufl.as_vector((0.0, -GRAVITY))
R = formulations.stress_power(P, z.test.u, slope) - ufl.inner(weight, z.test.u) * slope.dx


def data(start, end):
    law.parameters[:] = soil(FIRST + end).parameters


def largest(sim):
    length = np.linalg.norm(slope["u"], axis=1).max(initial=0)
    return domain.comm.allreduce(length, op=MPI.MAX)


history = io.History({"largest displacement [m]": largest})
sim = ImplicitMPM(
    R, z, formulations.QuasiStatic(z, dt=STEP), slope, data=data, observers=[history],
    newton={"tying": Tying(z.space, slope, ActiveCells(slope))},
)  # fmt: skip
for _ in io.watch(sim.run(LAST - FIRST, largest=STEP), LAST - FIRST, "slope"):
    if history["largest displacement [m]"][-1] > GONE:
        break

factor = FIRST + history["t [s]"]
way = history["largest displacement [m]"]
safety = factor[way < MOVED].max()
io.say(f"the slope stands up to a factor of {safety:.2f}; limit analysis 1.00")
curve = {"slope": (factor[1:], way[1:])}
labels = "reduction of strength", "largest displacement [m]"
io.plot("output/slope_displacement.png", curve, *labels)
io.picture("output/slope.png", slope, "eps_p", "plastic strain")

assert abs(safety - 1) < 0.03  # Chen
