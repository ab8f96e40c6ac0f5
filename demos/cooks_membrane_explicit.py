# SPDX-License-Identifier: MIT

# # Explicit Cook's membrane and F-bar
#
# Most MPM codes take explicit steps, where no pressure unknown can keep the volume. Nearly
# incompressible bodies then lock: their mean stress is a checkerboard, and their stiffness is
# wrong. This demo cures that by averages of the volume change, the F-bar method. Local damping
# brings the panel of [Cook's membrane](cooks_membrane.py) to rest, and its tip is compared with
# finite elements.
#
# The problem is section 4.1 of Y. Zhao, C. Jiang and J. Choo, *Circumventing volumetric locking in
# explicit material point methods: A simple, efficient, and general approach* (F-bar).
#
# ## Method
#
# In each step, the forces of the points give the nodes velocities, and these give the points new
# positions, deformation gradients and stresses. Stresses do not follow from $\mathbf F$, but from
# (F-bar, equation 18, in two dimensions)
#
# $$
# \bar{\mathbf F} = \left(\frac{\bar J}{J}\right)^{1/2} \mathbf F, \qquad J = \det\mathbf F .
# $$
#
# The average $\bar J$ is a sum over points to the nodes, weighted by volume, and back (equations 19
# and 20, where $w_{ip}$ is the function of node $i$ at point $p$):
#
# $$
# \bar J_p = \sum_i w_{ip} \frac{\sum_q w_{iq} V_q J_q}{\sum_q w_{iq} V_q} =: \Pi(J_p).
# $$
#
# The paper's algorithm 1 averages $\bar J$ again in each step (equation 26). It then drifts away
# from $J$, and a panel under constant load creeps. By default, each step here mixes a share $r$ of
# the true $J$ into it: $\bar J \leftarrow \Pi\big((1 - r)\,\bar J\,\Delta J + r J\big)$ with
# $r = 0.03$.

# +
from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.diagnostics import mean_stress, probe, roughness
from fenicsmpm.materials import NeoHookean

# -

LOAD = 1.0  # N in all, on the right edge of 16 m
REFERENCE = 0.2765  # m, tip by P2-P1 finite elements on fine meshes

# ## Simulation
#
# The panel is computed with averages and without, on a lattice of squares whose points see
# quadratic B-splines, and with averages on coarse triangles, where functions are linear. As in the
# paper, the last column of points carries the load. `R` has no inertia: explicit steps divide its
# forces by the lumped mass. The steps are as long as `cfl` says, in units of the time in which a
# pressure wave crosses a cell. Local damping brings the panel to rest, on triangles soonest with a
# share of 0.45.

SQUARES = {"cells": mesh.CellType.quadrilateral, "functions": "quadratic", "h": 1.0}
TRIANGLES = {"cells": mesh.CellType.triangle, "functions": "linear", "h": 2.0}
SLOWLY = {"cfl": 0.3, "damping": 0.8, "steps": 20000}
FAST = {"cfl": 0.8, "damping": 0.45, "steps": 8000}
CASES = {
    "F-bar": {"fbar": "default", **SQUARES, **SLOWLY},
    "no averages": {"fbar": None, **SQUARES, **SLOWLY},
    "F-bar on triangles": {"fbar": "default", **TRIANGLES, **FAST},
}


def panel(x):
    return (x[0] <= 48) & (x[1] >= x[0] * 44 / 48) & (x[1] <= 44 + x[0] * 16 / 48)


def simulate(name, cells, functions, h, fbar, cfl, damping, steps):
    """Return the body at rest, and the history of its tip."""
    corners, shape = [(0, -2), (50, 64)], [round(50 / h), round(66 / h)]
    # diagonals across the panel bend more easily than diagonals along it
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, corners, shape, cells, diagonal=mesh.DiagonalType.left
    )
    body = points.lattice(domain, h / 2, inside=panel)
    if functions != "linear":  # that of the mesh
        basis.use(body, functions)
    formulations.set_initial_state(body, density=1.0)
    edge = body.select(lambda x: x[0] > 48 - h / 2)
    edge["weight"] = 16 / edge.size_global  # its share of the edge's length, m
    top = domain.comm.allreduce(edge.x[:, 1].max(initial=-np.inf), MPI.MAX)
    tip = edge.select(lambda x: x[1] == top)

    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0))
    R = formulations.internal_force(z.test.v, body, NeoHookean(E=70.0, nu=0.499), fbar=fbar)
    R += formulations.dead_load(z.test.v, edge, (0.0, LOAD / 16))
    history = io.History({"tip [m]": lambda sim: probe(tip, "u")[1]})
    options = {"carried": [edge, tip], "observers": [history]}
    sim = ExplicitMPM(R, z, body, cfl=cfl, damping=damping, **options)
    until = steps * sim.dt
    for _ in io.watch(sim.run(until, until / 200), until, name):
        pass
    return body, history


tips, clouds, rough = {}, {}, {}
for name, case in CASES.items():
    body, tips[name] = simulate(name, **case)
    body.add_field("p", (), mean_stress(body["sigma"]))
    rough[name] = roughness(body, body["p"], case["h"] / 2) / (LOAD / 16)
    clouds[name] = io.gather_points(body)
    deviation = tips[name]["tip [m]"][-1] / REFERENCE - 1
    io.say(f"{name}: tip {deviation:+.2%} off {REFERENCE} m, roughness of p {rough[name]:.3f}")

# ## Results
#
# Without averages, the mean stress is noise along the edges. `roughness` measures it: the part that
# changes from point to point, here as a share of the load per area.

io.picture(
    "output/cooks_membrane_explicit.png", clouds, "p", "mean stress [Pa]", limits=(-0.1, 0.1)
)

# The tips come to rest. Those with averages agree with finite elements, also on triangles. For
# other averages, uGIMP and finer cells, see `studies/explicit.py cook`.

io.plot("output/cooks_membrane_explicit_tip.png", tips, reference={"finite elements": REFERENCE})

for name in ("F-bar", "F-bar on triangles"):
    assert abs(tips[name]["tip [m]"][-1] / REFERENCE - 1) < 0.02  # P2-P1 finite elements
assert rough["F-bar"] < 0.05 < 0.5 < rough["no averages"]  # shares of the load per area
assert rough["F-bar on triangles"] < 0.1
