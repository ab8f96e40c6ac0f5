# SPDX-License-Identifier: MIT
"""Bending beam and twisting column: table 1 of VMS in full, and the cases of CMN.

The problems are those of demos/bending_beam.py and demos/twisting_column.py (sections 6.3 and 6.4
of VMS). Cases 1 to 5 have the cell sizes and points per cell of table 1. "cmn" is the case of the
slides of Moreno, Contri and Larese (CMN 2022), with Miehe's volumetric law; unlike there, it has
subscales with inertia and tied nodes. "smooth" and its variants have quadratic B-splines on cubes
of 0.25 m with 8 points each, and dissipate with the interior penalty; "energy" conserves energy.
Displacements of the corner are compared with Taylor-Hood P2-P1 finite elements. A run of table 1
takes hours. It writes its history, a series for ParaView, and a checkpoint for restarts.
"""

import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import typer
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, points
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.diagnostics import kinetic_energy, probe, strain_energy, turning_points
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonError

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "meshes"))
from column import column  # noqa: E402

TABLE_1 = [(0.25, 12), (1 / 6, 12), (1 / 6, 24), (1 / 6, 48), (0.125, 12)]  # m, points per cell
CASES = {str(i): {"h": h, "per_cell": n} for i, (h, n) in enumerate(TABLE_1, start=1)}
CASES["cmn"] = {"h": 0.2, "per_cell": 16, "volumetric": "miehe", "transient": True, "tied": True}
SMOOTH = {"h": 0.25, "per_cell": 8, "functions": "quadratic", "tied": True}
CASES["smooth"] = SMOOTH | {"stabilization": "cip"}
CASES["smooth-cmn"] = CASES["smooth"] | {"volumetric": "miehe", "transient": True}
CASES["energy"] = SMOOTH | {"stabilization": "hessian", "scheme": "Midpoint"}
# Half the width of the background mesh [m]; a divisor of the number of points along a side; end of
# a run and time until which u_x has its first peak [s]; options of the cases of CMN; steps of
# smooth functions [s]; and the smallest distance of turning points of u_x in time [s]
COLUMNS = {
    "bending_beam": ((4.5, 1.0), 2, 3.0, 0.9, {"dt": 0.01}, 0.005, 0.2),
    "twisting_column": ((1.25, 1.25), 4, 0.5, 0.07, {"speed": 1.05}, 0.001, 0.02),
}


def velocity(name, x):
    if name == "bending_beam":
        return np.outer((5 / 3, 0, 0), x[2])
    return 100 * np.sin(np.pi * x[2] / 12) * np.array([x[1], -x[0], 0 * x[2]])


def tetrahedra(name, h, per_cell):
    """Return the mesh of the papers, and the spacing of points [m]."""
    (half_x, half_y), unit, *_ = COLUMNS[name]
    domain, tags = column(h, (-half_x, -half_y, 0), (half_x, half_y, 7))
    in_body = np.sum(tags.values[tags.indices < domain.topology.index_map(3).size_local] == 1)
    # a cubic lattice that begins at the corner of the mesh and must fit the body
    count = domain.comm.allreduce(int(in_body)) * per_cell / 6
    return domain, 1 / (unit * round(count ** (1 / 3) / unit))


def cubes(name, h, per_cell):
    """Return a mesh of cubes whose faces match the column, and the spacing of points [m]."""
    half = np.ceil(np.array([*COLUMNS[name][0], 0]) / h - 1e-9) * h
    corners = [-half, half + (0, 0, 7)]
    shape = np.rint((corners[1] - corners[0]) / h).astype(int)
    kind, partitioner = mesh.CellType.hexahedron, basis.shared_vertex_partitioner
    domain = mesh.create_box(MPI.COMM_WORLD, corners, shape, kind, partitioner=partitioner)
    return domain, h / round(per_cell ** (1 / 3))


