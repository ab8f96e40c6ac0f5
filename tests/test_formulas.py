# SPDX-License-Identifier: MIT
"""Formulas by hand: factors and powers that no exact motion shows."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from energy_bodies import MATERIALS, block, simulation
from test_time_schemes import SPEED, shear_oscillator

from fenicsmpm import MaterialPoints, forms, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells
from fenicsmpm.materials import NeoHookean
from fenicsmpm.simulation import Audit, ImplicitMPM


def test_ghost_terms():
    """Over one facet between cells of 0.5 m, functions with the jump 2 of the normal derivative."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (1.5, 0.5)], [3, 1], mesh.CellType.quadrilateral
    )
    body = MaterialPoints(domain, [(0.2, 0.2), (0.7, 0.2)], 0.1)
    fm.set_initial_state(body, 3.0)
    z = fm.Unknown(domain, "u", "p")
    law, cells = NeoHookean(10.0, 0.3), ActiveCells(body)
    kink, pressure = fem.Function(z.space), fem.Function(z.space)
    for function in (z.U, kink):
        function.sub(0).interpolate(lambda x: np.array([np.abs(x[0] - 0.5), 0 * x[0]]))
    for function in (z.U, pressure):
        function.sub(1).interpolate(lambda x: 5 * np.abs(x[0] - 0.5))

    def work(R, of):
        return forms.assemble_vector(forms.form(R)).array @ of.x.array

    h, gamma, rho, dt = 0.5, 0.2, 3.0, 0.1
    R = fm.ghost_penalty(z, cells, law, gamma=gamma)
    assert work(R, kink) == pytest.approx(gamma * law.mu * h * 2**2 * h)
    assert work(R, pressure) == pytest.approx(-gamma * h**3 / (2 * law.mu) * 10**2 * h)
    R = fm.ghost_mass(cells, fm.Midpoint(z, dt=dt), rho, gamma=gamma)
    assert work(R, kink) == pytest.approx(gamma * rho * h**3 * 2 / dt**2 * 2**2 * h)


def triangles():
    """Points of density 5 in triangles of h^2 = 1/8 m^2, and an unknown."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    body = points.fill(domain, 2)
    fm.set_initial_state(body, 5.0)
    return body, fm.Unknown(domain, "u", "p")


def test_subscales_with_inertia():
    """1 / tau_1 = 2 mu / (c1 h^2) + rho 4 / dt^2 with Newmark's method, tau_2 = 2 c2 mu."""
    body, z = triangles()
    law = NeoHookean(E=3.0, nu=0.5)
    scheme = fm.Newmark(z, dt=0.1)
    tau1, tau2 = fm.tau(body, law, c1=0.5, c2=3.0, scheme=scheme)
    expected = 1 / (2 * law.mu / (0.5 / 8) + 5.0 * 4 / 0.1**2)
    assert forms.evaluate(tau1, body) == pytest.approx(expected, rel=1e-12)
    assert forms.evaluate(tau2 + 0 * body.field("mass"), body) == pytest.approx(6 * law.mu)
    without, _ = fm.tau(body, law, c1=0.5)
    assert forms.evaluate(without, body) == pytest.approx(0.5 / 8 / (2 * law.mu), rel=1e-12)


def test_ppp_by_hand():
    body, z = triangles()
    law = NeoHookean(E=3.0, nu=0.5)
    z.U.x.array[:] = 0.05 * np.random.default_rng(1).standard_normal(len(z.U.x.array))
    p, q, j = z.p, z.test.p, fm.Kinematics(z.u, body).j
    by_hand = -0.7 / law.mu * j * (p - ufl.cell_avg(p)) * (q - ufl.cell_avg(q)) * body.dx
    ours, expected = (
        forms.assemble_vector(forms.form(form)).array
        for form in (fm.ppp(z, body, law, alpha=0.7), by_hand)
    )
    assert np.abs(expected).max() > 1e-4
    assert ours == pytest.approx(expected, abs=1e-14)


def test_inertia_has_the_mass_of_the_mapping():
    """What the grid gains in kinetic energy is the work of the stresses, with 0.4 of it lumped."""
    body, audit = block(), Audit()
    kind = partial(ImplicitMPM, observers=[audit])
    sim = simulation(body, MATERIALS["Hencky"], kind=kind, lumping=0.4)
    for _ in range(2):
        before = body["V_0"] @ body["work"]
        sim.step()
        work = body["V_0"] @ body["work"] - before
    assert abs(work) > 1e-3
    assert audit.last.changes["solve"].kinetic_energy == pytest.approx(-work, rel=1e-9)


def amplification(scheme, dt):
    """``(3, 3)`` how a step changes u, v dt and a dt^2 of the oscillator."""
    columns = []
    for unit in SPEED * np.eye(3):
        sim = shear_oscillator(scheme, dt)
        (body,) = sim.bodies
        sim.number = 1  # no search for the acceleration at the start
        body["u"][:, 0], body["F"][:, 0, 1] = unit[0], unit[0]  # h = 1 m
        body["v"][:, 0], body["a"][:, 0] = unit[1] / dt, unit[2] / dt**2
        sim.step()
        after = body["u"][0, 0], body["v"][0, 0] * dt, body["a"][0, 0] * dt**2
        columns.append(np.array(after) / SPEED)
    return np.array(columns).T


@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("kind", [fm.Bossak, fm.GeneralizedAlpha])
def test_spectral_radius_of_long_steps(kind, rho_inf):
    A = amplification(lambda z, dt: kind(z, dt=dt, rho_inf=rho_inf), 1e3)
    # a multiple eigenvalue is known to a root of round-off and of 1 / (omega dt)
    assert np.abs(np.linalg.eigvals(A)).max() == pytest.approx(rho_inf, abs=0.02)
