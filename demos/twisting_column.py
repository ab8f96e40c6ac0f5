# SPDX-License-Identifier: MIT

# # Twisting column
#
# A column of incompressible rubber starts to spin about its axis, faster towards its top. Clamped
# on its base, it winds up like a rope, and gets shorter on the way, until its top has made two
# thirds of a turn. Large rotations and incompressibility together make this one of the hardest
# tests of a formulation: the polynomial pressure projection, for instance, fails on it.
#
# The problem is section 6.4 of L. Moreno, R. Wüchner and A. Larese, *A mixed stabilized MPM
# formulation for incompressible hyperelastic materials using Variational Subgrid-Scales* (VMS),
# with larger cells. `studies/columns.py` computes all cases of the paper's table 1.
#
# ## Problem
#
# The column measures 1 m x 1 m x 6 m and is the one of the [bending beam](bending_beam.py), as are
# the equations. The initial velocity is
#
# $$
# \mathbf v_0 = 100 \sin\left(\frac{\pi z}{12}\right) (y, -x, 0)^\mathsf T\ \mathrm{m/s} .
# $$
#
# The fast motion needs short steps, and these need two other choices:
#
# - Subgrid scales with inertia. The quasi-static ones of VMS (equation 21) make Newton's method
#   fail in steps that are much shorter than $h\sqrt{\rho/\mu}$. With the time scheme,
#   $\tau_1^{-1} = 2\mu/h^2 + \rho\,r_a$, where $r_a\mathbf u$ is the change of acceleration in a
#   step.
# - Tied nodes instead of a ghost penalty. The penalty resists increments of displacement, however
#   short the step is. Nodes of little mass are therefore tied to the linear continuation of
#   well-filled cells.

# +
import sys
from pathlib import Path

import numpy as np

import fenicsmpm
from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean

# -

ROOT = Path(fenicsmpm.__file__).parents[1]
sys.path.insert(0, str(ROOT / "meshes"))
from column import column  # unstructured tetrahedra, by Gmsh

H, SPACING = 1 / 3, 1 / 12  # m, of cells and points, about 12 a cell (paper: down to 1/8 m)
LAW, DENSITY = NeoHookean(E=1.7e7, nu=0.5), 1100.0  # Pa, kg/m^3
DT, TIMES, TIP = 0.001, (0.025, 0.05), (0.5, 0.5, 6.0)  # s, s, m

# ## Mesh and material points


def spin(x):  # m/s
    return 100 * np.sin(np.pi * x[2] / 12) * np.array([x[1], -x[0], 0 * x[2]])


domain, _ = column(H, (-1.25, -1.25, 0.0), (1.25, 1.25, 7.0))
body = points.lattice(domain, SPACING, lambda x: np.all(np.abs(x) < [[0.5], [0.5], [6.0]], axis=0))
formulations.set_initial_state(body, DENSITY, spin)
tip = points.at(domain, TIP)

# ## Weak form
#
# `scheme=` gives the subgrid scales their inertia.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[2], 0))
scheme = formulations.Bossak(z, dt=DT)
force = scheme.force(body)  # less inertia
R = formulations.mixed(z, body, LAW, force=force)
R += formulations.asgs(z, body, LAW, force=force, scheme=scheme)
cells = ActiveCells(body, loads=[tip])

# ## Time steps
#
# A node at the surface has material on one side only. Its velocity, a mean of those of the points
# around it, would be too small where velocities grow outwards. With `taylor=True`, points continue
# their velocities linearly to the nodes. For this column, that decides whether the result is right.
#
# The tangent is factorized once a step: `keep_tangent` keeps it as long as each iteration reduces
# the residual to a hundredth.

history = io.History(
    {f"u_{name} [m]": lambda sim, i=i: probe(tip, "u")[i] for i, name in enumerate("xyz")}
)
sim = ImplicitMPM(
    R, z, scheme, body, carried=[tip], taylor=True,
    observers=[lambda sim, step: correct_weights(body, cells), history],
    newton={"tying": Tying(z.space, body, cells), "keep_tangent": 0.01},
)  # fmt: skip
clouds = {"t = 0": io.gather_points(body)}
for end in TIMES:
    for _ in io.watch(sim.run(end), end, "twisting column"):
        pass
    clouds[f"t = {end:g} s"] = io.gather_points(body)

# ## Results

io.picture("output/twisting_column.png", clouds, "p", "mean stress p [Pa]", cut=1)

# All three components of the corner's displacement follow the finite elements (total Lagrangian,
# P2-P1).

reference = np.loadtxt(ROOT / "benchmarks" / "references" / "twisting_column.csv", delimiter=",")
t, known = reference[:, 0], reference[:, 1:]
names = ["u_x [m]", "u_y [m]", "u_z [m]"]
found = np.column_stack([np.interp(t, history["t [s]"], history[name]) for name in names])
until = t <= TIMES[-1]
deviation = np.abs(found - known)[until].max() / np.abs(known).max()
io.say(f"u_x down to {found[until, 0].min():.4f} m, P2-P1 elements {known[until, 0].min():.4f} m")
io.say(f"largest deviation of the corner {deviation:.1%} of the largest displacement")
label, curves = "displacement of the corner [m]", {n: (history["t [s]"], history[n]) for n in names}
expected = {f"{n}, P2-P1": (t[until], known[until, i]) for i, n in enumerate(names)}
io.plot("output/twisting_column_corner.png", curves, "t [s]", label, reference=expected)

assert abs(found[until, 0].min() / known[until, 0].min() - 1) < 0.01  # benchmarks/references
assert deviation < 0.04
