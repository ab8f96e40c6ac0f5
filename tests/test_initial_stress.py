# SPDX-License-Identifier: MIT
"""Stress to begin with: F of a stress, bodies at rest under their weight, what cannot be."""

import math

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.cells import ActiveCells, Tying
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import (
    DruckerPrager,
    Hencky,
    Law,
    ModifiedCamClay,
    MohrCoulomb,
    NeoHookean,
    NewtonianFluid,
    VonMises,
    compiled,
    from_energy,
    stress,
    stretch_of,
)

COMM = MPI.COMM_WORLD
G = 9.81


def stresses(n=50, size=1.0, seed=1):
    """Symmetric tensors."""
    A = np.random.default_rng(seed).normal(size=(n, 3, 3)) * size
    return (A + A.transpose(0, 2, 1)) / 2


def is_symmetric_positive(F):
    return np.array_equal(F, F.transpose(0, 2, 1)) and np.linalg.eigvalsh(F).min() > 0


# --- the deformation of a stress ---------------------------------------------------------------


@pytest.mark.parametrize("size", [1e-4, 1.0, 100.0])
def test_hencky(size):
    """Against the closed solution: ln U = dev(tau) / 2 mu + ln J / 3."""
    law, sigma = Hencky(E=1000.0, nu=0.3), stresses(size=size)
    F, reached = stretch_of(law, sigma)
    assert reached.all()
    assert stress(law, F) == pytest.approx(sigma, rel=0, abs=1e-12 * 1000)
    values, axes = np.linalg.eigh(F)
    eps = np.einsum("nij,nj,nkj->nik", axes, np.log(values), axes)
    J = np.linalg.det(F)
    tau = J[:, None, None] * sigma
    mean = np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    exact = (tau - mean) / (2 * law.mu) + mean / (3 * law.kappa)
    assert eps == pytest.approx(exact, rel=0, abs=1e-12)


def _with_fibres(F, mu, fibre):
    """Anisotropic: fibres along (1, 1, 0)."""
    a, C = ufl.as_vector((1, 1, 0)), F.T * F
    return (
        mu / 2 * (ufl.tr(C) - 3 - 2 * ufl.ln(ufl.det(F))) + fibre / 4 * (ufl.dot(C * a, a) - 2) ** 2
    )


LAWS = [
    NeoHookean(1000.0, 0.3).pointwise(),
    VonMises(1000.0, 0.4, sigma_y=500.0, H=10.0),
    from_energy(
        lambda F, mu, lame: mu / 2 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(ufl.det(F)))
        + lame / 2 * ufl.ln(ufl.det(F)) ** 2,
        (1.0e3, 2.0e3),
    ),
    from_energy(_with_fibres, (1.0e3, 5.0e2)),
]  # fmt: skip


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_other_laws(law):
    sigma = stresses(size=100.0)
    F, reached = stretch_of(law, sigma)
    assert reached.all() and is_symmetric_positive(F)
    assert stress(law, F) == pytest.approx(sigma, rel=0, abs=1e-12 * law.wave_speed_modulus)


