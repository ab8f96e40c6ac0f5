# SPDX-License-Identifier: MIT
#
# # Landslide
#
# A slope of sensitive clay stands under its weight. Then its peak strength is reduced, as by water,
# and it fails: sheared clay keeps a sixteenth of its strength, so that one slice after the other
# slides down, and the slide eats its way back into the slope. The demo shows how
#
# - a three-dimensional body with softening plasticity is computed,
# - strengths are changed between two stages,
# - a long run is saved, and goes on with `--restart`.
#
# It is section 4.4 of Zhao, Jiang and Choo, *Circumventing volumetric locking in explicit material
# point methods* (in short: F-bar), after Bui and Nguyen.
#
# ## Formulation
#
# Hencky elasticity with von Mises plasticity. The paper's strengths 40.82 and 2.45 kPa are taken
# for bounds of the norm of the deviatoric stress, which are yield stresses of 50 and 3 kPa; they go
# from peak to residual with $\exp(-5 \epsilon_p)$. Without a length in the law, the width of shear
# bands is that of some cells.
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
from fenicsmpm.materials import VonMises

CREST, BASE, HEIGHT, WIDTH = 10.0, 15.0, 5.0, 5.0  # m
DENSITY, GRAVITY = 2150.0, 9.81  # kg/m^3, m/s^2
PEAK, RESIDUAL, REDUCTION = 50e3, 3e3, 1.65  # yield stresses, Pa
SETTLING = 1.0  # s of gravity with damping, before the failure
AVERAGES = {
    "F-bar": "default",
    "algorithm-1": formulations.ALGORITHM_1,
    "standard": None,
}
BASES = {"quadratic": "B-splines", "gimp": "uGIMP"}


def clay(reduction=1.0):
    return VonMises(E=25e6, nu=0.499, sigma_y=PEAK / reduction, sigma_r=RESIDUAL, eta=5.0)


@dataclass
class Case:
    basis: str = "quadratic"
    averages: str = "F-bar"
    h: float = 0.5  # size of cells, m
    dt: float | None = None  # s

    def label(self):
        return f"{self.averages}, {BASES[self.basis]}, h = {self.h:g} m"

    def files(self):
        return f"landslide_{self.averages}_{self.basis}_{self.h:g}m"


# The bottom is fixed, three sides are rollers; there is room for the slide to run out.


def build(case):
    lower, upper = np.zeros(3), np.array([40.0, WIDTH, 6.0])
    cells = np.rint(upper / case.h).astype(int)
    domain = mesh.create_box(
        MPI.COMM_WORLD, [lower, cells * case.h], cells.tolist(), mesh.CellType.hexahedron
    )

    def slope(x):
        return (x[:, 2] < HEIGHT) & (x[:, 0] + x[:, 2] < BASE - 1e-9)

    body = points.lattice(domain, case.h / 2, inside=slope)
    law = clay()
    basis.use(body, case.basis, **({"half_size": case.h / 4} if case.basis == "gimp" else {}))
    formulations.set_initial_state(body, DENSITY)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0))
    end = cells[0] * case.h
    bcs = [
        fem.dirichletbc(np.zeros(3), bottom, V),
        formulations.roller(V, 0, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], end)),
        formulations.roller(V, 1, lambda x: np.isclose(x[1], 0) | np.isclose(x[1], WIDTH)),
    ]
    v, w = fem.Function(V), ufl.TestFunction(V)
    R = formulations.internal_force(w, body, law, fbar=AVERAGES[case.averages])
    R += formulations.body_force(w, body, (0.0, 0.0, -GRAVITY))
    return ExplicitMPM(R, v, body, bcs=bcs, dt=case.dt, cfl=0.35, damping=0.5)


# Until `SETTLING` it is damped and as strong as it was; then not.


