# SPDX-License-Identifier: MIT
#
# # Cook's membrane in motion
#
# The tapered panel of `cooks_membrane.py`, a tenth of its size, is loaded on its right edge at once
# and swings up and down. Material points now move through a background mesh that knows nothing of
# the panel's boundary. The demo shows how
#
# - a body, the points that carry its load, and a probe are seeded,
# - inertia and a time scheme enter the forms,
# - the time loop runs, and what its Dirichlet conditions are,
# - cut cells, in which there is little material, are dealt with.
#
# It is the dynamic example of section 6.2 of Moreno, Wüchner and Larese, *A mixed stabilized MPM
# formulation for incompressible hyperelastic materials using Variational Subgrid-Scales* (in short:
# VMS). `--study` repeats its figures 6a, 6c and 6d.
#
# ## Formulation
#
# In every step from $t_n$ to $t_{n+1}$ the increment $u$ of the displacement and the mean stress
# $p$ are sought on the undeformed background mesh, such that
#
# $$
# \int \rho\,(a - b) \cdot w + \sigma_\mathrm{dev} : \nabla w + p \, \nabla \cdot w \, \mathrm{d}v
#     = \int_{\Gamma_0} t \cdot w \, \mathrm{d}s, \qquad
# \int (J - 1) \, q \, \mathrm{d}V = 0
# $$
#
# for all $w$, $q$. Integrals are sums over the material points. The acceleration $a$ is an
# expression in $u$ and in the velocity and acceleration at $t_n$, which are mapped from the points
# to the grid, weighted by mass. The load is *dead*: it is given per length of the undeformed edge
# and keeps its direction, and it is carried by boundary points.
#
# The condition $J = 1$ at the end of each step makes Newmark's method only weakly stable: pressures
# alternate and energy grows. Methods with a little dissipation at high frequencies are sound. Here
# it is Bossak's with $\rho_\infty = 0.8$; `--scheme Newmark` shows the difference.
#
# In cells that the body fills only partly, nodes have nearly no mass and no stiffness. The *ghost
# penalty* on jumps of gradients over the facets of such cells lets them follow their neighbours. Or
# they are *tied* to filled cells, which short steps need: the penalty resists increments, so that
# loads beside the body creep on in each step, however short it is.
#
# ## Implementation

import argparse
import logging
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, MaterialPoints, formulations, io
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import probe
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points import lattice, on_curve
from fenicsmpm.solvers import NewtonError

REFERENCE = Path(__file__).parent.parent / "benchmarks" / "references" / "cook_dynamic.csv"
YOUNG = 250.0  # Pa
DENSITY = 1.0  # kg/m^3
TRACTION = (0.0, 6.25)  # Pa
TIP = (4.8, 6.0)  # m
SCHEMES = ("Bossak", "GeneralizedAlpha", "Newmark", "BDF2")


@dataclass
class Case:
    stabilization: str = "asgs"
    h: float = 0.1  # edges of the background triangles along the axes, m
    per_cell: int = 33  # material points
    scheme: str = "Bossak"
    dt: float = 0.025  # s
    ghost: float = 0.1  # factor of the ghost penalty
    tied: bool = False  # nodes of little mass, instead of the ghost penalty
    correct: bool = True  # quadrature weights of full cells
    volumetric: str = "quadratic"  # law of the pressure, of no matter if nu = 0.5
    transient: bool = False  # subscales with inertia, which short steps need

    def label(self):
        return f"{self.stabilization.upper()}, h = {self.h:g} m, {self.per_cell} points a cell"


# Points lie on a square lattice of such a spacing that there are as many in a cell as wanted.


def panel(x):
    lower = x[:, 0] * 4.4 / 4.8
    upper = 4.4 + x[:, 0] * 1.6 / 4.8
    return (x[:, 0] <= 4.8) & (x[:, 1] >= lower) & (x[:, 1] <= upper)


