# SPDX-License-Identifier: MIT

# # Rubber ring on stairs
#
# Bodies often come from drawing programs. Here a rubber ring is read from an STL file. It is
# dropped onto stairs with a little push, and tumbles from step to step. The stairs are three rigid
# boxes with friction, at any height between the nodes of the mesh.
#
# ## Problem
#
# Only gravity and the stairs act on the ring. Its momentum is therefore known at any time:
#
# $$
# \mathbf p(t) = \mathbf p(0) + m\,\mathbf g\,t + \sum_k \int_0^t \mathbf f_k\,\mathrm d\tau,
# $$
#
# where $\mathbf f_k$ is the force that stair $k$ records. Contact gives no energy either. So the
# sum of kinetic and potential energy can only fall, except for elastic energy that comes back. The
# volume of the ring is $2\pi^2 R\,r^2$ with the radii $R$ and $r$ of ring and tube, less a little
# that the triangles cut off.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pyvista
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, RigidBody, basis, formulations, io, points, shapes
from fenicsmpm.diagnostics import kinetic_energy, momentum
from fenicsmpm.materials import Hencky

# -

H, SIZE = 0.1, (2.4, 1.2, 1.6)  # of cells and of the mesh, m; two points along a cell
RING, TUBE, START = 0.28, 0.1, (0.45, 0.6, 1.3)  # radii and centre, m
TREADS, RISERS = (0.8, 1.5, 2.4), (0.87, 0.47, 0.07)  # where the steps end, and how high, m
RUBBER, DENSITY, GRAVITY = Hencky(E=2e5, nu=0.4), 1000.0, 9.81
FRICTION, PUSH, TIMES = 0.4, (1.0, 0.0, 0.0), (0.0, 0.4, 0.8, 1.1)  # m/s, s
FRAME = 0.05  # s between two frames of the animation

# ## Ring
#
# The file is made here by pyvista, in mm, as drawing programs have it. `read_solid` says what is
# wrong with a surface that is not closed. `in_solid` fills the surface with points whose volume is
# that of the body to round-off.

file = Path("output/ring.stl")
if MPI.COMM_WORLD.rank == 0:
    file.parent.mkdir(exist_ok=True)
    torus = pyvista.ParametricTorus(ringradius=1e3 * RING, crosssectionradius=1e3 * TUBE)
    torus.clean().triangulate().save(file)
MPI.COMM_WORLD.barrier()
ring = points.read_solid(file).transformed(scale=1e-3, translation=START)

domain = mesh.create_box(
    MPI.COMM_WORLD, [(0, 0, 0), SIZE], [round(x / H) for x in SIZE], mesh.CellType.hexahedron
)
body = points.in_solid(domain, ring, H / 2)
basis.use(body, "quadratic")
formulations.set_initial_state(body, DENSITY, PUSH)

# ## Stairs
#
# A `RigidBody` needs a shape, here a box. Points feel it within its reach. The points in `stones`
# only show the stairs in the pictures. They are grey, because their speed is no number.

boxes = [
    shapes.Box((-1.0 if k == 0 else TREADS[k - 1], -1, -1), (TREADS[k], SIZE[1] + 1, RISERS[k]))
    for k in range(len(TREADS))
]
stones = points.lattice(domain, H / 2, inside=lambda x: np.any([box(x) for box in boxes], axis=0))
stones.add_field("v", (3,), np.nan)
stairs = [RigidBody(box, reach=H / 4, friction=FRICTION) for box in boxes]

# ## Time steps
#
# In each step, the loop adds up the impulse of the stairs and watches the energy. From time to time
# it draws a frame of the animation.

z = formulations.Unknown(domain, "v")
R = formulations.internal_force(z.test.v, body, RUBBER)
R += formulations.body_force(z.test.v, body, (0.0, 0.0, -GRAVITY))
sim = ExplicitMPM(R, z, body, rigid=stairs)


def energy():
    height = MPI.COMM_WORLD.allreduce(body["mass"] @ body.x[:, 2])
    return kinetic_energy(body) + GRAVITY * height


mass = MPI.COMM_WORLD.allreduce(body["mass"].sum())
before, impulse = momentum(body), np.zeros(3)
first, most = energy(), 0.0
look = {"field": "v", "label": "speed [m/s]", "limits": (0.0, 4.0)}
view = {**look, "bounds": ((0.0, 0.0, 0.0), SIZE)}
clouds, frames = {}, []
for end in TIMES:
    for step in io.watch(sim.run(end), end, "falling"):
        impulse += step.dt * sum(stair.force for stair in stairs)
        most = max(most, energy())
        if step.time > FRAME * len(frames):
            file = f"output/falling_down_stairs/{len(frames):02d}.png"
            frames.append(io.picture(file, io.gather_points([body, stones]), **view))
    clouds[f"t = {end:g} s"] = io.gather_points([body, stones])

# ## Results

io.picture("output/falling_down_stairs.png", clouds, **look)

# The same as an animation:

io.animate("output/falling_down_stairs.gif", frames)

# Momentum, energy and volume:

weight = mass * GRAVITY * sim.time * np.array([0.0, 0.0, -1.0])
error = np.abs(momentum(body) - before - weight - impulse).max() / np.abs(impulse).max()
volume = mass / DENSITY / (2 * np.pi**2 * RING * TUBE**2)
centre = MPI.COMM_WORLD.allreduce(body["mass"] @ body.x) / mass
io.say(f"volume of the file {volume:.4f} of the torus; momentum is right to {error:.1e}")
kept = energy() / first
io.say(f"centre {np.array2string(centre, precision=3)} m, from {START}; energy {kept:.3f}")

assert abs(volume - 1) < 0.02
assert error < 1e-9
assert most <= first * (1 + 1e-3)
assert centre[0] > TREADS[0] and centre[2] < START[2] - 0.5  # it has left the first step
