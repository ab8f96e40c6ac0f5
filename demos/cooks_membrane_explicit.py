# SPDX-License-Identifier: MIT
"""Cook's membrane, explicit.

The nearly incompressible panel of ``cooks_membrane.py``, now by explicit steps with local damping,
until it has come to rest: section 4.1 of Y. Zhao, C. Jiang and J. Choo, "Circumventing volumetric
locking in explicit material point methods". The background mesh is a lattice, and points see
quadratic B-splines. The load is carried by the last column of points, as in the paper. It is dead:
forces stay as they are while the points that carry them move with the grid.

In each step the forces of points give the nodes velocities, and these give points new positions,
deformation gradients and stresses. Where volume hardly changes, volumes of single points lock: the
mean stress is a checkerboard. So stresses are found from

    F_bar = (J_bar / J)^(1/2) F

with averages J_bar of J = det F, which are sums over points to the nodes, weighted by volume, and
back. Averaged again in each step, as in the paper's algorithm 1, they drift away from J, and the
panel creeps under its load. By default each step mixes 3 percent of the true J into them.

Other averages, uGIMP, triangles and finer cells: ``studies/explicit.py cook``.
"""

from mpi4py import MPI

import numpy as np
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, basis, formulations, io, points
from fenicsmpm.diagnostics import mean_stress, probe, roughness
from fenicsmpm.materials import NeoHookean

H, STEPS, DAMPING = 1.0, 20000, 0.8  # size of cells in m; share of local damping
LOAD = 1.0  # N in all, on the right edge of 16 m
AVERAGES = {"F-bar": "default", "no averages": None}
REFERENCE = 0.2765  # m, tip by P2-P1 finite elements on fine meshes


def panel(x):
    return (x[0] <= 48) & (x[1] >= x[0] * 44 / 48) & (x[1] <= 44 + x[0] * 16 / 48)


tips, clouds, rough = {}, {}, {}
for name, averages in AVERAGES.items():
    shape = [round(50 / H), round(66 / H)]
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, -2), (50, 64)], shape, mesh.CellType.quadrilateral
    )
    body = points.lattice(domain, H / 2, inside=panel)
    basis.use(body, "quadratic")
    formulations.set_initial_state(body, density=1.0)
    edge = body.select(lambda x: x[0] > 48 - H / 2)
    edge["weight"] = 16 / edge.size_global  # its share of the edge's length, m
    top = domain.comm.allreduce(edge.x[:, 1].max(initial=-np.inf), MPI.MAX)
    tip = edge.select(lambda x, top=top: x[1] == top)

    z = formulations.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[0], 0))
    R = formulations.internal_force(z.test.v, body, NeoHookean(E=70.0, nu=0.499), fbar=averages)
    R += formulations.dead_load(z.test.v, edge, (0.0, LOAD / 16))
    tips[name] = io.History({"tip [m]": lambda sim: probe(sim.carried[1], "u")[1]})
    sim = ExplicitMPM(
        R, z, body, carried=[edge, tip], cfl=0.3, damping=DAMPING, observers=[tips[name]]
    )
    until = STEPS * sim.dt
    for _ in io.watch(sim.run(until, until / 200), until, name):
        pass
    body.add_field("p", (), mean_stress(body["sigma"]))
    rough[name] = roughness(body, body["p"], H / 2) / (LOAD / 16)
    clouds[name] = io.gather_points(body)
    deviation = tips[name]["tip [m]"][-1] / REFERENCE - 1
    io.say(f"{name}: tip {deviation:+.2%} off {REFERENCE} m, roughness of p {rough[name]:.3f}")

io.picture(
    "output/cooks_membrane_explicit.png", clouds, "p", "mean stress [Pa]", limits=(-0.1, 0.1)
)
io.plot("output/cooks_membrane_explicit_tip.png", tips, reference={"finite elements": REFERENCE})

assert abs(tips["F-bar"]["tip [m]"][-1] / REFERENCE - 1) < 0.02  # P2-P1 finite elements
assert rough["F-bar"] < 0.05 < 0.5 < rough["no averages"]  # shares of the load per area
