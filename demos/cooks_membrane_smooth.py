# SPDX-License-Identifier: MIT

# # Cook's membrane on B-splines
#
# The gradients of linear functions jump across the edges of cells. Each material point that crosses
# an edge gets a small push, and the pushes eat energy, unless there are very many points. The panel
# of [Cook's membrane in motion](cooks_membrane_dynamic.py) needs 33 points in a triangle. Here it
# swings on quadratic B-splines, whose gradients are continuous. Nine points in a square are enough,
# and after two and a half oscillations the energy is still there.
#
# ## Formulation
#
# Displacement and mean stress are both sums of B-splines, of the nodes of the same lattice of
# squares. The balance of momentum is that of the triangles, and the constraint has an interior
# penalty (E. Burman and P. Hansbo, CMAME 195, 2006) instead of subgrid scales:
#
# $$
# \begin{aligned}
# (\rho\,\mathbf a, \mathbf w) + (\boldsymbol\sigma_\mathrm{dev}, \nabla\mathbf w)
# + (p, \nabla\cdot\mathbf w) &= \langle\mathbf t, \mathbf w\rangle_\mathrm{edge}, \\
# (J - 1, q) - \frac{\gamma h^3}{2\mu}
# \big([\nabla p\cdot\mathbf n], [\nabla q\cdot\mathbf n]\big) &= 0 .
# \end{aligned}
# $$
#
# Four things belong together:
#
# - B-splines for both $\mathbf u$ and $p$, chosen by `basis.use`.
# - The interior penalty, which makes equal orders stable. These splines have no kinks, so the
#   penalty is taken on the linear functions of the same nodal values, whose jumps $[\,\cdot\,]$ are
#   second differences.
# - Tied nodes. A node that sees little of the body takes the linear continuation of well-filled
#   cells.
# - Corrected weights, which integrate constants exactly in full cells.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy, turning_points
from fenicsmpm.materials import NeoHookean

# -

H, PER_SIDE, FUNCTIONS = 0.2, 3, "quadratic"  # m; points along a side of a square
LAW, DENSITY = NeoHookean(E=250.0, nu=0.5), 1.0  # Pa, kg/m^2
TRACTION, TIP = np.array([0.0, 6.25]), (4.8, 6.0)  # Pa, m
DT, END, PICTURES = 0.025, 7.0, (1.35, 2.75)  # s

# ## Bodies
#
# Splines reach beyond the neighbouring cell. The partitioner gives each rank the cells that its
# points see.


def panel(x):
    return (x[0] <= 4.8) & (x[1] >= x[0] * 4.4 / 4.8) & (x[1] <= 4.4 + x[0] * 1.6 / 4.8)


domain = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, -1), (6, 9)], [round(6 / H), round(10 / H)],
    mesh.CellType.quadrilateral, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
body = points.lattice(domain, H / PER_SIDE, inside=panel)
formulations.set_initial_state(body, DENSITY)
edge = points.on_curve(domain, (4.8, 4.4), TIP, spacing=H / 5)
tip = points.at(domain, TIP)
for p in (body, edge, tip):
    basis.use(p, FUNCTIONS)

# ## Weak form
#
# Only one line differs from linear triangles: `interior_penalty` instead of `asgs`.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Bossak(z, dt=DT)
cells = ActiveCells(body, loads=[edge, tip])
R = formulations.mixed(z, body, LAW, force=scheme.force(body))
R += formulations.interior_penalty(z, cells, LAW)
R += formulations.dead_load(z.test.u, edge, TRACTION)

# ## Time steps
#
# The history has the energy of the panel and the work of the load. Their difference should be zero.

columns = {
    "u_y of the tip [m]": lambda sim: probe(tip, "u")[1],
    "energy [J]": lambda sim: kinetic_energy(body) + strain_energy(body, LAW),
    "work [J]": lambda sim: body.mesh.comm.allreduce(edge.weight @ (edge["u"] @ TRACTION)),
}
history = io.History(columns)
sim = ImplicitMPM(
    R, z, scheme, body, carried=[edge, tip], newton={"tying": Tying(z.space, body, cells)},
    observers=[lambda sim, step: correct_weights(body, cells), history],
)  # fmt: skip
clouds = {}
for end in (*PICTURES, END):
    for _ in io.watch(sim.run(end), end, "Cook's membrane, smooth"):
        pass
    clouds[f"t = {end} s"] = io.gather_points(body)

# ## Results
#
# The pressure at the first peak, at the first minimum, and after 7 s:

io.picture("output/cooks_membrane_smooth.png", clouds, "p", "mean stress p [Pa]", cut=1)

# The turning points of the tip are compared with those of total Lagrangian P2-P1 finite elements.

reference = Path(fenicsmpm.__file__).parents[1] / "benchmarks" / "references" / "cook_dynamic.csv"
t, _, expected = np.loadtxt(reference, delimiter=",").T
turns = turning_points(t[t <= END], expected[t <= END])
found = turning_points(history["t [s]"], history["u_y of the tip [m]"])
peak = expected.max()
pairs = zip(found[:4], turns[:4], strict=True)
deviations = [(y - y_ref) / peak for (_, y), (_, y_ref) in pairs]
lack = (history["energy [J]"] - history["work [J]"]) / history["work [J]"].max()
io.say("turning points off by " + ", ".join(f"{d:+.1%}" for d in deviations) + " of the first peak")
io.say(f"energy at the end off by {lack[-1]:+.1%} of the largest work")

# The amplitude stays, because hardly any energy gets lost.

shown = {"splines, 9 points a square": (history["t [s]"], history["u_y of the tip [m]"])}
curve = {"P2-P1 finite elements": (t[t <= END], expected[t <= END])}
labels = "t [s]", "vertical displacement of the tip [m]"
io.plot("output/cooks_membrane_smooth_tip.png", shown, *labels, reference=curve)

assert np.abs(deviations).max() < 0.022  # benchmarks/references
assert np.abs(lack).max() < 0.015
