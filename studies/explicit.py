# SPDX-License-Identifier: MIT
"""Examples of Y. Zhao, C. Jiang, J. Choo, "Circumventing volumetric locking in explicit MPM".

The demos describe the problems. This script runs them with other averages of J, grid functions and
cell sizes. ``python studies/explicit.py cook --help`` lists the options of one problem. Lists are
given as ``--averages F-bar --averages standard``. Figures and files are written to output/.
"""

import math
from itertools import product
from pathlib import Path

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh
from dolfinx.mesh import CellType, DiagonalType

from fenicsmpm import ExplicitMPM, RigidBody, UnstableError, basis, io, points, shapes
from fenicsmpm import formulations as fm
from fenicsmpm.diagnostics import angular_momentum, mean_stress, probe, roughness
from fenicsmpm.materials import NeoHookean, NewtonianFluid, VonMises

AVERAGES = {"F-bar": "default", "standard": None}
AVERAGES |= {"algorithm-1": fm.ALGORITHM_1, "true-J": fm.TRUE_J}
BASES = {"quadratic": "B-splines", "gimp": "uGIMP", "linear": "linear"}
SPLINES, FBAR = ["quadratic"], ["F-bar"]
GRAVITY, PRANDTL, TIP = 9.81, 2 + math.pi, 0.2765  # m/s^2; m by P2-P1 finite elements
Names = list[str]
app = typer.Typer(help=__doc__, pretty_exceptions_enable=False)


def cases(bases, averages):
    """Return functions and averages of J by title; averages may also be r,s of ``FBar``."""
    try:
        for a in set(averages) - set(AVERAGES):
            AVERAGES[a] = fm.FBar(*map(float, a.split(",")))
        return {f"{a}, {BASES[b]}": (b, AVERAGES[a]) for b, a in product(bases, averages)}
    except (KeyError, TypeError, ValueError) as error:
        known = f"{', '.join(AVERAGES)} or r,s; functions: {', '.join(BASES)}"
        raise typer.BadParameter(f"{error}; averages: {known}") from error


def velocity(lower, upper, h, walls=True, beyond=0, **kind):
    """Return the unknown on a mesh with slip at its edges, or with cells beyond these walls."""
    corners = [np.array(lower) - beyond * h, np.array(upper) + beyond * h]
    shape = np.rint((corners[1] - corners[0]) / h).astype(int).tolist()
    in_space = len(shape) == 3
    kind = kind or {"cell_type": CellType.hexahedron if in_space else CellType.quadrilateral}
    create = mesh.create_box if in_space else mesh.create_rectangle
    z = fm.Unknown(create(MPI.COMM_WORLD, corners, shape, **kind), "v")
    for k, (low, high) in enumerate(zip(lower, upper, strict=True) if walls else ()):
        at = lambda x, k=k, a=low + 1e-9, b=high - 1e-9: (x[k] < a) | (x[k] > b)  # noqa: E731
        z.fix("v", at, component=k)
    return z


def seen(body, functions, spacing, density=None):
    """Choose grid functions of points and return these; undeformed if a density is given."""
    if functions != "linear":
        basis.use(body, functions, *([spacing / 2] if functions == "gimp" else []))
    if density:
        fm.set_initial_state(body, density)
    return body


def advance(sim, until, interval, label):
    try:
        yield from io.watch(sim.run(until, interval), until, label)
    except UnstableError as error:
        io.say(f"{label} ends at t = {sim.time:.4g} s: {error}")


def extent(values):
    ends = MPI.COMM_WORLD.allgather((values.min(initial=np.inf), values.max(initial=-np.inf)))
    return min(low for low, _ in ends), max(high for _, high in ends)


def pressures(body, unit):
    """Return points with their mean stress in a unit."""
    cloud = io.gather_points(body)
    if cloud is not None:
        cloud["p"] = mean_stress(cloud["sigma"]) / unit
    return cloud


def panel(x):
    return (x[0] <= 48) & (x[1] >= x[0] * 44 / 48) & (x[1] <= 44 + x[0] * 16 / 48)


