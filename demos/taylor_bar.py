# SPDX-License-Identifier: MIT
#
# # Taylor bar
#
# A copper bar hits a rigid wall at 227 m/s: its foot spreads like a mushroom, and nearly all of its
# energy is dissipated. The demo shows how
#
# - finite-strain plasticity is solved implicitly in three dimensions,
# - kinetic, stored and dissipated energy add up to what the bar had at first,
# - tied nodes make up for the few points at its rim.
#
# It is section 7.4 of Pretti, Coombs, Augarde, Sims, Marchena Puigvert and Reyna Gutierrez, *A
# conservation law consistent updated Lagrangian material point method for dynamic analysis* (in
# short: conservation). The formulation is that of `cantilever.py`.
#
# ## Implementation

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
from cantilever import METHODS, Energies, draw, drift, equations, plot, save, snapshot
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import VonMises
from fenicsmpm.solvers import CourantStep, NewtonError

RADIUS, LENGTH, WIDTH = 3.2e-3, 32.4e-3, 7.2e-3  # of the bar, and of the background mesh, m
BULK, SHEAR, DENSITY = 130e9, 43.3e9, 8930.0  # Pa, Pa, kg/m^3
SIGMA_Y, H = 0.4e9, 0.1e9  # Pa
SPEED, END = 227.0, 80e-6  # m/s, s
FIELDS = ("strain", "kinetic", "dissipated")  # energies in pictures
FINAL_LENGTH, FINAL_RADIUS = 21.45e-3, 7.1e-3  # m, from the literature


def copper():
    E = 9 * BULK * SHEAR / (3 * BULK + SHEAR)
    nu = (3 * BULK - 2 * SHEAR) / (2 * (3 * BULK + SHEAR))
    return VonMises(E, nu, SIGMA_Y, H)


# A quarter of the bar is computed. Its axis is y; planes x = 0 and z = 0 are those of symmetry,
# y = 0 is the wall, on which the bar may slide. The printed length of 32.2 mm does not fit 50 cells
# of 0.648 mm, 32.4 mm does, and so it is in the references.


@dataclass
class Case:
    method: str = "energy-momentum"
    cells: int = 50  # along the bar; of 0.8 mm across for 50
    per_direction: int = 2  # points a cell
    dt: float = 0.375e-6  # s, as in the paper for 50 cells
    tying: float = 0.1

    def label(self):
        return f"{self.method}, {self.cells} cells"


