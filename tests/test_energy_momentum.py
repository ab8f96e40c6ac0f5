# SPDX-License-Identifier: MIT
"""The mid-point rule with the energy-momentum stress: conservation laws, tangent, audit."""

import re

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import (
    ImplicitMPM,
    MaterialPoints,
    basis,
    diagnostics,
    forms,
    formulations,
    materials,
    points,
)
from fenicsmpm.audit import AuditedMPM
from fenicsmpm.formulations import EnergyMomentum, Midpoint, Newmark, Response, stress_power
from fenicsmpm.io import checkpoint
from fenicsmpm.mapping import ActiveCells, Tying
from fenicsmpm.materials import Hencky, Law, NewtonianFluid, VonMises, compiled
from fenicsmpm.solvers import CourantStep, EffectiveProjection, LinearSolverError, NewtonError

E, NU, DENSITY = 100.0, 0.3, 2.0


def neo_hooke(F):
    """An energy in UFL, compressible."""
    mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lame / 2 * ufl.ln(J) ** 2


MATERIALS = {
    "Hencky": Hencky(E, NU),
    "plastic": VonMises(E, NU, sigma_y=4.0, H=5.0),
    "softening": VonMises(E, NU, sigma_y=4.0, sigma_r=3.0, eta=2.0),
    "UFL": neo_hooke,
}


def block(dim=2, functions="linear", comm=MPI.COMM_SELF, per_cell=4):
    """A block of 2 x 1 (x 1) m that flies, turns and is stretched."""
    lower, upper = [0.0] * dim, [6.0, 4.0, 4.0][:dim]
    cells = [6, 4, 4][:dim]
    kinds = {2: mesh.CellType.quadrilateral, 3: mesh.CellType.hexahedron}
    simplices = {2: mesh.CellType.triangle, 3: mesh.CellType.tetrahedron}
    kind = (simplices if functions == "simplex" else kinds)[dim]
    create = mesh.create_rectangle if dim == 2 else mesh.create_box
    options = {"partitioner": basis.shared_vertex_partitioner}
    domain = create(comm, [lower, upper], cells, kind, **options)
    middle = np.array([2.2, 1.9, 2.1][:dim])
    half = np.array([1.0, 0.5, 0.5][:dim])
    spacing = 1 / per_cell
    body = points.lattice(domain, spacing, inside=lambda x: np.all(np.abs(x - middle) < half, 1))
    if functions == "gimp":
        basis.use(body, "gimp", spacing / 2)
    elif functions == "quadratic":
        basis.use(body, "quadratic")
    gradient = np.zeros((dim, dim))
    gradient[0, 1], gradient[1, 0], gradient[0, 0] = -1.5, 2.0, 1.0
    formulations.set_initial_state(
        body, DENSITY, lambda x: (x - middle) @ gradient.T + np.array([1.5, 0.3, 0.0][:dim])
    )
    return body


def simulation(body, material, scheme=Midpoint, kind=ImplicitMPM, dt=0.05, **options):
    space = fem.functionspace(body.mesh, ("Lagrange", 1, (body.x.shape[1],)))
    U, V = fem.Function(space), ufl.TestFunction(space)
    time = scheme(U, dt=dt, **options)
    if scheme is Midpoint:
        stress = EnergyMomentum(material, body, U)
        power = stress.power(V)
    else:
        stress = Response(material, body, formulations.Kinematics(U, body).F)
        power = stress_power(stress.P, V, body)
    R = power - ufl.inner(time.force(body), V) * body.dx
    if scheme is Midpoint and time.lumping > 0:
        R += time.lumped(V, body)
    newton = {"rtol": 1e-12, "atol": 1e-14, "line_search": True}
    return kind(R, U, time, body, updates={body: stress.updates}, newton=newton)


def total_energy(body):
    work = body.mesh.comm.allreduce(float(body["V_0"] @ body["work"]))
    return diagnostics.kinetic_energy(body) + work


# --- conservation ------------------------------------------------------------------------------

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
    size = DENSITY * body.volume * 2.0  # a momentum
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


def test_a_failed_step_leaves_no_plastic_strain():
    """Steps that are halved end as if they had been short from the start."""
    ends = []
    for fails in (True, False):
        body = block()
        sim = simulation(body, MATERIALS["plastic"], dt=0.1 if fails else 0.05)
        solve = sim.solve
        if fails:

            def solve_and_fail(solve=solve, sim=sim):
                result = solve()
                assert sim.map_to_points()[sim.bodies[0]]["eps_p"].max() > 0
                if float(sim.scheme.dt.value) > 0.06:
                    raise NewtonError("diverged", "as asked for", [])
                return result

            sim.solve = solve_and_fail
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


