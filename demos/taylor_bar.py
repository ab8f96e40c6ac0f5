# SPDX-License-Identifier: MIT

# # Taylor bar
#
# A copper bar hits a rigid wall at 227 m/s. Its foot spreads like a mushroom, and within 80
# microseconds most of its energy has become plastic work. This is the classical benchmark of
# transient codes. They agree that the bar ends 21.4 to 21.5 mm long, with a foot of 7.0 to 7.2 mm
# radius. Here an implicit step that conserves energy comes within a percent of both numbers, in
# about a hundred steps.
#
# The data are those of section 7.4 of G. Pretti, W. M. Coombs, C. E. Augarde, B. Sims, M. Marchena
# Puigvert and J. A. Reyna Gutiérrez, *A conservation law consistent updated Lagrangian material
# point method for dynamic analysis* (2023), with half as many cells along each axis and steps twice
# as long. `studies/conserving.py` has the paper's.
#
# ## Problem
#
# The formulation is that of the [plastic cylinders](cylinder_collision.py), in three dimensions,
# with uGIMP and linear hardening (equation 63 of the paper):
#
# $$
# \sqrt{2 J_2} \le \sqrt{\tfrac 2 3}\,(\sigma_y + H\,\varepsilon_p) .
# $$
#
# Kinetic, free and dissipated energy add up to what the bar had at first. A quarter of the bar is
# computed. Its axis is $y$, the planes $x = 0$ and $z = 0$ are those of symmetry, and $y = 0$ is
# the wall, on which the bar may slide.

# +
import itertools

from mpi4py import MPI

import numpy as np
import pyvista
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import VonMises

# -

RADIUS, LENGTH, WIDTH = 3.2e-3, 32.4e-3, 7.2e-3  # of the bar, and of the mesh, m
BULK, SHEAR, DENSITY = 130e9, 43.3e9, 8930.0  # Pa, Pa, kg/m^3
SIGMA_Y, HARDENING = 0.4e9, 0.1e9  # Pa
SPEED, END, DT = 227.0, 80e-6, 0.75e-6  # m/s, s, s
ALONG, ACROSS, PER_SIDE = 25, 4, 2  # cells, points along their sides
FINAL_LENGTH, FINAL_RADIUS = 21.45e-3, 7.1e-3  # m, middle of 21.4 ... 21.5 and 7.0 ... 7.2

# ## Bar
#
# The cells are longer across the bar than along it, and so are the boxes of the points. The field
# `r` remembers how far from the axis a point was.

law = VonMises(
    E=9 * BULK * SHEAR / (3 * BULK + SHEAR),
    nu=(3 * BULK - 2 * SHEAR) / (2 * (3 * BULK + SHEAR)),
    sigma_y=SIGMA_Y,
    H=HARDENING,
)
domain = mesh.create_box(
    MPI.COMM_WORLD, [(0, 0, 0), (WIDTH, LENGTH, WIDTH)], [ACROSS, ALONG, ACROSS],
    mesh.CellType.hexahedron, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
spacing = np.array([WIDTH / ACROSS, LENGTH / ALONG, WIDTH / ACROSS]) / PER_SIDE
bar = points.lattice(domain, spacing, inside=lambda x: np.hypot(x[0], x[2]) < RADIUS)
basis.use(bar, "gimp", spacing / 2)
bar.add_field("r", (), np.hypot(bar.x[:, 0], bar.x[:, 2]))
formulations.set_initial_state(bar, DENSITY, velocity=(0.0, -SPEED, 0.0))

# ## Time steps
#
# Nodes with few points, at the rim, follow those of well-filled cells. The `line_search` helps
# Newton's method where points begin to yield.

z = formulations.Unknown(domain, "u")
for axis in range(3):
    z.fix("u", lambda x, axis=axis: np.isclose(x[axis], 0), component=axis)
scheme = formulations.Midpoint(z, dt=DT)
R = formulations.EnergyMomentum(law, bar, z).power() + scheme.inertia(bar)
energies = io.History({
    "kinetic": lambda sim: kinetic_energy(bar),
    "free": lambda sim: strain_energy(bar, law),
    "dissipated": lambda sim: domain.comm.allreduce(bar["V_0"] @ bar["dissipation"]),
})  # fmt: skip
tying = Tying(z.space, bar, ActiveCells(bar), threshold=0.1)
newton = {"rtol": 1e-10, "line_search": True, "tying": tying}
sim = ImplicitMPM(R, z, scheme, bar, observers=[energies], newton=newton)
clouds = {}
for step in io.watch(sim.run(END), END, "Taylor bar"):
    if step.number in (round(END / DT / 8), round(END / DT / 3), round(END / DT)):
        clouds[f"t = {1e6 * step.time:.3g} us"] = io.gather_points(bar)

# ## Results
#
# The picture shows the whole bar, upright: the quarter and its mirror images. Points are on rank 0
# only.


def whole(cloud):
    if cloud is None:
        return None
    x, y, z = cloud.points.T
    parts = []
    for a, b in itertools.product((1, -1), repeat=2):
        parts.append(cloud.copy())
        parts[-1].points = np.column_stack([a * x, b * z, y])
    return pyvista.merge(parts, merge_points=False)


bars = {title: whole(cloud) for title, cloud in clouds.items()}
io.picture("output/taylor_bar.png", bars, "dissipation", "dissipated [J/m^3]", cut=1)

# Length and radius agree with other codes. The points at the ends of the bar tell how much both
# have changed.

down, wider = -bar["u"][:, 1], np.hypot(bar.x[:, 0], bar.x[:, 2]) - bar["r"]
down, wider = (domain.comm.allreduce(a.max(initial=0.0), MPI.MAX) for a in (down, wider))
length, radius = LENGTH - down, RADIUS + wider
t, *parts = (energies[title] for title in energies.titles)
total = sum(parts)
drift = np.ptp(total) / total[0]
io.say(f"length {1e3 * length:.2f} mm, by other codes 21.4 ... 21.5 mm")
io.say(f"radius {1e3 * radius:.2f} mm, by other codes 7.0 ... 7.2 mm")
io.say(f"{parts[-1][-1] / total[0]:.1%} dissipated; the sum of energies changes by {drift:.1e}")

# The sum of the energies is constant from the impact to the rest.

curves = {title: (1e6 * t, energies[title]) for title in energies.titles[1:]}
curves["sum"] = 1e6 * t, total
io.plot("output/taylor_bar_energies.png", curves, "t [us]", "energy [J]")

assert abs(length / FINAL_LENGTH - 1) < 0.01 and abs(radius / FINAL_RADIUS - 1) < 0.01
assert drift < 1e-9  # conservation of energy
assert np.all(np.diff(parts[-1]) > -1e-9 * total[0])  # second law
