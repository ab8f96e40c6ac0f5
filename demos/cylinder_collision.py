# SPDX-License-Identifier: MIT
#
# # Collision of two cylinders
#
# Two cylinders meet off their centres, stick to each other while they are pressed together, and
# fly apart. They share the background mesh and its velocities, which is all the contact there is.
# The demo shows how
#
# - bodies are brought into contact through the grid,
# - steps of variable length follow the condition of Courant, Friedrichs and Lewy on the grid,
# - momenta and energy are conserved through an impact, with plasticity (`--plastic`) as well.
#
# They are sections 7.2 and 7.3 of Pretti, Coombs, Augarde, Sims, Marchena Puigvert and Reyna
# Gutierrez, *A conservation law consistent updated Lagrangian material point method for dynamic
# analysis* (in short: conservation). The formulation is that of `cantilever.py`.
#
# ## Implementation

import argparse
import logging
import math
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
from cantilever import METHODS, Energies, draw, drift, equations, plot, save, snapshot
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import angular_momentum, momentum
from fenicsmpm.materials import Hencky, VonMises
from fenicsmpm.solvers import CourantStep, NewtonError

BOX = ((0.0, 0.0), (20.0, 12.0))  # of the background mesh, m
CENTRES = ((5.8, 5.5), (14.2, 6.5))  # m
RADIUS, SPEED, DENSITY = 2.0, 0.75, 5.0  # m, m/s towards each other, kg/m^3
YOUNG, POISSON, YIELD_RADIUS = 100.0, 0.3, 10.0  # Pa, -, Pa
END = 8.0  # s
FACTOR = 5.0  # times the paper's step, see below


# The paper bounds the norm of the deviatoric stress by 10 Pa (its equation 62), so that the yield
# stress in uniaxial tension is the root of 3/2 times that.


@dataclass
class Case:
    plastic: bool = False
    basis: str = "linear"
    method: str = "energy-momentum"
    h: float = 2.0  # size of cells, m
    per_direction: int = 35  # points a cell
    tying: float = 0.0  # nodes whose cells are filled less follow the others; 0 for none

    @property
    def law(self):
        if self.plastic:
            return VonMises(YOUNG, POISSON, sigma_y=math.sqrt(3 / 2) * YIELD_RADIUS)
        return Hencky(YOUNG, POISSON)

    def label(self):
        material = "plastic" if self.plastic else "elastic"
        return f"{material}, {self.basis}, h = {self.h:g} m, {self.method}"

    def files(self):
        material = "plastic" if self.plastic else "elastic"
        return f"collision_{material}_{self.basis}_{self.method}"


# Cells are filled with points, and those outside of the cylinders are left out. Tags tell the
# cylinders apart; one set of points is enough for both.


def build(case):
    cells = np.rint(np.array(BOX[1]) / case.h).astype(int)
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, BOX, cells, mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    spacing = case.h / case.per_direction
    left, right = (np.array(centre) for centre in CENTRES)

    def in_left(x):
        return np.hypot(*(x - left).T) < RADIUS

    bodies = points.lattice(
        domain, spacing, inside=lambda x: in_left(x) | (np.hypot(*(x - right).T) < RADIUS)
    )
    if case.basis == "gimp":
        basis.use(bodies, "gimp", spacing / 2)
    bodies["tag"] = np.where(in_left(bodies.x), 1, 2)
    formulations.set_initial_state(
        bodies, DENSITY, lambda x: np.outer(np.where(in_left(x), SPEED, -SPEED), (1.0, 0.0))
    )
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    U = fem.Function(space)
    scheme, updates, R = equations(case.method, case.law, bodies, U, dt=1.0)
    newton = {"rtol": 1e-11, "atol": 1e-13}
    if case.tying > 0:
        newton["tying"] = Tying(space, bodies, ActiveCells(bodies), case.tying)
    return ImplicitMPM(R, U, scheme, bodies, updates={bodies: updates}, newton=newton)


# ## Running
#
# The paper takes five times the step of explicit dynamics, which it finds with the sum of the
# points' moduli at a node instead of their mean. That is as many times larger as there are points
# in a cell; so its steps are 5/35 of that by the mean, or 0.055 s.
#
# Pictures are taken when there is most strain energy, and before and after that.


class Momenta:
    """Largest changes of linear and angular momentum so far, as shares of those of one cylinder."""

    def __init__(self, bodies):
        self.bodies = bodies
        self.linear = self.angular = 0.0
        self.at_start = momentum(bodies), angular_momentum(bodies)
        self.size = SPEED * bodies.mesh.comm.allreduce(float(bodies["mass"].sum())) / 2

    def record(self):
        linear = np.linalg.norm(momentum(self.bodies) - self.at_start[0]) / self.size
        angular = abs(angular_momentum(self.bodies) / self.at_start[1] - 1)
        self.linear, self.angular = max(self.linear, linear), max(self.angular, angular)


