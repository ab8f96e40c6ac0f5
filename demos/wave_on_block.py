# SPDX-License-Identifier: MIT

# # Wave against an elastic block
#
# Water runs against a block of rubber that is fixed to the floor. The block bends, springs back and
# swings, and the water shoots up and over it. Fluid-structure interaction usually means two codes
# and an interface between them. Here it is a `+` between two forms: both bodies are sets of points
# on one background mesh.
#
# ## Problem
#
# The water is that of the [dam break](dam_break_implicit.py), incompressible in each step. The
# block is a nearly incompressible neo-Hookean solid with $\det\mathbf F - 1 = p/\kappa$. Both are
# computed in displacement and pressure with subgrid scales. For all $\mathbf w$ and $q$,
#
# $$
# R_\mathrm{water}(\mathbf u, p; \mathbf w, q) + R_\mathrm{block}(\mathbf u, p; \mathbf w, q) = 0 .
# $$
#
# The two bodies share the displacements of nodes that both see. They do not slip where they touch,
# and the pressure is continuous.
#
# The problem is our own. Until it meets the block, the front of the water must run as J. C. Martin
# and W. J. Moyce measured (Phil. Trans. R. Soc. A 244, 1952, table 2). Only weight does work, so
# the sum of kinetic, potential and strain energy can only decrease: by viscosity, in the impact,
# and by the time scheme. The deflection has no reference. It depends on the mesh.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy
from fenicsmpm.materials import NeoHookean

# -

BOX, H = (4.0, 4.0), 0.1  # of the mesh, and size of its cells, m
WIDTH, HEIGHT, LEFT, RIGHT, TOP = 1.0, 2.0, 2.0, 2.4, 0.8  # of water and block, m
DT, END, CORRECTION = 4e-3, 1.0, 0.1  # s, s, share of a step
WATER, VISCOSITY, GRAVITY = 1000.0, 1e-3, 9.81  # kg/m^3, Pa s, m/s^2
BLOCK, RUBBER = 1200.0, NeoHookean(E=2e5, nu=0.45)  # kg/m^3, Pa
SHOWN = 0.5, 0.7, 0.9  # s
FRONT, ARRIVAL = 1.89, 1.63 / (2 * GRAVITY / WIDTH) ** 0.5  # m, s, of the experiment

# ## Bodies
#
# `corner` is a point without mass at the upper left corner of the block. It is carried along and
# tells the deflection.

domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), BOX], [round(side / H) for side in BOX],
    diagonal=mesh.DiagonalType.crossed,
)  # fmt: skip
water = points.quadrature(domain, degree=4, inside=lambda x: (x[0] < WIDTH) & (x[1] < HEIGHT))
block = points.quadrature(
    domain, degree=4, inside=lambda x: (x[0] > LEFT) & (x[0] < RIGHT) & (x[1] < TOP)
)
formulations.set_initial_state(water, WATER)
formulations.set_initial_state(block, BLOCK)
corner = points.at(domain, (LEFT + 1e-3, TOP - 1e-3))

# ## Weak form
#
# The loop adds the same three terms of both bodies. Beside a solid, $\det\mathbf f = 1$ keeps the
# volume of the water less well than alone, because the solid's residual is the fluid's loss. In
# each step, `correction` takes back a tenth of what has gathered.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0) | np.isclose(x[0], BOX[0]), component=0)
z.fix("u", lambda x: np.isclose(x[1], 0))
scheme = formulations.BDF2(z, dt=DT)
flow = formulations.NewtonianFlow(VISCOSITY, WATER, scheme, correction=CORRECTION)
g = fem.Constant(domain, (0.0, -GRAVITY))
R = 0
for body, law in (water, flow), (block, RUBBER):
    R += formulations.mixed(z, body, law, force=formulations.density(body) * g)
    R += formulations.asgs(z, body, law, force=scheme.force(body, g)) + scheme.lumped(body)

# ## Time steps


def potential(body):
    return domain.comm.allreduce(GRAVITY * body["mass"] @ body.x[:, 1])


history = io.History({
    "deflection [m]": lambda sim: probe(corner, "u")[0],
    "front": lambda sim: water.bounds()[1][0],
    "mechanical": lambda sim: sum(kinetic_energy(body) + potential(body) for body in sim.bodies),
    "strain": lambda sim: strain_energy(block, RUBBER),
    "volume": lambda sim: domain.comm.allreduce(water["V_0"] @ water["dilation"]),
})  # fmt: skip
sim = ImplicitMPM(R, z, scheme, [water, block], carried=[corner], observers=[history])
clouds = {}
for step in io.watch(sim.run(END), END, "wave"):
    if any(abs(step.time - time) < DT / 2 for time in SHOWN):
        clouds[f"t = {step.time:.2g} s"] = io.gather_points(sim.bodies)

# ## Results

io.picture("output/wave_on_block.png", clouds, "p", "mean stress [Pa]", cut=2)

# Front, energy and volume are checked, the deflection is only shown.

t, deflection, energy = (history[title] for title in ("t [s]", "deflection [m]", "mechanical"))
energy = energy + history["strain"]
gain, change = np.diff(energy).max() / energy[0], np.abs(history["volume"]).max() / water.volume()
arrival = t[np.argmax(history["front"] >= FRONT)]
io.say(f"front at {FRONT} m after {arrival:.3f} s, experiment {ARRIVAL:.3f} s")
io.say(f"largest deflection {deflection.max():.3f} m at {t[deflection.argmax()]:.2f} s")
io.say(f"energy: {energy[-1] / energy[0]:.1%} are left, the largest gain of a step is {gain:.1e}")
io.say(f"volume of the water: {change:.2%} are unaccounted for")
curve = {"corner": (t, deflection)}
io.plot("output/wave_on_block_deflection.png", curve, "t [s]", "deflection [m]")

assert abs(arrival / ARRIVAL - 1) < 0.08  # Martin and Moyce
assert change < 0.02  # det f = 1
assert gain < 1e-6  # conservation of energy, less what is dissipated