def build(
    name, h=0.25, per_cell=12, dt=0.001, stabilization="asgs", scheme="Bossak", speed=1.0,
    volumetric="quadratic", transient=False, tied=False, functions="linear", taylor=True,
):  # fmt: skip
    """Return the loop, whose carried point is the corner, and the energy of stabilization [J]."""
    domain, spacing = (tetrahedra if functions == "linear" else cubes)(name, h, per_cell)
    body = points.lattice(domain, spacing, lambda x: np.all(np.abs(x) < [[0.5], [0.5], [6]], 0))
    formulations.set_initial_state(body, 1100.0, lambda x: speed * velocity(name, x))  # kg/m^3
    tip = points.at(domain, (0.5, 0.5, 6.0))
    if functions != "linear":
        for p in (body, tip):
            basis.use(p, functions, spacing / 2 if functions == "gimp" else None)
    law = NeoHookean(1.7e7, nu=0.5, volumetric=volumetric)  # Pa
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[2], 0))
    scheme = getattr(formulations, scheme)(z, dt=dt)
    cells = ActiveCells(body, loads=[tip])
    newton, stored = {"keep_tangent": 0.01}, lambda: 0.0  # one tangent per step, as steps are short
    if conserves := isinstance(scheme, formulations.Midpoint):
        stress = formulations.MixedEnergyMomentum(law, body, z)
        R, stored = stress.power() + scheme.inertia(body), stress.volumetric_energy
    else:
        inertia = {"force": scheme.force(body), "scheme": scheme if transient else None}
        R = formulations.stabilized(stabilization, z, body, law, cells=cells, **inertia)
    if tied:
        newton["tying"] = Tying(z.space, body, cells)
    else:
        R += formulations.ghost_penalty(z, cells, law)
    taylor = taylor and not conserves
    observers = [] if conserves else [lambda sim, step: correct_weights(body, cells)]
    return ImplicitMPM(
        R, z, scheme, body, carried=[tip], taylor=taylor, newton=newton, observers=observers
    ), stored


def run(name, until, file, restart=False, saves=100, **case):
    """Return the history of corner [m] and energy [J], the body, and the number of halved steps.

    A checkpoint is saved after every ``saves`` steps.
    """
    (sim, stored), halved, checkpoint = build(name, **case), 0, Path(f"output/{file}.h5")
    if restart and checkpoint.exists():
        io.checkpoint.restore(checkpoint, sim)
    tip = {f"u_{'xyz'[i]} [m]": lambda sim, i=i: probe(sim.carried[0], "u")[i] for i in range(3)}
    body, law = sim.bodies[0], NeoHookean(1.7e7, nu=0.5)
    energies = kinetic_energy, lambda body: strain_energy(body, law), lambda body: stored()
    columns = tip | {"energy [J]": lambda sim: sum(energy(body) for energy in energies)}
    # called explicitly, as they need the loop's body
    history = io.History(columns, f"output/{file}.csv", case, append=restart)
    series = io.Series(f"output/{file}.vtkhdf", body, case, every=0.02, append=restart)
    history.begin(sim)
    series.begin(sim)
    try:
        for step in io.watch(sim.run(until), until, file):
            halved += step.attempts > 1
            history.done(sim, step)
            series.done(sim, step)
            if step.number % saves == 0:
                io.checkpoint.save(checkpoint, sim)
    except NewtonError as error:
        io.say(f"{file} ends at t = {sim.time:.4f} s: {error}")
    return history, body, halved


def smoothed_turns(t, values, apart):
    """Yield time, value and curvature of quartics fitted to the turns; flat peaks have ripples."""
    for time, _ in turning_points(t, values, apart):
        near = np.abs(t - time) < 0.4 * apart
        curve = np.polynomial.Polynomial.fit(t[near], values[near], 4)
        roots = curve.deriv().roots()
        real = roots[np.abs(roots.imag) < 1e-9].real
        at = real[np.argmin(np.abs(real - time))]
        yield at, curve(at), curve.deriv(2)(at)