def build(case):
    shape = np.ceil(np.array([6, 10]) / case.h - 1e-9).astype(int)
    upper = np.array([0, -1]) + case.h * shape
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -1), upper], shape.tolist())
    body = lattice(domain, case.h * np.sqrt(0.5 / case.per_cell), inside=panel)
    formulations.set_initial_state(body, DENSITY)
    edge = on_curve(domain, (4.8, 4.4), TIP, spacing=case.h / 5)
    here = domain.comm.rank == 0
    tip = MaterialPoints(domain, [TIP] if here else np.empty((0, 2)), weight=1.0)

    # The probe counts as well for which cells are active, so that it has a displacement there.

    cells = ActiveCells(body, loads=[edge, tip])
    law = NeoHookean(YOUNG, nu=0.5, volumetric=case.volumetric)
    W = formulations.mixed_space(domain, projections=case.stabilization == "osgs")
    U, V, newton = fem.Function(W), ufl.TestFunction(W), {}
    scheme = getattr(formulations, case.scheme)(U, dt=case.dt)
    R = formulations.stabilized(
        case.stabilization, U, V, body, law, force=scheme.force(body),
        scheme=scheme if case.transient else None,
    )  # fmt: skip
    R += formulations.dead_load(V, edge, TRACTION)
    if case.tied:
        newton = {"tying": Tying(W, body, cells)}
    elif case.ghost > 0:
        R += formulations.ghost_penalty(U, V, cells, law, gamma=case.ghost)

    left = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0))
    W_u, _ = W.sub(0).collapse()
    clamped = fem.locate_dofs_topological((W.sub(0), W_u), 1, left)
    bc = fem.dirichletbc(fem.Function(W_u), clamped, W.sub(0))

    # Points that have crossed edges leave cells overfull or with gaps. Weights corrected after each
    # step integrate constants exactly in full cells. This halves the error of the first minimum;
    # the price are pressures that are rougher in time.

    def adapt(body):
        if case.correct:
            correct_weights(body, cells)

    return ImplicitMPM(
        R, U, scheme, body, carried=[edge, tip], bcs=[bc], adapt=adapt, newton=newton
    )


# A run goes from step to step. A step that fails is tried again with half its length; the state at
# the points is then as it was before. The probe is carried by the grid like the load.


def run(case, until, output, movie=False):
    sim = build(case)
    body, tip = sim.bodies[0], sim.carried[1]
    io.say(f"{case.label()}: {body.size_global} material points of {body.volume:.4g} m^2")
    times, tips, frames = [0.0], [np.zeros(2)], []
    every = max(1, round(until / case.dt / 70))
    try:
        for step in io.watch(sim.run(until), until, case.label()):
            times.append(step.time)
            tips.append(probe(tip, "u"))
            if movie and step.number % every == 0:
                frames.append(output / "frames" / f"{len(frames):03d}.png")
                draw(frames[-1], body, f"t = {step.time:.2f} s")
    except NewtonError as error:
        io.say(f"  it ends at t = {sim.time:.3f} s: {error}")
    if frames:
        io.animate(output / "cooks_membrane_dynamic.gif", frames, comm=body.mesh.comm)
    return sim, np.column_stack([times, tips])


# Frames of an animation have the same colours and show the same box.


def draw(path, body, title, frame=True):
    panel = io.Panel(io.gather_points(body), "p", title)
    limits = (-40.0, 60.0) if frame else io.colour_range([panel], cut=1)
    bounds = ((-0.2, -0.2), (5.2, 7.6)) if frame else None
    io.picture(path, [panel], "mean stress p [Pa]", limits=limits, bounds=bounds)


# ## Results
#
# The reference is by Taylor-Hood P2-P1 finite elements, total Lagrangian, with the same material,
# load and dissipation (`benchmarks/references`). Heights of peaks are compared with its first one.


def turning_points(history):
    """Times and values of the peaks and minima of u_y, by parabolas through three steps."""
    t, y = history[:, 0], history[:, 2]
    found = []
    for k in range(1, len(t) - 1):
        near = y[np.abs(t - t[k]) < 0.21]  # s; turns of noise are not meant
        if y[k] in (near.max(), near.min()) and (y[k] - y[k - 1]) * (y[k + 1] - y[k]) < 0:
            a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], y[k - 1 : k + 2], 2)
            found.append((t[k] - b / (2 * a), c - b**2 / (4 * a)))
    return found


def compare(history):
    expected = turning_points(np.loadtxt(REFERENCE, delimiter=","))
    first_peak = expected[0][1]
    rows = io.Table(
        {
            "turning point": "s",
            "t [s]": ".3f",
            "reference": ".3f",
            "u_y [m]": ".4f",
            "reference ": ".4f",
            "deviation of u_y": "+.1%",
            "of t": "+.1%",
        }
    )
    names = ("first peak", "first minimum", "second peak", "second minimum")
    deviations = []
    for name, (t, y), (t_ref, y_ref) in zip(names, turning_points(history), expected, strict=False):
        deviations.append(((y - y_ref) / first_peak, t / t_ref - 1))
        rows.row(name, t, t_ref, y, y_ref, *deviations[-1])
    return deviations


def plot(path, histories):
    until = max(history[-1, 0] for history in histories.values())
    reference = np.loadtxt(REFERENCE, delimiter=",")
    reference = reference[reference[:, 0] <= until]
    io.plot(
        path,
        {label: (history[:, 0], history[:, 2]) for label, history in histories.items()},
        "t [s]",
        "vertical displacement of the tip [m]",
        reference={"P2-P1 finite elements": (reference[:, 0], reference[:, 2])},
    )


