# SPDX-License-Identifier: MIT
"""Bending beam that keeps its energy.

The column of demos/bending_beam.py is thrown to the side, and bends far over while its points cross
many cells, which costs energy with linear functions. Here, 3072 points see quadratic B-splines on
cubes, and the energy-momentum method keeps the sum of kinetic energy, strain energy and what
stabilization stores, to round-off:

    (rho (v_1 - v_0) / dt, w) + (F_m S, grad w) + (p, Delta J[w]) = 0,
    (Delta J, q) - alpha / mu h^2 (Delta r, grad grad q) = 0

with positions, velocities and p of the middle of the step, S : Delta C / 2 exactly the isochoric
energy that is gained, and a tensor r at the points that follows h^2 grad grad p. That term punishes
second derivatives of the pressure, as the interior penalty punishes jumps of its gradient; what it
stores is alpha |r|^2 / (2 mu) (``MixedEnergyMomentum``, docs/smooth.md). Nodes that see little of
the column are tied to the linear continuation of well-filled cubes.
"""

from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy
from fenicsmpm.materials import NeoHookean

H, PER_SIDE, FUNCTIONS = 0.25, 2, "quadratic"  # m; points along a side of a cube
LAW, DENSITY = NeoHookean(E=1.7e7, nu=0.5), 1100.0  # Pa, kg/m^3
DT, TIMES, TIP = 0.01, (0.25, 0.5), (0.5, 0.5, 6.0)  # s, s, m
REFERENCE = Path(__file__).parents[1] / "benchmarks" / "references" / "bending_beam.csv"

domain = mesh.create_box(
    MPI.COMM_WORLD, [(-1, -1, 0), (4, 1, 7)], [round(side / H) for side in (5, 2, 7)],
    mesh.CellType.hexahedron, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
body = points.lattice(domain, H / PER_SIDE, lambda x: np.all(np.abs(x[:2]) < 0.5, 0) & (x[2] < 6))
formulations.set_initial_state(body, DENSITY, lambda x: np.outer((5 / 3, 0, 0), x[2]))  # m/s
tip = points.at(domain, TIP)
for p in (body, tip):
    basis.use(p, FUNCTIONS)

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[2], 0))
scheme = formulations.Midpoint(z, dt=DT)
stress = formulations.MixedEnergyMomentum(LAW, body, z)
R = stress.power() + scheme.inertia(body)
columns = {
    "u_x of the corner [m]": lambda sim: probe(tip, "u")[0],
    "kinetic [J]": lambda sim: kinetic_energy(body),
    "strain [J]": lambda sim: strain_energy(body, LAW) + stress.volumetric_energy(),
}
history = io.History(columns)
newton = {"rtol": 1e-10, "tying": Tying(z.space, body, ActiveCells(body, loads=[tip]))}
sim = ImplicitMPM(R, z, scheme, body, carried=[tip], observers=[history], newton=newton)
clouds = {"t = 0": io.gather_points(body)}
for end in TIMES:
    for _ in io.watch(sim.run(end), end, "bending beam, smooth"):
        pass
    clouds[f"t = {end:g} s"] = io.gather_points(body)

t, known, *_ = np.loadtxt(REFERENCE, delimiter=",").T
t, known = t[t <= TIMES[-1]], known[t <= TIMES[-1]]
found = np.interp(t, history["t [s]"], history["u_x of the corner [m]"])
deviation = np.abs(found - known).max() / known.max()
energy = history["kinetic [J]"] + history["strain [J]"]
io.say(f"u_x up to {found.max():.4f} m, P2-P1 finite elements {known.max():.4f} m")
io.say(f"largest deviation {deviation:.1%} of it")
io.say(f"energy changed by up to {np.abs(energy / energy[0] - 1).max():.1e}")
shown = {"splines, 8 points a cube": (history["t [s]"], history["u_x of the corner [m]"])}
curve = {"P2-P1 finite elements": (t, known)}
io.plot("output/bending_beam_smooth_corner.png", shown, "t [s]", "u_x [m]", reference=curve)
io.picture("output/bending_beam_smooth.png", clouds, "p", "mean stress p [Pa]", cut=1)

assert abs(found.max() / known.max() - 1) < 0.02  # benchmarks/references
assert deviation < 0.03
assert np.abs(energy / energy[0] - 1).max() < 1e-8
