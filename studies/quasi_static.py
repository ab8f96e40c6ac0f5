# SPDX-License-Identifier: MIT
"""Cook's membrane and the strip footing by load steps, compared with explicit results.

Both problems end at rest, so implicit load steps without inertia solve them, too. The steps grow if
Newton's method converges easily. Points move and carry the state, as in ``explicit.py``.

Cook's membrane has displacement increments and mean stresses as unknowns, with subgrid scales
(ASGS) or PPP as stabilization. Nodes at the rim, where the body does not fit the mesh, are tied to
filled cells. It has 16 points per square. With 4 points, which is 2 per triangle, it is too soft by
6 percent.

The footing has the return mapping of its law in the form. In displacements alone ("u") it locks. In
"u-p" the mean Kirchhoff stress is an unknown, ln J = p / kappa, with PPP. The edge of the held
part lies between the last node under the footing and the next one. Loads are therefore too large by
about h / B. Divided by the width B + h instead, they are closer to the limit load.
"""

import math

from mpi4py import MPI

import typer
import ufl
from dolfinx import fem, mesh
from explicit import PRANDTL, TIP, membrane, panel, strip

from fenicsmpm import ImplicitMPM, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean, VonMises
from fenicsmpm.simulation import Reaction

CLAY = VonMises(E=1e6, nu=0.49, sigma_y=math.sqrt(3) * 100.0)  # Pa


def cook(h, stabilization, per_side=4):
    """Return the displacement of the tip [m], and the number of load steps."""
    shape, left = [round(50 / h), round(66 / h)], mesh.DiagonalType.left
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -2), (50, 64)], shape, diagonal=left)
    body = points.lattice(domain, h / per_side, inside=panel)
    formulations.set_initial_state(body, 1.0)
    edge = points.on_curve(domain, (48, 44), (48, 60), spacing=h / 5)
    tip = points.at(domain, (48.0, 60.0))
    cells, law = ActiveCells(body, loads=[edge, tip]), NeoHookean(E=70.0, nu=0.499)
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: x[0] < 1e-9)
    traction = fem.Constant(domain, (0.0, 0.0))

    def load(start, end):
        traction.value[:] = 0, end / 16

    R = formulations.stabilized(stabilization, z, body, law)
    R -= ufl.inner(traction, z.test.u) * edge.dx
    options = {"newton": {"tying": Tying(z.space, body, cells)}, "data": load}
    options["observers"] = [lambda sim, step: correct_weights(body, cells)]
    scheme = formulations.QuasiStatic(z, dt=0.1)
    sim = ImplicitMPM(R, z, scheme, body, carried=[edge, tip], **options)
    for _ in io.watch(sim.run(1.0, largest=0.25), 1.0, stabilization):
        pass
    return probe(tip, "u")[1], sim.number


def footing(cells, formulation, settlement=0.004, size=4):
    """Return settlements over width B, loads over strength, and the number of load steps."""
    shape = [size * cells, size * cells]
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (size, size)], shape, mesh.CellType.quadrilateral
    )
    ground = points.fill(domain, 2)
    formulations.set_initial_state(ground, 1000.0)
    z = formulations.Unknown(domain, *formulation.split("-"))
    z.fix("u", lambda x: (x[0] < 1e-9) | (x[0] > size - 1e-9), component=0)
    z.fix("u", lambda x: x[1] < 1e-9, component=1)
    under = z.fix("u", lambda x: (x[1] > size - 1e-9) & (x[0] < 0.5 + 1e-9), lambda t: (0, -t))
    k, force = formulations.Kinematics(z.u, ground), Reaction(under)
    P = formulations.Response(CLAY, ground, k.F).P
    if "p" in formulation:
        P += (z.p - CLAY.kappa * ufl.ln(k.J)) * ufl.inv(k.F).T
    R = formulations.stress_power(P, z.test.u, ground)
    if "p" in formulation:
        R += (ufl.ln(k.J) - z.p / CLAY.kappa) * z.test.p * ground.dx
        R += formulations.ppp(z, ground, NeoHookean(CLAY.E, CLAY.nu))
    scheme, loads = formulations.QuasiStatic(z, dt=settlement / 80), {0.0: 0.0}
    sim = ImplicitMPM(R, z, scheme, ground, observers=[force])
    for step in io.watch(sim.run(settlement, largest=settlement / 20), settlement, formulation):
        loads[step.time] = -force.value[1] / 50
    return list(loads), list(loads.values()), sim.number


def main(h: list[float] = [2.0, 1.0], cells: list[int] = [10, 20]):
    """Run Cook's membrane with cells of H m, and footings with CELLS along their width."""
    columns = {"problem".ljust(12): "s", "cells".ljust(6): "s", "method".ljust(16): "s"}
    table = io.Table(columns | {"result": ".4f", "reference": ".4f", "off": "+.1%", "steps": "d"})
    for size in h:
        _, tips, _ = membrane("quadratic", "default", size, 20000)
        rows = {name.upper(): cook(size, name) for name in ("asgs", "ppp")}
        for method, row in (rows | {"explicit, F-bar": (tips["tip [m]"][-1], 20000)}).items():
            table.row("Cook, tip", f"{size:g} m", method, row[0], TIP, row[0] / TIP - 1, row[1])
    curves = {}
    for n in cells:
        runs = {name: footing(n, name) for name in ("u", "u-p")}
        runs["explicit, F-bar"] = *strip("quadratic", "default", n, size=4)[1:], None
        for method, (way, load, steps) in runs.items():
            curves[f"{method}, h = B/{n}"] = way, load
            row = load[-1], PRANDTL, load[-1] / PRANDTL - 1, steps
            table.row("footing", f"B/{n}", method, *row)
    labels = "settlement / width", "load / shear strength"
    io.plot("output/quasi_static.png", curves, *labels, reference={"Prandtl": PRANDTL})


if __name__ == "__main__":
    typer.run(main)
