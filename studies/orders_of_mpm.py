# SPDX-License-Identifier: MIT
"""Orders of convergence of the Material Point Method, and what reduces them.

Manufactured motions: standing waves in a box on rollers, with points that stay in their cells or
cross some; a ring whose layers rotate; and an incompressible block at rest. Each row is a set of
grid functions and a time loop, with one suspected cause of a lower order removed after the other.
The script prints a table of the errors of displacement and of pressure (p), with the slopes of
their regression lines.
"""

import math

from mpi4py import MPI

import numpy as np
import typer
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, forms, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.materials import NeoHookean
from fenicsmpm.solvers import NewtonSolver, solve_in_load_steps
from fenicsmpm.verification import Manufactured, axis_aligned_waves, generalized_vortex, ring

DENSITY = 1000.0  # kg/m^2
WAVE = math.sqrt(10.0)  # m/s


def elastic(law, is_mixed=False):
    """Return the energy of a compressible solid, or of an incompressible one's isochoric part."""

    def energy(F):
        J = ufl.det(F)
        return law.energy(F, J) + (0 if is_mixed else law.kappa / 2 * (J - 1) ** 2)

    return energy


def see(body, functions, spacing):
    if functions != "linear":
        basis.use(body, functions, *([spacing / 2] if functions.endswith("gimp") else []))


def waves(n, functions, loop, amplitude, per=2, lumping=1.0, flip=1.0, corrected=False, until=0.2):
    """Return the error in the box, with n cells per side."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, mesh.CellType.quadrilateral)
    body = points.fill(domain, per)
    see(body, functions, 1 / n / per)
    energy = elastic(NeoHookean(1e4, 0.3))
    motion = axis_aligned_waves(amplitude, WAVE)
    exact = Manufactured(domain, motion, lambda F, rate: ufl.diff(energy(F), F), DENSITY)
    exact.set_initial_state(body)
    b, name = exact.force(body), "v" if loop == "explicit" else "u"
    z = fm.Unknown(domain, name)
    for k in range(2):
        z.fix(name, lambda x, k=k: np.isclose(x[k] * (1 - x[k]), 0), component=k)
    if loop == "explicit":
        R = fm.internal_force(z.test.v, body, energy, fbar=None) + fm.body_force(z.test.v, body, b)
        dt = 0.2 / n / WAVE
        sim = ExplicitMPM(R, z, body, data=exact.at_beginning, dt=dt, flip=flip)
    else:
        dt = 0.4 / n / WAVE
        middle = loop == "mid-point"
        scheme = (
            fm.Midpoint(z, dt=dt, lumping=lumping, flip=flip) if middle else fm.Newmark(z, dt=dt)
        )
        if middle:
            R = fm.EnergyMomentum(energy, body, z).power() + scheme.inertia(body)
            R -= ufl.inner(fm.density(body) * b, z.test.u) * body.dx
        else:
            P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
            R = fm.stress_power(P, z.test.u, body)
            R -= ufl.inner(scheme.force(body, b), z.test.u) * body.dx
        data = exact.at_middle if middle else exact.at_end
        cells = ActiveCells(body)
        corrections = [lambda sim, step: correct_weights(body, cells)] if corrected else []
        sim = ImplicitMPM(R, z, scheme, body, data=data, observers=corrections)
    for _ in sim.run(until):
        pass
    exact.set_time(sim.time)
    return {"": exact.error(body, "u")}


def block(n, functions, formulation, per=3):
    """Return errors of a block at rest, supported as in demos/manufactured_solution.py."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, mesh.CellType.quadrilateral)
    body = points.fill(domain, per)
    see(body, functions, 1 / n / per)
    law, cells = NeoHookean(10e6, 0.5), ActiveCells(body)

    def displacement(X, t):
        u = 0.01 * t * (X[0] + X[1]) ** 2 * ufl.exp(X[0] + X[1])
        return u, -u

    def pressure(X, t):
        return t * law.E / 3 * ufl.sin(2 * ufl.pi * X[0]) * ufl.cos(2 * ufl.pi * X[1])

    energy = elastic(law, is_mixed=True)
    stress = lambda F, rate: ufl.diff(energy(F), F)  # noqa: E731
    exact = Manufactured(domain, displacement, stress, 1.0, pressure)
    z = fm.Unknown(domain, "u", "p")
    held = fem.Function(z.part_space("u"))
    z.fix("u", lambda x: np.isclose(x[0] * (1 - x[0]) * x[1] * (1 - x[1]), 0), held)
    z.fix("p", lambda x: np.isclose(x[0] + x[1], 0))
    R = fm.stabilized(formulation, z, body, law, force=exact.force(body), cells=cells)

    def set_load(factor):
        exact.set_time(factor)
        held.x.array[:] = exact.interpolate("u", z.part_space("u")).x.array

    solve_in_load_steps(NewtonSolver(R, z.U, z.bcs, line_search=True), set_load)
    body.add_field("u", (2,), forms.evaluate(z.u, body))
    body.add_field("V_0", (), body.weight)
    p = forms.evaluate(z.p, body)
    level = body.weight @ (p - forms.evaluate(exact.at(body).p, body)) / body.weight.sum()
    body.add_field("p", (), p - level)
    return {"": exact.error(body, "u"), " (p)": exact.error(body, "p")}