@pytest.mark.parametrize("nu", [0.3, 0.499, 0.5])
@pytest.mark.parametrize("volumetric", ["quadratic", "miehe", "simo-taylor"])
def test_neo_hookean_in_closed_form(nu, volumetric):
    law, sigma = NeoHookean(1000.0, nu, volumetric), stresses(size=200.0)
    F, reached = law.stretch_of(sigma)
    assert reached.all() and is_symmetric_positive((F + F.transpose(0, 2, 1)) / 2)
    J, p = np.linalg.det(F), np.trace(sigma, axis1=1, axis2=2) / 3
    b = np.einsum("nij,nkj->nik", F, F)
    dev = b - np.trace(b, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    found = law.mu * J[:, None, None] ** (-5 / 3) * dev + p[:, None, None] * np.eye(3)
    assert found == pytest.approx(sigma, rel=0, abs=1e-12 * 1000)
    g = {"quadratic": J - 1, "miehe": 1 - 1 / J, "simo-taylor": (J - 1 / J) / 2}[volumetric]
    assert g == pytest.approx(law.inverse_kappa * p, rel=0, abs=1e-14)


def test_a_fluid_has_a_pressure_only():
    law = NewtonianFluid(kappa=1e5, mu=1.0)
    sigma = np.array([-2e4 * np.eye(3), np.diag([-2e4, -2e4, -1e4])])
    F, reached = stretch_of(law, sigma)
    assert list(reached) == [True, False]
    assert F[0] == pytest.approx(0.8 ** (1 / 3) * np.eye(3), rel=1e-14)


def test_outside_of_the_yield_surface():
    """Perfect plasticity does not get there, hardening would flow on the way."""
    shear = np.zeros((3, 3, 3))
    shear[:, 0, 1] = shear[:, 1, 0] = np.array([0.99, 1.0, 1.01]) * 10 / math.sqrt(3)
    for H in (0.0, 50.0):
        law = VonMises(1000.0, 0.3, sigma_y=10.0, H=H)
        F, _ = stretch_of(law, shear - 500 * np.eye(3))
        # the surface is one of J sigma, here J < 1
        J = np.linalg.det(F[0])
        assert list(stretch_of(law, shear / J - 500 * np.eye(3))[1]) == [True, True, False]


@pytest.mark.parametrize("kind", [MohrCoulomb, DruckerPrager])
@pytest.mark.parametrize("dilatancy", [0.0, 30.0])
def test_sand_under_little_pressure(kind, dilatancy):
    """Without cohesion, undeformed sand is at the tip of its yield surface; K0 from 1/3 to 3."""
    law, K0 = kind(1e8, 0.3, 0.0, friction=30.0, dilatancy=dilatancy), np.linspace(0.4, 2.5, 8)
    for pressure in (1.0, 1e2, 1e5):
        sigma = -pressure * np.array([np.diag([K, 1.0, K]) for K in K0])
        F, reached = stretch_of(law, sigma)
        assert reached.all()
        assert stress(law, F) == pytest.approx(sigma, rel=0, abs=1e-12 * law.wave_speed_modulus)


@compiled
def _flows_at_once(F, L, parameters, state, sigma):
    sigma[:, :] = 0.0


def test_a_law_without_resistance():
    law = Law(_flows_at_once, np.empty(0), 1.0)
    assert list(stretch_of(law, np.array([np.zeros((3, 3)), np.eye(3)]))[1]) == [True, False]


# --- a column of 10 m, K0 = 0.5, that nu would give 0.25 -----------------------------------------

DEPTH, DENSITY, K0 = 10.0, 2000.0, 0.5
SOIL = Hencky(E=50e6, nu=0.2)
AT_REST = fm.k0_state(DEPTH, DENSITY, K0)
SPEED = math.sqrt(G * DEPTH)


def column(functions="linear", h=0.5, top=DEPTH, cells=4):
    """Points that integrate products of grid functions and of what is linear exactly."""
    domain = mesh.create_rectangle(
        COMM, [(0, 0), (cells * h, 12)], [cells, round(12 / h)], mesh.CellType.quadrilateral
    )
    if functions == "cubic":
        body = points.quadrature(domain, 3, inside=lambda x: x[1] < top)
    else:
        per_side = 3 if functions == "quadratic" else 2
        body = points.fill(domain, per_side, inside=lambda x: x[1] < top)
    if functions != "linear":
        basis.use(body, functions, *([h / 4] if functions == "gimp" else []))
    fm.set_initial_state(body, DENSITY)
    return body


def supported(domain, name):
    """An unknown between smooth walls, on a smooth floor."""
    z = fm.Unknown(domain, *(["u", "p"] if name == "p" else [name]))
    part = "u" if name == "p" else name
    width = domain.comm.allreduce(domain.geometry.x[:, 0].max(), op=MPI.MAX)
    z.fix(part, lambda x: np.isclose(x[1], 0), component=1)
    z.fix(part, lambda x: np.isclose(x[0] * (width - x[0]), 0), component=0)
    return z


def explicit(body, law, fused=True, narrow=False, **options):
    z = supported(body.mesh, "v")
    R = fm.internal_force(z.test.v, body, law)
    if not (fused or narrow):
        R = fem.Constant(body.mesh, 1.0) * R
    R += fm.body_force(z.test.v, body, (0, -G))
    sim = ExplicitMPM(R, z, body, **options)
    assert ("by fused kernels" in str(sim)) == fused
    return sim


def expected(body, state=AT_REST):
    x = np.zeros((3, len(body)))
    x[: body.x.shape[1]] = body.x.T
    return state(x).transpose(2, 0, 1)


def assert_rest(body, sigma, speed, width=2.0):
    """At rest, and each stress of each point within half a percent; by far, in fact."""
    assert np.abs(body["v"]).max(initial=0) < speed * SPEED
    assert sigma == pytest.approx(expected(body), rel=1e-8, abs=1e-8 * DENSITY * G * DEPTH)
    assert np.all(body["F"][:, 2, 2] != 1)
    assert body.volume() == pytest.approx(width * DEPTH, rel=1e-10)


@pytest.mark.once
@pytest.mark.mpi
@pytest.mark.parametrize("functions", ["linear", "gimp", "quadratic", "cubic"])
def test_explicit_column_at_rest(functions):
    """1 s; asked for are 1e-4 sqrt(g h) and half a percent."""
    body = column(functions)
    fm.initial_stress(body, SOIL, AT_REST)
    F33 = body["F"][:, 2, 2].copy()
    for _ in explicit(body, SOIL).run(1.0, 0.25):
        pass
    assert_rest(body, body["sigma"], 1e-10)
    if COMM.size == 1:
        assert F33.max() - F33.min() > 5e-4
        assert np.sort(body["F"][:, 2, 2]) == pytest.approx(np.sort(F33), abs=1e-15)


@pytest.mark.parametrize(
    "functions,cells", [("quadratic", 1), ("gimp", 1), ("cubic", 1), ("cubic", 2)]
)
def test_explicit_column_that_is_narrow(functions, cells):
    """Of fewer nodes than a point sees elsewhere, which fused kernels do not do."""
    body = column(functions, cells=cells)
    fm.initial_stress(body, SOIL, AT_REST)
    sim = explicit(body, SOIL, fused=False, narrow=True)
    for _ in sim.run(0.05):
        pass
    assert np.abs(body["v"]).max() < 1e-10 * SPEED
    assert body["sigma"] == pytest.approx(expected(body), rel=1e-8, abs=1e-3)


def test_explicit_column_by_forms():
    body = column()
    fm.initial_stress(body, SOIL, AT_REST)
    for _ in explicit(body, SOIL, fused=False).run(0.25):
        pass
    assert_rest(body, body["sigma"], 1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("fused", [True, False])
def test_explicit_column_of_clay(fused):
    """Cam-Clay has a pressure without strain, and is elastic here."""
    clay = ModifiedCamClay(
        10e6, M=1.2, compression=0.1, swelling=0.01, pressure=100e3, preconsolidation=300e3
    )
    body = column("quadratic")
    fm.initial_stress(body, clay, AT_REST)
    for _ in explicit(body, clay, fused).run(0.5 if fused else 0.05, 0.25):
        pass
    assert np.all(body["eps_v_p"] == 0)
    assert_rest(body, body["sigma"], 1e-10)


AVERAGED = {
    "incompressible": Hencky(E=50e6, nu=0.495),
    "plastic": MohrCoulomb(E=50e6, nu=0.3, cohesion=5e3, friction=30.0),
    "both": DruckerPrager(E=50e6, nu=0.49, cohesion=5e3, friction=30.0, dilatancy=10.0),
}


@pytest.mark.mpi
@pytest.mark.parametrize(
    "functions,law,fused",
    [
        ("linear", "both", True),
        ("gimp", "plastic", True),
        ("quadratic", "both", True),
        ("quadratic", "incompressible", True),
        ("cubic", "both", True),
        ("quadratic", "both", False),
    ],
)
def test_averages_of_J_leave_a_column_at_rest(functions, law, fused):
    """Those that laws have by default: the stress to begin with is not averaged."""
    body, soil = column(functions), AVERAGED[law]
    assert fm.default_fbar(soil) is not None
    fm.initial_stress(body, soil, AT_REST)
    for _ in explicit(body, soil, fused).run(1.0 if fused else 0.1, 0.25):
        pass
    assert_rest(body, body["sigma"], 1e-10)
    assert body["J_bar"] == pytest.approx(body["J"], rel=1e-12)


def test_averages_of_a_column_that_is_pushed():
    """What is added to an initial stress is averaged, the same by forms and by fused kernels."""
    found = []
    for fused in (True, False):
        body, soil = column("quadratic"), AVERAGED["both"]
        fm.initial_stress(body, soil, AT_REST)
        body["v"][:, 1] = -2.0 * np.sin(np.arange(len(body)))
        sim = explicit(body, soil, fused, dt=2e-4)
        for _ in range(20):
            sim.step()
        order = np.argsort(body.id)
        found.append({name: body[name][order] for name in ("J", "J_bar", "sigma")})
    for name, values in found[0].items():
        assert found[1][name] == pytest.approx(values, rel=1e-9, abs=1e-9 * np.abs(values).max())
    smoothed, own = (np.ptp(found[0][name] / body["J_0"][order]) for name in ("J_bar", "J"))
    assert smoothed < 0.6 * own


@pytest.mark.mpi
@pytest.mark.parametrize("scheme", ["Newmark", "GeneralizedAlpha", "BDF2", "QuasiStatic"])
def test_implicit_column_at_rest(scheme):
    """1 s; asked for are 1e-6 sqrt(g h) and half a percent: there is nothing to be solved."""
    rest_by_implicit_steps(column(), scheme)


@pytest.mark.parametrize("cells", [1, 2])
def test_implicit_column_that_is_narrow(cells):
    """Of fewer nodes than a cubic spline has elsewhere."""
    rest_by_implicit_steps(column("cubic", cells=cells), "Newmark")


def rest_by_implicit_steps(body, scheme):
    z = supported(body.mesh, "u")
    time = getattr(fm, scheme)(z, dt=0.1)
    fm.initial_stress(body, SOIL, AT_REST)
    P = fm.Response(SOIL, body, fm.Kinematics(z.u, body).F).P
    R = fm.stress_power(P, z.test.u, body)
    R -= ufl.inner(time.force(body, ufl.as_vector((0, -G))), z.test.u) * body.dx
    for step in ImplicitMPM(R, z, time, body).run(1.0):
        assert step.newton.iterations == 0
    width = COMM.allreduce(body.mesh.geometry.x[:, 0].max(), op=MPI.MAX)
    assert_rest(body, stress(SOIL, body["F"]), 1e-12, width)


def test_column_that_conserves_energy():
    body = column()
    z = supported(body.mesh, "u")
    time = fm.Midpoint(z, dt=0.1)
    fm.initial_stress(body, SOIL, AT_REST)
    power = fm.EnergyMomentum(SOIL, body, z).power()
    R = power - ufl.inner(time.force(body, ufl.as_vector((0, -G))), z.test.u) * body.dx
    for _ in ImplicitMPM(R, z, time, body).run(1.0):
        pass
    assert_rest(body, stress(SOIL, body["F"]), 1e-12)
    with pytest.raises(
        ValueError, match="already has the stress of an EnergyMomentum: call initial_stress before"
    ):
        fm.initial_stress(body, SOIL, AT_REST)


@pytest.mark.mpi
@pytest.mark.parametrize("nu", [0.2, 0.5])
def test_mixed_column_at_rest(nu):
    """Displacement and pressure, by a law in UFL."""
    body, law = column(), NeoHookean(E=50e6, nu=nu)
    z = supported(body.mesh, "p")
    time = fm.Bossak(z, dt=0.1)
    fm.initial_stress(body, law, AT_REST)
    assert np.trace(expected(body), axis1=1, axis2=2) / 3 == pytest.approx(body["p"])
    R = fm.stabilized("osgs", z, body, law, force=time.force(body, ufl.as_vector((0, -G))))
    for _ in ImplicitMPM(R, z, time, body).run(1.0):
        pass
    F = body.field("F")
    sigma = law.deviatoric_stress(F) + body.field("p") * ufl.Identity(3)
    assert np.abs(body["v"]).max(initial=0) < 1e-12 * SPEED
    found = evaluate(sigma, body)
    assert found == pytest.approx(expected(body), rel=1e-8, abs=1e-8 * DENSITY * G * DEPTH)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["cip", "hessian", "split_osgs"])
def test_mixed_column_of_splines_at_rest(name):
    """Penalties on jumps and second derivatives, and projections, leave pressures like z as is."""
    body, law = column("quadratic"), NeoHookean(E=50e6, nu=0.5)
    z = supported(body.mesh, "p")
    time, cells = fm.Bossak(z, dt=0.1), ActiveCells(body)
    fm.initial_stress(body, law, AT_REST)
    options = {"cells": cells} if name == "cip" else {}
    force = time.force(body, ufl.as_vector((0, -G)))
    R = fm.stabilized(name, z, body, law, force=force, **options)
    sim = ImplicitMPM(R, z, time, body, newton={"tying": Tying(z.space, body, cells)})
    for _ in sim.run(1.0):
        pass
    sigma = law.deviatoric_stress(body.field("F")) + body.field("p") * ufl.Identity(3)
    assert np.abs(body["v"]).max(initial=0) < 1e-10 * SPEED
    found = evaluate(sigma, body)
    assert found == pytest.approx(expected(body), rel=1e-8, abs=1e-8 * DENSITY * G * DEPTH)


def test_an_energy_in_ufl():
    def psi(F):
        J = ufl.det(F)
        return 1e7 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(J)) + 1e7 * ufl.ln(J) ** 2

    body = column()
    fm.initial_stress(body, psi, AT_REST)
    assert stress(from_energy(psi), body["F"]) == pytest.approx(expected(body), rel=1e-9, abs=1e-3)
    z = supported(body.mesh, "v")
    R = fm.internal_force(z.test.v, body, psi) + fm.body_force(z.test.v, body, (0, -G))
    for _ in ExplicitMPM(R, z, body, dt=1e-3).run(0.1):
        pass
    assert np.abs(body["v"]).max() < 1e-12 * SPEED