def run(case, until, output, restart=False, interval=0.05, seconds_between_saves=0.25):
    sim = build(case)
    (body,) = sim.bodies
    checkpoint, saved = output / f"{case.files()}.h5", None
    if restart and checkpoint.exists():
        io.checkpoint.restore(checkpoint, sim)
        saved = sim.time
    io.say(f"{case.label()}: {body.size_global} material points, steps of {sim.dt:.3g} s")
    columns = {
        "t [s]": lambda: sim.time - SETTLING,
        "run-out [m]": lambda: body.bounds[1][0] - BASE,
        "largest plastic strain": lambda: largest(body, "eps_p"),
    }
    series_path = output / f"{case.files()}.pvd"
    table = output / f"{case.files()}.csv"
    shown = None if saved is None else saved - SETTLING
    history = io.History(table, columns, {"h [m]": case.h}, append_after=shown)
    with io.Series(series_path, body, {"h [m]": case.h}, append_after=saved) as series:
        try:
            if sim.time < SETTLING - 1e-9:
                for _ in io.watch(sim.run(SETTLING, interval), SETTLING, "settling"):
                    pass
                io.say(f"  settled: largest velocity {largest_velocity(body):.2g} m/s")
            sim.damping = 0.0
            sim.laws[body] = clay(REDUCTION)
            end = SETTLING + until
            for step in io.watch(sim.run(end, interval), end, case.label()):
                history.write()
                if len(series.times) * seconds_between_saves < step.time - SETTLING + 1e-9:
                    series.write(step.time)
                    io.checkpoint.save(checkpoint, sim)
        except UnstableError as error:
            io.say(f"  it ends at t = {sim.time - SETTLING:.3f} s: {error}")
    return sim, np.column_stack(list(io.read_history(table).values()))


def largest(body, name):
    return body.mesh.comm.allreduce(float(body[name].max(initial=0.0)), MPI.MAX)


def largest_velocity(body):
    speed = np.linalg.norm(body["v"], axis=1).max(initial=0.0)
    return body.mesh.comm.allreduce(float(speed), MPI.MAX)


def draw(path, runs):
    panels = []
    for case, sim, _ in runs:
        cloud = io.gather_points(sim.bodies[0])
        panels.append(io.Panel(cloud, "eps_p", f"{case.label()}, t = {sim.time - SETTLING:.1f} s"))
    io.picture(path, panels, "equivalent plastic strain", limits=(0.0, 2.0))


def show(cases, until, output, restart):
    runs = [(case, *run(case, until, output, restart)) for case in cases]
    rows = io.Table(
        {"averages, functions, cells": "s", "t [s]": ".2f", "run-out [m]": ".2f",
         "largest plastic strain": ".2f"}
    )  # fmt: skip
    for case, _, history in runs:
        if len(history):
            rows.row(case.label(), *history[-1])
    draw(output / "landslide.png", runs)
    run_outs = {case.label(): (history[:, 0], history[:, 1]) for case, _, history in runs}
    io.plot(output / "landslide_run_out.png", run_outs, "t since the failure [s]", "run-out [m]")
    io.say(f"landslide.png, landslide_run_out.png and landslide_*.pvd are in {output}")
    return runs


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Landslide of sensitive clay, explicit")
    add = parser.add_argument
    add("--basis", choices=BASES, nargs="+", default=["quadratic"], help="grid functions")
    add("--averages", choices=AVERAGES, nargs="+", default=["F-bar"], help="of J")
    add("--until", type=float, help="s after the failure (default: 1)")
    add(
        "--full",
        action="store_true",
        help="the paper's case: 0.2 m, 311250 points, 4.5 s after failure",
    )
    add("--short", action="store_true", help="a few steps on a coarse grid, for a test")
    add("--restart", action="store_true", help="go on from the last checkpoints in the output")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    if options.short and (options.full or options.until is not None):
        parser.error("argument --short: it has an end of its own, so leave out --full and --until")
    until = 0.05 if options.short else 4.5 if options.full else 1.0
    until = until if options.until is None else options.until
    if not until > 0:
        parser.error(f"argument --until: must be positive, not {until}")
    io.show_log(logging.WARNING)
    h, dt = (0.2, 5e-5) if options.full else (1.0 if options.short else 0.5, None)
    cases = [Case(b, a, h, dt) for b in options.basis for a in options.averages]
    return show(cases, until, options.output, options.restart)


if __name__ == "__main__":
    main()
