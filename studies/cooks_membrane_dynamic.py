# SPDX-License-Identifier: MIT
"""Cook's membrane in motion: figures 6a, 6c and 6d of VMS, other schemes, and the case of CMN.

The problem is that of demos/cooks_membrane_dynamic.py. VMS compares stabilizations (6a), numbers of
points per cell (6c) and cell sizes (6d). The slides of Moreno, Contri and Larese (CMN 2022) have
Miehe's volumetric law and short steps. Unlike there, "cmn" has subscales with inertia and tied
nodes; "cmn-cut" shows what happens without either. "cut" compares remedies for cells with little
material, with corrected weights and without.

The other figures show smooth functions on squares: cells and points (smooth), stabilizations and
functions (kinds), corrected weights (weights), time schemes (times), the case of CMN (smooth-cmn),
and linear functions for comparison (triangles). Turning points are compared with Taylor-Hood P2-P1
finite elements; their heights are relative to the first peak. The missing energy is relative to the
largest work of the load.
"""

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

REFERENCE = Path(__file__).parents[1] / "benchmarks" / "references" / "cook_dynamic.csv"
CMN = {"dt": 0.0025, "volumetric": "miehe", "transient": True, "tied": True, "per_cell": 16}
SMOOTH = {"functions": "quadratic", "stabilization": "cip", "tied": True, "h": 0.2, "per_cell": 9}
NONE = {"stabilization": "none"}
KINDS = [{"stabilization": s} for s in ("cip", "hessian", "split_osgs")]
TRIANGLES = {"h": 0.2, "per_cell": 24, "tied": True}
SCHEMES = "Bossak", "GeneralizedAlpha", "Newmark", "BDF2"
LABELS = (
    "functions", "stabilization", "h", "per_cell", "scheme", "tied", "corrected", "lumped",
    "ghost_mass", "transient",
)  # fmt: skip
PLAIN = {"tied": False, "corrected": False}
FIGURES = {
    "6a": [{"stabilization": name} for name in ("none", "ppp", "asgs", "osgs")],
    "6c": [{"per_cell": n} for n in (6, 12, 33)],
    "6d": [{"h": h} for h in (0.2, 0.1, 0.05)],
    "schemes": [{"scheme": s} for s in SCHEMES],
    "cmn": [CMN | {"h": h} for h in (0.6, 0.3, 0.15, 0.075, 0.0375)],
    "cmn-cut": [
        *(CMN | {"h": 0.3, "transient": False, "scheme": s} for s in SCHEMES[:3]),
        *(CMN | {"h": 0.075, "tied": False, "ghost_mass": on} for on in (False, True)),
        CMN | {"h": 0.075},
    ],
    "cut": [
        *({"h": 0.2} | c for c in (PLAIN, PLAIN | {"tied": True}, {"tied": True})),
        *({"h": 0.1} | PLAIN | c for c in ({}, {"scheme": SCHEMES[1]}, {"lumped": True})),
        *({"h": 0.1, "tied": False, "stabilization": name} for name in ("asgs", "osgs")),
    ],
    "smooth": [SMOOTH | c for c in ({"per_cell": 4}, {}, {"h": 0.1}, {"h": 0.1, **KINDS[1]})],
    "kinds": [SMOOTH | c for c in (*KINDS, {"functions": "gimp"}, {"functions": "cubic"}, NONE)],
    "weights": [SMOOTH | {"corrected": c} for c in (True, False)],
    "triangles": [
        *(TRIANGLES | {"stabilization": s} for s in ("asgs", "cip")),
        TRIANGLES | {"stabilization": "cip", "per_cell": 12},
        TRIANGLES | {"stabilization": "ppp", "scheme": "Midpoint"},
    ],
    "times": [
        *(SMOOTH | {"scheme": s} for s in SCHEMES[1:]),
        SMOOTH | {"scheme": "Midpoint", "stabilization": "hessian"},
    ],
    "smooth-cmn": [CMN | SMOOTH | {"h": h} for h in (0.3, 0.15)],
}


def panel(x):
    return (x[0] <= 4.8) & (x[1] >= x[0] * 4.4 / 4.8) & (x[1] <= 4.4 + x[0] * 1.6 / 4.8)