@pytest.mark.mpi
def test_layers_and_a_water_table():
    """Total stresses; a density for each layer; a kink of stress at the edges of cells."""
    state = fm.k0_state([10.0, 6.0], [1800.0, 2100.0], [0.4, 0.7], water_table=8.0)
    body = points.fill(column().mesh, 2, inside=lambda x: x[1] < 10)
    fm.set_initial_state(body, lambda x: np.where(x[1] > 6, 1800.0, 2100.0))
    assert COMM.allreduce(body["mass"].sum()) == pytest.approx(2 * (4 * 1800 + 6 * 2100))
    at = state(np.array([[0.0, 0.0], [7.0, 2.0], [0.0, 0.0]]))
    assert at[1, 1] == pytest.approx([-G * 3 * 1800, -G * (4 * 1800 + 4 * 2100)])
    u = G * 1000 * np.array([1.0, 6.0])
    assert at[0, 0] == pytest.approx([0.4, 0.7] * (at[1, 1] + u) - u)
    assert np.array_equal(at[0, 0], at[2, 2]) and np.all(at[0, 1:] == at[1:, 0])
    fm.initial_stress(body, SOIL, state)
    for _ in explicit(body, SOIL).run(0.2, 0.1):
        pass
    assert np.abs(body["v"]).max(initial=0) < 1e-10 * SPEED
    assert body["sigma"] == pytest.approx(expected(body, state), rel=1e-8, abs=1e-3)


