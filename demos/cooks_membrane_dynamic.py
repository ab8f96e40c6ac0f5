# SPDX-License-Identifier: MIT
"""Cook's membrane in motion.

The panel of demos/cooks_membrane.py, a tenth of its size, is loaded on its right edge at once and
swings up and down. Material points move through a background mesh that knows nothing of the panel's
boundary. It is the dynamic example of section 6.2 of Moreno, Wüchner and Larese, "A mixed
stabilized MPM formulation for incompressible hyperelastic materials using Variational
Subgrid-Scales", here on a coarser mesh; studies/cooks_membrane_dynamic.py has its figures.

In each step, the increment u of the displacement and the mean stress p are sought on the undeformed
background mesh such that, with integrals that are sums over material points,

    (rho a, w) + (sigma_dev, grad w) + (p, div w) = (t, w) on the initial edge,   (J - 1, q) = 0.

The acceleration a is an expression in u and in the histories of the points, mapped to the grid. The
load is dead: it keeps its direction, and boundary points carry it. J = 1 at the end of each step
makes Newmark's method only weakly stable; Bossak's damps high frequencies, which is enough.

In cells that are filled only partly, nodes have nearly no mass and stiffness. The ghost penalty on
jumps of gradients over the facets of such cells lets them follow their neighbours. Points that have
crossed edges leave cells overfull or with gaps: corrected weights integrate constants exactly in
full cells. This halves the error of the first minimum.
"""

from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean

H, PER_CELL = 0.2, 33  # m, edges of the triangles along the axes (paper: 0.1); points in one
LAW, DENSITY = NeoHookean(E=250.0, nu=0.5), 1.0  # Pa, kg/m^2
TRACTION, TIP = (0.0, 6.25), (4.8, 6.0)  # Pa, m
DT, TURNS = 0.025, (1.35, 2.75)  # s; first peak and first minimum
REFERENCE = Path(__file__).parents[1] / "benchmarks" / "references" / "cook_dynamic.csv"


def panel(x):
    return (x[0] <= 4.8) & (x[1] >= x[0] * 4.4 / 4.8) & (x[1] <= 4.4 + x[0] * 1.6 / 4.8)


domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -1), (6, 9)], [round(6 / H), round(10 / H)])
body = points.lattice(domain, H * np.sqrt(0.5 / PER_CELL), inside=panel)
formulations.set_initial_state(body, DENSITY)
edge = points.on_curve(domain, (4.8, 4.4), TIP, spacing=H / 5)
tip = points.at(domain, TIP)

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Bossak(z, dt=DT)
cells = ActiveCells(body, loads=[edge, tip])
force = scheme.force(body)  # less inertia
R = formulations.mixed(z, body, LAW, force=force) + formulations.asgs(z, body, LAW, force=force)
R += formulations.ghost_penalty(z, cells, LAW) + formulations.dead_load(z.test.u, edge, TRACTION)

history = io.History({"u_y of the tip [m]": lambda sim: probe(tip, "u")[1]})
observers = [lambda sim, step: correct_weights(body, cells), history]
sim = ImplicitMPM(R, z, scheme, body, carried=[edge, tip], observers=observers)
clouds = {}
for end in TURNS:
    for _ in io.watch(sim.run(end), end, "Cook's membrane"):
        pass
    clouds[f"t = {end} s"] = io.gather_points(body)

t, _, expected = np.loadtxt(REFERENCE, delimiter=",").T
found = np.interp(t, history["t [s]"], history["u_y of the tip [m]"])
peak, deviation = expected.max(), np.abs(found - expected)[t <= TURNS[-1]].max()
io.say(f"first peak {found.max():.4f} m, P2-P1 finite elements {peak:.4f} m")
io.say(f"largest deviation until t = {TURNS[-1]} s: {deviation / peak:.1%} of it")
curve = {"P2-P1 finite elements": (t[t <= TURNS[-1]], expected[t <= TURNS[-1]])}
io.plot("output/cooks_membrane_dynamic_tip.png", history, reference=curve)
io.picture("output/cooks_membrane_dynamic.png", clouds, "p", "mean stress p [Pa]", cut=1)

assert abs(found.max() / peak - 1) < 0.01  # benchmarks/references
assert deviation < 0.04 * peak  # less with smaller cells: docs/dynamics.md
