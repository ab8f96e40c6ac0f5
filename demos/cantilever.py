# SPDX-License-Identifier: MIT
#
# # Cantilever, energy conserved
#
# A beam is bent down by a force at its end, let go, and swings up and down for five times as long.
# Nothing damps it: energy and momenta must stay what they are, step by step. The demo shows how
#
# - laws at points, here Hencky's, are used in an implicit formulation,
# - the mid-point rule with the energy-momentum stress conserves energy to round-off,
# - other methods lose or gain energy (`--method`, `--study`).
#
# It is section 7.1 of Pretti, Coombs, Augarde, Sims, Marchena Puigvert and Reyna Gutierrez, *A
# conservation law consistent updated Lagrangian material point method for dynamic analysis* (in
# short: conservation).
#
# ## Formulation
#
# With F at the beginning, middle and end of a step, the internal forces are those of
#
# $$
# P = F_m S, \qquad S = \tfrac12 (S_n + S_{n+1})
#   + \frac{2 \Delta\psi - \tfrac12 (S_n + S_{n+1}) : \Delta C}{|\Delta C|^2} \, \Delta C ,
# $$
#
# so that $S : \Delta C / 2$ is the energy gained. Velocities are mapped to the grid with the
# consistent mass, and back by FLIP: then points gain what the grid gains.
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

from fenicsmpm import ImplicitMPM, basis, formulations, io, materials, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import kinetic_energy, strain_energy
from fenicsmpm.materials import Hencky
from fenicsmpm.solvers import CourantStep, NewtonError

LENGTH, HEIGHT = 10.0, 1.0  # m
BOX = ((0.0, 0.0), (11.0, 20.0))  # of the background mesh, m
DENSITY = 7750e3  # kg/m^3
FORCE = 500e3  # N, downwards
RELEASE, END = 25.0, 150.0  # s
LAWS = {"A": (1e9, 0.2), "B": (3e8, 0.49)}  # E in Pa, nu


# What a method is: time scheme, stress, mapping and mass. Only the first conserves energy.

METHODS = {
    "energy-momentum": "mid-point rule, energy-momentum stress, consistent mass, FLIP",
    "symplectic": "the same with the stress of the mid-point",
    "newmark": "Newmark's method, stress of the end, lumped mass in the mapping, FLIP",
    "pic": "as energy-momentum, but PIC",
    "lumped": "as energy-momentum, but lumped mass",
}


def equations(method, law, body, U, dt):
    """Time scheme, updates of the points' fields, and residual, of a body without loads."""
    V = ufl.TestFunction(U.function_space)
    if method == "newmark":
        scheme = formulations.Newmark(U, dt=dt)
    else:
        lumping = 1.0 if method == "lumped" else 0.0
        scheme = formulations.Midpoint(U, dt=dt, flip=float(method != "pic"), lumping=lumping)
    if method in ("newmark", "symplectic"):
        u = U if method == "newmark" else U / 2
        stress = formulations.Response(law, body, formulations.Kinematics(u, body).F)
        R = formulations.stress_power(stress.P, V, body)
    else:
        stress = formulations.EnergyMomentum(law, body, U)
        R = stress.power(V)
    return scheme, stress.updates, R + scheme.inertia(V, body)


# The grid functions are those of uGIMP. The force acts on the two points at the end that are next
# to the axis, and grows until it is taken away.


@dataclass
class Case:
    analysis: str = "A"
    method: str = "energy-momentum"
    h: float = 0.5  # size of cells, m
    per_direction: int = 12  # points a cell

    @property
    def law(self):
        return Hencky(*LAWS[self.analysis])

    def label(self):
        return f"({self.analysis}) {self.method}"


def build(case):
    cells = np.rint(np.array(BOX[1]) / case.h).astype(int)
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, BOX, cells, mesh.CellType.quadrilateral,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    spacing = case.h / case.per_direction
    axis = BOX[1][1] / 2
    body = points.lattice(
        domain,
        spacing,
        inside=lambda x: (x[:, 0] < LENGTH) & (np.abs(x[:, 1] - axis) < HEIGHT / 2),
    )
    basis.use(body, "gimp", spacing / 2)
    formulations.set_initial_state(body, DENSITY)
    at_end = (body.x[:, 0] > LENGTH - spacing) & (np.abs(body.x[:, 1] - axis) < spacing)
    body["tag"] = at_end

    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    U, V = fem.Function(space), ufl.TestFunction(space)
    clamped = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[0], 0))
    bcs = [fem.dirichletbc(np.zeros(2), clamped, space)]
    dt = CourantStep({body: case.law}, factor=15.0)()
    scheme, updates, R = equations(case.method, case.law, body, U, dt)
    force = fem.Constant(domain, np.zeros(2))  # on each of the two points
    R -= ufl.inner(force, V) / body.field("weight") * body.dx(1)

    def load(start, end):
        at = end if case.method == "newmark" else (start + end) / 2
        force.value[1] = -FORCE / 2 * at / RELEASE if at < RELEASE else 0.0

    # residuals of the first steps, of nearly no load, soon are round-off of the stresses
    newton = {"rtol": 1e-11, "atol": 1e-12 * FORCE}
    newton["tying"] = Tying(space, body, ActiveCells(body))
    return ImplicitMPM(
        R, U, scheme, body, bcs=bcs, updates={body: updates}, data=load, newton=newton
    )