def test_a_box_in_space():
    domain = mesh.create_box(COMM, [(0, 0, 0), (2, 2, 4)], [2, 2, 4], mesh.CellType.hexahedron)
    body = points.fill(domain, 2, inside=lambda x: x[2] < 3)
    fm.set_initial_state(body, DENSITY)
    state = fm.k0_state(3.0, DENSITY, K0, axis=2)
    fm.initial_stress(body, SOIL, state)
    z = fm.Unknown(domain, "v")
    z.fix("v", lambda x: np.isclose(x[2], 0), component=2)
    for k in range(2):
        z.fix("v", lambda x, k=k: np.isclose(x[k] * (2 - x[k]), 0), component=k)
    R = fem.Constant(domain, 1.0) * fm.internal_force(z.test.v, body, SOIL)
    R += fm.body_force(z.test.v, body, (0, 0, -G))
    for _ in ExplicitMPM(R, z, body).run(0.1):
        pass
    assert np.abs(body["v"]).max() < 1e-12 * SPEED
    assert body["sigma"] == pytest.approx(expected(body, state), rel=1e-8, abs=1e-4)


def test_state_of_a_law():
    """The body has what the law remembers; stress and volume are as they were asked for."""
    body, law = column(), VonMises(50e6, 0.2, sigma_y=2e5, H=1e6)
    volume, mass = body.weight.copy(), body["mass"].copy()
    fm.internal_force(supported(body.mesh, "v").test.v, body, law)  # its fields are there first
    fm.initial_stress(body, law, AT_REST)
    assert body["sigma"] == pytest.approx(expected(body), rel=1e-9, abs=1e-4)
    assert np.array_equal(body.weight, volume) and np.array_equal(body["mass"], mass)
    assert body["V_0"] * body["J"] == pytest.approx(volume, rel=1e-15)
    assert np.all(body["eps_p"] == 0) and np.array_equal(body["J_bar"], body["J"])


