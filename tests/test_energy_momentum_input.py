# SPDX-License-Identifier: MIT
"""What the energy-momentum stress and its mapping cannot use."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from energy_bodies import MATERIALS, NU, E, block, simulation

from fenicsmpm import (
    ImplicitMPM,
    MaterialPoints,
    forms,
    formulations,
)
from fenicsmpm.formulations import (
    EnergyMomentum,
    Kinematics,
    Midpoint,
    Response,
    Unknown,
    stress_power,
)
from fenicsmpm.materials import Law, NewtonianFluid, VonMises, compiled
from fenicsmpm.solvers import EffectiveProjection, LinearSolverError


@compiled
def _nothing(F, L, parameters, state, sigma):
    sigma[:] = 0.0


def test_laws_that_forms_cannot_use():
    body = block()
    F = body.field("F")
    with pytest.raises(ValueError, match="depends on velocities"):
        Response(NewtonianFluid(1e3, 1.0), body, F)
    with pytest.raises(ValueError, match="does not use L, create it with needs_rate=False"):
        Response(Law(_nothing, np.zeros(1), 1.0), body, F)


def test_what_energy_momentum_needs():
    body = block()
    z = Unknown(body.mesh, "u")
    plastic = MATERIALS["plastic"]
    state = {"eps_p": ((), 0.0)}
    law = Law(
        _nothing, np.zeros(1), 1.0, state=state, needs_rate=False,
        energy=plastic.energy, tangent=plastic.tangent,
    )  # fmt: skip
    with pytest.raises(ValueError, match="needs a field 'dissipation'"):
        EnergyMomentum(law, body, z)
    EnergyMomentum(plastic, body, z)
    with pytest.raises(ValueError, match="another EnergyMomentum"):
        EnergyMomentum(plastic, body, z)


@pytest.mark.parametrize("material", ["Hencky", "plastic", "UFL"])
def test_fields_renew_themselves(material):
    """Stress and work are those of the end of the step, without any ``updates``."""
    body = block()
    law = MATERIALS[material]
    sim = simulation(body, law)
    before = body.snapshot()
    sim.step()
    present = Response(law, body, body.field("F"))
    for name, value in {"S": present.S, "work": present.work}.items():
        assert np.abs(body[name] - before[name]).max() > 0.1
        assert body[name] == pytest.approx(forms.evaluate(value, body), abs=1e-9 * E)


@pytest.mark.parametrize("material", ["Hencky", "plastic", "UFL"])
def test_fields_that_nothing_renews(material):
    body = block()
    other = body.copy()
    z = Unknown(body.mesh, "u")
    time = Midpoint(z, dt=0.1)
    R = EnergyMomentum(MATERIALS[material], other, z).power()
    R -= ufl.inner(time.force(body), z.test.u) * body.dx
    with pytest.raises(ValueError, match=r"'S' changes in each step, .* pass them to it"):
        ImplicitMPM(R, z, time, body)


def test_fields_that_are_renewed_twice():
    body = block()
    z = Unknown(body.mesh, "u")
    time = Midpoint(z, dt=0.1)
    F = Kinematics(z.u, body).F
    R = time.inertia(body)
    for _ in range(2):
        R += stress_power(Response(MATERIALS["plastic"], body, F).P, z.test.u, body)
    with pytest.raises(ValueError, match="is renewed twice"):
        ImplicitMPM(R, z, time, body)


def test_state_and_parameters_that_change():
    """A response is computed anew for them, not only for another deformation."""
    body = block()
    body["F"] = body["F"] * 1.02
    body["F"][:, 0, 1] = 0.3
    law = VonMises(E, NU, sigma_y=4.0, H=5.0)
    P = forms.PointExpression(Response(law, body, body.field("F")).P, body)
    first = P.evaluate()
    body["eps_p"] = 0.5
    hardened = P.evaluate()
    assert np.abs(hardened - first).min(axis=0).max() > 0.1
    law.parameters[2] += 5.0 * 0.5
    body["eps_p"] = 0.0
    assert P.evaluate() == pytest.approx(hardened, abs=1e-12 * E)


def test_shares_beyond_their_range():
    z = Unknown(block().mesh, "u")
    for lumping in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match="share of the lumped mass"):
            Midpoint(z, dt=0.1, lumping=lumping)


def test_inertia_and_mapping_with_different_masses():
    body = block()
    z = Unknown(body.mesh, "u")
    with pytest.raises(ValueError, match=r"a share of 0.3 of .* lumping=1, or use scheme.inertia"):
        Midpoint(z, dt=0.1, lumping=0.3).lumped(body)
    Midpoint(z, dt=0.1, lumping=1.0).lumped(body)


def test_linear_continuation_needs_the_lumped_mass():
    body = block()
    z = Unknown(body.mesh, "u")
    time = Midpoint(z, dt=0.1)
    R = ufl.inner(time.force(body), z.test.u) * body.dx
    with pytest.raises(ValueError, match="lumping=1"):
        ImplicitMPM(R, z, time, body, taylor=True)


@pytest.mark.parametrize("mass", [np.nan, 0.0])
def test_singular_mass_leaves_the_state(mass):
    body = block()
    sim = simulation(body, MATERIALS["Hencky"])
    body["mass"] = np.where(body.x[:, 0] < 2, mass, body["mass"])
    before = body.snapshot()
    with pytest.raises(LinearSolverError, match="the mass of the points is singular or not finite"):
        sim.step()
    after = body.snapshot()
    assert sim.number == 0
    for name, value in before.items():
        assert np.array_equal(after[name], value, equal_nan=True), name


def test_few_points_still_map():
    """One point in a cell leaves its mass singular, but not the velocity at the point."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (2, 2)], [2, 2], mesh.CellType.quadrilateral
    )
    x = [[0.31, 0.42], [1.2, 1.7], [1.3, 1.6]]
    body = MaterialPoints(domain, x, 0.1)
    formulations.set_initial_state(body, 1.0, lambda x: np.array([1 + x[1], x[0]]))
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    v = fem.Function(space)
    EffectiveProjection([body], space, 0.0).project({"v": v})
    there = forms.evaluate(v, body)
    assert there == pytest.approx(body["v"], abs=1e-10)


def test_wrong_unknown_says_what_is_needed():
    body = block()
    z = Unknown(body.mesh, "u")
    with pytest.raises(ValueError, match=r"needs the parts u, p of the unknown, which has u$"):
        formulations.mixed(z, body, None)
