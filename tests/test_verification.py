# SPDX-License-Identifier: MIT
"""Manufactured solutions: loads that follow from a motion, and orders of the time loops."""

import math
import runpy
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.materials import NeoHookean, NewtonianFluid
from fenicsmpm.verification import Convergence, Manufactured, axis_aligned_waves

STUDY = runpy.run_path(str(Path(__file__).parents[1] / "studies" / "orders_of_mpm.py"))
DENSITY = 1000.0
LAW = NeoHookean(1e4, 0.3)
WAVE = math.sqrt(10.0)  # m/s


def energy(F):
    J = ufl.det(F)
    return LAW.energy(F, J) + LAW.kappa / 2 * (J - 1) ** 2


def stress(F, rate):
    return ufl.diff(energy(F), F)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_force_balances_stress_and_inertia(dim):
    """Derivatives by UFL against differences in space and time."""
    create = (mesh.create_unit_square, mesh.create_unit_cube)[dim - 2]
    domain = create(MPI.COMM_WORLD, *[3] * dim)

    def displacement(X, t):
        pairs = [(X[i], X[(i + 1) % dim]) for i in range(dim)]
        return [0.1 * (ufl.sin(x + 2 * y + t) - ufl.sin(x + t)) for x, y in pairs]

    def viscous(F, rate):
        return stress(F, rate) + 30.0 * rate

    exact = Manufactured(domain, displacement, viscous, DENSITY, lambda X, t: 50 * X[0] * X[1] * t)
    body = points.random(domain, 2, seed=3)
    body.add_field("X", (dim,), body.x)
    fields = exact.at(body)

    def values(name, shift=0.0, axis=0):
        body["X"] = body.x + shift * np.eye(dim)[axis]
        found = forms.evaluate(getattr(fields, name), body)
        body["X"] = body.x
        return found

    e = 1e-4
    exact.set_time(0.7)
    slopes = [(values("P", e, k) - values("P", -e, k))[:, :dim, k] / (2 * e) for k in range(dim)]
    F = np.stack([(values("u", e, k) - values("u", -e, k)) / (2 * e) for k in range(dim)], axis=2)
    assert values("F")[:, :dim, :dim] == pytest.approx(F + np.eye(dim), abs=1e-7)
    b, a = values("b"), values("a")
    assert b == pytest.approx(a - sum(slopes) / DENSITY, rel=1e-5, abs=1e-5 * np.abs(b).max())
    before, after = [], []
    for time, found in ((0.7 - e, before), (0.7 + e, after)):
        exact.set_time(time)
        found += [values("u"), values("v")]
    exact.set_time(0.7)
    assert values("v") == pytest.approx((after[0] - before[0]) / (2 * e), abs=1e-6)
    assert a == pytest.approx((after[1] - before[1]) / (2 * e), abs=1e-6)


@pytest.mark.parametrize("loop", ["Newmark", "explicit"])
@pytest.mark.parametrize("functions", ["linear", "gimp", "quadratic", "cubic"])
def test_waves_whose_points_stay_in_their_cells(functions, loop):
    errors = [STUDY["waves"](n, functions, loop, amplitude=5e-4)[""] for n in (8, 16, 32)]
    assert -np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0] > 1.8
    assert errors[-1] < 0.02


@pytest.mark.parametrize("loop", ["Newmark", "explicit"])
def test_waves_whose_points_cross_cells(loop):
    """Order two where points cover the body without gaps."""
    errors = [STUDY["waves"](n, "cpgimp", loop, amplitude=0.05)[""] for n in (8, 16, 32)]
    assert -np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0] > 1.95
    assert errors[-1] < 0.01


@pytest.mark.parametrize("formulation", ["u", "asgs"])
def test_vortex_whose_points_cross_cells(formulation):
    """Order two, with tied nodes and corrected weights; points move by more than four cells."""
    angle, sizes = 0.3, (24, 48)
    assert 2 * math.sin(angle / 2) > 4 * 3 / sizes[-1]
    errors = [STUDY["vortex"](n, "linear", formulation, angle=angle)[""] for n in sizes]
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert errors[1] < 0.035