# --- what cannot be ------------------------------------------------------------------------------


def shear(i, j, value=1e3):
    sigma = np.zeros((3, 3))
    sigma[i, j] = sigma[j, i] = value
    return sigma


@pytest.mark.mpi
@pytest.mark.parametrize(
    "sigma,message",
    [
        (np.eye(2), r"needs the shape \(3, 3\), not \(2, 2\)"),
        (np.full((3, 3), np.nan), "stresses must be finite"),
        ("none", "stresses must be numbers"),
        (np.eye(3) + np.triu(np.ones((3, 3)), 1), "must be symmetric: .* points are wrong, first"),
        (shear(0, 2), "no shear out of the plane, sigma_xz = sigma_yz = 0"),
        (shear(0, 1, 2e5), r"VonMises\(.* cannot have the stress: it lies outside the yield"),
        (lambda x: np.zeros((2, 2, x.shape[1])), r"must return values of the shape \(3, 3, "),
        (lambda x: np.where(x[1] < 1, np.nan, 0.0) * np.ones((3, 3, 1)), "stresses must be finite"),
        (fm.k0_state(5.0, DENSITY, K0), "a point at .* m is above the surface at 5.0 m"),
    ],
)
def test_stresses_that_cannot_be(sigma, message):
    """On all ranks, and the points are as before."""
    body = column()
    law = VonMises(50e6, 0.2, sigma_y=2e5)
    before = body.snapshot()
    with pytest.raises(ValueError, match=message):
        fm.initial_stress(body, law, sigma)
    assert before.keys() == body.snapshot().keys()
    assert all(np.array_equal(body[name], array) for name, array in before.items())


