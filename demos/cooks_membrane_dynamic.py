# SPDX-License-Identifier: MIT

# # Cook's membrane in motion
#
# The panel of [Cook's membrane](cooks_membrane.py), a tenth of its size, is loaded at once. It
# swings up by a quarter of its width and back again. Now the material points move through a
# background mesh that knows nothing of the panel's outline. This is the Material Point Method
# proper: incompressible, implicit, with a free boundary that cuts cells as it likes.
#
# The problem is the dynamic example of section 6.2 of L. Moreno, R. Wüchner and A. Larese, *A mixed
# stabilized MPM formulation for incompressible hyperelastic materials using Variational
# Subgrid-Scales* (VMS), on cells twice as large. `studies/cooks_membrane_dynamic.py` has its
# figures.
#
# ## Problem
#
# In each step, the increment $\mathbf u$ of the displacement and the mean stress $p$ are sought on
# the undeformed background mesh such that for all $\mathbf w$ and $q$ (VMS, equations 8 to 11)
#
# $$
# \begin{aligned}
# (\rho\,\mathbf a, \mathbf w) + (\boldsymbol\sigma_\mathrm{dev}, \nabla\mathbf w)
# + (p, \nabla\cdot\mathbf w) &= \langle\mathbf t, \mathbf w\rangle_\mathrm{edge}, \\
# (J - 1, q) &= 0 .
# \end{aligned}
# $$
#
# Integrals are sums over material points. The acceleration $\mathbf a$ is an expression in
# $\mathbf u$ and in the velocities and accelerations of the points, mapped to the grid. The load is
# dead: it keeps its direction, and boundary points carry it along.
#
# Three things make this work on points that move:
#
# - Time scheme. $J = 1$ at the end of each step makes Newmark's method only weakly stable. Bossak's
#   scheme damps the highest frequencies, which is enough.
# - Cut cells. Nodes of cells that are only partly filled have nearly no mass and stiffness. The
#   ghost penalty lets them follow their neighbours. It acts on the jumps of gradients across the
#   facets of such cells, by $\gamma\mu h\,([\partial_n\mathbf u], [\partial_n\mathbf w])$ on the
#   displacement and by $-\gamma h^3/(2\mu)\,([\partial_n p], [\partial_n q])$ on the pressure.
# - Weights. Points that have crossed edges leave cells overfull or with gaps. `correct_weights`
#   scales the weights in full cells such that constants are integrated exactly. Here, that halves
#   the error of the first minimum.

# +
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

import fenicsmpm
from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean

# -

H, PER_CELL = 0.2, 33  # m, edges of the triangles along the axes (paper: 0.1); points in one
LAW, DENSITY = NeoHookean(E=250.0, nu=0.5), 1.0  # Pa, kg/m^2
TRACTION, TIP = (0.0, 6.25), (4.8, 6.0)  # Pa, m
DT, TURNS = 0.025, (1.35, 2.75)  # s; first peak and first minimum

# ## Bodies
#
# The mesh is a box around everything that the panel will reach. A square lattice of points is cut
# out along the panel's outline. The points of `edge` carry the traction, `tip` follows the corner.
# Both have no mass.


def panel(x):
    return (x[0] <= 4.8) & (x[1] >= x[0] * 4.4 / 4.8) & (x[1] <= 4.4 + x[0] * 1.6 / 4.8)


domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -1), (6, 9)], [round(6 / H), round(10 / H)])
body = points.lattice(domain, H * np.sqrt(0.5 / PER_CELL), inside=panel)
formulations.set_initial_state(body, DENSITY)
edge = points.on_curve(domain, (4.8, 4.4), TIP, spacing=H / 5)
tip = points.at(domain, TIP)

# ## Weak form
#
# The body force is $-\rho\,\mathbf a$ of the time scheme. Galerkin's terms and the subgrid scales
# both take it, because the residual of the momentum has inertia, too.

z = formulations.Unknown(domain, "u", "p")
z.fix("u", lambda x: np.isclose(x[0], 0))
scheme = formulations.Bossak(z, dt=DT)
cells = ActiveCells(body, loads=[edge, tip])
force = scheme.force(body)  # less inertia
R = formulations.mixed(z, body, LAW, force=force) + formulations.asgs(z, body, LAW, force=force)
R += formulations.ghost_penalty(z, cells, LAW) + formulations.dead_load(z.test.u, edge, TRACTION)

# ## Time steps
#
# Observers are called after each step. The first one corrects the weights, the history records the
# tip. `carried` names the points without mass that move along. The loop stops at both turning
# points to keep a copy of the points for the picture.

history = io.History({"u_y of the tip [m]": lambda sim: probe(tip, "u")[1]})
observers = [lambda sim, step: correct_weights(body, cells), history]
sim = ImplicitMPM(R, z, scheme, body, carried=[edge, tip], observers=observers)
clouds = {}
for end in TURNS:
    for _ in io.watch(sim.run(end), end, "Cook's membrane"):
        pass
    clouds[f"t = {end} s"] = io.gather_points(body)

# ## Results
#
# The pressure at the first peak and at the first minimum:

io.picture("output/cooks_membrane_dynamic.png", clouds, "p", "mean stress p [Pa]", cut=1)

# The reference is a finite element computation of the same panel: total Lagrangian, Taylor-Hood
# P2-P1, in steps half as long.

reference = Path(fenicsmpm.__file__).parents[1] / "benchmarks" / "references" / "cook_dynamic.csv"
t, _, expected = np.loadtxt(reference, delimiter=",").T
found = np.interp(t, history["t [s]"], history["u_y of the tip [m]"])
peak, deviation = expected.max(), np.abs(found - expected)[t <= TURNS[-1]].max()
io.say(f"first peak {found.max():.4f} m, P2-P1 finite elements {peak:.4f} m")
io.say(f"largest deviation until t = {TURNS[-1]} s: {deviation / peak:.1%} of it")
curve = {"P2-P1 finite elements": (t[t <= TURNS[-1]], expected[t <= TURNS[-1]])}
io.plot("output/cooks_membrane_dynamic_tip.png", history, reference=curve)

# What is left is lost by points that cross edges. Smaller cells, each with as many points, reduce
# it, and [smooth grid functions](cooks_membrane_smooth.py) avoid it.

assert abs(found.max() / peak - 1) < 0.01  # benchmarks/references
assert deviation < 0.04 * peak  # less with smaller cells
