# SPDX-License-Identifier: MIT
#
# # Cook's membrane, explicit
#
# The nearly incompressible panel of `cooks_membrane.py` again, now by explicit steps,
# until it has come to rest. Without a remedy the points' volumes lock: the panel is too stiff and
# its mean stress a checkerboard. The demo shows how
#
# - an explicit simulation is set up, with B-splines or uGIMP on a lattice, or with linear functions
#   on triangles,
# - averages of J (F-bar) unlock it, and which of them creep,
# - local damping leads to a static solution.
#
# It is section 4.1 of Zhao, Jiang and Choo, *Circumventing volumetric locking in explicit material
# point methods* (in short: F-bar).
#
# ## Formulation
#
# In each step, velocities of the nodes follow from forces of the points, and new positions,
# deformation gradients and stresses of the points from these velocities. Stresses are found from
#
# $$
# \bar F = (\bar J / J)^{1/2} F
# $$
#
# with averages $\bar J$ of the points' $J = \det F$: sums over points to the nodes, weighted by
# volume, and back. Averaged again in each step, as in the paper's algorithm 1, they drift away from
# $J$, and the panel creeps on under its load. Mixed with 3 percent of the true $J$ in each step
# they do not (`FBar(r=0.03)`, the default).
#
# ## Implementation

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, UnstableError, basis, formulations, io, points
from fenicsmpm.diagnostics import mean_stress, probe, roughness
from fenicsmpm.materials import NeoHookean

REFERENCE = 0.2765  # m, u_y of the tip by P2-P1 finite elements, nu = 0.499
LOAD = 1.0  # N in all, on the right edge
AVERAGES = {
    "F-bar": "default",
    "algorithm-1": formulations.ALGORITHM_1,
    "true-J": formulations.TRUE_J,
    "standard": None,
}
BASES = {"quadratic": "B-splines", "gimp": "uGIMP", "linear": "triangles"}


@dataclass
class Case:
    basis: str = "quadratic"
    averages: str = "F-bar"
    h: float = 1.0  # size of cells, m

    @property
    def damping(self):
        """Share of local damping with which the tip comes to rest soonest."""
        return {"quadratic": 0.8, "gimp": 0.9, "linear": 0.7}[self.basis]

    @property
    def cfl(self):
        """Share of a wave's time through a cell; splines at the light corner need short steps."""
        return 0.8 if self.basis == "linear" else 0.3

    def label(self):
        return f"{self.averages}, {BASES[self.basis]}, h = {self.h:g} m"


def panel(x):
    lower = x[:, 0] * 44 / 48
    upper = 44 + x[:, 0] * 16 / 48
    return (x[:, 0] <= 48) & (x[:, 1] >= lower) & (x[:, 1] <= upper)


# The load is carried by the last column of points, as in the paper. It is dead: forces stay as they
# are while the points that carry them move with the grid.


def build(case):
    h = case.h
    shape = [round(50 / h), round(66 / h)]
    cells = mesh.CellType.triangle if case.basis == "linear" else mesh.CellType.quadrilateral
    corners = [(0, -2), (50, 64)]
    # diagonals across the panel bend more easily than those along it
    diagonal = mesh.DiagonalType.left
    domain = mesh.create_rectangle(MPI.COMM_WORLD, corners, shape, cells, diagonal=diagonal)
    body = points.lattice(domain, h / 2, inside=panel)
    if case.basis != "linear":  # the functions of the mesh
        basis.use(body, case.basis, **({"half_size": h / 4} if case.basis == "gimp" else {}))
    formulations.set_initial_state(body, density=1.0)
    edge = body.select(lambda x: x[:, 0] > 48 - h / 2)
    edge["weight"] = 16 / edge.size_global  # its share of the edge's length, m
    top = edge.x[:, 1].max(initial=-np.inf)
    top = domain.comm.allreduce(top, MPI.MAX)
    tip = edge.select(lambda x: x[:, 1] == top)

    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    v, w = fem.Function(V), ufl.TestFunction(V)
    rubber = NeoHookean(E=70.0, nu=0.499)
    R = formulations.internal_force(w, body, rubber, fbar=AVERAGES[case.averages])
    R += formulations.dead_load(w, edge, (0.0, LOAD / 16))
    left = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    return ExplicitMPM(
        R,
        v,
        body,
        carried=[edge, tip],
        bcs=[fem.dirichletbc(np.zeros(2), left, V)],
        cfl=case.cfl,
        damping=case.damping,
    )


