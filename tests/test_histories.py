# SPDX-License-Identifier: MIT
"""Parts of an unknown that points carry: heat in a body that turns and crosses cells."""

import math

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import ImplicitMPM, points
from fenicsmpm import formulations as fm

pytestmark = pytest.mark.ranks

CAPACITY, DENSITY = 2.0, 3.0
TURNS_A_SECOND = 0.25


def everywhere(x):
    return np.ones(x.shape[1], dtype=bool)


def turned(x, start, end):
    """Displacement of a rigid rotation about the origin from one time to another."""
    angle = 2 * math.pi * TURNS_A_SECOND * (end - start)
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(c - 1) * x[0] - s * x[1], s * x[0] + (c - 1) * x[1]])


def rotating_body(n, per, dt, conductivity, flip, temperature):
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(-2, -2), (2, 2)], [n, n])
    body = points.lattice(domain, 4 / n / per, inside=lambda x: np.abs(x).max(axis=0) < 1)
    fm.set_initial_state(body, DENSITY)
    body.add_field("T", (), temperature(body.x.T))
    z = fm.Unknown(domain, "u", fm.Part("T", flip=flip))
    z.fix("u", everywhere, turned)
    scheme = fm.QuasiStatic(z, dt=dt)
    k = fm.Kinematics(z.u, body)
    rate = CAPACITY * fm.density(body) * scheme.rate("T")
    flux = conductivity * k.j * ufl.inner(k.grad(z.T), k.grad(z.test.T))
    R = (rate * z.test.T + flux) * body.dx
    return ImplicitMPM(R, z, scheme, body)


def heat(body):
    return body.mesh.comm.allreduce(float(CAPACITY * body["mass"] @ body["T"]))


@pytest.mark.mpi
@pytest.mark.parametrize("flip", [1.0, 0.0])
def test_heat_is_kept(flip):
    sim = rotating_body(16, 2, 0.05, 1.0, flip, lambda x: 1 + np.cos(2 * x[0]) * x[1] ** 2)
    body = sim.bodies[0]
    cells = body.cell.copy() if body.mesh.comm.size == 1 else None
    at_start = heat(body)
    for _ in sim.run(1.0):
        pass
    assert heat(body) == pytest.approx(at_start, rel=1e-12)
    if cells is not None:
        assert np.mean(cells != body.cell) > 0.7
    # it has turned by a right angle, and cooled down where it was hot
    order = np.argsort(body.id)
    assert np.linalg.norm(body["u"], axis=1).max() > 1
    assert np.ptp(body["T"][order]) < 1


def test_conduction_in_a_body_that_turns():
    """The first mode of an insulated square decays by its rate, with an error of second order."""
    rate = 0.1 * math.pi**2 / 4 / (CAPACITY * DENSITY)

    def mode(x):
        return np.sin(math.pi / 2 * x[0])

    errors = []
    for n in (8, 16, 32):
        sim = rotating_body(n, 3, 0.02, 0.1, 1.0, mode)
        for _ in sim.run(0.4):
            pass
        body = sim.bodies[0]
        shape = mode((body.x - body["u"]).T)
        amplitude = np.mean(shape * body["T"]) / np.mean(shape**2)
        errors.append(abs(amplitude / math.exp(-rate * 0.4) - 1))
    assert errors[-1] < 1e-4
    orders = np.diff(np.log2(errors))
    assert np.all(orders < -1.8), errors


@pytest.mark.parametrize(
    ("scheme", "order"),
    [(fm.QuasiStatic, 1), (fm.Bossak, 1), (fm.GeneralizedAlpha, 1), (fm.Midpoint, 2), (fm.BDF2, 2)],
)
def test_rates_of_histories(scheme, order):
    """T' = -T everywhere in a body at rest, which mapping does not disturb: orders in time."""

    def error(dt):
        domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
        body = points.fill(domain, 2)
        fm.set_initial_state(body, DENSITY)
        body.add_field("T", (), 1.0)
        z = fm.Unknown(domain, "u", fm.Part("T", flip=1.0))
        z.fix("u", everywhere)
        time = scheme(z, dt=dt)
        T = time.middle("T") if scheme is fm.Midpoint else z.T
        for _ in ImplicitMPM((time.rate("T") + T) * z.test.T * body.dx, z, time, body).run(1.0):
            pass
        np.testing.assert_allclose(body["T"], body["T"][0], rtol=1e-10)
        return abs(body["T"][0] - math.exp(-1))

    errors = [error(dt) for dt in (0.1, 0.05, 0.025)]
    assert np.diff(np.log2(errors)) == pytest.approx(-order, abs=0.15)


def test_only_histories_have_rates():
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    z = fm.Unknown(domain, "u", fm.Part("T"), fm.Part("q", role="grid"))
    for part in ("u", "q", "S"):
        with pytest.raises(ValueError, match=f"only a history has a rate, not the part '{part}'"):
            fm.BDF2(z, dt=0.1).rate(part)


def test_a_history_needs_a_field():
    sim_arguments = (16, 2, 0.1, 1.0, 1.0)
    with pytest.raises(ValueError, match="lacks the field 'T'"):
        domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
        body = points.fill(domain, 2)
        fm.set_initial_state(body, 1.0)
        z = fm.Unknown(domain, "u", "T")
        scheme = fm.QuasiStatic(z, dt=0.1)
        R = (z.T - z.old.T) * z.test.T * body.dx
        ImplicitMPM(R, z, scheme, body)
    assert rotating_body(*sim_arguments, lambda x: x[0]).unknown.old.T.name == "old_T"
