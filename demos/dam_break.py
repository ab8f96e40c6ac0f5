# SPDX-License-Identifier: MIT
#
# # Dam break
#
# A column of water, 4 m long and 2 m high, stands behind a gate. The gate goes, and the water runs
# along the floor to the wall on the right and back. Water is nearly incompressible: its pressure is
# noise, and the water as stiff as jelly, unless J is averaged. The demo shows how
#
# - a fluid is set up, with slip walls,
# - a first stage with damping finds the state of rest under gravity,
# - points with all that they carry go to another mesh,
# - averages of J keep a fluid free of noise for long.
#
# It is section 4.3 of Zhao, Jiang and Choo, *Circumventing volumetric locking in explicit material
# point methods* (in short: F-bar), after Mast et al., Journal of Computational Physics 231, 2012.
#
# ## Formulation
#
# $$
# \sigma = K (\bar J - 1) I + 2 \mu \, \mathrm{dev} \, d
# $$
#
# with the bulk modulus K, the viscosity, and the rate of deformation d. As in
# `cooks_membrane_explicit.py`, $\bar J$ is an average over the grid. Nothing in a fluid holds the
# true J of neighbours together: with the paper's algorithm 1 they drift apart, unseen by the
# pressure. By default, a share of the difference to the average is taken back as the water deforms.
#
# Steps are those of the paper, a seventeenth of the time that sound takes through a cell. Water
# that runs up a wall comes very near to it, where functions have steep slopes: with steps seven
# times as long the film is torn to pieces.
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
from fenicsmpm.diagnostics import mean_stress
from fenicsmpm.materials import NewtonianFluid

LENGTH, HEIGHT = 4.0, 2.0  # of the water, m
DENSITY = 997.5  # kg/m^3
GRAVITY = 9.81  # m/s^2
WATER = NewtonianFluid(kappa=2e9, mu=1e-3)
AVERAGES = {
    "F-bar": "default",
    "algorithm-1": formulations.ALGORITHM_1,
    "true-J": formulations.TRUE_J,
    "standard": None,
}
BASES = {"quadratic": "B-splines", "gimp": "uGIMP"}
# m at t [s], by computations with algorithm 1, the wall at 12 m and two cells beyond the walls
FRONTS = {
    "quadratic": {0.4: 5.3, 0.8: 8.1, 1.2: 11.1},
    "gimp": {0.4: 5.4, 0.8: 8.4, 1.2: 11.7},
}


@dataclass
class Case:
    basis: str = "quadratic"
    averages: str = "F-bar"
    h: float = 0.25  # size of cells, m
    per_side: int = 5  # points along the side of a cell
    wall: float = 8.0  # where the wall on the right is, m
    beyond: int = 0  # cells behind the walls
    dt: float = 1e-5  # s

    def label(self):
        return f"{self.averages}, {BASES[self.basis]}"


# Walls are edges of a mesh, where the normal velocity is zero. So the gate is the edge of a first
# mesh, on which the water comes to rest. Functions at the edges are such that the normal velocity
# is zero just there. Codes that do not have them need cells beyond the walls, whose nodes are held,
# too: the water then sticks a little, sinks into the floor, and has bands of pressure (`--beyond`).


def build(case, wall):
    h, beyond = case.h, case.beyond * case.h
    lower, upper = np.array([-beyond, -beyond]), np.array([wall + beyond, 6 + beyond])
    shape = np.rint((upper - lower) / h).astype(int).tolist()
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [lower, upper], shape, mesh.CellType.quadrilateral
    )
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    sides = formulations.roller(V, 0, lambda x: (x[0] < 1e-9) | (x[0] > wall - 1e-9))
    floor = formulations.roller(V, 1, lambda x: (x[1] < 1e-9) | (x[1] > 6 - 1e-9))
    return V, [sides, floor]


def start(case, V, bcs, water, damping):
    size = {"half_size": case.h / case.per_side / 2} if case.basis == "gimp" else {}
    basis.use(water, case.basis, **size)
    v, w = fem.Function(V), ufl.TestFunction(V)
    R = formulations.internal_force(w, water, WATER, fbar=AVERAGES[case.averages])
    R += formulations.body_force(w, water, (0.0, -GRAVITY))
    return ExplicitMPM(R, v, water, bcs=bcs, dt=case.dt, damping=damping)


# First stage: gravity, with damping. The pressure at rest is known.


def fill(case, seconds=0.3):
    V, bcs = build(case, LENGTH)

    def inside(x):
        return (x > 0).all(axis=1) & (x[:, 0] < LENGTH) & (x[:, 1] < HEIGHT)

    water = points.lattice(V.mesh, case.h / case.per_side, inside=inside)
    formulations.set_initial_state(water, DENSITY)
    sim = start(case, V, bcs, water, damping=0.5)
    io.say(f"{case.label()}: {water.size_global} material points, steps of {sim.dt:.3g} s")
    for _ in io.watch(sim.run(seconds, seconds / 10), seconds, "filling"):
        pass
    depth = HEIGHT - water.x[:, 1]
    error = np.abs(mean_stress(water["sigma"]) + DENSITY * GRAVITY * depth).max(initial=0.0)
    error = water.mesh.comm.allreduce(error, MPI.MAX) / (DENSITY * GRAVITY * HEIGHT)
    io.say(f"  at rest, pressures deviate from rho g h by {error:.2%} of rho g H at most")
    return water, error


