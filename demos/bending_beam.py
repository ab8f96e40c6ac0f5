# SPDX-License-Identifier: MIT
#
# # Bending beam
#
# An incompressible column of rubber, 1 m x 1 m x 6 m, stands clamped on its base and is thrown to
# the side: its initial velocity grows linearly with the height. It bends far over, swings back and
# to the other side. The demo shows how
#
# - a body is seeded in an unstructured background mesh,
# - initial velocities are given,
# - a three-dimensional run writes a series for ParaView, and an animation.
#
# It is section 6.3 of Moreno, Wüchner and Larese, *A mixed stabilized MPM formulation for
# incompressible hyperelastic materials using Variational Subgrid-Scales* (in short: VMS).
# `twisting_column.py` is its section 6.4 and uses what is defined here.
#
# ## Formulation
#
# The same as in `cooks_membrane_dynamic.py`, in three dimensions and without load: in each step,
#
# $$
# \int \rho\,a \cdot w + \sigma_\mathrm{dev} : \nabla w + p \, \nabla \cdot w \, \mathrm{d}v = 0,
# \qquad \int (J - 1) \, q \, \mathrm{d}V = 0
# $$
#
# with algebraic subgrid scales (ASGS) that stabilize equal orders of $u$ and $p$, and a ghost
# penalty on the facets of cells that are only partly filled, or tied nodes.
#
# ## Implementation

import argparse
import logging
import sys
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

from fenicsmpm import ImplicitMPM, MaterialPoints, formulations, io
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import lattice
from fenicsmpm.solvers import NewtonError

sys.path.insert(0, str(Path(__file__).parent.parent / "meshes"))
from column import column  # the background meshes

REFERENCES = Path(__file__).parent.parent / "benchmarks" / "references"
YOUNG = 1.7e7  # Pa
DENSITY = 1100.0  # kg/m^3
TIP = (0.5, 0.5, 6.0)  # m


@dataclass
class Case:
    name: str  # of the demo
    velocity: object  # function of positions (n, 3) to velocities (n, 3)
    lower: tuple  # corners of the background mesh, m
    upper: tuple
    reference: str | None  # file of the history by finite elements
    stabilization: str = "asgs"
    h: float = 0.25  # size of cells, m
    per_cell: int = 12  # material points
    dt: float = 0.001  # s
    scheme: str = "Bossak"
    taylor: bool = True  # continue velocities linearly to the nodes
    volumetric: str = "quadratic"  # law of the pressure, of no matter if nu = 0.5
    transient: bool = False  # subscales with inertia, which short steps need
    tied: bool = False  # nodes of little mass, instead of the ghost penalty

    def label(self):
        kind = f"{self.stabilization.upper()}, {self.scheme}"
        return f"h = {self.h:.4g} m, {self.per_cell} points a cell, {kind}"

    def files(self):
        """Name of the files of this case, without endings."""
        kind = f"{self.stabilization}_{self.scheme}_{self.dt:g}s{'_tied' if self.tied else ''}"
        return f"{self.name}_{self.h:.4g}m_{self.per_cell}_{kind}"


def beam(**options):
    return Case(
        "bending_beam",
        lambda x: np.outer(x[:, 2], (5 / 3, 0, 0)),
        (-4.5, -1.0, 0.0),
        (4.5, 1.0, 7.0),
        "bending_beam.csv",
        **options,
    )


# Points lie on a cubic lattice, of a spacing such that there are as many in a cell as wanted on
# average: the cells of an unstructured mesh differ in size, equal points do not. The lattice begins
# at the corner of the mesh and has to fit the body's.


