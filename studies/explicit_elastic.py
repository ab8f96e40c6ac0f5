# SPDX-License-Identifier: MIT
"""Elastic bodies by explicit steps: waves, stresses at rest, and a beam that bends.

A solid that does not lock has no averages of J by default. The bar and the column show what
averages would do to it: ``--averages 0.03`` forces them on, ``--averages standard`` is none, and
``--averages F-bar`` is what the law has by default. A column that begins with its stress at rest
shows which points keep this rest. ``python studies/explicit_elastic.py bar --help`` lists the
options of one problem.
"""

import math
from itertools import product
from pathlib import Path

import numpy as np
import typer
from explicit import GRAVITY, Names, advance, cases, extent, seen, velocity

from fenicsmpm import ExplicitMPM, basis, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.diagnostics import kinetic_energy, mean_stress, probe, strain_energy
from fenicsmpm.materials import Hencky, NeoHookean

REFERENCE = Path(__file__).parents[1] / "benchmarks" / "references" / "bending_beam.csv"
DENSITY, DEPTH = 2000.0, 10.0  # kg/m^3 and m, of the column
FORCED = ["standard", "0.03"]  # none, and averages that are forced on
app = typer.Typer(help=__doc__, pretty_exceptions_enable=False)


@app.command()
def bar(h: float = 0.04, bases: Names = ["quadratic"], averages: Names = FORCED):
    """Energy that is left in the first mode of an elastic bar after ten periods."""
    table = io.Table({"averages, functions".ljust(25): "s", "energy left": ".1%"})
    for name, (functions, kind) in cases(bases, averages).items():
        z = velocity((0, 0), (1.2, 3 * h), h)
        body = points.fill(z.mesh, 2, inside=lambda x: x[0] < 1)
        seen(body, functions, h / 2)
        mode = lambda x: np.array([0.01 * np.sin(np.pi * x[0] / 2), 0 * x[0]])  # noqa: E731
        fm.set_initial_state(body, 1.0, mode)
        law = Hencky(E=100.0, nu=0.0)
        sim = ExplicitMPM(fm.internal_force(z.test.v, body, law, fbar=kind), z, body)
        start = kinetic_energy(body)
        list(advance(sim, 4.0, 0.4, name))
        table.row(name.ljust(25), (kinetic_energy(body) + strain_energy(body, law)) / start)


@app.command()
def discs(nu: list[float] = [0.3, 0.48, 0.49], h: float = 0.05,
          bases: Names = ["gimp", "quadratic"],
          averages: Names = ["standard", "0.03", "0.3,100"]):  # fmt: skip
    """Kinetic energy that two discs have left after they met head-on, and their least J."""
    columns = {"averages, functions".ljust(25): "s", "nu": "g", "energy left": ".1%"}
    table = io.Table(columns | {"least J": ".4f"})
    for (name, (functions, kind)), ratio in product(cases(bases, averages).items(), nu):
        z = velocity((-0.2, -0.2), (1.2, 1.2), h, walls=False)
        bodies, R = [], None
        for place, speed in ((0.2, 0.1), (0.8, -0.1)):
            inside = lambda x, c=place: np.hypot(*(x[:2] - c)) < 0.2  # noqa: E731
            disc = seen(points.lattice(z.mesh, h / 4, inside=inside), functions, h / 4)
            fm.set_initial_state(disc, 1e3, (speed, speed))
            force = fm.internal_force(z.test.v, disc, Hencky(E=1e3, nu=ratio), fbar=kind)
            R, bodies = force if R is None else R + force, [*bodies, disc]
        start, least = sum(map(kinetic_energy, bodies)), 1.0
        for _ in advance(ExplicitMPM(R, z, bodies), 3.2, 0.05, f"{name}, {ratio}"):
            least = min(least, *(extent(disc["J"])[0] for disc in bodies))
        table.row(name.ljust(25), ratio, sum(map(kinetic_energy, bodies)) / start, least)


@app.command()
def column(nu: list[float] = [0.0, 0.3, 0.49], h: float = 0.5, bases: Names = ["quadratic"],
           averages: Names = FORCED):  # fmt: skip
    """Error of sigma_xx / sigma_yy in a column of 10 m that settles under its weight."""
    columns = {"averages, functions".ljust(25): "s", "nu": ".2f", "lowest 3 m": ".3f"}
    table = io.Table(columns | {"rows 3 to 5 from": ".3f", "to": ".3f", "0.01 until [m]": ".2f"})
    for (name, (functions, kind)), ratio in product(cases(bases, averages).items(), nu):
        z = velocity((0, 0), (8 * h, DEPTH + 2), h)
        body = points.lattice(z.mesh, h / 2, inside=lambda x: x[1] < DEPTH)
        seen(body, functions, h / 2, DENSITY)
        R = fm.internal_force(z.test.v, body, Hencky(E=50e6, nu=ratio), fbar=kind)
        R += fm.body_force(z.test.v, body, (0.0, -GRAVITY))
        list(advance(ExplicitMPM(R, z, body, damping=0.8), 4.0, 0.4, f"{name}, {ratio}"))
        sigma, depth = body["sigma"], DEPTH - (body.x - body["u"])[:, 1]
        off = np.abs(sigma[:, 0, 0] / sigma[:, 1, 1] - ratio / (1 - ratio))
        floor, rows = off[depth > DEPTH - 3].max(), np.floor(2 * depth / h)
        some = [off[rows == row].max() for row in (2, 3, 4)]
        bent = depth[(off > 0.01) & (depth < DEPTH - 3)].max(initial=0.0)
        table.row(name.ljust(25), ratio, floor, min(some), max(some), bent)