def run(case, until=END, times=(1.9, 2.7, 3.5, 4.9)):
    sim = build(case)
    bodies = sim.bodies[0]
    length = CourantStep({bodies: case.law}, FACTOR / case.per_direction)
    io.say(f"{case.label()}: {bodies.size_global} material points")
    energies, momenta, frames = Energies(sim, case.law), Momenta(bodies), {}
    left = list(times)
    try:
        for step in io.watch(sim.run(until, step_length=length), until, case.label()):
            energies.record(step)
            momenta.record()
            if left and step.time >= left[0] - 1e-9:
                frames["ABCD"[len(times) - len(left)]] = snapshot(bodies, case.law, sim.time)
                left.pop(0)
    except NewtonError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return energies, momenta, length, frames


# ## Results


def show(cases, until, output):
    rows, tables = [], {}
    for case in cases:
        times = (2.9, 3.9, 4.4, 6.7) if case.plastic else (1.9, 2.7, 3.5, 4.9)
        energies, momenta, length, frames = run(case, until, times)
        table = energies.table()
        tables[case.label()] = table
        rows.append((case, momenta, length, table))
        save(output / f"{case.files()}.csv", table, {"case": case.label()})
        if frames and case.method == "energy-momentum":
            fields = ("strain", "kinetic") + ("dissipated",) * case.plastic
            draw(output / f"{case.files()}.png", frames, "J", 1.0, fields)
    columns = {"until [s]": ".4g", "momentum": ".1e", "angular": ".1e", "energy": ".1e"}
    columns |= {"at the end": "+.2%", "dissipated": ".1%", "Newton its": ".2f", "most": ".0f"}
    width = max(len(case.label()) for case, *_ in rows)
    printed = io.Table(
        {"largest changes of".ljust(width): "s"} | columns | {"steps from": ".4f", "to [s]": ".4f"}
    )
    for case, momenta, length, table in rows:
        steps = np.array(length.history)
        printed.row(
            case.label(), table[-1, 0], momenta.linear, momenta.angular, drift(table, 0.0),
            table[-1, 4] / table[0, 4] - 1, table[-1, 3] / table[0, 4],
            table[1:, 5].mean(), table[1:, 5].max(), steps.min(), steps.max(),
        )  # fmt: skip
    plot(output / "collision_energies.png", tables)
    io.say(f"collision_energies.png, pictures of A, B, C, D and .csv files are in {output}")
    return rows


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Collision of two cylinders")
    add = parser.add_argument
    add(
        "--plastic", action="store_true", help="von Mises plasticity (7.3) instead of elastic (7.2)"
    )
    add("--fine", action="store_true", help="uGIMP, cells of 0.5 m, 8 points a direction")
    add("--method", choices=METHODS, nargs="+", help="(default: energy-momentum)")
    add("--full", action="store_true", help="the paper's three cases")
    add("--study", action="store_true", help="all methods, elastic")
    add("--until", type=float, default=END, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps with fewer points, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    add("-v", "--verbose", action="store_true", help="print a line for each Newton iteration")
    if parser.parse_args(arguments).short:
        parser.set_defaults(until=0.3)
    options = parser.parse_args(arguments)
    if not options.until > 0:
        parser.error(f"argument --until: must be positive, not {options.until}")
    own = [options.short, options.study, options.full]
    if sum(own) > 1 or (any(own) and (options.method or options.plastic or options.fine)):
        parser.error("--short, --study and --full have cases of their own: give nothing with them")
    if options.plastic and "symplectic" in (options.method or ()):
        parser.error("the stress of the mid-point has no plastic state at the end of a step")
    io.show_log(logging.INFO if options.verbose else logging.WARNING)
    fine = {"basis": "gimp", "h": 0.5, "per_direction": 8, "tying": 0.1}
    if options.short:
        return show([Case(per_direction=10)], options.until, options.output)
    if options.full:
        cases = [Case(), Case(plastic=True), Case(plastic=True, **fine)]
    elif options.study:
        cases = [Case(method=method) for method in METHODS]
    else:
        methods = options.method or ["energy-momentum"]
        kind = fine if options.fine else {}
        cases = [Case(plastic=options.plastic, method=method, **kind) for method in methods]
    return show(cases, options.until, options.output)


if __name__ == "__main__":
    main()
