# SPDX-License-Identifier: MIT

# # Contact of two discs
#
# Two bodies may share the velocities of the grid. They then stick to each other as soon as they see
# the same nodes, one or two cells before they touch, and never separate cleanly. A `Contact` gives
# each body its own nodal velocities. Two elastic discs now meet when they really touch, and part
# with nearly all of their energy.
#
# ## Problem
#
# The case is that of D. Sulsky, Z. Chen and H. L. Schreyer (*A particle method for
# history-dependent materials*, CMAME 118, 1994). Two discs of radius $R$ fly head-on along the
# diagonal of a unit square. They must feel each other when the distance of their centres is
#
# $$
# |\mathbf x_2 - \mathbf x_1| = 2R,
# $$
#
# and not before. Their total momentum must stay zero. After the contact, the sum of kinetic and
# strain energy should be what it was, except for what waves in the discs lose.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, formulations, io, points
from fenicsmpm.diagnostics import kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import Hencky
from fenicsmpm.simulation import Contact

# -

CELLS, PER_SIDE, FRICTION = 20, 4, 0.0  # along a side of 1 m; points along a side of a cell
RADIUS, SPEED, DENSITY, LAW = 0.2, 0.1, 1000.0, Hencky(E=1000.0, nu=0.3)  # m, m/s, kg/m^3, Pa
CENTRES, END, PICTURES = (0.25, 0.75), 2.8, (0.0, 1.5, 2.8)  # m, s

# ## Discs
#
# Each disc is a set of points of its own.

h = 1 / CELLS
domain = mesh.create_unit_square(MPI.COMM_WORLD, CELLS, CELLS, mesh.CellType.quadrilateral)
discs = []
for centre, speed in zip(CENTRES, (SPEED, -SPEED), strict=True):
    disc = points.lattice(
        domain, h / PER_SIDE, inside=lambda x, c=centre: np.hypot(x[0] - c, x[1] - c) < RADIUS
    )
    formulations.set_initial_state(disc, DENSITY, (speed, speed))
    discs.append(disc)

# ## Simulation
#
# The forms of both discs are added. The contact acts between their nodal velocities: it takes away
# what brings the bodies together, if the domains of their points meet, and pulls nothing back
# afterwards. `contact.force` is the force that it has used in the last step.


def middle(disc):
    mass = domain.comm.allreduce(disc["mass"].sum())
    return domain.comm.allreduce(disc["mass"] @ disc.x) / mass


z = formulations.Unknown(domain, "v")
R, other = (formulations.internal_force(z.test.v, disc, LAW) for disc in discs)
R += other
contact = Contact(*discs, friction=FRICTION)
history = io.History(
    {
        "kinetic energy [J]": lambda sim: sum(map(kinetic_energy, discs)),
        "strain energy [J]": lambda sim: sum(strain_energy(disc, LAW) for disc in discs),
        "contact force [N]": lambda sim: np.linalg.norm(contact.force),
        "distance [m]": lambda sim: np.linalg.norm(middle(discs[1]) - middle(discs[0])),
    }
)
sim, clouds = ExplicitMPM(R, z, discs, contacts=[contact], observers=[history]), {}
for end in PICTURES:
    for _ in io.watch(sim.run(end), end, "two discs"):
        pass
    clouds[f"t = {end} s"] = io.gather_points(discs)

# ## Results

io.picture("output/two_discs.png", clouds, "v", "speed [m/s]")

# The contact begins within a quarter of a cell of the true gap.

energy = history["kinetic energy [J]"] + history["strain energy [J]"]
force, distance = history["contact force [N]"], history["distance [m]"]
first = (distance[np.argmax(force > 0) - 1] - 2 * RADIUS) / h
kept = energy[-1] / energy[0]
left = np.abs(sum(map(momentum, discs))).max() / (DENSITY * np.pi * RADIUS**2 * SPEED)
io.say(f"contact begins at a gap of {first:.2f} cells; {kept:.1%} of the energy is left")
io.say(f"momentum is zero to {left:.0e} of that of a disc")
names = ("kinetic energy [J]", "strain energy [J]")
curves = {name[:-4]: (history["t [s]"], history[name]) for name in names}
io.plot("output/two_discs_energy.png", curves, "t [s]", "energy [J]")

assert abs(first) < 0.25 and kept > 0.95 and left < 1e-12
