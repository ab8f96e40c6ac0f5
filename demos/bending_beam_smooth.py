# SPDX-License-Identifier: MIT

# # Bending beam that keeps its energy
#
# Rubber does not stop swinging for no reason, but many simulations of it do: the time scheme damps,
# and so does each point that crosses a face. Here nothing damps. The column of the [bending
# beam](bending_beam.py) is thrown to the side, its points cross many cells, and the sum of all
# energies is kept to round-off. Two things do it: B-splines, which need only 8 points in a cube,
# and a step that conserves energy by construction.
#
# ## Formulation
#
# The unknowns are the increment of displacement and the pressure $p$ of the step, both sums of
# quadratic B-splines. Indices 0, $m$ and 1 stand for the beginning, the middle and the end of the
# step, and $\Delta$ for the change within it. Per initial volume, for all $\mathbf w$ and $q$,
#
# $$
# \begin{aligned}
# \left(\rho\,\frac{\mathbf v_1 - \mathbf v_0}{\Delta t}, \mathbf w\right)
# + (\mathbf F_m \mathbf S, \operatorname{Grad}\mathbf w) + (p, \Delta J[\mathbf w]) &= 0, \\
# (\Delta J, q) - \frac{\alpha}{\mu} (\Delta\mathbf r, h^2\,\nabla\nabla q) &= 0 .
# \end{aligned}
# $$
#
# - $\mathbf S$ is the energy-momentum stress: $\mathbf S : \Delta\mathbf C / 2$ is exactly the
#   isochoric energy gained in the step. Equation 47 of Pretti et al., *A conservation law
#   consistent updated Lagrangian material point method for dynamic analysis* (2023), defines it.
# - $\Delta J[\mathbf w]$ is the corresponding derivative of the volume, so that $p$ does exactly
#   the work $p\,\Delta J$.
# - $\mathbf r$ is a tensor at the points that follows $h^2\,\nabla\nabla p$. It punishes second
#   derivatives of the pressure, as the interior penalty punishes jumps of its gradient, and it
#   stores the energy $\alpha |\mathbf r|^2 / (2 \mu)$. So the stabilization does not destroy energy
#   either.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy
from fenicsmpm.materials import NeoHookean

# -

H, PER_SIDE, FUNCTIONS = 0.25, 2, "quadratic"  # m; points along a side of a cube
LAW, DENSITY = NeoHookean(E=1.7e7, nu=0.5), 1100.0  # Pa, kg/m^3
DT, TIMES, TIP = 0.01, (0.25, 0.5), (0.5, 0.5, 6.0)  # s, s, m

# ## Bodies
#
# The background mesh is a lattice of cubes, which B-splines need. 3072 points make up the column.

domain = mesh.create_box(
    MPI.COMM_WORLD, [(-1, -1, 0), (4, 1, 7)], [round(side / H) for side in (5, 2, 7)],
    mesh.CellType.hexahedron, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
body = points.lattice(domain, H / PER_SIDE, lambda x: np.all(np.abs(x[:2]) < 0.5, 0) & (x[2] < 6))
formulations.set_initial_state(body, DENSITY, lambda x: np.outer((5 / 3, 0, 0), x[2]))  # m/s
tip = points.at(domain, TIP)
for p in (body, tip):
    basis.use(p, FUNCTIONS)

# ## Weak form
#
# `MixedEnergyMomentum` has all terms but the inertia. It keeps its promise with the mid-point rule
# only.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[2], 0))
scheme = formulations.Midpoint(z, dt=DT)
stress = formulations.MixedEnergyMomentum(LAW, body, z)
R = stress.power() + scheme.inertia(body)

# ## Time steps
#
# `tying` lets nodes that see little of the column follow the linear continuation of well-filled
# cubes, which costs no energy. Newton's method must converge well: what it leaves, the energy gets.

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

# ## Results

io.picture("output/bending_beam_smooth.png", clouds, "p", "mean stress p [Pa]", cut=1)

# The corner is closer to finite elements (total Lagrangian, P2-P1) than that of the
# [tetrahedra](bending_beam.py), with less than a third of their points.

reference = Path(fenicsmpm.__file__).parents[1] / "benchmarks" / "references" / "bending_beam.csv"
t, known, *_ = np.loadtxt(reference, delimiter=",").T
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

assert abs(found.max() / known.max() - 1) < 0.02  # benchmarks/references
assert deviation < 0.03
assert np.abs(energy / energy[0] - 1).max() < 1e-8
