# SPDX-License-Identifier: MIT
"""The mid-point rule with the energy-momentum stress: conservation laws and tangent."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from energy_bodies import DENSITY, MATERIALS, E, block, simulation, total_energy

from fenicsmpm import (
    diagnostics,
    forms,
    materials,
)
from fenicsmpm.formulations import EnergyMomentum, Midpoint, Newmark, Response, Unknown
from fenicsmpm.io import checkpoint
from fenicsmpm.solvers import NewtonError

# --- conservation -------------------------------------------------------------------------------


CASES = [
    (2, "linear", "Hencky"),
    (2, "linear", "plastic"),
    (2, "linear", "softening"),
    (2, "linear", "UFL"),
    (2, "simplex", "Hencky"),
    (2, "gimp", "plastic"),
    (2, "quadratic", "Hencky"),
    (3, "linear", "plastic"),
]


@pytest.mark.parametrize(("dim", "functions", "material"), CASES)
def test_energy_and_momenta_are_conserved(dim, functions, material):
    body = block(dim, functions, per_cell=4 if dim == 2 else 3)
    sim = simulation(body, MATERIALS[material])
    energy, momentum = total_energy(body), diagnostics.momentum(body)
    turning = diagnostics.angular_momentum(body)
    size = DENSITY * body.volume() * 2.0  # a momentum
    exchanged = 0.0
    steps = (0.05, 0.05, 0.02, 0.05, 0.05, 0.04, 0.05, 0.05) if dim == 2 else (0.05,) * 4
    if functions == "quadratic":  # where few points see the tail of a spline
        steps = (0.01,) * 12
    for dt in steps:
        sim.step(dt)
        exchanged = max(exchanged, float(body["V_0"] @ body["work"]))
    assert exchanged > 0.05 * energy
    assert total_energy(body) == pytest.approx(energy, rel=1e-11)
    assert diagnostics.momentum(body) == pytest.approx(momentum, abs=1e-12 * size)
    assert diagnostics.angular_momentum(body) == pytest.approx(turning, abs=1e-11 * size)
    if material in ("plastic", "softening"):
        assert body["dissipation"].max() > 0
        assert body["eps_p"].max() > 0.01


@pytest.mark.parametrize("stage", ["solve", "convect"])
def test_a_failed_step_leaves_no_plastic_strain(stage):
    """Steps that are halved end as if they had been short from the start."""
    ends = []
    for fails in (True, False):
        body = block()
        sim = simulation(body, MATERIALS["plastic"], dt=0.1 if fails else 0.05)
        original = getattr(sim, stage)
        if fails:

            def do_and_fail(*arguments, original=original, sim=sim):
                result = original(*arguments)
                assert sim.map_to_points()[sim.bodies[0]]["eps_p"].max() > 0
                if float(sim.scheme.dt.value) > 0.06:
                    raise NewtonError("diverged", "as asked for", [])
                return result

            setattr(sim, stage, do_and_fail)
        assert [step.dt for step in sim.run(0.1)] == pytest.approx([0.05, 0.05])
        ends.append(body.snapshot())
    assert ends[0]["eps_p"].max() > 0.01
    for name, array in ends[0].items():
        assert array == pytest.approx(ends[1][name], rel=1e-12, abs=1e-12), name


def test_plastic_body_goes_on_from_a_checkpoint(tmp_path):
    sim = simulation(block(), MATERIALS["plastic"])
    for _ in range(3):
        sim.step()
    checkpoint.save(tmp_path / "three.h5", sim)
    again = simulation(block(), MATERIALS["plastic"])
    checkpoint.restore(tmp_path / "three.h5", again)
    assert again.bodies[0]["eps_p"].max() > 0.01
    for _ in range(2):
        sim.step()
        again.step()
    for name, array in sim.bodies[0].snapshot().items():
        assert np.array_equal(again.bodies[0][name], array), name


@pytest.mark.parametrize(
    ("scheme", "options", "least"),
    [(Newmark, {}, 0.05), (Midpoint, {"flip": 0.0}, 1e-3), (Midpoint, {"lumping": 1.0}, 0.02)],
)
def test_what_does_not_conserve_energy(scheme, options, least):
    body, law = block(), MATERIALS["Hencky"]
    sim = simulation(body, law, scheme, **options)
    before = diagnostics.kinetic_energy(body)
    for _ in range(8):
        sim.step()
    after = diagnostics.kinetic_energy(body) + body["V_0"] @ materials.energy(law, body["F"])
    assert abs(after / before - 1) > least


# --- stress and tangent -------------------------------------------------------------------------


@pytest.mark.parametrize("material", MATERIALS)
def test_tangent_is_the_derivative(material):
    body = block()
    sim = simulation(body, MATERIALS[material])
    sim.step(0.05)
    sim.map_to_grid()
    R, J, x = sim.newton.R, sim.newton.J, sim.unknown.U.x.array
    x[:] = 0.05 * sim.scheme.histories["v"].x.array  # away from the corner of the yield surface
    if material in ("plastic", "softening"):
        yielding = sim.map_to_points()[body]["eps_p"] > body["eps_p"] + 1e-4
        assert 0.1 < yielding.mean() < 1
    direction = np.random.default_rng(1).standard_normal(len(x))
    direction[forms.inactive_dofs(J)] = 0
    start = x.copy()
    A = forms.assemble_matrix(J).to_scipy()
    h = 1e-6
    ends = []
    for sign in (1, -1):
        x[:] = start + sign * h * direction
        ends.append(forms.assemble_vector(R).array.copy())
    difference = (ends[0] - ends[1]) / (2 * h)
    found = A @ direction
    assert np.abs(found - difference).max() < 1e-6 * np.abs(difference).max()


@pytest.mark.parametrize("material", ["Hencky", "UFL"])
def test_algorithmic_stress_without_change_of_metric(material):
    """It tends to the stress at the start, smoothly: linearly in the increment."""
    body = block()
    body["F"] = body["F"] + 0.1 * np.random.default_rng(2).standard_normal((len(body), 3, 3))
    z = Unknown(body.mesh, "u")
    stress = EnergyMomentum(MATERIALS[material], body, z)
    value = forms.PointExpression(stress.algorithmic_stress, body)
    at_start = value.evaluate()
    assert at_start == pytest.approx(body["S"], abs=1e-12 * E)
    direction = np.random.default_rng(3).standard_normal(len(z.U.x.array))
    slopes = []
    for size in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
        z.U.x.array[:] = size * direction
        slopes.append((value.evaluate() - at_start) / size)
    for slope in slopes:
        assert np.abs(slope - slopes[0]).max() < 2e-3 * np.abs(slopes[0]).max()


@pytest.mark.parametrize("material", ["Hencky", "plastic"])
def test_power_is_the_energy_gained(material):
    """S : Delta C / 2 for changes of any size, those that yield as well."""
    body = block()
    body["F"] = body["F"] + 0.05 * np.random.default_rng(2).standard_normal((len(body), 3, 3))
    z = Unknown(body.mesh, "u")
    stress = EnergyMomentum(MATERIALS[material], body, z)
    change = stress.F.T * stress.F - ufl.dot(body.field("F").T, body.field("F"))
    power = forms.PointExpression(ufl.inner(stress.algorithmic_stress, change) / 2, body)
    work, C = forms.PointExpression(stress.work, body), forms.PointExpression(change, body)
    direction = np.random.default_rng(3).standard_normal(len(z.U.x.array))
    for size in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
        z.U.x.array[:] = 0.3 * size * direction
        gained = work.evaluate() - body["work"]
        norm = np.linalg.norm(C.evaluate(), axis=(1, 2))
        allowed = E * np.minimum(1e-18, 1e-24 / norm) + 4e-16 * np.abs(body["work"]).max() + 1e-17
        # the change of C itself is known to round-off only
        allowed = allowed + 1e-15 * np.abs(body["S"]).max()
        assert np.all(np.abs(power.evaluate() - gained) < allowed)


def test_same_stress_in_ufl_and_at_points():
    """The law at points, linearized in a form, has the stress and energy of the law itself."""
    body = block()
    rng = np.random.default_rng(4)
    body["F"] = body["F"] + 0.1 * rng.standard_normal((len(body), 3, 3))
    law = MATERIALS["plastic"]
    response = Response(law, body, body.field("F"))
    state = law.initial_state(len(body))
    sigma = materials.stress(law, body["F"], state=state)
    J = np.linalg.det(body["F"])
    P = J[:, None, None] * sigma @ np.linalg.inv(body["F"]).transpose(0, 2, 1)
    assert forms.evaluate(response.P, body) == pytest.approx(P, abs=1e-12 * E)
    psi = materials.energy(law, body["F"], state)
    dissipation = law.state_field(state, "dissipation")
    assert dissipation.max() > 0
    assert forms.evaluate(response.work, body) == pytest.approx(psi + dissipation, abs=1e-12 * E)
    assert response.updates["eps_p"]() == pytest.approx(law.state_field(state, "eps_p"))


# --- parallel -----------------------------------------------------------------------------------


@pytest.mark.ranks
@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["linear", "gimp"])
def test_same_on_several_ranks(functions):
    results = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        body = block(functions=functions, comm=comm)
        sim = simulation(body, MATERIALS["plastic"])
        before = total_energy(body)
        for _ in range(5):
            sim.step()
        assert total_energy(body) == pytest.approx(before, rel=1e-11)
        results.append([diagnostics.kinetic_energy(body), *diagnostics.momentum(body)])
    assert results[1] == pytest.approx(results[0], rel=1e-9)