def build(
    stabilization="asgs", h=0.1, per_cell=33, scheme="Bossak", dt=0.025, volumetric="quadratic",
    transient=False, tied=False, corrected=True, functions="linear", lumped=False,
    ghost_mass=False,
):  # fmt: skip
    """Return the loop, carrying loaded edge and tip, and the energy of stabilization [J]."""
    nx, ny = (int(np.ceil(length / h - 1e-9)) for length in (6, 10))
    is_smooth = functions != "linear"
    kind = mesh.CellType.quadrilateral if is_smooth else mesh.CellType.triangle
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, -1), (nx * h, ny * h - 1)], [nx, ny], kind,
        partitioner=basis.shared_vertex_partitioner,
    )  # fmt: skip
    spacing = h * np.sqrt((1.0 if is_smooth else 0.5) / per_cell)
    body = points.lattice(domain, spacing, inside=panel)
    formulations.set_initial_state(body, density=1.0)  # kg/m^2
    edge = points.on_curve(domain, (4.8, 4.4), (4.8, 6.0), spacing=h / 5)
    tip = points.at(domain, (4.8, 6.0))
    if is_smooth:
        for p in (body, edge, tip):
            basis.use(p, functions, spacing / 2 if functions == "gimp" else None)
    cells = ActiveCells(body, loads=[edge, tip])
    law = NeoHookean(250.0, nu=0.5, volumetric=volumetric)  # Pa
    z = formulations.Unknown(domain, "u", "p")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = getattr(formulations, scheme)(z, dt=dt)
    stored = lambda: 0.0  # noqa: E731
    if conserves := isinstance(scheme, formulations.Midpoint):
        stress = formulations.MixedEnergyMomentum(law, body, z)
        R, stored = stress.power() + scheme.inertia(body), stress.volumetric_energy
    elif lumped:
        R = formulations.mixed(z, body, law) + scheme.lumped(body)
        R += formulations.asgs(z, body, law, force=scheme.force(body))
    else:
        inertia = {"force": scheme.force(body), "scheme": scheme if transient else None}
        R = formulations.stabilized(stabilization, z, body, law, cells=cells, **inertia)
    R += formulations.dead_load(z.test.u, edge, (0.0, 6.25))  # Pa
    if not tied:
        R += formulations.ghost_penalty(z, cells, law)
    if ghost_mass:
        R += formulations.ghost_mass(cells, scheme, 1.0)
    sim = ImplicitMPM(
        R, z, scheme, body, carried=[edge, tip],
        observers=[] if conserves or not corrected else [lambda *_: correct_weights(body, cells)],
        newton={"tying": Tying(z.space, body, cells)} if tied else {},
    )  # fmt: skip
    return sim, stored


def run(until, label, movie=None, **case):
    """Return times [s], upward displacements of the tip [m], and missing energy by work."""
    (sim, stored), law = build(**case), NeoHookean(250.0, nu=0.5)
    rows, frames, (body,), edge = [(0.0, 0.0, 0.0, 0.0)], [], sim.bodies, sim.carried[0]
    try:
        for step in io.watch(sim.run(until), until, label):
            work = body.mesh.comm.allreduce(float(edge.weight @ edge["u"][:, 1]) * 6.25)
            lack = kinetic_energy(body) + strain_energy(body, law) + stored() - work
            rows.append((step.time, probe(sim.carried[1], "u")[1], lack, work))
            if movie and step.time >= (len(frames) + 1) * until / 70 - 1e-9:
                frames.append(Path(movie).with_suffix("") / f"{len(frames):03d}.png")
                panels, box = {f"t = {step.time:.2f} s": sim.bodies}, ((-0.2, -0.2), (5.2, 7.6))
                io.picture(frames[-1], panels, "p", "p [Pa]", limits=(-40, 60), bounds=box)
    except NewtonError as error:
        io.say(f"{label} ends at t = {sim.time:.3f} s: {error}")
    if frames:
        io.animate(movie, frames)
    t, y, lack, work = np.array(rows).T
    return t, y, lack / work.max()


def named(key, value):
    """Return what a table says of an option."""
    if isinstance(value, bool):
        return key if value else f"not {key}"
    return value if isinstance(value, str) else f"{key} {value}"


def main(
    figures: list[str] = ["6a", "6c", "6d"], until: float = 7.0, scheme: str = "Bossak",
    h: float = 0.1, tied: bool = False, corrected: bool = True, movie: bool = False,
):  # fmt: skip
    """Repeat FIGURES: 6a, 6c, 6d, schemes, cut, cmn, cmn-cut, smooth, smooth-cmn, kinds, ...

    The options apply to cases that do not set them.
    """
    if unknown := set(figures) - set(FIGURES):
        raise typer.BadParameter(f"{', '.join(unknown)}: the figures are {', '.join(FIGURES)}")
    t, _, y = np.loadtxt(REFERENCE, delimiter=",").T
    expected, shown = turning_points(t, y), t <= until
    common = {"scheme": scheme, "h": h, "tied": tied, "corrected": corrected}
    for figure in figures:
        columns = {"case".ljust(56): "s", "u_y [m]": ".4f", "off by": "+.1%", "t [s]": ".3f"}
        table, curves = io.Table({**columns, "off by ": "+.1%", "energy": "+.1%"}), {}
        for case in FIGURES[figure]:
            label = ", ".join(named(key, case[key]) for key in LABELS if key in case)
            gif = f"output/cooks_membrane_{label.replace(' ', '_')}.gif" if movie else None
            times, values, lack = run(until, label, gif, **common | case)
            curves[label] = times, values
            turns = zip(turning_points(times, values), expected, strict=False)
            for (time, value), (t_ref, y_ref) in turns:
                share, then = (value - y_ref) / expected[0][1], np.interp(time, times, lack)
                table.row(label.ljust(56), value, share, time, time / t_ref - 1, then)
            table.row(label.ljust(56), values[-1], None, times[-1], None, lack[-1])
        reference = {"P2-P1 finite elements": (t[shown], y[shown])}
        labels = "t [s]", "vertical displacement of the tip [m]"
        io.plot(f"output/cooks_membrane_{figure}.png", curves, *labels, reference=reference)


if __name__ == "__main__":
    typer.run(main)
