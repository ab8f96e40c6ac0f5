# SPDX-License-Identifier: MIT
#
# # Taylor and Green's vortex
#
# A viscous fluid turns in a closed box, slips along its walls and comes to rest. The solution is
# known, so that errors can be measured while points move through the mesh. The demo shows
#
# - the order of convergence of a flow with moving points,
# - what holds the level of the pressure where there is no free surface,
# - what becomes of the order if the number of points in a cell stays the same.
#
# ## Problem
#
# $$
# v = e^{-2 \nu \pi^2 t} \,
#   (\sin \pi x \cos \pi y, \; -\cos \pi x \sin \pi y), \qquad
# p = -\tfrac{\rho}{4} \, e^{-4 \nu \pi^2 t} (\cos 2 \pi x + \cos 2 \pi y) + p_0
# $$
#
# in the unit square, where p is the mean stress, minus the usual pressure. Points that have left
# the places in which they were seeded integrate less well: the error of a cell's integral is a
# share of it that depends on how many points there are. So the number of points in a cell must
# grow as cells become smaller, here along each side from 4 to 16. Velocities are continued linearly
# from the points to the nodes (`taylor=True`).
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
from matplotlib.figure import Figure

from fenicsmpm import ImplicitMPM, formulations, io, points

DENSITY = 1.0  # kg/m^2
POINTS = {8: 4, 16: 8, 32: 16}  # along the side of a triangle, by the squares along the box
DIAGONALS = ("crossed", "left_right", "right")


@dataclass
class Case:
    viscosity: float = 0.1  # Pa s
    diagonal: str = "crossed"  # of the squares
    until: float = 0.1  # s


def exact(x, t, viscosity):
    """Velocity [m/s] at positions (n, 2)."""
    a, b = np.pi * x.T
    decay = np.exp(-2 * viscosity / DENSITY * np.pi**2 * t)
    return decay * np.column_stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])


# The pressure is held at one node: without, its level is free, and the first step an error. Half
# way up a side it is what it is on average.


def build(case, n, per_side):
    kind = getattr(mesh.DiagonalType, case.diagonal)
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, diagonal=kind)
    fluid = points.fill(domain, per_side)
    formulations.set_initial_state(fluid, DENSITY, velocity=lambda x: exact(x, 0.0, case.viscosity))
    space = formulations.mixed_space(domain)
    U, V = fem.Function(space), ufl.TestFunction(space)
    scheme = formulations.Newmark(U, dt=0.05 / n)
    law = formulations.NewtonianFlow(case.viscosity, DENSITY, scheme)
    R = formulations.mixed(U, V, fluid, law) + scheme.lumped(V, fluid)
    R += formulations.asgs(U, V, fluid, law, force=scheme.force(fluid))

    def zero(sub, where):
        collapsed = sub.collapse()[0]
        dofs = fem.locate_dofs_geometrical((sub, collapsed), where)
        return fem.dirichletbc(fem.Function(collapsed), dofs, sub)

    def at_node(x):
        return np.isclose(x[0], 0) & np.isclose(x[1], 0.5)

    walls = [
        zero(space.sub(0).sub(k), lambda x, k=k: np.isclose(x[k], 0) | np.isclose(x[k], 1))
        for k in range(2)
    ]
    bcs = [*walls, zero(space.sub(1), at_node)]
    updates = {fluid: law.updates(fluid)}
    return ImplicitMPM(R, U, scheme, fluid, bcs=bcs, updates=updates, taylor=True)


def error(case, n, per_side):
    """Relative L2 error of the points' velocity, and the points."""
    sim = build(case, n, per_side)
    (fluid,) = sim.bodies
    label = f"1/{n}, {per_side**2} points a cell"
    for _ in io.watch(sim.run(case.until), case.until, label):
        pass
    wanted = exact(fluid.x, sim.time, case.viscosity)
    squares = [(fluid.weight @ np.sum(v**2, axis=1)) for v in (fluid["v"] - wanted, wanted)]
    found, size = (fluid.mesh.comm.allreduce(float(s)) for s in squares)
    return np.sqrt(found / size), fluid


# ## Results


def show(case, sizes, output):
    rows = io.Table({"h, points a cell": "s", "error of velocity": ".2e", "order": ".2f"})
    errors = {"growing number of points": [], "16 points a cell": []}
    for label, found in errors.items():
        for n in sizes:
            per_side = POINTS[n] if label.startswith("growing") else 4
            value, fluid = error(case, n, per_side)
            order = np.log2(found[-1] / value) if found else None
            found.append(value)
            rows.row(f"1/{n}, {per_side**2}", value, order)
    cloud = io.gather_points(fluid)
    panel = io.Panel(cloud, "v", f"t = {case.until:g} s")
    io.picture(output / "taylor_green.png", [panel], "velocity [m/s]")
    plot(output / "taylor_green_errors.png", sizes, errors)
    io.say(f"taylor_green*.png are in {output}")
    return errors


def plot(path, sizes, errors):
    if MPI.COMM_WORLD.rank != 0:
        return
    figure = Figure(figsize=(5, 4), layout="constrained")
    ax = figure.subplots()
    h = 1 / np.array(sizes)
    for label, found in errors.items():
        ax.loglog(h, found, "o-", ms=4, label=label)
    ax.loglog(h, 0.7 * min(map(min, errors.values())) * (h / h[-1]) ** 2, "k:", label="order 2")
    ax.set_xticks(h, [f"1/{n}" for n in sizes])
    values = [value for found in errors.values() for value in found]
    steps = np.array([1, 2, 5]) * 10.0 ** np.arange(-6, 1)[:, None]
    shown = steps[(steps > 0.5 * min(values)) & (steps < 2 * max(values))]
    ax.set_yticks(shown, [f"{value:g}" for value in shown])
    ax.minorticks_off()
    ax.set_xlabel("h [m]")
    ax.set_ylabel("relative L2 error of the velocity [-]")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Decaying vortex, order of convergence")
    add = parser.add_argument
    add("--viscosity", type=float, default=Case.viscosity, help="in Pa s (default: %(default)s)")
    add("--diagonal", choices=DIAGONALS, default="crossed", help="of squares (default: crossed)")
    add("--until", type=float, default=Case.until, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps on the two coarser meshes, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    if parser.parse_args(arguments).short:
        parser.set_defaults(until=0.02)
    options = parser.parse_args(arguments)
    for name in ("viscosity", "until"):
        if not getattr(options, name) > 0:
            parser.error(f"argument --{name}: must be positive, not {getattr(options, name)}")
    io.show_log(logging.WARNING)
    sizes = list(POINTS)[:2] if options.short else list(POINTS)
    return show(Case(options.viscosity, options.diagonal, options.until), sizes, options.output)


if __name__ == "__main__":
    main()
