# SPDX-License-Identifier: MIT
"""Bending beam.

An incompressible column of rubber, 1 m x 1 m x 6 m, stands clamped on its base and is thrown to the
side: its initial velocity grows linearly with the height, 5/3 z. It bends far over. The points move
through an unstructured background mesh, whose cells they cross. It is section 6.3 of Moreno,
Wüchner and Larese, "A mixed stabilized MPM formulation for incompressible hyperelastic materials
using Variational Subgrid-Scales" (in short: VMS), with larger cells and longer steps, until it
turns back; studies/columns.py has its table 1 in full.

The formulation is that of demos/cooks_membrane_dynamic.py, in space and without load: in each step

    (rho a, w) + (sigma_dev, grad w) + (p, div w) = 0,   (J - 1, q) = 0

with algebraic subgrid scales, and a ghost penalty on the facets of cells that are only partly
filled. A node at the surface has material on one side only. With ``taylor=True`` points continue
their velocities linearly to the nodes. Points lie on a cubic lattice: the cells of an unstructured
mesh differ in size, equal points do not. It begins at the corner of the mesh and fits the column's.
Points that cross faces cost some energy, the less, the more there are.
"""

import sys
from pathlib import Path

import numpy as np

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "meshes"))
from column import column  # unstructured tetrahedra, by Gmsh

H, SPACING = 1 / 3, 1 / 12  # m, of cells and points, about 12 a cell (paper: down to 1/8 m)
LAW, DENSITY = NeoHookean(E=1.7e7, nu=0.5), 1100.0  # Pa, kg/m^3
DT, TIMES, TIP = 0.01, (0.25, 0.5), (0.5, 0.5, 6.0)  # s (paper: 0.001), s, m

domain, _ = column(H, (-4.5, -1.0, 0.0), (4.5, 1.0, 7.0))
body = points.lattice(domain, SPACING, lambda x: np.all(np.abs(x) < [[0.5], [0.5], [6.0]], axis=0))
formulations.set_initial_state(body, DENSITY, lambda x: np.outer((5 / 3, 0, 0), x[2]))  # m/s
tip = points.at(domain, TIP)

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[2], 0))
scheme = formulations.Bossak(z, dt=DT)
force = scheme.force(body)  # less inertia
cells = ActiveCells(body, loads=[tip])
R = formulations.mixed(z, body, LAW, force=force) + formulations.asgs(z, body, LAW, force=force)
R += formulations.ghost_penalty(z, cells, LAW)

history = io.History({"u_x of the corner [m]": lambda sim: probe(tip, "u")[0]})
sim = ImplicitMPM(
    R, z, scheme, body, carried=[tip], taylor=True,
    observers=[lambda sim, step: correct_weights(body, cells), history],
)  # fmt: skip
clouds = {"t = 0": io.gather_points(body)}
for end in TIMES:
    for _ in io.watch(sim.run(end), end, "bending beam"):
        pass
    clouds[f"t = {end:g} s"] = io.gather_points(body)

reference = ROOT / "benchmarks" / "references" / "bending_beam.csv"
t, known, *_ = np.loadtxt(reference, delimiter=",").T
t, known = t[t <= TIMES[-1]], known[t <= TIMES[-1]]
found = np.interp(t, history["t [s]"], history["u_x of the corner [m]"])
deviation = np.abs(found - known).max() / known.max()
volume = body.mesh.comm.allreduce(body["V_0"] @ body["J"])
io.say(f"u_x up to {found.max():.4f} m, P2-P1 finite elements {known.max():.4f} m")
io.say(f"largest deviation {deviation:.1%} of it; volume {volume:.4f} m^3 of 6 m^3")
io.plot("output/bending_beam_corner.png", history, reference={"P2-P1 elements": (t, known)})
io.picture("output/bending_beam.png", clouds, "p", "mean stress p [Pa]", cut=1)

assert abs(found.max() / known.max() - 1) < 0.05  # benchmarks/references
assert deviation < 0.06
assert abs(volume / 6 - 1) < 0.001  # incompressible
