# SPDX-License-Identifier: MIT
"""Which orders of convergence the Material Point Method has, and what costs them.

Two manufactured motions: standing waves in a box of rollers, with points that stay in their cells
or cross some, and a ring whose layers turn. Each row is a set of grid functions and a time loop;
what is suspected to cost the order is switched off one by one. Prints a table of the errors of
displacement, with the slopes of their regression lines.
"""

import math

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, io, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying, correct_weights
from fenicsmpm.materials import NeoHookean
from fenicsmpm.verification import Manufactured, axis_aligned_waves, generalized_vortex, ring

DENSITY = 1000.0  # kg/m^2
WAVE = math.sqrt(10.0)  # m/s


def elastic(law, is_mixed=False):
    """Energy of a compressible solid, or of the isochoric part of an incompressible one."""

    def energy(F):
        J = ufl.det(F)
        return law.energy(F, J) + (0 if is_mixed else law.kappa / 2 * (J - 1) ** 2)

    return energy


def see(body, functions, spacing):
    if functions != "linear":
        basis.use(body, functions, *([spacing / 2] if functions.endswith("gimp") else []))


def waves(n, functions, loop, amplitude, per=2, lumping=1.0, flip=1.0, corrected=False, until=0.2):
    """Error of the displacement in the box, n cells a side."""
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
    return exact.error(body, "u")


def vortex(n, functions, formulation, tied=True, corrected=True, angle=0.3):
    """Error of the displacement in the ring, whose points move by up to 0.3 m; n cells a side."""
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
    exact = Manufactured(domain, motion, lambda F, rate: ufl.diff(energy(F), F), DENSITY)
    exact.set_initial_state(body)
    z = fm.Unknown(domain, "u", *(["p"] if is_mixed else []))
    scheme = fm.Bossak(z, dt=0.4 * h)
    force, cells = scheme.force(body, exact.force(body)), ActiveCells(body)
    if is_mixed:
        R = fm.stabilized(formulation, z, body, law, force=force, scheme=scheme)
    else:
        P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
        R = fm.stress_power(P, z.test.u, body) - ufl.inner(force, z.test.u) * body.dx
    corrections = [lambda sim, step: correct_weights(body, cells)]
    sim = ImplicitMPM(
        R, z, scheme, body, data=exact.at_end,
        observers=corrections if corrected and not lattice else [],
        newton={"tying": Tying(z.space, body, cells)} if tied and not lattice else {},
    )  # fmt: skip
    for _ in sim.run(0.5):
        pass
    exact.set_time(sim.time)
    return exact.error(body, "u")


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
        ("quadratic", "u", {}),
        ("linear", "asgs", {}),
        ("linear", "asgs", {"corrected": False}),
        ("linear", "osgs", {}),
    ):
        without = "".join(f", not {name}" for name in options)
        given = {"functions": functions, "formulation": formulation, **options}
        yield f"vortex: {functions}, {formulation}{without}", vortex, given


def main(waves_on=(8, 16, 32), vortex_on=(24, 48, 96)):
    table = io.Table(
        {"case".ljust(50): "s", "coarse": ".2e", "medium": ".2e", "fine": ".2e", "order": ".2f"}
    )
    for title, error, options in rows():
        sizes = waves_on if error is waves else vortex_on
        found = []
        for n in sizes:
            try:
                found.append(error(n, **options))
            except RuntimeError:  # no solution
                found.append(None)
        known = [(n, e) for n, e in zip(sizes, found, strict=True) if e is not None]
        order = -np.polyfit(*np.log(known).T, 1)[0] if len(known) > 1 else None
        table.row(title.ljust(50), *found, order)


if __name__ == "__main__":
    main()
