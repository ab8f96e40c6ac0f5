# SPDX-License-Identifier: MIT

# # Factor of safety of a slope
#
# By how much could soil be weaker before a slope fails? Engineers answer with the factor of safety.
# They reduce cohesion and friction until there is no equilibrium any more. Here the Material Point
# Method does it: the slope moves by millimetres as long as it stands, and by decimetres once it
# fails. Limit analysis says that this must happen at a factor of 1.
#
# ## Problem
#
# Soil with an inclination of 45 degrees and the height $H$ = 10 m has the friction angle $\varphi$
# = 20 degrees, and flows normal to the yield surface. Limit analysis (W. F. Chen, *Limit Analysis
# and Soil Plasticity*, 1975) has failure at
#
# $$
# \frac{\gamma H}{c} = 16.16 .
# $$
#
# With $\gamma$ = 20 kN/m³ that is a cohesion of $c$ = 12.38 kPa. The strength is reduced by a
# factor $f$ that grows,
#
# $$
# c_f = \frac c f, \qquad \tan\varphi_f = \frac{\tan\varphi}{f},
# $$
#
# as E. M. Dawson, W. H. Roth and A. Drescher (Géotechnique 49, 1999) have done in finite
# differences.
#
# The slope starts with the stress at rest, $\sigma_h = K_0\,\sigma_v$ with Jaky's
# $K_0 = 1 - \sin\varphi$. This is not in equilibrium along the slope, and the first load step finds
# what is.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import MohrCoulomb

# -

H, PER_SIDE = 0.5, 2  # m; points along a side of a cell
WIDTH, BASE, TOE, HEIGHT = 26.0, 2.0, 6.0, 10.0  # m
COHESION, FRICTION = 12.38e3, 20.0  # Pa, degrees
DENSITY, GRAVITY = 20e3 / 9.81, 9.81  # kg/m^3, m/s^2
K0 = 1 - np.sin(np.radians(FRICTION))  # Jaky
FIRST, LAST, STEP = 0.9, 1.1, 0.01  # of the factor
MOVED, GONE = 0.01, 0.1  # largest displacements of a slope that stands, and when to stop, m

# ## Slope


def surface(x):
    return BASE + np.clip(x[0] - TOE, 0, HEIGHT)


def at_rest(x):
    vertical = -DENSITY * GRAVITY * (surface(x) - x[1])
    return np.multiply.outer(np.diag([K0, 1.0, K0]), vertical)


def soil(factor):
    angle = np.degrees(np.arctan(np.tan(np.radians(FRICTION)) / factor))
    return MohrCoulomb(1e8, 0.3, COHESION / factor, friction=angle, dilatancy=angle)


# Points below the surface make up the slope. `initial_stress` gives them the stress that this law
# has after some elastic strain that nobody needs to know.

top = BASE + HEIGHT + 2 * H
domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (WIDTH, top)], [round(WIDTH / H), round(top / H)],
    mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
slope, law = points.lattice(domain, H / PER_SIDE, inside=lambda x: x[1] < surface(x)), soil(FIRST)
basis.use(slope, "quadratic")
formulations.set_initial_state(slope, DENSITY)
formulations.initial_stress(slope, law, at_rest)

# ## Weak form
#
# The work of the stress less that of the weight, without inertia.

z = formulations.Unknown(domain, "u")
z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], WIDTH), component=0)
z.fix("u", lambda x: np.isclose(x[1], 0))
P = formulations.Response(law, slope, formulations.Kinematics(z.u, slope).F).P
weight = formulations.density(slope) * ufl.as_vector((0.0, -GRAVITY))
R = formulations.stress_power(P, z.test.u, slope) - ufl.inner(weight, z.test.u) * slope.dx

# ## Load steps
#
# The "time" of the quasi-static scheme is the growth of the factor. `data` sets the parameters of
# the law before each step. Where Newton's method fails, the step is halved. The loop stops when the
# slope has gone.


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

# ## Results
#
# The slope slides on a curved surface from the toe to the crest:

io.picture("output/slope.png", slope, "eps_p", "plastic strain", cut=1)

# The displacement takes off at a factor that is two percent above that of limit analysis:

factor = FIRST + history["t [s]"]
way = history["largest displacement [m]"]
safety = factor[way < MOVED].max()
io.say(f"the slope stands up to a factor of {safety:.2f}; limit analysis 1.00")
curve = {"slope": (factor[1:], way[1:])}
labels = "reduction of strength", "largest displacement [m]"
io.plot(
    "output/slope_displacement.png",
    curve,
    *labels,
    reference={"limit analysis": ([1.0, 1.0], [0.0, way.max()])},
)

assert abs(safety - 1) < 0.03  # Chen
