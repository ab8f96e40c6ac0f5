# SPDX-License-Identifier: MIT

# # Block on an incline
#
# Supports of a real problem are rarely along the lines of a mesh. Here, a block lies on an incline
# that crosses the cells at 30 degrees, and the mesh knows nothing of it. The incline is one line of
# UFL: a distance. With little friction the block slides as fast as a rigid one must, with more it
# stays where it is.
#
# ## Problem
#
# Points along the lower edge of the block carry the contact. Each feels how deep it is in the
# incline, $d(\mathbf x) < 0$. It is pressed out along the normal, in proportion to the depth, and
# held along the incline by friction, which sticks up to Coulomb's limit of $\mu$ times the normal
# traction. On an incline of angle $\alpha$, a rigid block has the acceleration
#
# $$
# a = \max\big(0,\ g (\sin\alpha - \mu\cos\alpha)\big),
# $$
#
# so it rests if $\mu > \tan\alpha = 0.577$.

# +
from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import momentum
from fenicsmpm.materials import Hencky

# -

ANGLE, FRICTIONS = np.pi / 6, (0.3, 0.6)
H, LENGTH, HEIGHT = 0.1, 0.6, 0.3  # m
LAW, DENSITY, GRAVITY = Hencky(E=1e6, nu=0.3), 1000.0, 9.81  # Pa, kg/m^3, m/s^2
DT, RAMP, END = 0.01, 0.1, 0.5  # s; gravity grows in the time RAMP
FOOT = np.array([0.2, 1.4])  # m, the block's upper end on the incline
ALONG, UP = np.array([np.cos(ANGLE), -np.sin(ANGLE)]), np.array([np.sin(ANGLE), np.cos(ANGLE)])

# ## Geometry
#
# `incline` is the distance of a place from the incline, positive above it. It works on numbers and
# on UFL.


def inside(x):
    s, d = (x[:2].T - FOOT) @ ALONG, (x[:2].T - FOOT) @ UP
    return (s > 0) & (s < LENGTH) & (d > 0) & (d < HEIGHT)


def incline(x):
    return (x[0] - FOOT[0]) * UP[0] + (x[1] - FOOT[1]) * UP[1]


# ## Simulation
#
# Block and contact points see quadratic B-splines. `wall` takes the distance and gives the
# contact's terms of the weak form. The block is a law at points, `Response`, without a pressure
# unknown. Gravity grows within the first tenth of a second, so that the block does not bounce. The
# points of the ramp take no part: they are drawn in grey, because their speed is no number.


def slide(friction):
    """History of the speed along the incline, and points at the end."""
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2.4, 2.0)], [round(2.4 / H), round(2.0 / H)],
        mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    block = points.lattice(domain, H / 4, inside=inside)
    ramp = points.lattice(domain, H / 4, inside=lambda x: incline(x) < 0)
    ramp.add_field("v", (2,), np.nan)
    formulations.set_initial_state(block, DENSITY)
    edge = points.on_curve(domain, FOOT, FOOT + LENGTH * ALONG, spacing=H / 5)
    for p in (block, edge):
        basis.use(p, "quadratic")
    z = formulations.Unknown(domain, "u")
    scheme, cells = formulations.BDF2(z, dt=DT), ActiveCells(block, loads=[edge])
    F = formulations.Kinematics(z.u, block).F
    P = formulations.Response(LAW, block, F).P
    g = fem.Constant(domain, (0.0, 0.0))
    R = formulations.stress_power(P, z.test.u, block) + scheme.inertia(block)
    R -= ufl.inner(formulations.density(block) * g, z.test.u) * block.dx
    R += formulations.wall(z, edge, LAW, incline, friction=friction, factor=10.0)

    def data(start, end):
        g.value[1] = -GRAVITY * min(end / RAMP, 1.0)

    mass = MPI.COMM_WORLD.allreduce(block["mass"].sum())
    history = io.History({"v [m/s]": lambda sim: momentum(block) @ ALONG / mass})
    sim = ImplicitMPM(
        R, z, scheme, block, carried=[edge], data=data, observers=[history], taylor=True,
        newton={"tying": Tying(z.space, block, cells), "line_search": True},
    )  # fmt: skip
    for _ in io.watch(sim.run(END), END, f"friction {friction}"):
        pass
    return history, io.gather_points([block, ramp])


# Both blocks run, and their accelerations are fitted to the speeds after gravity has come to its
# full value.

speeds, exact, clouds = {}, {}, {}
for friction in FRICTIONS:
    history, clouds[f"friction {friction}"] = slide(friction)
    t, v = history["t [s]"], history["v [m/s]"]
    speeds[f"friction {friction}"] = t, v
    a = max(0.0, GRAVITY * (np.sin(ANGLE) - friction * np.cos(ANGLE)))
    late = t > 1.5 * RAMP
    exact[f"rigid block, {friction}"] = t[late], v[late][0] + a * (t[late] - t[late][0])
    found = np.polyfit(t[late], v[late], 1)[0]
    io.say(f"friction {friction}: acceleration {found:.3f} m/s^2, of a rigid block {a:.3f}")
    assert abs(found - a) < 0.01 * GRAVITY * (np.sin(ANGLE) - min(FRICTIONS) * np.cos(ANGLE))

# ## Results

around = (0.0, 0.5), (1.6, 1.8)
io.picture(
    "output/block_on_an_incline.png", clouds, "v", "speed [m/s]", limits=(0.0, 1.2), bounds=around
)

# The speeds are those of a rigid block on the same incline:

io.plot("output/block_on_an_incline_speed.png", speeds, "t [s]", "speed [m/s]", reference=exact)