def test_materials_that_cannot_have_a_stress():
    body = column()
    with pytest.raises(ValueError, match=r"NewtonianFluid.* cannot have the stress"):
        fm.initial_stress(body, NewtonianFluid(1e6), shear(0, 1))
    with pytest.raises(ValueError, match=r"NeoHookean.* cannot have the stress"):
        fm.initial_stress(body, NeoHookean(1e6, 0.3), -1e7 * np.eye(3))
    bare = points.fill(body.mesh, 2)
    with pytest.raises(ValueError, match=r"call set_initial_state\(points, density\) first"):
        fm.initial_stress(bare, SOIL, AT_REST)


@pytest.mark.parametrize(
    "arguments,message",
    [
        (([0.0, 1.0], [1e3, 1e3], 0.5), "from the surface downwards"),
        (([1.0, 0.0], 1e3, 0.5), "a density and a K0, but 2, 1 and 1 values"),
        ((0.0, -1e3, 0.5), "densities must be positive"),
        ((0.0, 1e3, -0.5), "K0 not negative"),
        ((0.0, math.nan, 0.5), "densities of layers must be finite"),
    ],
)
def test_layers_that_cannot_be(arguments, message):
    with pytest.raises(ValueError, match=message):
        fm.k0_state(*arguments)
    with pytest.raises(ValueError, match="the water table must not be above the surface"):
        fm.k0_state(0.0, 1e3, 0.5, water_table=1.0)
    with pytest.raises(ValueError, match="the vertical axis is 1 for y or 2 for z, not 0"):
        fm.k0_state(0.0, 1e3, 0.5, axis=0)


@pytest.mark.mpi
def test_densities_by_position():
    body = points.fill(column().mesh, 2)
    with pytest.raises(ValueError, match=r"density must be positive: -1.0 kg/m\^d at point"):
        fm.set_initial_state(body, lambda x: np.where(x[1] < 1, -1.0, 1.0))
    with pytest.raises(ValueError, match="must return values of the shape"):
        fm.set_initial_state(body, lambda x: x)
    assert not body.field_names