# A run records energies, the displacement of the end and the residuals of Newton's method.


class Energies:
    """Kinetic, strain and dissipated energy of bodies over time."""

    def __init__(self, sim, law):
        self.sim, self.law = sim, law
        self.rows = []
        self.residuals = []
        self.lowest = 0.0  # u_y of any point so far, m
        self.record()

    def record(self, step=None):
        bodies = self.sim.bodies
        kinetic = sum(kinetic_energy(body) for body in bodies)
        strain = sum(strain_energy(body, self.law) for body in bodies)
        dissipated = sum(
            body.mesh.comm.allreduce(float(body["V_0"] @ body["dissipation"]))
            for body in bodies
            if "dissipation" in body
        )
        iterations = 0
        if step is not None:
            iterations = step.newton.iterations
            self.residuals.append((step.time, step.newton.residuals))
        down = min(body["u"][:, 1].min(initial=np.inf) for body in bodies)
        self.lowest = min(self.lowest, bodies[0].mesh.comm.allreduce(float(down), MPI.MIN))
        self.rows.append((self.sim.time, kinetic, strain, dissipated, iterations))

    def table(self):
        """Columns t, kinetic, strain, dissipated and total energy, Newton iterations."""
        t, kinetic, strain, dissipated, iterations = np.array(self.rows).T
        total = kinetic + strain + dissipated
        return np.column_stack([t, kinetic, strain, dissipated, total, iterations])


def drift(table, start):
    """Largest change of the total energy since a time, as a share of it."""
    total = table[table[:, 0] >= start - 1e-9, 4]
    return float(np.abs(total / total[0] - 1).max())


def run(case, until=END):
    sim = build(case)
    body = sim.bodies[0]
    io.say(f"{case.label()}: {body.size_global} material points, steps of {sim.next_dt:.4g} s")
    energies = Energies(sim, case.law)
    highest = 0.0
    frames = {}
    try:
        for step in io.watch(sim.run(until), until, case.label()):
            energies.record(step)
            table = energies.rows[-1]
            if step.time > RELEASE and table[2] > highest:
                highest = table[2]
                frames["most strain energy"] = snapshot(body, case.law, sim.time)
            if len(energies.rows) > 2 and step.time < RELEASE:
                frames["before the release"] = snapshot(body, case.law, sim.time)
    except NewtonError as error:
        io.say(f"  it ends at t = {sim.time:.4g} s: {error}")
    return energies, frames


# ## Results
#
# Pictures show the energies per initial volume at the points.


def snapshot(body, law, time):
    """Time, and the points with their energies per initial volume [J/m^3]."""
    cloud = io.gather_points(body)
    speed = np.concatenate(body.mesh.comm.allgather(np.sum(body["v"] ** 2, axis=1)))
    psi = materials.energy(law, body["F"], materials.state_of(law, body))
    psi = np.concatenate(body.mesh.comm.allgather(psi))
    mass = np.concatenate(body.mesh.comm.allgather(body["mass"] / body["V_0"]))
    if cloud is not None:
        cloud["strain energy"], cloud["kinetic energy"] = psi, mass * speed / 2
        if "dissipation" in cloud.point_data:
            cloud["dissipated energy"] = cloud["dissipation"]
    return time, cloud


def draw(path, frames, unit="kJ", scale=1e3, fields=("strain", "kinetic"), time_unit=("s", 1.0)):
    """Points coloured by their energies at some times."""
    for field in fields:
        panels = []
        for title, (time, cloud) in frames.items():
            if cloud is not None:
                cloud[field] = cloud[f"{field} energy"] / scale
            shown = f"{title}, {time / time_unit[1]:.4g} {time_unit[0]}"
            panels.append(io.Panel(cloud, field, shown))
        label = f"{field} energy [{unit}/m^3]"
        name = path.with_name(f"{path.stem}_{field}.png")
        io.picture(name, panels, label, limits=io.colour_range(panels, cut=1))