def build(case):
    domain, tags = column(case.h, case.lower, case.upper)
    owned = domain.topology.index_map(3).size_local
    in_body = int(np.sum(tags.values[tags.indices < owned] == 1))
    cells_of_body = domain.comm.allreduce(in_body)
    margins = -0.5 - np.array(case.lower[:2])
    unit = next(n for n in (1, 2, 4) if np.allclose(margins * n % 1, 0))
    a_side = unit * round((cells_of_body * case.per_cell / 6) ** (1 / 3) / unit)

    def inside(x):
        return (np.abs(x[:, :2]).max(axis=1) < 0.5) & (x[:, 2] > 0) & (x[:, 2] < 6)

    body = lattice(domain, 1 / a_side, inside=inside)
    formulations.set_initial_state(body, DENSITY, case.velocity)
    here = domain.comm.rank == 0
    tip = MaterialPoints(domain, [TIP] if here else np.empty((0, 3)), weight=1.0)

    law = NeoHookean(YOUNG, nu=0.5, volumetric=case.volumetric)
    W = formulations.mixed_space(domain, projections=case.stabilization == "osgs")
    U, V = fem.Function(W), ufl.TestFunction(W)
    scheme = getattr(formulations, case.scheme)(U, dt=case.dt)
    R = formulations.stabilized(
        case.stabilization, U, V, body, law, force=scheme.force(body),
        scheme=scheme if case.transient else None,
    )  # fmt: skip
    cells = ActiveCells(body, loads=[tip])
    newton = {"keep_tangent": 0.01}  # steps are short enough for one tangent each
    if case.tied:
        newton["tying"] = Tying(W, body, cells)
    else:
        R += formulations.ghost_penalty(U, V, cells, law)

    base = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0))
    W_u, _ = W.sub(0).collapse()
    clamped = fem.locate_dofs_topological((W.sub(0), W_u), 2, base)
    bc = fem.dirichletbc(fem.Function(W_u), clamped, W.sub(0))

    # A node at the surface has material on one side only. Its velocity, a mean of those of the
    # points around it, would be too small where velocities grow outwards. With `taylor=True` points
    # continue their velocities linearly to the nodes.
    #
    # Points that have crossed faces leave cells overfull or with gaps. Weights corrected after each
    # step integrate constants exactly in full cells.

    def adapt(body):
        correct_weights(body, cells)

    return ImplicitMPM(
        R, U, scheme, body, carried=[tip], bcs=[bc], adapt=adapt, taylor=case.taylor, newton=newton
    )


# A run writes a file for ParaView every `interval`, a table of the displacements of the corner, and
# now and then a checkpoint, from which `--restart` goes on. Where it fails, it shows what it has.
#
# The sum of kinetic and strain energy should stay what it was. Points that cross faces cost some of
# it; `--scheme Newmark` gains so much that it fails in the end, since $J = 1$ in each step makes
# Newmark's method only weakly stable.


def run(case, until, output, movie=False, restart=False, interval=0.02, steps_between_saves=100):
    sim = build(case)
    body, tip = sim.bodies[0], sim.carried[0]
    io.say(f"{case.label()}: {body.size_global} material points of {body.volume:.4g} m^3")
    law = NeoHookean(YOUNG, nu=0.5)
    at_start = kinetic_energy(body)
    checkpoint = output / f"{case.files()}.h5"
    saved = None
    if restart and checkpoint.exists():
        io.checkpoint.restore(checkpoint, sim)
        saved = sim.time
        io.say(f"  goes on from t = {sim.time:.4g} s")
    columns = {"t [s]": lambda: sim.time}
    columns |= {f"u_{name} [m]": lambda i=i: probe(tip, "u")[i] for i, name in enumerate("xyz")}

    def energy():
        return kinetic_energy(body) + strain_energy(body, law)

    columns["energy / energy at the start"] = lambda: energy() / at_start
    parameters = {"h [m]": case.h, "points a cell": case.per_cell, "E [Pa]": YOUNG, "nu": 0.5}
    table = output / f"{case.files()}.csv"
    history = io.History(table, columns, parameters, append_after=saved)
    if saved is None:
        history.write()
    frames = sorted((output / "frames").glob("*.png")) if movie and saved is not None else []
    series_path = output / f"{case.files()}.pvd"
    with io.Series(series_path, body, parameters, append_after=saved) as series:
        try:
            for step in io.watch(sim.run(until), until, case.label()):
                history.write()
                if step.number % steps_between_saves == 0:
                    io.checkpoint.save(checkpoint, sim)
                if step.time < (len(series.times) + 1) * interval - 1e-9:
                    continue
                series.write(step.time)
                if movie:
                    frames.append(output / "frames" / f"{len(frames):03d}.png")
                    draw(frames[-1], case, body, f"t = {step.time:.3f} s")
        except NewtonError as error:
            io.say(f"  it ends at t = {sim.time:.4f} s: {error}")
    io.say(f"energy at t = {sim.time:.4g} s: {energy() / at_start:.2%} of that at the start")
    if frames:
        io.animate(output / f"{case.name}.gif", frames, comm=body.mesh.comm)
    return sim, np.loadtxt(table, delimiter=",", comments=["#", "t"], ndmin=2)