# --- stress and tangent ------------------------------------------------------------------------


@pytest.mark.parametrize("material", MATERIALS)
def test_tangent_is_the_derivative(material):
    body = block()
    sim = simulation(body, MATERIALS[material])
    sim.step(0.05)
    sim.map_to_grid()
    R, J, U = sim.newton.R, sim.newton.J, sim.U
    x = U.x.array
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
    space = fem.functionspace(body.mesh, ("Lagrange", 1, (2,)))
    body["F"] = body["F"] + 0.1 * np.random.default_rng(2).standard_normal((len(body), 3, 3))
    U = fem.Function(space)
    stress = EnergyMomentum(MATERIALS[material], body, U)
    value = forms.PointExpression(stress.algorithmic_stress, body)
    at_start = value.evaluate()
    assert at_start == pytest.approx(body["S"], abs=1e-12 * E)
    direction = np.random.default_rng(3).standard_normal(len(U.x.array))
    slopes = []
    for size in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
        U.x.array[:] = size * direction
        slopes.append((value.evaluate() - at_start) / size)
    for slope in slopes:
        assert np.abs(slope - slopes[0]).max() < 2e-3 * np.abs(slopes[0]).max()


@pytest.mark.parametrize("material", ["Hencky", "plastic"])
def test_power_is_the_energy_gained(material):
    """S : Delta C / 2 for changes of any size, those that yield as well."""
    body = block()
    body["F"] = body["F"] + 0.05 * np.random.default_rng(2).standard_normal((len(body), 3, 3))
    U = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (2,))))
    stress = EnergyMomentum(MATERIALS[material], body, U)
    change = stress.F.T * stress.F - ufl.dot(body.field("F").T, body.field("F"))
    power = forms.PointExpression(ufl.inner(stress.algorithmic_stress, change) / 2, body)
    work, C = forms.PointExpression(stress.work, body), forms.PointExpression(change, body)
    direction = np.random.default_rng(3).standard_normal(len(U.x.array))
    for size in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
        U.x.array[:] = 0.3 * size * direction
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


# --- audit -------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", [1.0, 0.0])
@pytest.mark.parametrize("lumping", [0.0, 0.4, 1.0])
def test_audit_agrees_with_the_tables(flip, lumping):
    """Conservation paper, tables 1 and 2, with mass matrices made here."""
    body = block()
    sim = simulation(body, MATERIALS["Hencky"], kind=AuditedMPM, flip=flip, lumping=lumping)
    sim.step()
    nodes = sim.U.function_space.tabulate_dof_coordinates()[:, :2]
    N = shape_functions(body, nodes)
    consistent = N.T @ (body["mass"][:, None] * N)
    difference = np.diag(consistent.sum(axis=1)) - consistent  # lumped - consistent
    T = diagnostics.kinetic_energy(body)
    sim.step()
    audit = sim.audit
    v0 = sim.scheme.histories["v"].x.array.reshape(-1, 2)
    u = sim.U.x.array.reshape(-1, 2)
    v1 = 2 * u / float(sim.scheme.dt.value) - v0
    seen = consistent.any(axis=1)
    v0, v1 = np.where(seen[:, None], v0, 0), np.where(seen[:, None], v1, 0)
    x1 = nodes + u
    K = audit.points_before.kinetic_energy
    assert K == pytest.approx(T)
    size = 2 * DENSITY * 2.0
    changes = audit.changes

    def turn(x, p):
        return np.sum(x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0])

    # table 1
    assert changes["map to the grid"].momentum == pytest.approx(0, abs=1e-12 * size)
    effective = consistent + lumping * difference
    lost = np.sum(v0 * (effective @ v0)) / 2 - K
    assert changes["map to the grid"].kinetic_energy == pytest.approx(lost, abs=1e-12 * K)
    assert lost < 1e-12 * K
    assert changes["map to the grid"].angular_momentum == pytest.approx(0, abs=1e-12 * size)
    # table 2: what points gain in the step less what the grid gains in it
    gain = audit.points_after - audit.points_before - (audit.grid_after - audit.grid_before)
    assert gain.momentum == pytest.approx(0, abs=1e-12 * size)
    dv = v1 - v0
    moved = dv if flip else v1
    expected = -lumping * turn(x1, difference @ moved)
    assert gain.angular_momentum == pytest.approx(expected, abs=1e-12 * size)
    if flip:
        expected = -lumping / 2 * np.sum(dv * (difference @ dv))
    else:
        expected = np.sum(v0 * (consistent @ v0)) / 2 - K
        expected -= lumping / 2 * np.sum(dv * (difference @ (v1 + v0)))
    assert gain.kinetic_energy == pytest.approx(expected, abs=1e-12 * K)
    assert "map to the points" in str(audit)