def single(case, until, output, movie):
    sim, history = run(case, until, output, movie)
    compare(history)
    body = sim.bodies[0]
    parameters = vars(case) | {"t [s]": sim.time, "E [Pa]": YOUNG, "nu": 0.5}
    io.write(output / "points.vtp", io.gather_points(body), parameters)
    draw(output / "pressure.png", body, f"{case.label()}\nt = {sim.time:.2f} s", frame=False)
    plot(output / "tip.png", {case.label(): history})
    io.say(f"points.vtp, pressure.png and tip.png are in {output}")
    return history


# The study repeats three figures of VMS: stabilizations (6a), numbers of points a cell (6c) and
# sizes of cells (6d); and that of the slides of Moreno, Contri and Larese, CMN 2022, with Miehe's
# volumetric law, short steps and tied nodes. A case that fails is shown as far as it got.

FIGURES = {
    "6a": [("none", 0.1, 33), ("ppp", 0.1, 33), ("asgs", 0.1, 33), ("osgs", 0.1, 33)],
    "6c": [("asgs", 0.1, 6), ("asgs", 0.1, 12), ("asgs", 0.1, 33)],
    "6d": [("asgs", 0.2, 33), ("asgs", 0.1, 33), ("asgs", 0.05, 33)],
    "slides": [("asgs", h, 16) for h in (0.6, 0.3, 0.15, 0.075, 0.0375)],
}
OF_VMS = ("6a", "6c", "6d")


def study(figures, base, until, output):
    for name in figures:
        histories = {}
        for stabilization, h, per_cell in FIGURES[name]:
            case = replace(base, stabilization=stabilization, h=h, per_cell=per_cell)
            if name == "slides":
                case = replace(case, dt=0.0025, volumetric="miehe", transient=True, tied=True)
            _, histories[case.label()] = run(case, until, output)
            compare(histories[case.label()])
        plot(output / f"figure_{name}.png", histories)
        io.say(f"figure_{name}.png is in {output}\n")


# ## Command line


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Cook's membrane, dynamic and incompressible")
    default = Case()
    add = parser.add_argument
    add("--stabilization", choices=formulations.STABILIZATIONS, help="(default: asgs)")
    add("--size", type=float, help="edges of the background triangles in m (default: 0.2)")
    add("--points", type=int, help="material points a cell (default: 12)")
    add("--scheme", choices=SCHEMES, default=default.scheme, help="(default: %(default)s)")
    add("--dt", type=float, help=f"time step in s (default: {default.dt})")
    add("--ghost", type=float, default=default.ghost, help="ghost penalty (default: %(default)s)")
    add("--tied", action="store_true", help="tie nodes of little mass instead")
    add("--uncorrected", action="store_true", help="leave the quadrature weights of full cells")
    add("--until", type=float, help="end in s (default: 3)")
    add("--full", action="store_true", help="the paper's case: 0.1 m, 33 points a cell, 7 s")
    add("--study", choices=FIGURES, nargs="*", help="repeat figures (default: those of VMS)")
    add("--short", action="store_true", help="a few steps only, for a test")
    add("--movie", action="store_true", help="write an animation, too")
    add("--output", type=Path, default=Path("output"), metavar="DIR", help="(default: %(default)s)")
    add("-v", "--verbose", action="store_true", help="print a line for each Newton iteration")
    options = parser.parse_args(arguments)
    full = options.full or options.study is not None
    if options.tied and options.ghost != default.ghost:
        parser.error("argument --tied: is instead of --ghost, give one of them")
    if options.points is not None and options.points < 1:
        parser.error(f"argument --points: at least 1 a cell is needed, not {options.points}")
    if options.study is not None:
        for name in ("stabilization", "size", "points", "movie"):
            if getattr(options, name):
                parser.error(f"argument --study: has cases of its own, so leave out --{name}")
        if "slides" in options.study and options.dt is not None:
            parser.error("argument --study: slides have a time step of their own")
    until, h, per_cell, dt = options.until, options.size, options.points, options.dt
    dt = default.dt if dt is None else dt
    if until is None:
        until = 0.1 if options.short else 7.0 if full else 3.0
    if h is None:
        h = 0.1 if full else 0.5 if options.short else 0.2
    if per_cell is None:
        per_cell = 33 if full else 12
    if not (h > 0 and dt > 0 and until > 0 and options.ghost >= 0):
        parser.error("--size, --dt and --until must be positive, --ghost not negative")
    if abs(round(1 / h) * h - 1) > 1e-9:
        parser.error(f"argument --size: must divide 1 m into equal parts, not {h}")
    io.show_log(logging.INFO if options.verbose else logging.WARNING)
    case = Case(
        options.stabilization or default.stabilization, h, per_cell, options.scheme,
        dt, options.ghost, options.tied, not options.uncorrected,
    )  # fmt: skip
    if options.study is None:
        single(case, until, options.output, options.movie)
    else:
        study(options.study or OF_VMS, case, until, options.output)


if __name__ == "__main__":
    main()
