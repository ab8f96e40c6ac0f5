# SPDX-License-Identifier: MIT
"""What the energy-momentum stress and its mapping cannot use."""

import re

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
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.formulations import EnergyMomentum, Midpoint, Response
from fenicsmpm.materials import Law, NewtonianFluid, VonMises, compiled
from fenicsmpm.solvers import EffectiveProjection, LinearSolverError


@compiled
def _nothing(F, L, parameters, state, sigma):
    sigma[:] = 0.0


def test_laws_that_forms_cannot_use():
    body = block()
    F = body.field("F")
    with pytest.raises(ValueError, match="has no energy and no tangent"):
        Response(Law(_nothing, np.zeros(1), 1.0, needs_rate=False), body, F)
    with pytest.raises(ValueError, match="no velocities"):
        Response(NewtonianFluid(1e3, 1.0), body, F)


def test_what_energy_momentum_needs():
    body = block()
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    plastic = MATERIALS["plastic"]
    state = {"eps_p": ((), 0.0)}
    law = Law(
        _nothing, np.zeros(1), 1.0, state=state, needs_rate=False,
        energy=plastic.energy, tangent=plastic.tangent,
    )  # fmt: skip
    with pytest.raises(ValueError, match="needs a field 'dissipation'"):
        EnergyMomentum(law, body, U)
    EnergyMomentum(plastic, body, U)
    with pytest.raises(ValueError, match="another EnergyMomentum"):
        EnergyMomentum(plastic, body, U)


@pytest.mark.parametrize("material", ["Hencky", "plastic", "UFL"])
def test_fields_that_nothing_renews(material):
    body = block()
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    V = ufl.TestFunction(U.function_space)
    time = Midpoint(U, dt=0.1)
    R = EnergyMomentum(MATERIALS[material], body, U).power(V)
    R -= ufl.inner(time.force(body), V) * body.dx
    with pytest.raises(ValueError, match=r"pass updates=\{body: stress.updates\}"):
        ImplicitMPM(R, U, time, body)


def test_tied_nodes_of_several_bodies():
    body = block()
    other = body.copy()
    space = fem.functionspace(body.mesh, ("Lagrange", 1, (2,)))
    U, V = fem.Function(space), ufl.TestFunction(space)
    time = Midpoint(U, dt=0.1)
    R = sum(ufl.inner(time.force(b), V) * b.dx for b in (body, other))
    newton = {"tying": Tying(space, body, ActiveCells(body))}
    with pytest.raises(ValueError, match="the cells that one body fills"):
        ImplicitMPM(R, U, time, [body, other], newton=newton)


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
    space = fem.functionspace(block().mesh, ("Lagrange", 1, (2,)))
    U = fem.Function(space)
    for lumping in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match="share of the lumped mass"):
            Midpoint(U, dt=0.1, lumping=lumping)


def test_inertia_and_mapping_with_different_masses():
    body = block()
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    V = ufl.TestFunction(U.function_space)
    with pytest.raises(ValueError, match=r"a share of 0.3 of .* lumping=1, or take scheme.inertia"):
        Midpoint(U, dt=0.1, lumping=0.3).lumped(V, body)
    Midpoint(U, dt=0.1, lumping=1.0).lumped(V, body)


def test_linear_continuation_needs_the_lumped_mass():
    body = block()
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    V = ufl.TestFunction(U.function_space)
    time = Midpoint(U, dt=0.1)
    with pytest.raises(ValueError, match="lumping = 1"):
        ImplicitMPM(ufl.inner(time.force(body), V) * body.dx, U, time, body, taylor=True)


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
    formulations.set_initial_state(body, 1.0, lambda x: np.column_stack([1 + x[:, 1], x[:, 0]]))
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    v = fem.Function(space)
    EffectiveProjection([body], space, 0.0).project({"v": v})
    there = forms.evaluate(v, body)
    assert there == pytest.approx(body["v"], abs=1e-10)


def test_wrong_space_says_what_is_needed():
    body = block()
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    with pytest.raises(ValueError, match=re.escape("mixed space of displacement and pressure")):
        formulations.mixed(U, ufl.TestFunction(U.function_space), body, None)
