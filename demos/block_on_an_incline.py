# SPDX-License-Identifier: MIT
"""A block on an incline that is not along the grid: it slides or rests, by Coulomb's law.

The incline is no mesh but a distance in UFL. Points along the lower edge of the block feel how deep
they are in it: they are pressed out along the normal, and held along the incline by friction, which
sticks up to its limit. With the coefficient mu the block slides with g (sin a - mu cos a); if mu
is more than tan a, it rests.
"""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import momentum
from fenicsmpm.materials import Hencky

ANGLE, FRICTIONS = np.pi / 6, (0.3, 0.6)
H, LENGTH, HEIGHT = 0.1, 0.6, 0.3  # m
LAW, DENSITY, GRAVITY = Hencky(E=1e6, nu=0.3), 1000.0, 9.81  # Pa, kg/m^3, m/s^2
DT, RAMP, END = 0.01, 0.1, 0.5  # s; gravity grows in the time RAMP
FOOT = np.array([0.2, 1.4])  # m, the block's upper end on the incline
ALONG, UP = np.array([np.cos(ANGLE), -np.sin(ANGLE)]), np.array([np.sin(ANGLE), np.cos(ANGLE)])


def inside(x):
    s, d = (x[:2].T - FOOT) @ ALONG, (x[:2].T - FOOT) @ UP
    return (s > 0) & (s < LENGTH) & (d > 0) & (d < HEIGHT)


def incline(x):
    return (x[0] - FOOT[0]) * UP[0] + (x[1] - FOOT[1]) * UP[1]


def slide(friction):
    """History of the speed along the incline, and the block at the end."""
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2.4, 2.0)], [round(2.4 / H), round(2.0 / H)],
        mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    block = points.lattice(domain, H / 4, inside=inside)
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
    return history, io.gather_points(block)


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
    assert abs(found - a) < 0.01 * GRAVITY * np.sin(ANGLE)
io.plot("output/block_on_an_incline_speed.png", speeds, "t [s]", "speed [m/s]", reference=exact)
io.picture("output/block_on_an_incline.png", clouds, "v", "speed [m/s]")
