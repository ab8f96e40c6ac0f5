# SPDX-License-Identifier: MIT
"""Energy and momenta of different methods: sections 7.1 to 7.4 of the conservation paper.

A problem, such as "cantilever-A", with the paper's numbers of cells and points, is solved by one
method or all of them. The script prints how much energy and momenta have changed, the energy from
the end of the loads on. It draws energies over time and the strain energy of the points.
"""

from math import sqrt

from mpi4py import MPI

import numpy as np
import typer
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ImplicitMPM, basis, formulations, io, materials, points
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, momentum, strain_energy
from fenicsmpm.materials import Hencky, VonMises
from fenicsmpm.solvers import CourantStep, NewtonError

METHODS = {  # options of the mid-point rule
    "energy-momentum": {},
    "symplectic": {},  # stress at the mid-point; it has no state at the end, so elastic only
    "pic": {"flip": 0.0},
    "lumped": {"lumping": 1.0},
    "newmark": None,  # stress at the end, lumped mass in the mapping
}


def equations(method, law, body, z, dt):
    """Return the time scheme and the residual of a body without loads."""
    if method == "newmark":
        scheme = formulations.Newmark(z, dt=dt)
    else:
        scheme = formulations.Midpoint(z, dt=dt, **METHODS[method])
    if method in ("newmark", "symplectic"):
        u = z.u if method == "newmark" else z.u / 2
        P = formulations.Response(law, body, formulations.Kinematics(u, body).F).P
        return scheme, formulations.stress_power(P, z.test.u, body) + scheme.inertia(body)
    return scheme, formulations.EnergyMomentum(law, body, z).power() + scheme.inertia(body)


def background(box, cells):
    create, kind = mesh.create_rectangle, mesh.CellType.quadrilateral
    if len(box) == 3:
        create, kind = mesh.create_box, mesh.CellType.hexahedron
    corners, partitioner = [(0.0,) * len(box), box], basis.shared_vertex_partitioner
    return create(MPI.COMM_WORLD, corners, list(cells), kind, partitioner=partitioner)


# Each problem returns points, the unknown with its conditions, and the length of steps [s].


def cantilever(law, per_side=12):
    domain, d = background((11.0, 20.0), (22, 40)), 0.5 / per_side
    body = points.lattice(domain, d, inside=lambda x: (x[0] < 10) & (np.abs(x[1] - 10) < 0.5))
    basis.use(body, "gimp", d / 2)
    formulations.set_initial_state(body, 7750e3)
    body["tag"] = (body.x[:, 0] > 10 - d) & (np.abs(body.x[:, 1] - 10) < d)  # two loaded points
    z = formulations.Unknown(domain, "u")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    return body, z, CourantStep({body: law}, factor=15.0)()


def cylinders(law, h=2.0, per_side=35, functions="linear"):
    def side(x):
        left, right = (np.hypot(x[0] - a, x[1] - b) < 2 for a, b in ((5.8, 5.5), (14.2, 6.5)))
        return left * 1.0 - right

    domain = background((20.0, 12.0), (round(20 / h), round(12 / h)))
    body = points.lattice(domain, h / per_side, inside=lambda x: side(x) != 0)
    if functions != "linear":
        basis.use(body, functions, h / per_side / 2)
    formulations.set_initial_state(body, 5.0, lambda x: np.outer((0.75, 0), side(x)))
    # the paper's time step uses the sum of the points' moduli at a node instead of their mean
    return body, formulations.Unknown(domain, "u"), CourantStep({body: law}, 5 / per_side)


def taylor_bar(law, cells=50, dt=0.375e-6):
    box, shape = np.array([7.2e-3, 32.4e-3, 7.2e-3]), np.rint(np.array([0.18, 1, 0.18]) * cells)
    domain, d = background(box, shape.astype(int)), box / shape / 2
    body = points.lattice(domain, d, inside=lambda x: np.hypot(x[0], x[2]) < 3.2e-3)
    basis.use(body, "gimp", d / 2)
    formulations.set_initial_state(body, 8930.0, velocity=(0.0, -227.0, 0.0))
    z = formulations.Unknown(domain, "u")
    for axis in range(3):
        z.fix("u", lambda x, axis=axis: np.isclose(x[axis], 0), component=axis)
    return body, z, dt


K, G = 130e9, 43.3e9  # Pa, of copper
COPPER = VonMises(9 * K * G / (3 * K + G), (3 * K - 2 * G) / (6 * K + 2 * G), 0.4e9, 0.1e9)
SOFT, PLASTIC = Hencky(100.0, 0.3), VonMises(100.0, 0.3, sigma_y=sqrt(3 / 2) * 10)  # Pa
FINE = {"h": 0.5, "per_side": 8, "functions": "gimp"}
PROBLEMS = {  # points, law, options; Newton's method, threshold of tying; end of loads, of the run
    "cantilever-A": (cantilever, Hencky(1e9, 0.2), {}, {"rtol": 1e-11}, 0.5, 25.0, 150.0),
    "cantilever-B": (cantilever, Hencky(3e8, 0.49), {}, {"rtol": 1e-11}, 0.5, 25.0, 150.0),
    "collision": (cylinders, SOFT, {}, {"rtol": 1e-11}, None, 0.0, 8.0),
    "collision-plastic": (cylinders, PLASTIC, {}, {"rtol": 1e-11}, None, 0.0, 8.0),
    "collision-plastic-fine": (cylinders, PLASTIC, FINE, {"rtol": 1e-11}, 0.1, 0.0, 8.0),
    "taylor-bar": (taylor_bar, COPPER, {}, {"rtol": 1e-10, "line_search": True}, 0.1, 0.0, 8e-5),
}
ENERGIES = "kinetic", "strain", "dissipated"


