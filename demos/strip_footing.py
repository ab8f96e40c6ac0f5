# SPDX-License-Identifier: MIT

# # Strip footing
#
# A rigid strip is pressed into soft clay, which yields without change of volume. L. Prandtl found
# in 1920 what the ground can bear: $2 + \pi$ times its shear strength. A method that locks finds no
# such limit, and the ground bears ever more. This demo presses the strip with averaged volumes and
# without, and compares both loads with Prandtl's.
#
# The problem is section 4.2 of Y. Zhao, C. Jiang and J. Choo, *Circumventing volumetric locking in
# explicit material point methods: A simple, efficient, and general approach* (F-bar).
#
# ## Problem
#
# The clay obeys Hencky's elasticity and von Mises' plasticity. In plane strain, the yield stress is
# $\sqrt 3$ times the shear strength $s$. The strip has the width $B$, and the load $Q$ per length
# at failure is
#
# $$
# \frac{Q}{B\,s} = 2 + \pi .
# $$
#
# Stresses follow from averages $\bar J$ (F-bar, equations 18 to 20), as in [explicit Cook's
# membrane](cooks_membrane_explicit.py). For a law that flows, the true $J$ is drawn to its average,
# too.
#
# Only the half beside the axis of symmetry is computed. The paper has finer cells and ground of
# $6B$ by $6B$, which bears the same: what yields is $0.7B$ deep and $1.5B$ wide.

# +
import math

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, RigidBody, basis, formulations, io, points, shapes
from fenicsmpm.materials import VonMises

# -

B, CELLS, SIZE = 1.0, 12, 4  # m; cells along B; depth and width of the ground in B
STRENGTH = 100.0  # undrained, Pa
CLAY, DENSITY = VonMises(E=1e6, nu=0.49, sigma_y=math.sqrt(3) * STRENGTH), 1000.0  # kg/m^3
SETTLEMENT, SPEED = 0.004, 1e-5  # at the end in B; of the footing per speed of pressure waves
AVERAGES = {"F-bar": "default", "no averages": None}
PRANDTL = 2 + math.pi

# ## Simulation
#
# The footing is a rigid body. It pushes points by a barrier, and friction without limit holds what
# touches it. Its lower face is half a point's distance above the highest points. It moves slowly,
# and a little local damping takes the waves that it makes.

h, top = B / CELLS, SIZE * B
speed = SPEED * math.sqrt(CLAY.wave_speed_modulus / DENSITY)  # m/s
until = SETTLEMENT * B / speed
curves, clouds, plateaus = {}, {}, {}
for name, averages in AVERAGES.items():
    n = SIZE * CELLS
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (top, top + 4 * h)], [n, n + 4], mesh.CellType.quadrilateral
    )
    ground = points.lattice(domain, h / 2, inside=lambda x: x[1] < top)
    basis.use(ground, "quadratic")
    formulations.set_initial_state(ground, DENSITY)
    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], top), component=0)
    z.fix("v", lambda x: np.isclose(x[1], 0), component=1)
    footing = RigidBody(
        shapes.Box((-B, top), (B / 2, math.inf)), reach=h / 4, velocity=(0.0, -speed),
        friction=math.inf,
    )  # fmt: skip
    R = formulations.internal_force(z.test.v, ground, CLAY, fbar=averages)
    history = io.History({"load": lambda sim: -sim.rigid[0].force[1] / (B / 2 * STRENGTH)})
    sim = ExplicitMPM(R, z, ground, damping=0.002, rigid=[footing], observers=[history])
    for _ in io.watch(sim.run(until, until / 200), until, name):
        pass

    curves[name] = speed * history["t [s]"] / B, history["load"]
    plateaus[name] = history["load"][-40:].mean()
    io.say(f"{name}: load {plateaus[name]:.3f} times the strength, Prandtl {PRANDTL:.3f}")
    clouds[name] = io.gather_points(ground)

# ## Results
#
# With averages, the ground moves as in Prandtl's mechanism: a wedge goes down with the strip, and a
# fan turns at its edge and pushes the ground beside it up. Mean stresses still alternate between
# rows of cells under the strip, because what alternates from node to node causes no nodal forces.
# Other shares $r$ and $s$ of the averages leave these stripes. `FBar(r=0.03, s=100)` halves them,
# but its load still rises here, and on cells of $B/20$ it is 16 percent below Prandtl's. Without
# averages, stresses are noise.

around = (0, top - 1.5 * B), (2.5 * B, top)
io.picture("output/strip_footing.png", clouds, "u", "displacement [m]", bounds=around)

# The load reaches a plateau close to Prandtl's. Finer cells come closer: see
# `studies/explicit.py footing`, which has other averages and uGIMP, too.

labels = "settlement / width of the footing", "load / shear strength"
io.plot("output/strip_footing_load.png", curves, *labels, reference={"Prandtl": PRANDTL})

assert abs(plateaus["F-bar"] / PRANDTL - 1) < 0.08  # Prandtl, of cells that are coarse
assert plateaus["no averages"] > 1.15 * PRANDTL  # locks