# Frames of an animation have the same colours and show the same box.


def draw(path, case, body, title, frame=True):
    cloud = io.gather_points(body)
    if cloud is not None:
        cloud["p"] = cloud["p"] / 1e6
    panel = io.Panel(cloud, "p", title)
    limits = (-2.0, 2.0) if frame else io.colour_range([panel], cut=1)
    bounds = (case.lower, case.upper) if frame else None
    io.picture(path, [panel], "mean stress p [MPa]", limits=limits, bounds=bounds)


# ## Results
#
# The reference is by Taylor-Hood P2-P1 finite elements, total Lagrangian (`benchmarks/references`).


def reference(case):
    return np.loadtxt(REFERENCES / case.reference, delimiter=",")


def compare(case, history):
    """Largest deviation of each component so far, as a share of the reference's largest one."""
    if len(history) == 1 or case.reference is None:
        io.say("there is nothing to compare")
        return {}
    expected = reference(case)
    rows = io.Table(
        {"u": "s", "largest [m]": ".4f", "at t [s]": ".3f", "reference [m]": ".4f",
         "at  t [s]": ".3f", "largest deviation": ".2%"}
    )  # fmt: skip
    until = min(history[-1, 0], expected[-1, 0])
    expected = expected[expected[:, 0] <= until + 1e-9]
    t = history[:, 0]
    scale = np.abs(expected[:, 1:]).max()
    deviations = {}
    for i, name in enumerate(("u_x", "u_y", "u_z"), start=1):
        here, there = np.argmax(np.abs(history[:, i])), np.argmax(np.abs(expected[:, i]))
        difference = (
            np.interp(t[t <= until], expected[:, 0], expected[:, i]) - history[t <= until, i]
        )
        deviations[name] = float(np.abs(difference).max() / scale)
        rows.row(
            name, history[here, i], t[here], expected[there, i], expected[there, 0],
            deviations[name],
        )  # fmt: skip
    io.say(f"deviations until t = {until:.3g} s, as shares of the largest displacement")
    return deviations


def plot(path, case, histories):
    if MPI.COMM_WORLD.rank != 0:
        return
    until = max(history[-1, 0] for history in histories.values())
    figure = Figure(figsize=(7, 10), layout="constrained")
    *axes, last = figure.subplots(4, 1, sharex=True)
    for i, ax in enumerate(axes, start=1):
        if case.reference is not None:
            expected = reference(case)
            shown = expected[expected[:, 0] <= until]
            ax.plot(shown[:, 0], shown[:, i], "k--", lw=1, label="P2-P1 finite elements")
        for label, history in histories.items():
            ax.plot(history[:, 0], history[:, i], label=label)
        ax.set_ylabel(f"u_{'xyz'[i - 1]} of the corner [m]")
        ax.grid(alpha=0.3)
    for history in histories.values():
        last.plot(history[:, 0], history[:, 4])
    last.set_ylabel("energy / energy at the start")
    last.set_xlabel("t [s]")
    last.set_ylim(bottom=0.0)
    last.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=160)