def seeds(h):
    """Return functions and points of a column whose stress is given, by title."""

    def below(x):
        return x[1] < DEPTH

    def fill(per_side):
        return lambda domain: points.fill(domain, per_side, inside=below)

    lattice = lambda domain: points.lattice(domain, 0.4 * h, inside=below)  # noqa: E731
    rule = lambda domain: points.quadrature(domain, 3, inside=below)  # noqa: E731
    yield from ((name, "fill, 2 a side", fill(2), h / 4) for name in ("linear", "gimp"))
    yield "quadratic", "fill, 3 a side", fill(3), None
    yield "cubic", "quadrature, degree 3", rule, None
    yield "quadratic", "fill, 2 a side", fill(2), None
    yield from (
        (name, "lattice, 0.4 h", lattice, h / 5) for name in ("gimp", "quadratic", "linear")
    )


@app.command()
def rest(h: list[float] = [0.5, 0.25], until: float = 1.0):
    """Velocity and error of stress in a column of 10 m that begins with its stress at rest."""
    columns = {"functions": "s", "points".ljust(20): "s", "h [m]": ".2f"}
    table = io.Table(columns | {"|v| / sqrt(g depth)": ".0e", "stress off by": ".0e"})
    at_rest, law = fm.k0_state(DEPTH, DENSITY, 0.5), Hencky(E=50e6, nu=0.2)
    for size in h:
        for functions, title, seed, half in seeds(size):
            z = velocity((0, 0), (4 * size, DEPTH + 2), size)
            body = seed(z.mesh)
            if functions != "linear":
                basis.use(body, functions, *([half] if functions == "gimp" else []))
            fm.set_initial_state(body, DENSITY)
            fm.initial_stress(body, law, at_rest)
            R = fm.internal_force(z.test.v, body, law)
            R += fm.body_force(z.test.v, body, (0.0, -GRAVITY))
            list(advance(ExplicitMPM(R, z, body), until, until / 10, f"{functions}, {title}"))
            wanted = at_rest(np.vstack([body.x.T, np.zeros(len(body))])).transpose(2, 0, 1)
            off = np.abs(body["sigma"] - wanted).max() / (DENSITY * GRAVITY * DEPTH)
            speed = np.abs(body["v"]).max() / math.sqrt(GRAVITY * DEPTH)
            table.row(functions.ljust(9), title.ljust(20), size, speed, off)


@app.command()
def beam(h: list[float] = [0.25], until: float = 0.6, nu: float = 0.499,
         bases: Names = ["quadratic"], averages: Names = ["F-bar", "standard"]):  # fmt: skip
    """Largest u_x of the corner of the bending beam of VMS, with 8 points in a cell."""
    columns = {"averages, functions".ljust(25): "s", "h [m]": "g", "u_x [m]": ".3f"}
    columns |= {"off": "+.1%", "at [s]": ".3f", "end [s]": ".3f", "mean stress [MPa]": ".1f"}
    table, known = io.Table(columns | {"to": ".1f"}), np.loadtxt(REFERENCE, delimiter=",").T[:2]
    limit = known[1, known[0] <= 0.9].max()
    for (name, (functions, kind)), size in product(cases(bases, averages).items(), h):
        z = velocity((-3.5, -1.5, 0.0), (3.5, 1.5, 7.0), size, walls=False)
        z.fix("v", lambda x: np.isclose(x[2], 0))
        inside = lambda x: (np.abs(x[:2]).max(axis=0) < 0.5) & (x[2] < 6)  # noqa: E731
        body = seen(points.lattice(z.mesh, size / 2, inside=inside), functions, size / 2)
        fm.set_initial_state(body, 1100.0, lambda x: np.outer((5 / 3, 0, 0), x[2]))
        corner = seen(points.at(z.mesh, (0.5, 0.5, 6.0)), functions, size / 2)
        R = fm.internal_force(z.test.v, body, NeoHookean(E=1.7e7, nu=nu), fbar=kind)
        history = io.History({"u_x": lambda sim, corner=corner: probe(corner, "u")[0]})
        options = {"carried": [corner], "observers": [history], "cfl": 0.3}
        sim = ExplicitMPM(R, z, body, **options)
        list(advance(sim, until, 0.01, f"{name}, {size:g} m"))
        u, p = history["u_x"], mean_stress(body["sigma"]) / 1e6
        first = np.argmax(u)
        row = u[first], u[first] / limit - 1, history["t [s]"][first], sim.time
        table.row(name.ljust(25), size, *row, p.min(), p.max())


if __name__ == "__main__":
    app()