def plot(path, tables, unit=("s", "J"), scale=(1.0, 1.0)):
    """Energies over time."""
    if MPI.COMM_WORLD.rank != 0:
        return
    figure = Figure(figsize=(7, 3.2 * len(tables)), layout="constrained")
    for ax, (label, table) in zip(
        np.atleast_1d(figure.subplots(len(tables), 1)), tables.items(), strict=True
    ):
        t = table[:, 0] / scale[0]
        names = ["kinetic", "strain", "dissipated", "total"]
        for k, name in enumerate(names, start=1):
            if np.any(table[:, k]):
                style = "k-" if name == "total" else "-"
                ax.plot(t, table[:, k] / scale[1], style, lw=1, label=name)
        ax.set_title(label, fontsize="medium")
        ax.set_xlabel(f"t [{unit[0]}]")
        ax.set_ylabel(f"energy [{unit[1]}]")
        ax.grid(alpha=0.3)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)


def plot_convergence(path, runs, start, end):
    """Residuals of Newton's method in the steps between two times (figure 5b)."""
    if MPI.COMM_WORLD.rank != 0:
        return
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    ax = figure.subplots()
    for n, (label, energies) in enumerate(runs.items()):
        shown = [r for t, r in energies.residuals if start <= t <= end]
        for k, residuals in enumerate(shown):
            share = np.array(residuals) / residuals[0]
            name = label if k == 0 else None
            ax.semilogy(np.arange(len(share)), share, "o-", color=f"C{n}", lw=0.7, ms=3, label=name)
    ax.axhline(1e-11, color="k", ls="--", lw=1, label="tolerance")
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.set_xlabel("Newton iteration")
    ax.set_ylabel("|R| / |R| at the start of the step")
    ax.grid(alpha=0.3)
    ax.legend()
    figure.savefig(path, dpi=160)


def show(cases, until, output):
    runs, tables = {}, {}
    rows = []
    for case in cases:
        energies, frames = run(case, until)
        table = energies.table()
        runs[case.label()], tables[case.label()] = energies, table
        rows.append((case, energies, table))
        name = f"cantilever_{case.analysis}_{case.method}"
        save(output / f"{name}.csv", table, {"method": METHODS[case.method], "case": case.analysis})
        if frames and case.method == "energy-momentum":
            draw(output / f"{name}.png", frames)
    columns = {"analysis, method": "s", "until [s]": ".4g", "energy at 25 s [kJ]": ".4f"}
    columns |= {"drift": ".2e", "at the end": "+.2%", "Newton its": ".2f", "most": ".0f"}
    printed = io.Table(columns | {"lowest u_y [m]": ".3f"})
    for case, energies, table in rows:
        after = table[table[:, 0] >= RELEASE]
        if len(after) == 0:
            after = table[-1:]
        printed.row(
            case.label(), table[-1, 0], after[0, 4] / 1e3,
            drift(table, after[0, 0]), after[-1, 4] / after[0, 4] - 1,
            table[1:, 5].mean(), table[1:, 5].max(), energies.lowest,
        )  # fmt: skip
    plot(output / "cantilever_energies.png", tables, ("s", "kJ"), (1.0, 1e3))
    conserving = {c.label(): runs[c.label()] for c, _, _ in rows if c.method == "energy-momentum"}
    if conserving:
        plot_convergence(output / "cantilever_newton.png", conserving, 22.0, 32.0)
    io.say(f"cantilever_energies.png, cantilever_newton.png and .csv files are in {output}")
    return tables


def save(path, table, parameters):
    if MPI.COMM_WORLD.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        titles = "t [s],kinetic [J],strain [J],dissipated [J],total [J],Newton iterations"
        header = "".join(f"# {name} = {value}\n" for name, value in parameters.items()) + titles
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Cantilever, let go after it was bent")
    add = parser.add_argument
    default = Case()
    add("--analysis", choices=LAWS, nargs="+", help="the paper's (A) E = 1 GPa, nu = 0.2, or (B)")
    add("--method", choices=METHODS, nargs="+", help="(default: energy-momentum)")
    add("--study", action="store_true", help="all methods, analysis (A)")
    add("--points", type=int, default=default.per_direction, help="a direction in a cell")
    add("--until", type=float, default=END, help="end in s (default: %(default)s)")
    add("--short", action="store_true", help="a few steps with fewer points, for a test")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    add("-v", "--verbose", action="store_true", help="print a line for each Newton iteration")
    if parser.parse_args(arguments).short:
        parser.set_defaults(points=4, until=3.0, analysis=["A"])
    options = parser.parse_args(arguments)
    if options.points < 1 or not options.until > 0:
        parser.error("--points and --until must be positive")
    if options.study and (options.method or options.analysis):
        parser.error("argument --study: has cases of its own, so leave out --method and --analysis")
    io.show_log(logging.INFO if options.verbose else logging.WARNING)
    methods = list(METHODS) if options.study else options.method or ["energy-momentum"]
    analyses = ["A"] if options.study else options.analysis or list(LAWS)
    cases = [Case(a, m, per_direction=options.points) for a in analyses for m in methods]
    return show(cases, options.until, options.output)


if __name__ == "__main__":
    main()