def build(problem, method, release=None, tying=None, **more):
    """Return simulation, history and step length; ``more`` are options of the points."""
    seed, law, options, newton, threshold, end_of_loads, _ = PROBLEMS[problem]
    body, z, length = seed(law, **{**options, **more})
    scheme, R = equations(method, law, body, z, length if isinstance(length, float) else 1.0)
    release, force = release or end_of_loads, fem.Constant(z.mesh, np.zeros(len(body.x.T)))
    if release:
        R -= ufl.inner(force, z.test.u) / body.field("weight") * body.dx(1)
    threshold = tying or threshold
    if threshold:
        newton = {**newton, "tying": Tying(z.space, body, ActiveCells(body), threshold)}

    def load(start, end):
        at = end if method == "newmark" else (start + end) / 2
        force.value[1] = -250e3 * at / release if at < release else 0.0

    total, start, spin = z.mesh.comm.allreduce, momentum(body), angular_momentum(body)
    size = total(float(body["mass"] @ np.linalg.norm(body["v"], axis=1))) / 2 or 1.0
    turning = np.linalg.norm(spin) or 1.0
    history = io.History({
        "kinetic": lambda sim: kinetic_energy(body),
        "strain": lambda sim: strain_energy(body, law),
        "dissipated": lambda sim: total(body["V_0"] @ body["dissipation"]) if law.state else 0.0,
        "momentum": lambda sim: np.linalg.norm(momentum(body) - start) / size,
        "angular": lambda sim: np.linalg.norm(angular_momentum(body) - spin) / turning,
    })  # fmt: skip
    sim = ImplicitMPM(R, z, scheme, body, data=load, observers=[history], newton=newton)
    return sim, history, length if callable(length) else None


def drift(history, start=0.0):
    """Return the change of the sum of energies since a time, relative to this sum."""
    sums = sum(history[title] for title in ENERGIES)[history["t [s]"] >= start]
    return sums / sums[0] - 1


def shape(body):
    """Return length and radius of the bar [mm]."""
    (x, z), (X, Z) = body.x.T[::2], (body.x - body["u"]).T[::2]
    most = -body["u"][:, 1], np.hypot(x, z) - np.hypot(X, Z)
    down, wider = (body.mesh.comm.allreduce(a.max(initial=0.0), MPI.MAX) for a in most)
    return 32.4 - 1e3 * down, 3.2 + 1e3 * wider


def run(problem, method, until):
    """Return histories, and points with strain energies [J/m^3] at half the time and the end."""
    sim, history, length = build(problem, method)
    (body,), law, iterations, clouds = sim.bodies, PROBLEMS[problem][1], [], {}
    body.add_field("psi", ())
    try:
        for step in io.watch(sim.run(until, step_length=length), until, method):
            iterations.append(step.newton.iterations)
            if step.time - step.dt < until / 2 <= step.time or step.time > until * (1 - 1e-9):
                state = materials.state_of(law, body)
                body.assign({"psi": materials.energy(law, body["F"], state)})
                clouds[f"t = {step.time:.3g} s"] = io.gather_points(body)
    except NewtonError as error:
        io.say(f"{method} ends at t = {sim.time:.4g} s: {error}")
    return body, history, iterations, clouds


def main(problem: str, method: str = "energy-momentum", until: float = 0.0):
    """Solve PROBLEM by a method, or by "all"."""
    if problem not in PROBLEMS or method not in [*METHODS, "all"]:
        raise typer.BadParameter(
            f"problems: {', '.join(PROBLEMS)}; methods: all, {', '.join(METHODS)}"
        )
    law, start, end = PROBLEMS[problem][1], *PROBLEMS[problem][-2:]
    rows, sums = [], {}
    for name in METHODS:
        if method not in (name, "all") or (name == "symplectic" and law.state):
            continue
        body, history, iterations, clouds = run(problem, name, until or end)
        t, path = history["t [s]"], f"output/{problem}_{name}"
        parts = {title: (t, history[title]) for title in ENERGIES}
        sums[name] = t, sum(values for _, values in parts.values())
        io.plot(f"{path}_energies.png", {**parts, "sum": sums[name]}, "t [s]", "energy [J]")
        if clouds:
            io.picture(f"{path}.png", clouds, "psi", "strain energy [J/m^3]", cut=1)
        change = drift(history, start) if t[-1] > start else np.array([np.nan])
        lost = history["dissipated"][-1] / sums[name][1][-1]
        free = problem.startswith("collision")
        momenta = (history[title].max() if free else None for title in ("momentum", "angular"))
        last = shape(body) if problem == "taylor-bar" else (None, None)
        row = name, t[-1], np.abs(change).max(), change[-1], lost, np.mean(iterations)
        rows.append((*row, *momenta, *last))
    columns = {"method".ljust(15): "s", "until [s]": ".3g", "energy": ".1e", "at the end": "+.2%"}
    columns |= {"dissipated": ".1%", "iterations": ".2f", "momentum": ".1e", "angular": ".1e"}
    table = io.Table(columns | {"length [mm]": ".2f", "radius [mm]": ".2f"})
    for row in rows:
        table.row(*row)
    io.plot(f"output/{problem}_sums.png", sums, "t [s]", "sum of energies [J]")


if __name__ == "__main__":
    typer.run(main)