def show(cases, until, output, movie, restart):
    histories = {}
    for case in cases:
        sim, history = run(case, until, output, movie, restart)
        histories[case.label()] = history
        compare(case, history)
        draw(output / f"{case.name}.png", case, sim.bodies[0], f"t = {sim.time:.3f} s", frame=False)
        plot(output / f"{case.name}_tip.png", case, histories)
    name = cases[0].name
    io.say(f"{cases[-1].files()}.pvd, {name}.png and {name}_tip.png are in {output}")
    return histories


# ## Command line

TABLE = [(0.25, 12), (1 / 6, 12), (1 / 6, 24), (1 / 6, 48), (0.125, 12)]  # table 1 of VMS


def slides(**options):
    """The beam of Moreno, Contri and Larese, CMN 2022, with Miehe's volumetric law."""
    return beam(
        h=0.2, per_cell=16, dt=0.01, volumetric="miehe", transient=True, tied=True, **options
    )


def main(
    arguments=None, make=beam, slides=slides, end=0.3, full_end=3.0, description="Bending beam"
):
    parser = argparse.ArgumentParser(description=f"{description}, incompressible")
    add = parser.add_argument
    add("--size", type=float, help="size of cells in m (default: 0.25)")
    add("--points", type=int, help="material points a cell (default: 12)")
    add("--dt", type=float, help="time step in s (default: 0.001)")
    add("--stabilization", choices=formulations.STABILIZATIONS, default="asgs")
    add("--scheme", choices=("Bossak", "GeneralizedAlpha", "Newmark", "BDF2"), default="Bossak")
    add("--tied", action="store_true", help="tie nodes of little mass; slides always do")
    add("--until", type=float, help=f"end in s (default: {end:g})")
    cases_help = f"cases 1 to 5 of the paper's table 1, until {full_end:g} s (default: all)"
    add("--full", nargs="*", type=int, choices=range(1, 6), metavar="CASE", help=cases_help)
    add("--slides", action="store_true", help=f"the case of CMN 2022, until {full_end:g} s")
    add("--short", action="store_true", help="a few steps on a coarse mesh, for a test")
    add("--movie", action="store_true", help="write an animation, too")
    add("--restart", action="store_true", help="go on from the last checkpoints in the output")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    add("-v", "--verbose", action="store_true", help="print a line for each Newton iteration")
    options = parser.parse_args(arguments)
    names = {"size": "h", "points": "per_cell", "dt": "dt"}
    given = {name: value for name in names if (value := getattr(options, name)) is not None}
    for name, value in {**given, "until": 1 if options.until is None else options.until}.items():
        if not value > 0:
            parser.error(f"argument --{name}: must be positive, not {value}")
    kinds = {"short": options.short, "full": options.full is not None, "slides": options.slides}
    chosen_kinds = [name for name, is_chosen in kinds.items() if is_chosen]
    if len(chosen_kinds) > 1:
        parser.error(f"argument --{chosen_kinds[0]}: not together with --{chosen_kinds[1]}")
    if given and chosen_kinds:
        parser.error(f"--{chosen_kinds[0]} has cases of its own, so leave out --{min(given)}")
    io.show_log(logging.INFO if options.verbose else logging.WARNING)
    common = {"stabilization": options.stabilization, "scheme": options.scheme}
    if options.tied and not options.slides:
        common["tied"] = True
    if options.full is not None:
        chosen = options.full or range(1, 6)
        cases = [make(h=TABLE[i - 1][0], per_cell=TABLE[i - 1][1], **common) for i in chosen]
        default_end = full_end
    elif options.slides:
        cases, default_end = [slides(**common)], full_end
    elif options.short:
        cases = [make(h=0.5, per_cell=6, dt=0.005, **common)]
        default_end = 0.02
    else:
        cases = [make(**{names[name]: value for name, value in given.items()}, **common)]
        default_end = end
    until = default_end if options.until is None else options.until
    return show(cases, until, options.output, options.movie, options.restart)


if __name__ == "__main__":
    main()