def vortex(n, functions, formulation, tied=True, corrected=True, angle=0.3):
    """Return errors in the ring, whose points move by up to 0.3 m; n cells per side."""
    h = 3 / n
    lattice = functions != "linear"
    kind = mesh.CellType.quadrilateral if lattice else mesh.CellType.triangle
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(-1.5, -1.5), (1.5, 1.5)], [n, n], kind)
    body = ring(domain, h / 3)
    see(body, functions, h / 3)
    is_mixed = formulation != "u"
    law = NeoHookean(1e3, 0.5 if is_mixed else 0.3)
    energy = elastic(law, is_mixed)
    motion = generalized_vortex(angle)

    def pressure(X, t):  # zero at the surfaces of the ring
        return law.mu * t * ufl.sin(2 * ufl.pi * (ufl.sqrt(ufl.inner(X, X)) - 0.75))

    exact = Manufactured(
        domain, motion, lambda F, rate: ufl.diff(energy(F), F), DENSITY,
        pressure if is_mixed else None,
    )  # fmt: skip
    exact.set_initial_state(body)
    z = fm.Unknown(domain, "u", *(["p"] if is_mixed else []))
    scheme = fm.Bossak(z, dt=0.4 * h)
    force, cells = scheme.force(body, exact.force(body)), ActiveCells(body)
    if is_mixed:
        transient = {"scheme": scheme, "cells": cells}
        R = fm.stabilized(formulation, z, body, law, force=force, **transient)
    else:
        P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
        R = fm.stress_power(P, z.test.u, body) - ufl.inner(force, z.test.u) * body.dx
    corrections = [lambda sim, step: correct_weights(body, cells)]
    sim = ImplicitMPM(
        R, z, scheme, body, data=exact.at_end,
        observers=corrections if corrected else [],
        newton={"tying": Tying(z.space, body, cells)} if tied else {},
    )  # fmt: skip
    for _ in sim.run(0.5):
        pass
    exact.set_time(sim.time)
    return {"": exact.error(body, "u")} | ({" (p)": exact.error(body, "p")} if is_mixed else {})


def rows(small=5e-4, large=0.05):
    for amplitude, kind in ((small, "stay"), (large, "cross")):
        for functions in ("linear", "gimp", "cpgimp", "quadratic", "cubic"):
            for loop in ("Newmark", "explicit"):
                options = {"functions": functions, "loop": loop, "amplitude": amplitude}
                yield f"waves, points {kind}: {functions}, {loop}", waves, options
    linear = {"functions": "linear", "loop": "Newmark", "amplitude": large, "corrected": True}
    yield "  linear, Newmark, corrected weights", waves, linear
    cross = {"functions": "quadratic", "amplitude": large}
    yield "  quadratic, Newmark, 16 points a cell", waves, {**cross, "loop": "Newmark", "per": 4}
    yield "  quadratic, mid-point, lumped mass", waves, {**cross, "loop": "mid-point"}
    yield (
        "  quadratic, mid-point, consistent mass",
        waves,
        {**cross, "loop": "mid-point", "lumping": 0.0},
    )
    yield "  quadratic, explicit, PIC", waves, {**cross, "loop": "explicit", "flip": 0.0}
    for functions, formulation, options in (
        ("linear", "u", {}),
        ("linear", "u", {"corrected": False}),
        ("linear", "u", {"tied": False, "corrected": False}),
        ("quadratic", "u", {"tied": False, "corrected": False}),
        ("quadratic", "u", {}),
        ("linear", "asgs", {}),
        ("linear", "asgs", {"corrected": False}),
        ("linear", "osgs", {}),
        ("linear", "cip", {}),
        ("quadratic", "cip", {}),
        ("quadratic", "cip", {"corrected": False}),
        ("quadratic", "hessian", {}),
        ("quadratic", "split_osgs", {}),
        ("gimp", "cip", {}),
    ):
        without = "".join(f", not {name}" for name in options)
        given = {"functions": functions, "formulation": formulation, **options}
        yield f"vortex: {functions}, {formulation}{without}", vortex, given
    for functions in ("linear", "quadratic", "cubic"):
        for formulation in ("cip", "split_osgs", *(["hessian"] if functions != "linear" else [])):
            given = {"functions": functions, "formulation": formulation}
            yield f"block: {functions}, {formulation}", block, given


def main(
    waves_on: list[int] = [8, 16, 32], vortex_on: list[int] = [24, 48, 96],
    block_on: list[int] = [8, 16, 32, 64], only: str = "",
):  # fmt: skip
    """Print rows whose case begins with ONLY, on meshes with these numbers of cells per side."""
    sizes = {waves: waves_on, vortex: vortex_on, block: block_on}
    table = io.Table(
        {"case".ljust(50): "s", "coarse": ".2e", "medium": ".2e", "fine": ".2e", "order": ".2f"}
    )
    for title, errors, options in rows():
        if not title.startswith(only):
            continue
        found = []
        for n in sizes[errors]:
            try:
                found.append(errors(n, **options))
            except RuntimeError:  # no solution found
                found.append({})
        for part in max(found, key=len):
            values = [some.get(part) for some in found]
            known = [(n, e) for n, e in zip(sizes[errors], values, strict=True) if e is not None]
            order = -np.polyfit(*np.log(known).T, 1)[0] if len(known) > 1 else None
            table.row((title + part).ljust(50), *values[-3:], order)


if __name__ == "__main__":
    typer.run(main)