def test_a_motion_that_begins_deformed_is_refused():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    exact = Manufactured(domain, lambda X, t: (0.1 * X[0], 0 * X[1]), stress, DENSITY)
    with pytest.raises(ValueError, match=r"at time zero is 0\.0"):
        exact.set_initial_state(points.fill(domain, 2))


def test_orders_of_a_study(capsys, tmp_path):
    study = Convergence(["u", "p"])
    for h in (0.4, 0.2, 0.1):
        study.add(h, u=3 * h**2, p=h**1.5)
    assert study.orders() == pytest.approx({"u": 2.0, "p": 1.5})
    assert study.orders(last=2) == pytest.approx({"u": 2.0, "p": 1.5})
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].split() == ["0.1", "3.000e-02", "2.00", "3.162e-02", "1.50"]
    study.plot(tmp_path / "a" / "orders.png")
    assert (tmp_path / "a" / "orders.png").stat().st_size > 5000
    with pytest.raises(ValueError, match="errors of u, p, not of q"):
        study.add(0.05, q=1.0)


def test_waves_of_a_fluid():
    """A law that depends on rates, in explicit steps."""
    law = NewtonianFluid(1e4, 30.0)

    def newtonian(F, rate):
        L, J = ufl.dot(rate, ufl.inv(F)), ufl.det(F)
        sigma = law.kappa * (J - 1) * ufl.Identity(3) + 2 * law.mu * ufl.dev(ufl.sym(L))
        return J * ufl.dot(sigma, ufl.inv(F).T)

    errors = []
    for n in (16, 32):
        domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n, mesh.CellType.quadrilateral)
        body = points.fill(domain, 2)
        basis.use(body, "quadratic")
        exact = Manufactured(domain, axis_aligned_waves(5e-4, WAVE), newtonian, DENSITY)
        exact.set_initial_state(body)
        z = fm.Unknown(domain, "v")
        for k in range(2):
            z.fix("v", lambda x, k=k: np.isclose(x[k] * (1 - x[k]), 0), component=k)
        R = fm.internal_force(z.test.v, body, law, fbar=None)
        R += fm.body_force(z.test.v, body, exact.force(body))
        sim = ExplicitMPM(R, z, body, data=exact.at_beginning, dt=0.1 / n / WAVE)
        for _ in sim.run(0.2):
            pass
        exact.set_time(sim.time)
        errors.append(exact.error(body, "u"))
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert errors[-1] < 0.02


def test_a_bar_that_tractions_pull():
    """Its end is inside of a cell; it moves by what acts on boundary points there."""

    def motion(X, t):
        return [1e-3 * ufl.sin(math.pi * X[0] / 2) * ufl.sin(5 * t), 0 * X[1]]

    errors = []
    for n in (8, 16):
        h = 1 / (n + 0.5)
        domain = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), ((n + 2) * h, 2 * h)], [n + 2, 2], mesh.CellType.quadrilateral
        )
        body = points.lattice(domain, h / 4, inside=lambda x: x[0] < 1)
        exact = Manufactured(domain, motion, stress, DENSITY)
        exact.set_initial_state(body)
        edge = points.on_curve(domain, (1, 0), (1, 2 * h), spacing=h / 4)
        z = fm.Unknown(domain, "u")
        z.fix("u", lambda x: np.isclose(x[0], 0), component=0)
        z.fix("u", lambda x, h=h: np.isclose(x[1] * (2 * h - x[1]), 0), component=1)
        scheme, cells = fm.Newmark(z, dt=0.4 * h / WAVE), ActiveCells(body, loads=[edge])
        P = fm.Response(energy, body, fm.Kinematics(z.u, body).F).P
        R = fm.stress_power(P, z.test.u, body)
        R -= ufl.inner(scheme.force(body, exact.force(body)), z.test.u) * body.dx
        traction = exact.at(edge).P
        R += fm.dead_load(z.test.u, edge, ufl.as_vector([traction[0, 0], traction[1, 0]]))
        newton = {"tying": Tying(z.space, body, cells)}
        sim = ImplicitMPM(R, z, scheme, body, carried=[edge], data=exact.at_end, newton=newton)
        for _ in sim.run(0.3):
            pass
        exact.set_time(sim.time)
        errors.append(exact.error(body, "u"))
    assert np.log2(errors[0] / errors[1]) > 1.5
    assert errors[-1] < 0.003