# Neighbours in a smooth field differ by little from their mean: how much is the measure of a
# checkerboard, here in shares of the load per area of the edge.


def run(case, steps):
    sim = build(case)
    body, tip = sim.bodies[0], sim.carried[1]
    io.say(f"{case.label()}: {body.size_global} material points, steps of {sim.dt:.4g} s")
    until = steps * sim.dt
    history = [(0.0, 0.0)]
    try:
        for step in io.watch(sim.run(until, until / 200), until, case.label()):
            history.append((step.time, probe(tip, "u")[1]))
    except UnstableError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return sim, np.array(history)


def results(case, sim, history, rows):
    t, u = history.T
    last_quarter = u[t >= 0.75 * t[-1]]
    change = np.ptp(last_quarter) / abs(u[-1]) if u[-1] else 0.0
    body = sim.bodies[0]
    rough = roughness(body, mean_stress(body["sigma"]), case.h / 2) / (LOAD / 16)
    rows.row(case.averages, BASES[case.basis], u[-1], u[-1] / REFERENCE - 1, change, rough)
    return {"tip": u[-1], "change": change, "roughness": rough}


def draw(path, sims):
    panels = []
    for case, sim in sims:
        cloud = io.gather_points(sim.bodies[0])
        if cloud is not None:
            cloud["p"] = mean_stress(cloud["sigma"])
        panels.append(io.Panel(cloud, "p", case.label()))
    io.picture(path, panels, "mean stress p [Pa]", limits=(-0.1, 0.1))


def show(cases, steps, output):
    sims, histories = [], {}
    for case in cases:
        sim, history = run(case, steps)
        sims.append((case, sim))
        histories[case.label()] = history
    columns = {"averages": "s", "functions": "s", "u_y of the tip [m]": ".4f"}
    columns |= {"deviation": "+.1%", "change in the last quarter": ".2%", "roughness of p": ".4f"}
    rows = io.Table(columns)
    found = [results(case, sim, histories[case.label()], rows) for case, sim in sims]
    io.say(f"reference {REFERENCE} m by finite elements")
    draw(output / "mean_stress.png", sims)
    io.plot(
        output / "tip.png",
        {label: tuple(history.T) for label, history in histories.items()},
        "t [s]",
        "vertical displacement of the tip [m]",
        reference={"P2-P1 finite elements": REFERENCE},
    )
    io.say(f"mean_stress.png and tip.png are in {output}")
    return found


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Cook's membrane, explicit, nearly incompressible")
    add = parser.add_argument
    add("--basis", choices=BASES, nargs="+", help="grid functions (default: quadratic)")
    add("--averages", choices=AVERAGES, nargs="+", help="of J (default: F-bar standard)")
    add("--size", type=float, default=1.0, help="of cells in m (default: %(default)s)")
    add("--steps", type=int, help="(default: 20000)")
    add("--full", action="store_true", help="60000 steps, all averages and functions")
    add("--short", action="store_true", help="a few steps on a coarse grid, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    if parser.parse_args(arguments).short:
        parser.set_defaults(size=2.0, steps=200)
    options = parser.parse_args(arguments)
    if options.size <= 0 or abs(2 / options.size - round(2 / options.size)) > 1e-9:
        parser.error(f"argument --size: must divide 2 m into equal parts, not {options.size}")
    if options.steps is not None and options.steps < 1:
        parser.error(f"argument --steps: at least 1, not {options.steps}")
    if options.full and (options.short or options.basis or options.averages or options.steps):
        parser.error("argument --full: it has cases of its own, so only --size goes with it")
    io.show_log(logging.WARNING)
    bases = list(BASES) if options.full else options.basis or ["quadratic"]
    averages = list(AVERAGES) if options.full else options.averages or ["F-bar", "standard"]
    steps = 60000 if options.full else options.steps or 20000
    cases = [Case(basis, average, options.size) for basis in bases for average in averages]
    return show(cases, steps, options.output)


if __name__ == "__main__":
    main()