@pytest.mark.mpi
def test_audit_in_space_and_on_several_ranks():
    audits = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        body = block(3, comm=comm, per_cell=3)
        before = diagnostics.angular_momentum(body)
        sim = simulation(body, MATERIALS["Hencky"], kind=AuditedMPM)
        sim.step()
        audits.append(sim.audit)
        whole = sim.audit.changes["whole step"]
        turned = diagnostics.angular_momentum(body) - before
        assert whole.angular_momentum == pytest.approx(turned, abs=1e-12)
        assert whole.angular_momentum == pytest.approx(np.zeros(3), abs=1e-11)
    for stage, change in audits[0].changes.items():
        other = audits[1].changes[stage]
        for name in ("momentum", "angular_momentum", "kinetic_energy"):
            assert getattr(other, name) == pytest.approx(getattr(change, name), abs=1e-9), stage


def shape_functions(body, nodes):
    """Bilinear functions of unit cells at the points, ``(n_points, n_nodes)``."""
    distance = np.abs(body.x[:, None] - nodes[None])
    return np.prod(np.maximum(1 - distance, 0), axis=2)


# --- time steps --------------------------------------------------------------------------------


def test_courant_step_of_full_cells():
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2, 1)], [8, 2], mesh.CellType.quadrilateral
    )
    body = points.lattice(domain, 0.05)
    formulations.set_initial_state(body, DENSITY)
    law = MATERIALS["Hencky"]
    wave = np.sqrt(law.wave_speed_modulus / DENSITY)
    step = CourantStep({body: law}, factor=5.0)
    assert step() == pytest.approx(5.0 * 0.25 / wave)
    body["weight"] = 2 * body.weight  # half the density
    assert step() == pytest.approx(5.0 * 0.25 / wave / np.sqrt(2))
    assert step.history == pytest.approx([5.0 * 0.25 / wave, 5.0 * 0.25 / wave / np.sqrt(2)])
    assert CourantStep({body: law}, 5.0, smallest=1.0)() == 1.0
    assert CourantStep({body: law.wave_speed_modulus}, 5.0, largest=1e-3)() == 1e-3
    for modulus in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="P-wave modulus must be positive"):
            CourantStep({body: modulus}, 5.0)
    with pytest.raises(ValueError, match="needs a body"):
        CourantStep({}, 5.0)
    body["mass"] = 0.0
    with pytest.raises(ValueError, match="without mass"):
        step()
    for bad in ({"factor": 0.0}, {"factor": 1.0, "smallest": 2.0, "largest": 1.0}):
        with pytest.raises(ValueError, match="factor of Courant's step must be positive"):
            CourantStep({body: law}, **bad)


def test_courant_step_of_two_bodies_in_a_cell():
    """Moduli count by volume: three points of one in a cell, and one of the other."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1, mesh.CellType.quadrilateral)
    moduli = {}
    for x, modulus in (([(0.2, 0.2), (0.2, 0.8), (0.8, 0.2)], 8.0), ([(0.8, 0.8)], 40.0)):
        body = MaterialPoints(domain, x, 0.25)
        formulations.set_initial_state(body, DENSITY)
        moduli[body] = modulus
    # the node next to the single point has N = 0.64 of it, 0.16 of two others, 0.04 of the third
    stiffest = 0.64 * 40 + 0.36 * 8
    assert CourantStep(moduli, 1.0)() == pytest.approx(np.sqrt(DENSITY / stiffest))


def test_run_with_steps_of_variable_length():
    body = block()
    sim = simulation(body, MATERIALS["Hencky"], dt=1.0)
    lengths = iter([0.01, 0.03, 0.02, 0.05])
    steps = [step.dt for step in sim.run(0.1, step_length=lambda: next(lengths))]
    assert steps == pytest.approx([0.01, 0.03, 0.02, 0.04])


# --- parallel ----------------------------------------------------------------------------------


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


# --- bad input ---------------------------------------------------------------------------------


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
