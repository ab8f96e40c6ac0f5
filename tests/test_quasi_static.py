# SPDX-License-Identifier: MIT
"""Load steps without inertia: a column under its weight, a cantilever, reactions, step lengths."""

import math
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from scipy.integrate import solve_bvp

from fenicsmpm import ImplicitMPM, MaterialPoints, points
from fenicsmpm import formulations as fm
from fenicsmpm.materials import Hencky
from fenicsmpm.solvers import NewtonError

sys.path.insert(0, str(Path(__file__).parent.parent / "studies"))

from moved_points import Column, see


@pytest.mark.mpi
@pytest.mark.parametrize(
    "functions,bound", [("quadratic", 0.008), ("gimp", 0.008), ("cubic", 0.0015)]
)
def test_column_under_its_own_weight(functions, bound):
    column = Column(functions)
    iterations = [step.newton.iterations for step in column.sim.run(1.0)]
    assert len(iterations) == 40 and max(iterations) <= 5
    assert column.error() < bound
    weight = column.density * column.g * column.L * 1.0
    assert column.floor.value == pytest.approx((0, weight), rel=1e-9, abs=1e-9 * weight)


@pytest.mark.parametrize(
    "functions,weights",
    [
        ("linear", "corrected"),
        ("cpgimp", "as they are"),
        ("gimp", "balanced"),
        ("quadratic", "balanced"),
        ("cubic", "balanced"),
    ],
)
def test_integrals_over_moved_points_converge(functions, weights):
    """Moved points integrate badly, but for better weights, and sizes that follow the points."""
    errors = []
    for h in (2.0, 1.0, 0.5, 0.25):
        column = Column(functions, h, weights)
        for _ in column.sim.run(1.0):
            pass
        errors.append(column.error())
    assert errors[1] < 0.0025
    assert np.all(np.diff(np.log2(errors)) < -0.75), errors


def test_load_steps_grow_and_shrink():
    column = Column("quadratic", steps=40)
    steps = list(column.sim.run(1.0, largest=0.25))
    assert 4 < len(steps) < 15
    lengths = [step.dt for step in steps[:-1]]
    assert max(lengths) <= 0.25 and np.all(np.diff(lengths) >= -1e-12)
    assert column.error() < 0.02
    # a step that is too long is halved, and grows again
    column = Column("quadratic", steps=1, max_iterations=6)
    steps = list(column.sim.run(1.0))
    assert steps[0].attempts > 1 and sum(step.dt for step in steps) == pytest.approx(1.0)


def rod(E, nu, L, force):
    """End of a geometrically exact rod of height 1 in plane strain, bent down by a dead force.

    E. Reissner, ZAMP 23, 1972: axial and shear flexibility, shear factor 5/6.
    """
    E_plane, G = E / (1 - nu**2), E / 2 / (1 + nu)

    def equations(_, y):
        angle, moment = y[:2]
        stretch = 1 - force * np.sin(angle) / E_plane
        shear = -force * np.cos(angle) / (5 / 6 * G)
        dx = stretch * np.cos(angle) - shear * np.sin(angle)
        dz = stretch * np.sin(angle) + shear * np.cos(angle)
        return np.array([moment / (E_plane / 12), dx * force, dx, dz])

    s = np.linspace(0, L, 100)
    guess = np.array([-s / L, 0 * s, s, 0 * s])
    solution = solve_bvp(
        equations, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), s, guess, tol=1e-8
    )
    assert solution.success
    return L - solution.y[2, -1], -solution.y[3, -1]


@pytest.mark.parametrize("functions,h", [("gimp", 0.25), ("quadratic", 0.2)])
def test_cantilever_against_a_rod(functions, h):
    E, nu, L, force, per = 12e6, 0.2, 10.0, 1e5, 6
    expected = rod(E, nu, L, force)
    assert expected == pytest.approx((5.5, 8.2), abs=0.05)
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, -9.5), (11, 1)], [round(11 / h), math.ceil(10.5 / h)],
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    body = points.lattice(domain, h / per, inside=lambda x: (x[0] < L) & (np.abs(x[1]) < 0.5))
    see(body, functions, h / per / 2)
    tip = MaterialPoints(domain, [(L, 0.0)], weight=1.0)
    see(tip, functions, h / per / 2)
    fm.set_initial_state(body, 1.0)
    at_end = body.x[:, 0] > L - h / per
    body.add_field("share", (), at_end / at_end.sum())
    z = fm.Unknown(domain, "u")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = fm.QuasiStatic(z, dt=1 / 20)
    P = fm.Response(Hencky(E, nu), body, fm.Kinematics(z.u, body).F).P
    pull = fem.Constant(domain, np.zeros(2))

    def load(start, end):
        pull.value = (0, -force * end)

    share = body.field("share") / body.field("weight")
    R = fm.stress_power(P, z.test.u, body) - share * ufl.inner(pull, z.test.u) * body.dx
    sim = ImplicitMPM(R, z, scheme, body, carried=[tip], data=load)
    assert len(list(sim.run(1.0))) == 20
    assert -tip["u"][0] == pytest.approx(expected, rel=0.015)


def test_a_load_without_material_is_not_tried_again():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.lattice(domain, 0.1, inside=lambda x: x[0] < 0.5)
    fm.set_initial_state(body, 1.0)
    away = MaterialPoints(domain, [(0.9, 0.9)], weight=1.0)
    z = fm.Unknown(domain, "u")
    z.fix("u", lambda x: np.isclose(x[0], 0))
    scheme = fm.QuasiStatic(z, dt=1.0)
    P = fm.Response(Hencky(1.0, 0.0), body, fm.Kinematics(z.u, body).F).P
    R = fm.stress_power(P, z.test.u, body) + fm.dead_load(z.test.u, away, (1, 0))
    sim = ImplicitMPM(R, z, scheme, body, carried=[away])
    with pytest.raises(NewtonError, match="load without material"):
        next(sim.run(1.0))
    assert sim.next_dt == 1.0


def test_conditions_of_a_loop():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    body = points.fill(domain, 2)
    fm.set_initial_state(body, 1.0)

    def loop(value):
        z = fm.Unknown(domain, "u")
        z.fix("u", lambda x: np.isclose(x[0], 0))
        z.fix("u", lambda x: np.isclose(x[0], 1), value, component=0)
        P = fm.Response(Hencky(1.0, 0.0), body, fm.Kinematics(z.u, body).F).P
        R = fm.stress_power(P, z.test.u, body)
        return ImplicitMPM(R, z, fm.QuasiStatic(z, dt=0.25), body)

    # a total that would be added in each step
    with pytest.raises(
        ValueError, match=r"does not depend on time would be added again .*lambda t"
    ):
        loop(0.1)
    # the end is where the total says, whatever the steps are
    sim = loop(lambda t: -0.02 * t**2)
    for _ in sim.run(1.0):
        pass
    right = np.argmax(body.x[:, 0])
    assert body["u"][right, 0] == pytest.approx(-0.02, rel=0.1)
    sim.unknown.fix("u", lambda x: np.isclose(x[1], 0))
    with pytest.raises(ValueError, match="added to the unknown after the simulation was made"):
        sim.step()