def build(case):
    across = max(round(9 * case.cells / 50), 2)
    domain = mesh.create_box(
        MPI.COMM_WORLD, [(0.0, 0.0, 0.0), (WIDTH, LENGTH, WIDTH)], [across, case.cells, across],
        mesh.CellType.hexahedron, partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    spacing = np.array([WIDTH / across, LENGTH / case.cells, WIDTH / across]) / case.per_direction
    bar = points.lattice(domain, spacing, inside=lambda x: np.hypot(x[:, 0], x[:, 2]) < RADIUS)
    basis.use(bar, "gimp", spacing / 2)
    formulations.set_initial_state(bar, DENSITY, lambda x: np.tile((0.0, -SPEED, 0.0), (len(x), 1)))
    space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    U = fem.Function(space)
    bcs = []
    for axis in range(3):
        part = space.sub(axis)
        collapsed = part.collapse()[0]
        dofs = fem.locate_dofs_geometrical(
            (part, collapsed), lambda x, axis=axis: np.isclose(x[axis], 0)
        )
        bcs.append(fem.dirichletbc(fem.Function(collapsed), dofs, part))
    law = copper()
    scheme, updates, R = equations(case.method, law, bar, U, case.dt)
    newton = {"rtol": 1e-10, "atol": 1e-9, "line_search": True}
    newton["tying"] = Tying(space, bar, ActiveCells(bar), case.tying)
    return ImplicitMPM(R, U, scheme, bar, bcs=bcs, updates={bar: updates}, newton=newton)


# ## Running
#
# The largest displacements along the bar and across it give its final length and radius.


def shape(bar):
    """Shortening and widening of the bar [m]."""
    comm = bar.mesh.comm
    start = bar.x - bar["u"]
    wider = np.hypot(bar.x[:, 0], bar.x[:, 2]) - np.hypot(start[:, 0], start[:, 2])
    shorter = comm.allreduce(float(np.max(-bar["u"][:, 1], initial=0.0)), MPI.MAX)
    return shorter, comm.allreduce(float(np.max(wider, initial=0.0)), MPI.MAX)


def run(case, until=END):
    sim = build(case)
    bar = sim.bodies[0]
    law = copper()
    estimate = CourantStep({bar: law}, 1.0)()
    io.say(
        f"{case.label()}: {bar.size_global} material points, steps of {case.dt:.3g} s, "
        f"{case.dt / estimate:.1f} times that of explicit dynamics"
    )
    energies, shapes, frames = Energies(sim, law), [(0.0, 0.0, 0.0)], {}
    try:
        for step in io.watch(sim.run(until), until, case.label()):
            energies.record(step)
            shapes.append((sim.time, *shape(bar)))
            if sim.time > until * ((len(frames) + 1) / 3 - 1e-9):
                name = ("a third", "two thirds", "the end")[len(frames)]
                frames[name] = snapshot(bar, law, sim.time)
    except NewtonError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return energies, np.array(shapes), frames


# ## Results


def show(cases, until, output):
    tables, widened, shortened = {}, {}, {}
    rows = []
    for case in cases:
        energies, shapes, frames = run(case, until)
        table = energies.table()
        tables[case.label()] = table
        rows.append((case, table, shapes))
        shortened[f"{case.label()}: shortened"] = (shapes[:, 0] * 1e6, shapes[:, 1] * 1e3)
        widened[f"{case.label()}: widened"] = (shapes[:, 0] * 1e6, shapes[:, 2] * 1e3)
        save(output / f"taylor_bar_{case.method}.csv", table, {"case": case.label()})
        if frames:
            draw(output / f"taylor_bar_{case.method}.png", frames, "MJ", 1e6, FIELDS, ("us", 1e-6))
    columns = {"method, cells": "s", "until [us]": ".4g", "length [mm]": ".2f", "of 21.45": "+.1%"}
    columns |= {"radius [mm]": ".2f", "of 7.1": "+.1%", "energy": ".1e", "dissipated": ".1%"}
    printed = io.Table(columns | {"Newton its": ".2f", "most": ".0f"})
    for case, table, shapes in rows:
        length, radius = LENGTH - shapes[-1, 1], RADIUS + shapes[-1, 2]
        printed.row(
            case.label(), table[-1, 0] * 1e6, length * 1e3, length / FINAL_LENGTH - 1,
            radius * 1e3, radius / FINAL_RADIUS - 1, drift(table, 0.0),
            table[-1, 3] / table[0, 4], table[1:, 5].mean(), table[1:, 5].max(),
        )  # fmt: skip
    plot(output / "taylor_bar_energies.png", tables, ("us", "J"), (1e-6, 1.0))
    io.plot(
        output / "taylor_bar_shape.png",
        shortened | widened,
        "t [us]",
        "largest displacement [mm]",
        reference={
            "final length 21.45 mm": (LENGTH - FINAL_LENGTH) * 1e3,
            "final radius 7.1 mm": (FINAL_RADIUS - RADIUS) * 1e3,
        },
    )
    io.say(f"pictures taylor_bar_*.png and .csv files are in {output}")
    return rows


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Taylor bar: copper hits a wall")
    add = parser.add_argument
    default = Case()
    add("--full", action="store_true", help="the paper's 50 cells along the bar (default: 25)")
    add("--method", choices=METHODS, nargs="+", help="(default: energy-momentum)")
    add("--until", type=float, default=END, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps on a coarse mesh, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    add("-v", "--verbose", action="store_true", help="print a line for each Newton iteration")
    if parser.parse_args(arguments).short:
        parser.set_defaults(until=3e-6)
    options = parser.parse_args(arguments)
    if not options.until > 0:
        parser.error(f"argument --until: must be positive, not {options.until}")
    if options.short and (options.full or options.method):
        parser.error("argument --short: has a case of its own, so leave out --full and --method")
    if "symplectic" in (options.method or ()):
        parser.error("the stress of the mid-point has no plastic state at the end of a step")
    io.show_log(logging.INFO if options.verbose else logging.WARNING)
    if options.short:
        return show([Case(cells=25, dt=2 * default.dt)], options.until, options.output)
    size = {} if options.full else {"cells": 25, "dt": 2 * default.dt}
    cases = [Case(method, **size) for method in options.method or ["energy-momentum"]]
    return show(cases, options.until, options.output)


if __name__ == "__main__":
    main()
