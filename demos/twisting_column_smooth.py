# SPDX-License-Identifier: MIT

# # Twisting column on B-splines
#
# The [twisting column](twisting_column.py) once more, with a third of the points. Its points cross
# many faces while it winds up and turns back, which costs energy with linear functions. On
# quadratic B-splines its energy stays the same within one percent.
#
# The problem is section 6.4 of L. Moreno, R. Wüchner and A. Larese, *A mixed stabilized MPM
# formulation for incompressible hyperelastic materials using Variational Subgrid-Scales* (VMS),
# until the column has turned back once. `studies/columns.py` goes on to 0.5 s.
#
# ## Formulation
#
# Displacement and mean stress are both quadratic B-splines on cubes of 0.25 m, with 8 points in
# each. In each step, for all $\mathbf w$ and $q$,
#
# $$
# \begin{aligned}
# (\rho\,\mathbf a, \mathbf w) + (\boldsymbol\sigma_\mathrm{dev}, \nabla\mathbf w)
# + (p, \nabla\cdot\mathbf w) &= 0, \\
# (J - 1, q) - \frac{\gamma h^3}{2\mu}\,
# ([\nabla p\cdot\mathbf n], [\nabla q\cdot\mathbf n]) &= 0 .
# \end{aligned}
# $$
#
# The interior penalty, taken on the linear functions of the same nodal values, makes equal orders
# stable. Nodes that see little of the column are tied, weights are corrected, and velocities are
# continued linearly from points to nodes. [Cook's membrane on B-splines](cooks_membrane_smooth.py)
# explains these choices.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy
from fenicsmpm.materials import NeoHookean

# -

H, PER_SIDE = 0.25, 2  # m; points along a side of a cube
LAW, DENSITY = NeoHookean(E=1.7e7, nu=0.5), 1100.0  # Pa, kg/m^3
DT, TIMES, TIP = 0.001, (0.025, 0.05), (0.5, 0.5, 6.0)  # s, s, m

# ## Mesh and material points


def velocity(x):
    return 100 * np.sin(np.pi * x[2] / 12) * np.array([x[1], -x[0], 0 * x[2]])  # m/s


domain = mesh.create_box(
    MPI.COMM_WORLD, [(-1.25, -1.25, 0), (1.25, 1.25, 7)], [10, 10, 28],
    mesh.CellType.hexahedron, partitioner=basis.shared_vertex_partitioner,
)  # fmt: skip
body = points.lattice(domain, H / PER_SIDE, lambda x: np.all(np.abs(x[:2]) < 0.5, 0) & (x[2] < 6))
formulations.set_initial_state(body, DENSITY, velocity)
tip = points.at(domain, TIP)
for p in (body, tip):
    basis.use(p, "quadratic")

# ## Weak form

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[2], 0))
scheme = formulations.Bossak(z, dt=DT)
cells = ActiveCells(body, loads=[tip])
R = formulations.mixed(z, body, LAW, force=scheme.force(body))
R += formulations.interior_penalty(z, cells, LAW)

# ## Time steps
#
# The history has the displacement of the corner and the energy. `keep_tangent` keeps a factorized
# tangent as long as each iteration reduces the residual to a tenth: splines couple many nodes, so
# factorizing is expensive.

columns = {f"u_{'xyz'[k]} [m]": lambda sim, k=k: probe(tip, "u")[k] for k in range(3)}
columns["energy [J]"] = lambda sim: kinetic_energy(body) + strain_energy(body, LAW)
history = io.History(columns)
sim = ImplicitMPM(
    R, z, scheme, body, carried=[tip], taylor=True,
    newton={"keep_tangent": 0.1, "tying": Tying(z.space, body, cells)},
    observers=[lambda sim, step: correct_weights(body, cells), history],
)  # fmt: skip
clouds = {"t = 0": io.gather_points(body)}
for end in TIMES:
    for _ in io.watch(sim.run(end), end, "twisting column, smooth"):
        pass
    clouds[f"t = {end:g} s"] = io.gather_points(body)

# ## Results

io.picture("output/twisting_column_smooth.png", clouds, "p", "mean stress p [Pa]", cut=1)

# The first minimum of each component is compared with finite elements (total Lagrangian, P2-P1).

reference = Path(fenicsmpm.__file__).parents[1] / "benchmarks/references/twisting_column.csv"
t, *known = np.loadtxt(reference, delimiter=",").T
known = np.array(known)[:, t <= TIMES[-1]]
t = t[t <= TIMES[-1]]
found = np.array([np.interp(t, history["t [s]"], history[f"u_{k} [m]"]) for k in "xyz"])
lowest, energy = found.min(axis=1), history["energy [J]"] / history["energy [J]"][0]
for k, low, expected in zip("xyz", lowest, known.min(axis=1), strict=True):
    io.say(f"first minimum of u_{k} {low:.4f} m, P2-P1 finite elements {expected:.4f} m")
io.say(f"energy between {energy.min():.4f} and {energy.max():.4f} of that at the start")

# Solid lines are those of the points, broken ones those of the finite elements.

curves = {f"u_{k}": (t, u) for k, u in zip("xyz", found, strict=True)}
expected = {f"u_{k}, P2-P1": (t, u) for k, u in zip("xyz", known, strict=True)}
labels = "t [s]", "displacement of the corner [m]"
io.plot("output/twisting_column_smooth_corner.png", curves, *labels, reference=expected)

assert np.abs(lowest / known.min(axis=1) - 1).max() < 0.03  # benchmarks/references
assert np.abs(energy - 1).max() < 0.01