def paired_turns(t, values, known, apart):
    """Yield turns of a curve with the nearest ones of the same kind that are known.

    Each pair is time and value, known time and value. A curve may lack a turn or have one more.
    """
    expected = list(smoothed_turns(*known, apart))
    for time, value, bend in smoothed_turns(t, values, apart):
        alike = [turn for turn in expected if turn[2] * bend > 0 and abs(turn[0] - time) < apart]
        if alike:
            yield time, value, *min(alike, key=lambda turn: abs(turn[0] - time))[:2]


def main(
    name: str, cases: list[str] = ["1", "2", "3", "4", "5"], until: float | None = None,
    stabilization: str = "asgs", scheme: str = "Bossak", h: float | None = None,
    dt: float | None = None, taylor: bool = True, tied: bool = False, restart: bool = False,
):  # fmt: skip
    """Run CASES of bending_beam or twisting_column: 1 to 5, cmn, smooth, smooth-cmn, energy.

    H and DT are those of all cases, if given. TAYLOR maps velocities to nodes with their gradients.
    TIED ties nodes with little mass in cases 1 to 5, whose subscales then have inertia.
    """
    if name not in COLUMNS or not set(cases) <= set(CASES):
        known = f"columns are {', '.join(COLUMNS)}, cases {', '.join(CASES)}"
        raise typer.BadParameter(f"{name}, {', '.join(cases)}: {known}")
    _, _, end, window, of_cmn, step, apart = COLUMNS[name]
    titles = {"case": "s", "first peak of u_x [m]": ".4f", "at [s]": ".3f", "end [s]": ".3f"}
    rates = {"largest deviation": ".1%", "energy left": ".1%"}
    table = io.Table({**titles, **rates, "halved steps": "d"})
    known = np.loadtxt(ROOT / "benchmarks" / "references" / f"{name}.csv", delimiter=",").T[:2]
    curves, first = {}, np.argmax(np.abs(known[1, known[0] <= window]))
    rows = []
    table.row("P2-P1", known[1, first], known[0, first], *[None] * 4)
    for case in cases:
        options = {"stabilization": stabilization, "scheme": scheme, "taylor": taylor}
        options |= {"tied": tied, "transient": tied} | CASES[case]
        options |= {"dt": step} if "functions" in options else {}
        options |= of_cmn if case.endswith("cmn") else {}
        options |= {key: value for key, value in {"h": h, "dt": dt}.items() if value}
        file = f"{name}_{case}_{options['stabilization']}_{options['scheme']}" + "_tied" * tied
        history, body, halved = run(name, until or end, file, restart, **options)
        t, u_x, left = (history[title] for title in ("t [s]", "u_x [m]", "energy [J]"))
        curves[f"case {case}"], first = (t, u_x), np.argmax(np.abs(u_x[t <= window]))
        deviation = np.abs(np.interp(t, *known) - u_x).max() / np.abs(known[1]).max()
        deviation = None if "speed" in options else deviation  # finite elements start more slowly
        table.row(case, u_x[first], t[first], t[-1], deviation, left[-1] / left[0], halved)
        for time, value, t_ref, expected in paired_turns(t, u_x, known, apart):
            rows.append((case, value, value / expected - 1, time / t_ref - 1))
        title = {f"case {case}, t = {t[-1]:.3f} s": body}
        io.picture(f"output/{file}.png", title, "p", "mean stress p [Pa]", cut=1)
    turns = io.Table({"case": "s", "turn of u_x [m]": ".4f", "off by": "+.1%", "in time": "+.1%"})
    for row in rows:
        turns.row(*row)
    known = {"P2-P1 finite elements": tuple(known[:, known[0] <= t[-1]])}
    io.plot(f"output/{name}_tip.png", curves, "t [s]", "u_x of the corner [m]", reference=known)


if __name__ == "__main__":
    typer.run(main)