def membrane(functions, averages, h, steps, nu=0.499, squares=False):
    """Return body of Cook's membrane, history of the tip, and roughness of p over load per area."""
    # diagonals across the panel bend more easily than diagonals along it
    triangles = {"cell_type": CellType.triangle, "diagonal": DiagonalType.left}
    kind = triangles if functions == "linear" and not squares else {}
    z = velocity((0, -2), (50, 64), h, walls=False, **kind)
    body = seen(points.lattice(z.mesh, h / 2, inside=panel), functions, h / 2, 1.0)
    edge = body.select(lambda x: x[0] > 48 - h / 2)
    edge["weight"] = 16 / edge.size_global  # m
    tip = edge.select(lambda x, top=extent(edge.x[:, 1])[1]: x[1] == top)
    z.fix("v", lambda x: np.isclose(x[0], 0))
    R = fm.internal_force(z.test.v, body, NeoHookean(E=70.0, nu=nu), fbar=averages)
    R += fm.dead_load(z.test.v, edge, (0.0, 1 / 16))  # Pa
    history = io.History({"tip [m]": lambda sim: probe(tip, "u")[1]})
    # this damping leads to rest soonest; splines at the light corner need short steps
    damping, cfl = {"quadratic": (0.8, 0.3), "gimp": (0.9, 0.3), "linear": (0.7, 0.8)}[functions]
    options = {"carried": [edge, tip], "observers": [history]}
    sim = ExplicitMPM(R, z, body, cfl=cfl, damping=damping, **options)
    list(advance(sim, steps * sim.dt, steps * sim.dt / 200, functions))
    return body, history, 16 * roughness(body, mean_stress(body["sigma"]), h / 2)


