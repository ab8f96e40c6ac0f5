# SPDX-License-Identifier: MIT
#
# # A wave hits an elastic block
#
# The water of `dam_break_implicit.py` runs against a block of rubber, fixed to the floor. Its force
# bends the block, which springs back and swings. The demo shows
#
# - a fluid and a solid on one background mesh: their forms are added,
# - what they share: displacements at the nodes, hence no slip where they touch; and the pressure,
#   continuous across their contact.
#
# ## Formulation
#
# Water is an incompressible Newtonian fluid, the block neo-Hookean, nearly incompressible. Where
# they meet in a cell, its nodes have the mass of both.
#
# ## Implementation

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dam_break_implicit import (
    DENSITY,
    GRAVITY,
    HEIGHT,
    VISCOSITY,
    WIDTH,
    volume_error,
    walls,
)  # fmt: skip
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, formulations, io, points
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonError

BOX = (4.0, 4.0)  # of the background mesh, m
BLOCK = ((2.0, 0.0), (2.4, 0.8))  # corners, m
BLOCK_DENSITY = 1200.0  # kg/m^3
RUBBER = NeoHookean(E=2e5, nu=0.45)  # Pa


@dataclass
class Case:
    h: float = 0.1  # size of cells, m
    dt: float = 2e-3  # s


def within(corners):
    lower, upper = np.array(corners)
    return lambda x: np.all((x > lower) & (x < upper), axis=1)


def build(case):
    shape = np.rint(np.array(BOX) / case.h).astype(int).tolist()
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), BOX], shape, diagonal=mesh.DiagonalType.crossed
    )
    water = points.quadrature(domain, degree=4, inside=within(((0, 0), (WIDTH, HEIGHT))))
    block = points.quadrature(domain, degree=4, inside=within(BLOCK))
    formulations.set_initial_state(water, DENSITY)
    formulations.set_initial_state(block, BLOCK_DENSITY)
    at_corner = [(BLOCK[0][0] + 1e-3, BLOCK[1][1] - 1e-3)] if domain.comm.rank == 0 else []
    corner = MaterialPoints(domain, np.reshape(at_corner, (-1, 2)), weight=1.0)

    space = formulations.mixed_space(domain)
    U, V = fem.Function(space), ufl.TestFunction(space)
    scheme = formulations.BDF2(U, dt=case.dt)
    flow = formulations.NewtonianFlow(VISCOSITY, DENSITY, scheme, correction=0.1)
    g = fem.Constant(domain, (0.0, -GRAVITY))

    def equations(body, law):
        R = formulations.mixed(U, V, body, law, force=formulations.density(body) * g)
        R += formulations.asgs(U, V, body, law, force=scheme.force(body, g))
        return R + scheme.lumped(V, body)

    return ImplicitMPM(
        equations(water, flow) + equations(block, RUBBER),
        U,
        scheme,
        [water, block],
        carried=[corner],
        bcs=walls(space, BOX[0]),
        updates={water: flow.updates(water)},
    )


# A point without mass, carried along, tells the deflection of the block at its upper corner.


def run(case, until, output, shots):
    sim = build(case)
    water, block = sim.bodies
    (corner,) = sim.carried
    total = f"{water.size_global} points of water, {block.size_global} of the block"
    io.say(f"h = {case.h:g} m: {total}, steps of {case.dt:.3g} s")
    columns = {
        "t [s]": lambda: sim.time,
        "deflection [m]": lambda: probe(corner, "u")[0],
        "water to the left of the block [m^2]": lambda: left_of(water, BLOCK[0][0]),
        "highest water [m]": lambda: water.bounds[1][1],
        "change of the water's volume": lambda: volume_error(water),
    }
    history, panels = io.History(output / "wave_on_block.csv", columns, {"h [m]": case.h}), []
    history.write()
    try:
        for step in io.watch(sim.run(until), until, "wave"):
            history.write()
            if any(abs(step.time - t) < case.dt / 2 for t in shots):
                panels.append(io.Panel(both(sim.bodies), "p", f"t = {step.time:.3g} s"))
    except NewtonError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return panels


def left_of(water, x):
    return water.mesh.comm.allreduce(float(water.weight[water.x[:, 0] < x].sum()))


def both(bodies):
    """Points of water and block with their pressures in kPa; the block's are mean stresses."""
    clouds = [io.gather_points(body) for body in bodies]
    if clouds[0] is None:
        return None
    cloud = clouds[0].append_polydata(clouds[1])
    cloud["p"] = -cloud["p"] / 1e3
    return cloud


# ## Results


def show(case, until, output):
    shots = [t for t in (0.5, 0.65, 0.8, 1.2) if t <= until + 1e-9] or [until]
    panels = run(case, until, output, shots)
    table = io.read_history(output / "wave_on_block.csv")
    t, deflection = table["t [s]"], table["deflection [m]"]
    most = int(np.argmax(np.abs(deflection)))
    columns = {"cells": "s", "until [s]": ".3g", "largest deflection [m]": ".3f", "at [s]": ".3f"}
    columns |= {"highest water [m]": ".2f", "change of volume": "+.1e"}
    height = table["highest water [m]"][t > 0.4].max(initial=0.0)
    change = np.abs(table["change of the water's volume"]).max()
    rows = io.Table(columns)
    rows.row(f"h = {case.h:g} m", t[-1], deflection[most], t[most], height, change)
    if panels:
        path = output / "wave_on_block.png"
        label = "pressure, in the block mean pressure [kPa]"
        io.picture(path, panels, label, limits=(0.0, 12.0), bounds=((0, 0), BOX))
    curves = {"upper left corner": (t, deflection)}
    io.plot(output / "wave_on_block_deflection.png", curves, "t [s]", "deflection [m]")
    io.say(f"wave_on_block.csv and wave_on_block*.png are in {output}")
    return table


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Dam break against an elastic block, implicit")
    add = parser.add_argument
    add("--size", type=float, default=0.1, help="of cells in m (default: %(default)s)")
    add("--until", type=float, default=1.2, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps on a coarse mesh, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    if parser.parse_args(arguments).short:
        parser.set_defaults(size=0.2, until=0.02)
    options = parser.parse_args(arguments)
    if not options.until > 0:
        parser.error(f"argument --until: must be positive, not {options.until}")
    h = options.size
    if not (h > 0 and round(0.2 / h) > 0 and abs(0.2 / h - round(0.2 / h)) < 1e-9):
        parser.error(f"argument --size: 0.2 m, or that by an integer, not {h}")
    io.show_log(logging.WARNING)
    return show(Case(h=h), options.until, options.output)


if __name__ == "__main__":
    main()