# Second stage: the water as it is, on the whole mesh, without damping.


def run(case, until, pictures=()):
    at_rest, error = fill(case)
    V, bcs = build(case, case.wall)
    water = points.from_mesh(V.mesh, at_rest)
    sim = start(case, V, bcs, water, damping=0.0)
    history, shots = [], []
    interval = 0.05
    try:
        for step in io.watch(sim.run(until, interval), until, case.label()):
            t = step.time
            _, upper = water.bounds
            J = water["J"]
            low = water.mesh.comm.allreduce(J.min(initial=1.0), MPI.MIN)
            high = water.mesh.comm.allreduce(J.max(initial=1.0), MPI.MAX)
            history.append((t, upper[0], water.volume / (LENGTH * HEIGHT) - 1, low, high))
            if any(abs(t - shot) < interval / 2 for shot in pictures):
                shots.append(snapshot(water, f"{case.label()}, t = {t:.2f} s"))
    except UnstableError as failure:
        io.say(f"  it ends {sim.time:.3f} s after the gate: {failure}")
    return sim, np.array(history).reshape(-1, 5), shots, error


def snapshot(water, title):
    cloud = io.gather_points(water)
    if cloud is not None:
        cloud["p"] = -mean_stress(cloud["sigma"]) / 1e3
    return io.Panel(cloud, "p", title)


# ## Results


def results(case, history, rows):
    if not len(history):
        return
    end = history[-1, 0]
    for t in [t for t in (0.4, 0.8, 1.0, 1.2) if t < end + 1e-6] or [end]:
        front, volume, low, high = (np.interp(t, history[:, 0], column) for column in history.T[1:])
        expected = FRONTS[case.basis].get(t) if case.wall >= 12 else None
        deviation = front / expected - 1 if expected else None
        rows.row(case.label(), t, front, expected, deviation, volume, low, high)


def show(cases, until, output):
    runs, histories = [], {}
    pictures = [t for t in (0.4, 0.8, 1.2, 2.0) if t <= until + 1e-9] or [until]
    for case in cases:
        runs.append((case, *run(case, until, pictures)))
        histories[case.label()] = runs[-1][2]
    columns = {"averages, functions": "s", "t [s]": ".2f", "front [m]": ".2f"}
    columns |= {"reference [m]": ".1f", "deviation": "+.1%", "change of volume": "+.2%"}
    rows = io.Table(columns | {"least J": ".4f", "largest J": ".4f"})
    for case, _, history, _, _ in runs:
        results(case, history, rows)
    for k, (_, _, _, shots, _) in enumerate(runs):
        if shots:
            bounds = ((0, 0), (cases[k].wall, 3.0))
            path = output / f"dam_break_{cases[k].averages}_{cases[k].basis}.png"
            io.picture(path, shots, "pressure [kPa]", limits=(0.0, 20.0), bounds=bounds)
    fronts = {label: (history[:, 0], history[:, 1]) for label, history in histories.items()}
    io.plot(output / "dam_break_front.png", fronts, "t since the gate [s]", "foremost point [m]")
    io.say(f"dam_break_*.png are in {output}")
    return runs


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Dam break, explicit, nearly incompressible")
    add = parser.add_argument
    add("--basis", choices=BASES, nargs="+", default=["quadratic"], help="grid functions")
    add("--averages", choices=AVERAGES, nargs="+", default=["F-bar"], help="of J")
    add("--wall", type=float, default=8.0, help="wall on the right in m (default: %(default)s)")
    add("--beyond", type=int, default=0, help="cells beyond the walls (default: %(default)s)")
    add("--until", type=float, help="s after the gate (default: 1.2)")
    add("--full", action="store_true", help="until 2 s, as in the paper")
    add("--short", action="store_true", help="a few steps on a coarse grid, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    if not (options.wall > LENGTH and abs(options.wall * 4 - round(options.wall * 4)) < 1e-9):
        parser.error(f"argument --wall: a multiple of 0.25 m above 4 m, not {options.wall}")
    if options.beyond < 0:
        parser.error(f"argument --beyond: at least 0, not {options.beyond}")
    if options.full and (options.short or options.until is not None):
        parser.error("argument --full: it has an end of its own, so leave out --short and --until")
    until = 2.0 if options.full else 0.05 if options.short else 1.2
    until = until if options.until is None else options.until
    if not until > 0:
        parser.error(f"argument --until: must be positive, not {until}")
    io.show_log(logging.WARNING)
    h, per_side, dt = (0.5, 3, 1e-4) if options.short else (0.25, 5, 1e-5)
    cases = [
        Case(basis, averages, h, per_side, options.wall, options.beyond, dt)
        for basis in options.basis
        for averages in options.averages
    ]
    return show(cases, until, options.output)


if __name__ == "__main__":
    main()