@app.command()
def cook(h: float = 1.0, steps: int = 60000, nu: float = 0.499, squares: bool = False,
         bases: Names = SPLINES, averages: Names = [*AVERAGES]):  # fmt: skip
    """Cook's membrane, cells of H m: tip, its remaining motion, roughness of the mean stress.

    Linear functions are on triangles, or on squares as the others. The tip is compared with that
    of finite elements for nu = 0.499.
    """
    columns = {"averages, functions".ljust(25): "s", "tip [m]": ".4f", "off 0.2765 m": "+.1%"}
    table = io.Table(columns | {"change in the last quarter": ".2%", "roughness": ".4f"})
    curves, clouds = {}, {}
    for name, case in cases(bases, averages).items():
        body, curves[name], rough = membrane(*case, h, steps, nu, squares)
        u, clouds[name] = curves[name]["tip [m]"], pressures(body, 1.0)
        change = np.ptp(u[3 * len(u) // 4 :]) / abs(u[-1])
        table.row(name.ljust(25), u[-1], u[-1] / TIP - 1, change, rough)
    io.picture("output/cook.png", clouds, "p", "mean stress [Pa]", limits=(-0.1, 0.1))
    io.plot("output/cook_tip.png", curves, reference={"finite elements": TIP})


def strip(functions, averages, cells, size=6, settlement=0.004):
    """Return ground of a strip footing of width 1 m, settlements [m], and loads over strength."""
    h, clay = 1 / cells, VonMises(E=1e6, nu=0.49, sigma_y=math.sqrt(3) * 100.0)
    z = velocity((0, 0), (size, size + 4 * h), h)
    ground = points.lattice(z.mesh, h / 2, inside=lambda x: x[1] < size)
    seen(ground, functions, h / 2, 1000.0)
    down = 1e-5 * math.sqrt(clay.wave_speed_modulus / 1000.0)  # m/s
    ends = (-1.0, size), (0.5, math.inf)
    box = RigidBody(shapes.Box(*ends), reach=h / 4, velocity=(0.0, -down), friction=math.inf)
    R = fm.internal_force(z.test.v, ground, clay, fbar=averages)
    history = io.History({"load": lambda sim: -box.force[1] / 50})
    sim = ExplicitMPM(R, z, ground, damping=0.002, rigid=[box], observers=[history])
    list(advance(sim, settlement / down, settlement / down / 200, f"B/{cells}"))
    return ground, history["t [s]"] * down, history["load"]


@app.command()
def footing(n: list[int] = [20], bases: Names = SPLINES, averages: Names = FBAR, size: int = 6):
    """Bearing capacity of a strip footing, N cells wide, on ground that is SIZE times as wide."""
    table = io.Table({"case".ljust(32): "s", "plateau": ".3f", "off 2 + pi": "+.1%"})
    curves, clouds = {}, {}
    for (name, case), cells in product(cases(bases, averages).items(), n):
        title = f"{name}, h = B/{cells}"
        ground, *curves[title] = strip(*case, cells, size)
        plateau, clouds[title] = curves[title][1][-40:].mean(), pressures(ground, 100.0)
        table.row(title.ljust(32), plateau, plateau / PRANDTL - 1)
    io.picture("output/footing.png", clouds, "p", "p / shear strength", limits=(-5.0, 0.0))
    labels = "settlement / width", "load / shear strength"
    io.plot("output/footing_load.png", curves, *labels, reference={"Prandtl": PRANDTL})


def flume(functions, averages, wall, beyond, damping, water=None, h=0.25, per_side=5, dt=1e-5):
    """Return history and loop of water in a box with cells beyond its walls; new or given water."""
    z, spacing = velocity((0, 0), (wall, 6), h, beyond=beyond), h / per_side
    if water is None:
        inside = lambda x: (x[:2] > 0).all(axis=0) & (x[0] < 4) & (x[1] < 2)  # noqa: E731
        water = seen(points.lattice(z.mesh, spacing, inside=inside), functions, spacing, 997.5)
    else:
        water = seen(points.from_mesh(z.mesh, water), functions, spacing)
    R = fm.internal_force(z.test.v, water, NewtonianFluid(kappa=2e9, mu=1e-3), fbar=averages)
    R += fm.body_force(z.test.v, water, (0.0, -GRAVITY))
    columns = {
        "front [m]": lambda sim: water.bounds()[1][0],
        "J": lambda sim: extent(water["J"])[0],
    }
    columns |= {"J to": lambda sim: extent(water["J"])[1], "V": lambda sim: water.volume() / 8 - 1}
    history = io.History(columns)
    return history, ExplicitMPM(R, z, water, dt=dt, damping=damping, observers=[history])


def released(case, wall=8.0, beyond=0, until=1.2, at=(), **options):
    """Return history, clouds at some times, and errors of pressures at rest over rho g H."""
    _, sim = flume(*case, 4.0, beyond, 0.5, **options)
    list(advance(sim, 0.3, 0.03, "filling"))
    (water,) = sim.bodies
    depth = mean_stress(water["sigma"]) / (-997.5 * GRAVITY)
    error = extent(np.abs(depth - 2 + water.x[:, 1]))[1] / 2
    history, sim = flume(*case, wall, beyond, 0.0, water, **options)
    clouds = {}
    for step in advance(sim, until, 0.05, "dam break"):
        if np.isclose(at, step.time, atol=0.01).any():
            clouds[f"t = {step.time:.2f} s"] = pressures(sim.bodies[0], -1e3)
    return history, clouds, error


@app.command()
def dam(wall: float = 8.0, beyond: int = 0, until: float = 1.2, averages: Names = FBAR,
        bases: Names = SPLINES):  # fmt: skip
    """Dam break UNTIL a time in s, 2 in the paper; BEYOND layers of cells outside the walls."""
    columns = {"averages, functions".ljust(25): "s", "t [s]": ".2f", "front [m]": ".2f"}
    columns |= {"least J": ".4f", "largest J": ".4f", "change of volume": "+.2%"}
    table, fronts = io.Table(columns), {}
    for name, case in cases(bases, averages).items():
        history, clouds, error = released(case, wall, beyond, until, (0.4, 0.8, 1.2, 2.0))
        rows = np.array([history[title] for title in history.titles]).T
        for row in rows[np.isin(rows[:, 0].round(2), (0.4, 0.8, 1.0, 1.2, 2.0))]:
            table.row(name.ljust(25), *row)
        io.say(f"  at rest, pressures are off by {error:.2%} of rho g H at most")
        fronts[name] = rows[:, 0], rows[:, 1]
        view = {"limits": (0.0, 20.0), "bounds": ((0, 0), (wall, 3.0))}
        if clouds:
            io.picture(f"output/dam, {name}.png", clouds, "p", "pressure [kPa]", **view)
    io.plot("output/dam_front.png", fronts, "t since the gate [s]", "foremost point [m]")


def slope(functions, averages, h, dt=None):
    """Return the landslide's law by the reduction of its strength, and its loop; 5 m wide."""
    law = lambda by: VonMises(E=25e6, nu=0.499, sigma_y=50e3 / by, sigma_r=3e3, eta=5.0)  # noqa: E731
    z = velocity((0.0, 0.0, 0.0), (40.0, 5.0, 6.0), h)
    z.fix("v", lambda x: np.isclose(x[2], 0))
    inside = lambda x: (x[2] < 5) & (x[0] + x[2] < 15 - 1e-9)  # noqa: E731
    body = seen(points.lattice(z.mesh, h / 2, inside=inside), functions, h / 2, 2150.0)
    R = fm.internal_force(z.test.v, body, law(1.0), fbar=averages)
    R += fm.body_force(z.test.v, body, (0.0, 0.0, -GRAVITY))
    return law, ExplicitMPM(R, z, body, dt=dt, cfl=0.35, damping=0.5)


@app.command()
def landslide(h: float = 0.5, until: float = 4.5, dt: float | None = None, averages: Names = FBAR,
              bases: Names = SPLINES, restart: bool = False):  # fmt: skip
    """Landslide in 3D UNTIL s after the failure; the paper's is --h 0.2 --dt 5e-5 (1 hour)."""
    columns = {"averages, functions".ljust(25): "s", "t [s]": ".2f", "run-out [m]": ".2f"}
    columns |= {"plastic strain": ".2f", "least J": ".4f", "largest J": ".4f"}
    table = io.Table(columns | {"mean stress from [kPa]": ".0f", "to [kPa]": ".0f"})
    curves, clouds = {}, {}
    for name, case in cases(bases, averages).items():
        law, sim = slope(*case, h, dt)
        (body,), path = sim.bodies, f"output/landslide, {name}, {h:g} m"
        if restart and Path(f"{path}.h5").exists():
            io.checkpoint.restore(f"{path}.h5", sim)
        run_out = {"run-out [m]": lambda sim: sim.bodies[0].bounds()[1][0] - 15}
        history = io.History(run_out, f"{path}.csv", append=restart)
        series = io.Series(f"{path}.vtkhdf", body, append=restart)
        list(advance(sim, 1.0, 0.05, "settling"))
        for recorder in (history, series):
            recorder.begin(sim)
        sim.damping, sim.laws[body] = 0.0, law(1.65)
        for step in advance(sim, 1 + until, 0.25, name):
            for recorder in (history, series):
                recorder.done(sim, step)
            io.checkpoint.save(f"{path}.h5", sim)
        curves[name] = history["t [s]"] - 1, history["run-out [m]"]
        clouds[name], p = io.gather_points(body), mean_stress(body["sigma"]) / 1e3
        ends = extent(body["eps_p"])[1], *extent(body["J"]), *extent(p)
        table.row(name.ljust(25), sim.time - 1, curves[name][1][-1], *ends)
    io.picture("output/landslide.png", clouds, "eps_p", "plastic strain", limits=(0.0, 2.0))
    io.plot("output/landslide_run_out.png", curves, "t since the failure [s]", "run-out [m]")


def spinning(functions, flip, h, turns, rate=0.2):
    """Return number of steps and remaining angular momentum of a free disc after some turns."""
    z = velocity((0, 0), (1, 1), h, walls=False)
    disc = points.lattice(z.mesh, h / 2, inside=lambda x: np.hypot(*(x[:2] - 0.5)) < 0.3)
    seen(disc, functions, h / 2)
    fm.set_initial_state(disc, 1e3, lambda x: rate * np.array([0.5 - x[1], x[0] - 0.5]))
    R = fm.internal_force(z.test.v, disc, NeoHookean(E=1e3, nu=0.3))
    sim = ExplicitMPM(R, z, disc, flip=flip)
    start, until = angular_momentum(disc), turns * 2 * math.pi / rate
    list(advance(sim, until, until / 20, f"{functions}, {flip:g}"))
    return sim.number, angular_momentum(disc) / start


@app.command()
def spin(h: float = 0.05, turns: float = 2.0, bases: Names = SPLINES,
         flip: list[float] = [1.0, 0.99, 0.0]):  # fmt: skip
    """Spinning free disc: the angular momentum that fractions of FLIP keep after some turns."""
    table = io.Table({"functions".ljust(9): "s", "FLIP": ".2f", "steps": "d", "left": ".1%"})
    for functions, share in product(bases, flip):
        table.row(functions.ljust(9), share, *spinning(functions, share, h, turns))


if __name__ == "__main__":
    app()
