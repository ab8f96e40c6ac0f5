# SPDX-License-Identifier: MIT
#
# # Strip footing
#
# A rigid strip is pressed into soft clay, which yields without change of volume. The load that the
# ground can bear is known since Prandtl: (2 + pi) times its shear strength. Where volumes lock, the
# ground bears ever more. The demo shows how
#
# - plasticity is chosen, and its history read from the points,
# - a rigid body pushes points by a barrier, with friction,
# - symmetry and supports are conditions on nodes.
#
# It is section 4.2 of Zhao, Jiang and Choo, *Circumventing volumetric locking in explicit material
# point methods* (in short: F-bar).
#
# ## Formulation
#
# Hencky elasticity with von Mises plasticity, whose yield stress is $\sqrt 3$ times the shear
# strength in plane strain; averages of J as in `cooks_membrane_explicit.py`. The footing moves
# slowly, and a little local damping takes the waves that it makes.
#
# ## Implementation

import argparse
import logging
import math
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, RigidBox, UnstableError, basis, formulations, io, points
from fenicsmpm.diagnostics import mean_stress
from fenicsmpm.materials import VonMises

WIDTH = 1.0  # of the footing, B, m
DEPTH = 6.0  # of the ground, and its width beside the axis of symmetry, in widths of the footing
STRENGTH = 100.0  # undrained shear strength, Pa
PRANDTL = 2 + math.pi
CLAY = VonMises(E=1e6, nu=0.49, sigma_y=math.sqrt(3) * STRENGTH)
DENSITY = 1.0e3  # kg/m^3
AVERAGES = {
    "F-bar": "default",
    "algorithm-1": formulations.ALGORITHM_1,
    "true-J": formulations.TRUE_J,
    "standard": None,
}
BASES = {"quadratic": "B-splines", "gimp": "uGIMP"}


@dataclass
class Case:
    basis: str = "quadratic"
    averages: str = "F-bar"
    cells: int = 20  # a width of the footing
    penetration: float = 0.004  # at the end, in widths
    speed: float = 1e-5  # of the footing, in shares of the speed of pressure waves
    damping: float = 0.002

    def label(self):
        return f"{self.averages}, {BASES[self.basis]}, h = B/{self.cells}"


# Only the half beside the axis of symmetry is there. The footing is a box with its lower face half
# a point's distance above the highest points; friction holds what touches it.


def build(case):
    h = WIDTH / case.cells
    size = DEPTH * WIDTH
    n = round(DEPTH * case.cells)
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (size, size + 4 * h)], [n, n + 4], mesh.CellType.quadrilateral
    )
    ground = points.lattice(domain, h / 2, inside=lambda x: x[:, 1] < size)
    basis.use(ground, case.basis, **({"half_size": h / 4} if case.basis == "gimp" else {}))
    formulations.set_initial_state(ground, DENSITY)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))

    sides = formulations.roller(V, 0, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], size))
    floor = formulations.roller(V, 1, lambda x: np.isclose(x[1], 0))
    wave = math.sqrt(CLAY.wave_speed_modulus / DENSITY)
    footing = RigidBox(
        lower=(-WIDTH, size),
        upper=(WIDTH / 2, math.inf),
        reach=h / 4,
        velocity=(0.0, -case.speed * wave),
        friction=math.inf,
    )
    v, w = fem.Function(V), ufl.TestFunction(V)
    R = formulations.internal_force(w, ground, CLAY, fbar=AVERAGES[case.averages])
    bcs = [sides, floor]
    return ExplicitMPM(R, v, ground, bcs=bcs, damping=case.damping, rigid=[footing])


# The load is the force on the footing over its (half) width, averaged between two records.


def run(case, records=200):
    sim = build(case)
    ground, footing = sim.bodies[0], sim.rigid[0]
    speed = -footing.velocity_at(0.0)[1]
    until = case.penetration * WIDTH / speed
    io.say(
        f"{case.label()}: {ground.size_global} material points, {until / sim.dt:.0f} steps of "
        f"{sim.dt:.4g} s"
    )
    loads, history = [], [(0.0, 0.0)]
    sim.data = lambda start, end: loads.append(-footing.force[1])
    try:
        for step in io.watch(sim.run(until, until / records), until, case.label()):
            load = np.mean(loads) / (WIDTH / 2) / STRENGTH
            history.append((speed * step.time / WIDTH, load))
            loads.clear()
    except UnstableError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return sim, np.array(history)


def plateau(history):
    """Mean of the last fifth."""
    settlement, load = history.T
    return float(load[settlement >= 0.8 * settlement[-1]].mean())


def draw(path, sims):
    panels = []
    for case, sim in sims:
        cloud = io.gather_points(sim.bodies[0])
        if cloud is not None:
            cloud["p"] = mean_stress(cloud["sigma"]) / STRENGTH
        panels.append(io.Panel(cloud, "p", case.label()))
    io.picture(path, panels, "mean stress / shear strength", limits=(-5.0, 0.0))


def show(cases, output):
    sims, histories = [], {}
    for case in cases:
        sim, history = run(case)
        sims.append((case, sim))
        histories[case.label()] = history
    columns = {"averages, functions, cells": "s", "plateau of load / strength": ".3f"}
    rows = io.Table(columns | {"2 + pi": ".3f", "deviation": "+.1%"})
    for label, history in histories.items():
        rows.row(label, plateau(history), PRANDTL, plateau(history) / PRANDTL - 1)
    draw(output / "strip_footing.png", sims)
    io.plot(
        output / "strip_footing_load.png",
        {label: tuple(history.T) for label, history in histories.items()},
        "settlement / width of the footing",
        "load / shear strength",
        reference={"Prandtl, 2 + pi": PRANDTL},
    )
    io.say(f"strip_footing.png and strip_footing_load.png are in {output}")
    return histories


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Strip footing on clay, explicit")
    add = parser.add_argument
    default = Case()
    add("--basis", choices=BASES, nargs="+", help="grid functions (default: quadratic)")
    add("--averages", choices=AVERAGES, nargs="+", help="of J (default: F-bar)")
    add("--cells", type=int, help=f"a width (default: {default.cells})")
    add("--speed", type=float, default=default.speed, help="of the footing per wave speed")
    add("--penetration", type=float, default=default.penetration, help="in widths")
    add("--full", action="store_true", help="20, 40 and 80 cells, F-bar and standard, both bases")
    add("--short", action="store_true", help="a few steps on a coarse grid, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    if parser.parse_args(arguments).short:
        parser.set_defaults(speed=5e-4, penetration=0.0004, cells=4)
    options = parser.parse_args(arguments)
    for name in ("cells", "speed", "penetration"):
        value = getattr(options, name)
        if value is not None and not value > 0:
            parser.error(f"argument --{name}: must be positive, not {value}")
    chosen = [name for name in ("basis", "averages", "cells") if getattr(options, name)]
    if options.full and (chosen or options.short):
        parser.error(
            "argument --full: has cases of its own, so only --speed and --penetration go with it"
        )
    io.show_log(logging.WARNING)
    common = {"penetration": options.penetration, "speed": options.speed}
    if options.full:
        cases = [
            Case(basis, averages, cells, **common)
            for cells in (20, 40, 80)
            for basis in BASES
            for averages in ("F-bar", "standard")
        ]
    else:
        cases = [
            Case(basis, averages, options.cells or default.cells, **common)
            for basis in options.basis or ["quadratic"]
            for averages in options.averages or ["F-bar"]
        ]
    return show(cases, options.output)


if __name__ == "__main__":
    main()
