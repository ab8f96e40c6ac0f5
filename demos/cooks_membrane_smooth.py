# SPDX-License-Identifier: MIT
"""Smooth functions: Cook's membrane in motion with few points.

The problem is that of demos/cooks_membrane_dynamic.py. There, points cross cells of linear
functions, whose gradients jump. Each crossing is a small push, and the pushes eat energy unless
there are very many points. Here, displacement and mean stress are quadratic B-splines on a lattice
of squares: their gradients are continuous, and 9 points a square are enough. Four things belong
together (docs/smooth.md):

- splines for both, u and p (``basis.use``), on the nodes of the same lattice;
- the interior penalty on jumps of the gradient of p, in terms of the linear functions of the same
  nodal values, -gamma h^3 / (2 mu) ([grad p . n], [grad q . n]): it makes equal orders stable;
- nodes that see little of the body are tied to the linear continuation of well-filled cells;
- weights of points in full cells are corrected so that constants are integrated exactly.

Kinetic and strain energy less the work of the load should be zero.
"""

from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy, turning_points
from fenicsmpm.materials import NeoHookean

H, PER_SIDE, FUNCTIONS = 0.2, 3, "quadratic"  # m; points along a side of a square
LAW, DENSITY = NeoHookean(E=250.0, nu=0.5), 1.0  # Pa, kg/m^2
TRACTION, TIP = np.array([0.0, 6.25]), (4.8, 6.0)  # Pa, m
DT, END, PICTURES = 0.025, 7.0, (1.35, 2.75)  # s
REFERENCE = Path(__file__).parents[1] / "benchmarks" / "references" / "cook_dynamic.csv"


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

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Bossak(z, dt=DT)
cells = ActiveCells(body, loads=[edge, tip])
R = formulations.mixed(z, body, LAW, force=scheme.force(body))
R += formulations.interior_penalty(z, cells, LAW)
R += formulations.dead_load(z.test.u, edge, TRACTION)


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

t, _, expected = np.loadtxt(REFERENCE, delimiter=",").T
turns = turning_points(t[t <= END], expected[t <= END])
found = turning_points(history["t [s]"], history["u_y of the tip [m]"])
peak = expected.max()
pairs = zip(found[:4], turns[:4], strict=True)
deviations = [(y - y_ref) / peak for (_, y), (_, y_ref) in pairs]
lack = (history["energy [J]"] - history["work [J]"]) / history["work [J]"].max()
io.say("turning points off by " + ", ".join(f"{d:+.1%}" for d in deviations) + " of the first peak")
io.say(f"energy at the end off by {lack[-1]:+.1%} of the largest work")
shown = {"splines, 9 points a square": (history["t [s]"], history["u_y of the tip [m]"])}
curve = {"P2-P1 finite elements": (t[t <= END], expected[t <= END])}
labels = "t [s]", "vertical displacement of the tip [m]"
io.plot("output/cooks_membrane_smooth_tip.png", shown, *labels, reference=curve)
io.picture("output/cooks_membrane_smooth.png", clouds, "p", "mean stress p [Pa]", cut=1)

assert np.abs(deviations).max() < 0.022  # benchmarks/references
assert np.abs(lack).max() < 0.015
