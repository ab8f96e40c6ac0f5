# SPDX-License-Identifier: MIT
"""Laws of soils against closed solutions, differences of themselves, and what must hold always."""

import math

import numpy as np
import pytest
from energy_bodies import block, simulation, total_energy
from scipy.optimize import brentq

from fenicsmpm import diagnostics, materials
from fenicsmpm.materials import (
    DruckerPrager,
    ModifiedCamClay,
    MohrCoulomb,
    VonMises,
    check_tangent,
)

pytestmark = pytest.mark.once

E, NU = 1000.0, 0.3
MU, KAPPA = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
SOFTENING = {
    "softening_strain": 0.3,
    "residual_cohesion": 1.0,
    "residual_friction": 20.0,
    "residual_dilatancy": 0.0,
}
CASES = {
    "sand": {"cohesion": 0.0, "friction": 30.0},
    "dilatant": {"cohesion": 10.0, "friction": 30.0, "dilatancy": 10.0},
    "associated": {"cohesion": 10.0, "friction": 30.0, "dilatancy": 30.0},
    "cut-off": {"cohesion": 10.0, "friction": 30.0, "dilatancy": 10.0, "tension": 3.0},
    "no tension": {"cohesion": 10.0, "friction": 30.0, "tension": 0.0},
    "clay": {"cohesion": 10.0, "friction": 0.0},
    "softening": {"cohesion": 10.0, "friction": 30.0, "dilatancy": 10.0, **SOFTENING},
    "softening cut-off": {"cohesion": 10.0, "friction": 25.0, "tension": 4.0, **SOFTENING},
}
frictional = pytest.mark.parametrize("kind", [DruckerPrager, MohrCoulomb])
cases = pytest.mark.parametrize("case", CASES)


def cam_clay(ratio=1.0, mu=1000.0):
    """Clay at 100 Pa, with an overconsolidation ratio."""
    return ModifiedCamClay(
        mu, M=1.2, compression=0.1, swelling=0.02, pressure=100.0, preconsolidation=100.0 * ratio
    )


def steps(strain, n=200, seed=0, mean=0.0):
    """Random deformation gradients, of points that are extended by a mean."""
    noise = np.random.default_rng(seed).standard_normal((n, 3, 3))
    return (1 + mean) * np.eye(3) + strain * noise


def kirchhoff(law, F, state):
    """Kirchhoff stresses; the state changes."""
    return np.linalg.det(F)[:, None, None] * materials.stress(law, F, state=state)


def principal(tau):
    """Principal values, the largest first."""
    return np.linalg.eigvalsh(tau)[:, ::-1]


def diagonal(strain):
    """Deformation gradient of one point with principal logarithmic strains."""
    return np.diag(np.exp(strain))[None]


def excess(law, tau, share=0.0):
    """Largest yield function [Pa], from its definition in degrees."""
    friction, k, _, limit = law.parameters[3:7] + share * (
        np.append(law.parameters[7:10], law.parameters[6]) - law.parameters[3:7]
    )
    t = principal(tau)
    if isinstance(law, MohrCoulomb):
        outside = (t[:, 0] - t[:, 2] + (t[:, 0] + t[:, 2]) * friction) / 2 - k
        return np.maximum(outside, t[:, 0] - limit)
    p = t.mean(axis=1)
    r = np.sqrt(((t - p[:, None]) ** 2).sum(axis=1) / 2)
    return np.maximum(r + friction * p - k, p - limit)


# --- tangent ----------------------------------------------------------------------------------


@frictional
@cases
@pytest.mark.parametrize("mean", [-0.02, 0.0, 0.02])
def test_tangent_of_frictional_laws(kind, case, mean):
    """From states that have flowed, to elastic, plane, edge, apex and cut-off ones and beyond."""
    law = kind(E, NU, **CASES[case])
    state = law.initial_state(200)
    materials.stress(law, steps(0.02, mean=mean), state=state)
    F = steps(0.02, mean=mean) + steps(0.01, seed=1) - np.eye(3)
    assert check_tangent(law, F, state) < 1e-6
    after = state.copy()
    materials.stress(law, F, state=after)
    flows = law.state_field(after, "eps_p") > law.state_field(state, "eps_p")
    assert 5 < flows.sum()
    if mean == 0 and case not in ("clay", "sand"):
        assert flows.sum() < 195
        opened = law.state_field(after, "opening") - law.state_field(state, "opening")
        assert np.any(opened > 0) and np.any(opened < 0)


PLACES = {
    # sorted trial strains, and which principal stresses are then at the limit or equal
    "elastic": ((0.0, -0.005, -0.01), lambda t, limit: t[0] - t[2] < 9),
    "plane": ((0.03, 0.0, -0.04), lambda t, limit: t[0] > t[1] + 1 > t[2] + 2),
    "edge of compression": ((0.0, 0.0, -0.05), lambda t, limit: t[0] - t[1] < 1e-9 < t[1] - t[2]),
    "edge of extension": ((0.05, 0.0, 0.0), lambda t, limit: t[1] - t[2] < 1e-9 < t[0] - t[1]),
    "apex": ((0.06, 0.05, 0.05), lambda t, limit: t[2] > limit - 1e-9),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("turned", [False, True])
def test_tangent_where_strains_are_equal(place, turned):
    """Mohr-Coulomb, from no strain; equal strains have any principal directions."""
    law = MohrCoulomb(E, NU, cohesion=10.0, friction=30.0, dilatancy=10.0)
    strain, holds = PLACES[place]
    if place == "edge of extension":
        strain = (0.02, -0.06, -0.06)
    F = diagonal(np.array(strain))
    if turned:
        F = steps(0.3, 1, seed=4) @ np.linalg.qr(steps(1.0, 1))[0]
        u, _, v = np.linalg.svd(F)
        F = u @ diagonal(np.array(strain)) @ v
    t = principal(kirchhoff(law, F, law.initial_state(1)))[0]
    assert holds(t, law.tension)
    if place == "edge of compression":  # a kink of the elastic trial's order is none of the stress
        assert t[0] == pytest.approx(t[1])
    assert check_tangent(law, F, law.initial_state(1)) < 1e-7


def test_tension_cut_off():
    """All places where a return can end, by what is at its limit or equal there."""
    law = MohrCoulomb(E, NU, cohesion=10.0, friction=30.0, dilatancy=10.0, tension=3.0)
    strains = np.random.default_rng(0).uniform(-0.1, 0.1, (3000, 3))
    F = np.concatenate([diagonal(strain) for strain in strains])
    state = law.initial_state(len(F))
    tau = kirchhoff(law, F, state)
    t = principal(tau)
    assert excess(law, tau).max() < 1e-9
    slides = np.abs((1.5 * t[:, 0] - 0.5 * t[:, 2]) / 2 - law.parameters[4]) < 1e-9
    at_limit = (np.abs(t - 3.0) < 1e-9).sum(axis=1)
    equal = (np.abs(np.diff(t, axis=1)) < 1e-9) @ [1, 2]
    places = {(int(a), bool(b), int(c)) for a, b, c in zip(at_limit, slides, equal, strict=True)}
    # planes, edges, corners, the tip; number of stresses at the limit, friction, equal stresses
    assert places == {
        (0, False, 0), (0, True, 0), (0, True, 1), (0, True, 2),
        (1, False, 0), (1, True, 0), (1, True, 2), (2, False, 1), (2, True, 1), (3, False, 3),
    }  # fmt: skip
    assert check_tangent(law, F) < 1e-6


@pytest.mark.parametrize("ratio", [1.0, 1.5, 20.0])
@pytest.mark.parametrize("mean", [-0.02, 0.0, 0.02])
def test_tangent_of_cam_clay(ratio, mean):
    """On the wet and on the dry side."""
    law = cam_clay(ratio)
    state = law.initial_state(200)
    F = steps(0.02, mean=mean)
    for _ in range(3):  # heavily overconsolidated clay gets to the dry side
        materials.stress(law, F, state=state)
    F = F + steps(0.01, seed=1) - np.eye(3)
    assert check_tangent(law, F, state) < 1e-6
    after = state.copy()
    materials.stress(law, F, state=after)
    change = law.state_field(after, "eps_v_p") - law.state_field(state, "eps_v_p")
    assert np.any(change != 0)
    if ratio == 1.5:
        assert np.any(change > 0) and np.any(change < 0) and np.any(change == 0)


# --- what must hold always --------------------------------------------------------------------

LAWS = {
    **{f"DruckerPrager, {case}": (DruckerPrager, CASES[case]) for case in CASES},
    **{f"MohrCoulomb, {case}": (MohrCoulomb, CASES[case]) for case in CASES},
}


def made(name):
    if name.startswith("cam"):
        return cam_clay(float(name.split()[-1]))
    kind, parameters = LAWS[name]
    return kind(E, NU, **parameters)


every_law = pytest.mark.parametrize("name", [*LAWS, "cam clay 1", "cam clay 4"])


@every_law
def test_objectivity(name):
    """Q F gives Q sigma Q^T, and the same state."""
    law = made(name)
    F, Q = steps(0.03, 50), np.linalg.qr(steps(1.0, 50, seed=3))[0]
    a, b = law.initial_state(50), law.initial_state(50)
    for _ in range(2):
        sigma = materials.stress(law, F, state=a)
        rotated = materials.stress(law, Q @ F, state=b)
        error = np.abs(rotated - Q @ sigma @ np.swapaxes(Q, 1, 2)).max()
        assert error < 1e-11 * E
        assert np.allclose(a, b, rtol=1e-9, atol=1e-12)
        F = F @ steps(0.03, 50, seed=5)


@every_law
def test_stress_is_the_derivative_of_the_energy(name):
    """In elastic states, and of energy and dissipation where flow is associated and perfect."""
    law = made(name)
    associated = "associated" in name or name.endswith(", clay")
    F = steps(0.02 if associated else 1e-4, 50, mean=-0.001)
    old = law.initial_state(50)

    def work(F):
        state = old.copy()
        materials.stress(law, F, state=state)
        return materials.energy(law, F, state) + law.state_field(state, "dissipation")

    P = np.swapaxes(np.linalg.inv(F), 1, 2)
    state = old.copy()
    P = np.linalg.det(F)[:, None, None] * materials.stress(law, F, state=state) @ P
    flows = law.state_field(state, "eps_p") > 0
    elastic = ~flows
    assert (flows.sum() > 20) if associated else True
    chosen = np.ones(50, bool) if associated else elastic
    if name not in ("cam clay 1", "DruckerPrager, sand", "MohrCoulomb, sand"):
        assert np.any(chosen)
    gradients = np.empty((50, 3, 3))
    for p in range(50):
        law.work_gradient(F[p], law.parameters, old[p], gradients[p])
    h = 1e-6
    for i, j in np.ndindex(3, 3):
        d = np.zeros((3, 3))
        d[i, j] = h
        slope = (work(F + d) - work(F - d)) / (2 * h)
        assert np.abs(slope - P[:, i, j])[chosen].max(initial=0.0) < 2e-6 * E
        assert np.abs(slope - gradients[:, i, j]).max() < 2e-6 * E


@every_law
def test_yield_condition_and_dissipation(name):
    """After steps of any size: on or in the yield surface; nothing gains energy by flow."""
    law = made(name)
    state, n = law.initial_state(100), 100
    F = np.tile(np.eye(3), (n, 1, 1))
    for step in range(12):
        F = F @ steps(0.02 if step % 3 else 0.1, n, seed=step)
        old = state.copy()
        tau = kirchhoff(law, F, state)
        eps_p = law.state_field(state, "eps_p")
        flows = eps_p > law.state_field(old, "eps_p")
        scale = 1e-9 * E * np.linalg.cond(F) ** 2
        if name.startswith("cam"):
            t = principal(tau)
            p = -t.mean(axis=1)
            q = np.sqrt(1.5 * ((t + p[:, None]) ** 2).sum(axis=1))
            M, compression, swelling, _, p_0 = law.parameters[1:]
            p_c = p_0 * np.exp(-law.state_field(state, "eps_v_p") / (compression - swelling))
            f = np.sqrt((q / M) ** 2 + (p - p_c / 2) ** 2) - p_c / 2
        else:
            softened = np.minimum(law.parameters[2] * eps_p, 1.0)
            f = np.array([excess(law, tau[k : k + 1], softened[k])[0] for k in range(n)])
        assert np.all(f < scale)
        if "sand" not in name and "softening" not in name:
            assert np.all(np.abs(f[flows]) < scale[flows])
        gained = law.state_field(state, "dissipation") - law.state_field(old, "dissipation")
        assert np.all(gained >= -1e-12 * E)
        assert flows.any()


def test_the_nearest_admissible_stress():
    """Associated flow: plastic strain is in the normal cone (principle of maximum dissipation)."""
    generator = np.random.default_rng(0)
    for parameters in (CASES["associated"], {**CASES["associated"], "tension": 5.0}):
        law = MohrCoulomb(E, NU, **parameters)
        others = np.sort(generator.uniform(-200.0, 18.0, (20000, 3)), axis=1)[:, ::-1]
        tensors = np.zeros((len(others), 3, 3))
        tensors[:, range(3), range(3)] = others
        others = others[excess(law, tensors) <= 0]
        assert len(others) > 500
        for strain in np.sort(generator.uniform(-0.1, 0.1, (300, 3)), axis=1)[:, ::-1]:
            t = principal(kirchhoff(law, diagonal(strain), law.initial_state(1)))[0]
            mean = t.mean()
            flow = strain - (t - mean) / (2 * MU) - mean / (3 * KAPPA)
            assert ((others - t) @ flow).max() < 1e-10 * E


@every_law
def test_work_is_energy_and_dissipation(name):
    """Along a path that loads and unloads, with the order of the step."""
    law = made(name)
    errors = []
    for n in (400, 800):
        t = np.linspace(0, 1, n + 1)
        F = np.tile(np.eye(3), (n + 1, 1, 1))
        F[:, 0, 1] = 0.1 * np.sin(4 * t)
        F[:, 1, 1] -= 0.02 * t
        state = law.initial_state(1)
        start = materials.energy(law, F[:1], state)[0]
        sigma = np.concatenate([materials.stress(law, f[None], state=state) for f in F])
        P = np.linalg.det(F)[:, None, None] * sigma @ np.swapaxes(np.linalg.inv(F), 1, 2)
        work = np.sum((P[1:] + P[:-1]) / 2 * np.diff(F, axis=0))
        stored = materials.energy(law, F[-1:], state)[0] - start
        errors.append(abs((stored + law.state_field(state, "dissipation")[0]) / work - 1))
    assert errors[0] < 0.01 and errors[1] < 0.6 * errors[0] + 1e-5


# --- closed solutions ---------------------------------------------------------------------------


def lateral(law, axial, stress, state, plane_strain=False):
    """Step to an axial strain at given lateral Kirchhoff stress: stresses and lateral strain."""

    def F(x):
        return diagonal(np.array([axial, x, 0.0 if plane_strain else x]))

    def residual(x):
        return kirchhoff(law, F(x), state.copy())[0, 1, 1] - stress

    x = brentq(residual, -0.5, 2.0, xtol=1e-15)
    return np.diag(kirchhoff(law, F(x), state)[0]), x


def sheared(law, axial, confinement, plane_strain=False, n=40):
    """Stresses at an axial strain after isotropic confinement, and strains of the last steps."""
    state, x = law.initial_state(1), []
    start = -confinement / (3 * getattr(law, "kappa", math.inf))
    kirchhoff(law, diagonal(np.full(3, start)), state)
    for e in start + np.linspace(0, axial, n + 1)[1:]:
        tau, side = lateral(law, e, -confinement, state, plane_strain)
        x.append(side)
    return tau, np.diff(x[-2:])[0] / (axial / n), state


def passive(angle):
    return (1 + math.sin(math.radians(angle))) / (1 - math.sin(math.radians(angle)))


@pytest.mark.parametrize(
    "make",
    [MohrCoulomb, lambda *a: DruckerPrager(*a, match="compression")],
    ids=["MohrCoulomb", "DruckerPrager"],
)
@pytest.mark.parametrize("dilatancy", [0.0, 12.0, 30.0])
def test_triaxial_compression(make, dilatancy):
    """Strength p N + 2 c sqrt(N) with N = tan^2(45 degrees + phi / 2); and the rate of dilation."""
    law = make(E, NU, 5.0, 30.0, dilatancy)
    tau, rate, _ = sheared(law, -0.2, 20.0)
    N = passive(30.0)
    assert tau[0] == pytest.approx(-(20.0 * N + 10.0 * math.sqrt(N)), rel=1e-9)
    # volume by axial shortening: (1 + 2 rate) = 1 - N_psi, for the edges and the cone through them
    assert 1 + 2 * rate == pytest.approx(1 - passive(dilatancy), abs=1e-9)


@pytest.mark.parametrize(
    "make",
    [MohrCoulomb, lambda *a: DruckerPrager(*a, match="extension")],
    ids=["MohrCoulomb", "DruckerPrager"],
)
@pytest.mark.parametrize("dilatancy", [0.0, 12.0])
def test_triaxial_extension(make, dilatancy):
    """The axial stress falls to (p - 2 c sqrt(N)) / N."""
    law = make(E, NU, 5.0, 30.0, dilatancy)
    tau, _, _ = sheared(law, 0.2, 60.0)
    N = passive(30.0)
    assert tau[0] == pytest.approx(-(60.0 - 10.0 * math.sqrt(N)) / N, rel=1e-9)


@pytest.mark.parametrize(
    "make",
    [MohrCoulomb, lambda *a: DruckerPrager(*a, match="plane strain")],
    ids=["MohrCoulomb", "DruckerPrager"],
)
@pytest.mark.parametrize("dilatancy", [0.0, 12.0, 30.0])
def test_plane_strain_compression(make, dilatancy):
    """The strength of Mohr and Coulomb; Drucker's and Prager's cone when all strain is plastic."""
    law = make(E, NU, 5.0, 30.0, dilatancy)
    tau, rate, _ = sheared(law, -0.4, 20.0, plane_strain=True)
    N = passive(30.0)
    exact = 1e-9 if isinstance(law, MohrCoulomb) else 1e-3
    assert tau[0] == pytest.approx(-(20.0 * N + 10.0 * math.sqrt(N)), rel=exact)
    # sin(psi) is dilation by shear
    assert (1 + rate) / (1 - rate) == pytest.approx(-math.sin(math.radians(dilatancy)), abs=1e-3)


def test_the_cones_of_drucker_and_prager():
    """Coefficients for phi = 30 degrees: the formulas by hand."""
    for match, divisor in ("compression", 2.5), ("extension", 3.5):
        law = DruckerPrager(E, NU, 1.0, 30.0, match=match)
        assert law.parameters[3] == pytest.approx(3 / math.sqrt(3) / divisor, rel=1e-14)
        assert law.parameters[4] == pytest.approx(3 / divisor, rel=1e-14)
    law = DruckerPrager(E, NU, 1.0, 30.0, 30.0, match="plane strain")
    t = math.tan(math.pi / 6)
    assert law.parameters[3] == pytest.approx(3 * t / math.sqrt(9 + 12 * t**2), rel=1e-14)
    assert law.parameters[4] == pytest.approx(3 / math.sqrt(9 + 12 * t**2), rel=1e-14)
    assert law.parameters[3] == pytest.approx(law.parameters[5], rel=1e-14)
    law = DruckerPrager(E, NU, 1.0, 30.0, match="plane strain")
    assert law.parameters[3] == pytest.approx(0.5, rel=1e-14)


@frictional
def test_without_friction(kind):
    """Drucker and Prager become von Mises; Tresca's shear strength is c."""
    law = kind(E, NU, 10.0, 0.0) if kind is MohrCoulomb else kind(E, NU, 10.0, 0.0, 0.0, None)
    F = steps(0.03)
    state = law.initial_state(200)
    if kind is DruckerPrager:
        law = kind(E, NU, 10.0, 0.0, match="plane strain")
        other = VonMises(E, NU, sigma_y=math.sqrt(3) * 10.0)
        expected, found = materials.stress(other, F), materials.stress(law, F, state=state)
        assert np.abs(found - expected).max() < 1e-11 * E
        assert np.abs(
            law.state_field(state, "C_p_inverse")
            - state_after(other, F)["C_p_inverse"]
        ).max() < 1e-12  # fmt: skip
        assert law.state_field(state, "eps_p") == pytest.approx(state_after(other, F)["eps_p"])
        return
    t = principal(kirchhoff(law, F, state))
    flows = law.state_field(state, "eps_p") > 0
    assert flows.sum() > 50
    assert t[flows, 0] - t[flows, 2] == pytest.approx(20.0, rel=1e-11)


def state_after(law, F):
    state = law.initial_state(len(F))
    materials.stress(law, F, state=state)
    return {name: law.state_field(state, name) for name in law.state}


@pytest.mark.parametrize("dilatancy", [0.0, 10.0])
@frictional
def test_oedometer(kind, dilatancy):
    """K0 is nu / (1 - nu), if not less than the active coefficient: then it is that."""
    for nu, coefficient in ((0.3, 0.3 / 0.7), (0.2, 1 / passive(30.0))):
        law = kind(E, nu, 0.0, 30.0, dilatancy)
        state = law.initial_state(1)
        for e in np.linspace(0, -0.1, 11)[1:]:
            tau = np.diag(kirchhoff(law, diagonal(np.array([e, 0, 0])), state)[0])
        assert tau[1:] == pytest.approx(coefficient * tau[0], rel=1e-10)
        flows = law.state_field(state, "eps_p")[0] > 0
        assert flows == (nu == 0.2)
        if not flows or dilatancy == 0:  # the volume is elastic
            assert tau.mean() == pytest.approx(-law.kappa * 0.1, rel=1e-10)


def test_softening_against_the_closed_solution():
    """Shear at constant volume: 2 mu (e - e_p) = c - (c - c_r) eps_p / strain, then c_r."""
    law = DruckerPrager(
        E, NU, 10.0, 0.0, match="plane strain", softening_strain=0.1, residual_cohesion=4.0
    )
    state = law.initial_state(1)
    for e in np.linspace(0, 0.2, 21)[1:]:
        tau = np.diag(kirchhoff(law, diagonal(np.array([e, -e, 0.0])), state)[0])
        slope = 60.0 * 2 / math.sqrt(3)  # of c by e_p: eps_p is 2 / sqrt(3) times that
        e_p = max((2 * MU * e - 10.0) / (2 * MU - slope), 0.0)
        if 2 / math.sqrt(3) * e_p > 0.1:
            e_p = e - 4.0 / (2 * MU)
        assert tau[0] == pytest.approx(2 * MU * (e - e_p), rel=1e-11)
        assert law.state_field(state, "eps_p")[0] == pytest.approx(
            2 / math.sqrt(3) * e_p, rel=1e-10
        )
    assert tau[0] == pytest.approx(4.0, rel=1e-11)


@frictional
def test_residual_strength_in_triaxial_compression(kind):
    law = kind(E, NU, 10.0, 30.0, 10.0, **SOFTENING)
    tau, rate, state = sheared(law, -0.6, 20.0, n=60)
    assert law.state_field(state, "eps_p")[0] > 0.3
    if kind is MohrCoulomb:
        N = passive(20.0)
        assert tau[0] == pytest.approx(-(20.0 * N + 2.0 * math.sqrt(N)), rel=1e-9)
    assert rate == pytest.approx(-0.5, abs=1e-9)  # no dilatancy is left


# --- opening --------------------------------------------------------------------------------------


@frictional
@cases
@pytest.mark.parametrize("direction", [(1, 1, 1), (1, 1, 0), (1, 0, 0), (1, 0.2, -0.3)])
def test_what_flies_apart_closes_without_resistance(kind, case, direction):
    """Pulled apart and pushed back: no pressure until the volume is that of the beginning."""
    law = kind(E, NU, **CASES[case])
    direction = np.array(direction, float)
    state, pressures, openings = law.initial_state(1), [], []
    path = np.concatenate([np.linspace(0, 1, 41), np.linspace(1, 0, 41), np.linspace(0, -0.05, 6)])
    for e in path:
        tau = kirchhoff(law, diagonal(e * direction), state)[0]
        pressures.append(-np.trace(tau) / 3)
        openings.append(law.state_field(state, "opening")[0])
        assert excess(law, tau[None])[0] < 1e-9 * E
    pressures, openings, volume = np.array(pressures), np.array(openings), path * direction.sum()
    isotropic, squeezed = direction.min() == 1, direction.min() < 0
    is_open = openings > 1e-13
    assert squeezed or is_open[2:80].any() == (case != "clay")
    assert not is_open[82 + squeezed :].any()
    # Volume changes by elasticity, openings, and dilatancy that is complete when it opens.
    dilated = volume + pressures / law.kappa - openings
    assert np.abs(dilated[is_open] - dilated[is_open][:1]).max(initial=0) < 1e-13
    if law.parameters[5] == 0 or isotropic:
        assert np.abs(dilated).max() < 1e-13
        assert squeezed or pressures[42:82].max() < 1e-10 * E
        assert np.all(np.diff(pressures[82:]) > 0)
        assert pressures[83:] == pytest.approx(-law.kappa * volume[83:], rel=1e-9)
    # While open, it carries no more pressure than it did when it opened.
    back = is_open.copy()
    back[:41] = False
    assert pressures[back].max(initial=0) <= max(pressures[:41].max(), 0) + 1e-10 * E


@pytest.mark.parametrize("case", ["cut-off", "no tension", "softening cut-off"])
@pytest.mark.parametrize("strain", [0.01, 0.05])
def test_cracks_close_before_there_is_more_compression(case, strain):
    """Squeezed from two sides while it cracks: what it carries stays, and closing dissipates."""
    law = MohrCoulomb(E, NU, **CASES[case])
    state, pressures = law.initial_state(1), []
    path = [(0.0, -strain * t) for t in np.linspace(0, 1, 6)]
    path += [(e, -strain) for e in np.linspace(0, 0.2, 41)[1:]]
    carried = len(path) - 1
    path += [(e, -strain) for e in np.linspace(0.2, -0.01, 43)[1:]]
    dissipation = 0.0
    for across, along in path:
        tau = kirchhoff(law, diagonal(np.array([across, along, along])), state)[0]
        pressures.append(-np.trace(tau) / 3)
        opening = law.state_field(state, "opening")[0]
        before, dissipation = dissipation, law.state_field(state, "dissipation")[0]
        assert dissipation >= before - 1e-14 * E
        if len(pressures) - 1 > carried and opening > 1e-13:
            assert pressures[-1] <= pressures[carried] + 1e-10 * E
        if len(pressures) - 1 == carried:
            assert opening > 0.05 and pressures[-1] > 1.0
    assert opening == 0
    if law.parameters[5] == 0:  # all of the volume is back
        assert pressures[-1] == pytest.approx(law.kappa * (0.01 + 2 * strain), rel=1e-9)


@frictional
@cases
@pytest.mark.parametrize("noise", [0.012, 0.05])
def test_random_paths_that_open_and_close(kind, case, noise):
    """Tangent, work, dissipation and volume, at all steps of points that part and come back."""
    law, n = kind(E, NU, **CASES[case]), 60
    state, F = law.initial_state(n), np.tile(np.eye(3), (n, 1, 1))
    gradients, h, d = np.empty((n, 3, 3)), 1e-6, np.zeros((3, 3))
    for step in range(14):
        old = state.copy()
        F = F @ steps(noise, n, seed=step, mean=0.02 if step < 6 else -0.025)
        assert check_tangent(law, F, old) < 1e-6
        mean = np.trace(kirchhoff(law, F, state), axis1=1, axis2=2) / 3
        opening, before = (law.state_field(s, "opening") for s in (state, old))
        assert np.all(law.state_field(state, "dissipation") >= old[:, 11] - 1e-13 * E)
        assert np.all(opening >= 0)
        more = mean < law.state_field(old, "open_stress") - 1e-9 * E
        assert not np.any(more & (opening > 1e-13) & (before > 0))
        if law.parameters[5] == 0:
            volume = np.log(np.linalg.det(F))
            assert np.abs(mean / law.kappa - volume + opening).max() < 1e-12

        def work(F, old=old):
            state = old.copy()
            materials.stress(law, F, state=state)
            return materials.energy(law, F, state) + law.state_field(state, "dissipation")

        for p in range(n):
            law.work_gradient(F[p], law.parameters, old[p], gradients[p])
        for i, j in ((0, 0), (1, 2)):
            d[:], d[i, j] = 0, h
            slope = (work(F + d) - work(F - d)) / (2 * h)
            assert np.abs(slope - gradients[:, i, j]).max() < 2e-6 * E


@frictional
def test_sand_that_flew_about(kind):
    """Many points that part and come back by random paths have no pressure at their volume."""
    law, n = kind(E, NU, 0.0, 35.0), 100
    state, F = law.initial_state(n), steps(0.2, n)
    F /= np.cbrt(np.linalg.det(F))[:, None, None]
    for step in (*range(20), *range(20, -1, -1)):
        turn = np.linalg.qr(steps(1.0, n, seed=step))[0]
        apart = math.exp(0.05 * step)
        sigma = materials.stress(law, apart * turn @ F, state=state)
        assert np.abs(sigma).max() < 1e-8 * E
    pressed = kirchhoff(law, 0.99 * F, state)
    assert -np.trace(pressed, axis1=1, axis2=2) / 3 == pytest.approx(
        -3 * law.kappa * math.log(0.99), rel=1e-7
    )


# --- Cam-Clay ---------------------------------------------------------------------------------


def test_isotropic_compression_and_swelling_lines():
    """Straight lines of ln p and ln J, loaded, unloaded and loaded again."""
    law = cam_clay(2.0)
    state = law.initial_state(1)
    volume_at_yield = -0.02 * math.log(2.0)
    lowest, turns = 0.0, (0.0, -0.2, -0.15, -0.3)
    for volume in np.concatenate([np.linspace(*turns[k : k + 2], 11) for k in range(3)]):
        tau = kirchhoff(law, diagonal(np.full(3, volume / 3)), state)[0]
        p = -np.trace(tau) / 3
        assert np.abs(tau + p * np.eye(3)).max() < 1e-10 * p
        lowest = min(volume, lowest)
        if lowest > volume_at_yield:
            expected = 100.0 * math.exp(-volume / 0.02)
        else:
            p_c = 200.0 * math.exp(-(lowest - volume_at_yield) / 0.1)
            expected = p_c * math.exp(-(volume - lowest) / 0.02)
        assert p == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("ratio", [1.0, 1.6, 8.0])
def test_critical_state_undrained(ratio):
    """p = p_0 (R / 2)^((lambda - kappa) / lambda), q = M p: from the wet and from the dry side."""
    law = cam_clay(ratio)
    state = law.initial_state(1)
    for e in np.linspace(0, 1.0, 201)[1:]:
        tau = np.diag(kirchhoff(law, diagonal(np.array([-e, e / 2, e / 2])), state)[0])
    p = 100.0 * (ratio / 2) ** 0.8
    assert -tau.mean() == pytest.approx(p, rel=1e-6)
    assert tau[1] - tau[0] == pytest.approx(1.2 * p, rel=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 1.5])
def test_critical_state_drained(ratio):
    """q = 3 (p - p_0) = M p at constant lateral stress; the volume is that of the state line."""
    law = cam_clay(ratio)
    state = law.initial_state(1)
    for e in np.linspace(0, -2.0, 81)[1:]:
        tau, side = lateral(law, e, -100.0, state)
    p = 300.0 / (3 - 1.2)
    assert -tau.mean() == pytest.approx(p, rel=1e-5)
    # ln J at the critical state: that of the undrained test, and lambda ln p from there
    volume = e + 2 * side
    undrained = 100.0 * (ratio / 2) ** 0.8
    assert volume == pytest.approx(-0.1 * math.log(p / undrained), abs=1e-5)


def test_oedometer_of_cam_clay():
    """eta of K0: eta^2 + 3 (1 - kappa / lambda) eta = M^2, if there is no elastic shear strain."""
    law = cam_clay(mu=1e8)
    state = law.initial_state(1)
    for e in np.linspace(0, -0.5, 201)[1:]:
        tau = np.diag(kirchhoff(law, diagonal(np.array([e, 0.0, 0.0])), state)[0])
    ratio = (tau[1] - tau[0]) / -tau.mean()
    eta = (-3 * 0.8 + math.sqrt(9 * 0.64 + 4 * 1.44)) / 2
    assert ratio == pytest.approx(eta, rel=1e-3)


def test_clay_that_parts():
    """No pressure while it is apart, and the same as before at the same volume."""
    law = cam_clay(2.0)
    state = law.initial_state(1)
    for stretch in (*np.linspace(0, 2, 21), *np.linspace(2, 0, 21)):
        tau = kirchhoff(law, diagonal(np.full(3, stretch)), state)[0]
        assert np.trace(tau) / 3 == pytest.approx(-100.0 * math.exp(-3 * stretch / 0.02), abs=1e-9)
    # Sheared while apart, it softens to nothing, and has its strength back by compaction, to the
    # line of isotropic compression but for what shear stress is left.
    kirchhoff(law, diagonal(np.array([1.2, 0.8, 1.0])), state)
    tau = kirchhoff(law, diagonal(np.array([-0.1, -0.1, -0.1])), state)[0]
    assert -np.trace(tau) / 3 == pytest.approx(
        200.0 * math.exp((0.3 - 0.02 * math.log(2)) / 0.1), rel=0.01
    )


# --- loops ------------------------------------------------------------------------------------

IN_FLIGHT = {
    "DruckerPrager": lambda: DruckerPrager(100.0, 0.3, 2.0, 30.0, 5.0),
    "MohrCoulomb": lambda: MohrCoulomb(100.0, 0.3, 2.0, 30.0, 5.0, tension=2.0),
    "softening": lambda: MohrCoulomb(
        100.0, 0.3, 2.0, 30.0, softening_strain=0.2, residual_cohesion=1.0, residual_friction=20.0
    ),
    "cam clay": lambda: ModifiedCamClay(40.0, 1.2, 0.2, 0.05, 1.0, 2.0),
}


@pytest.mark.parametrize("name", IN_FLIGHT)
def test_energy_and_momenta_in_implicit_steps(name):
    """A block in free flight that flows."""
    body = block()
    sim = simulation(body, IN_FLIGHT[name](), dt=0.02)
    energy, momentum = total_energy(body), diagnostics.momentum(body)
    turning = diagnostics.angular_momentum(body)
    for _ in range(4):
        sim.step(0.02)
    assert body["eps_p"].max() > 0.01
    assert total_energy(body) == pytest.approx(energy, rel=1e-10)
    assert diagnostics.momentum(body) == pytest.approx(momentum, abs=1e-11)
    assert diagnostics.angular_momentum(body) == pytest.approx(turning, abs=1e-10)


# --- parameters -------------------------------------------------------------------------------


@frictional
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"E": 0.0}, "E = 0.0"),
        ({"nu": 0.5}, "nu = 0.5"),
        ({"friction": 90.0}, r"friction must lie in \[0, 90\) degrees: friction = 90.0"),
        ({"friction": -1.0}, "friction = -1.0"),
        ({"friction": math.nan}, "friction = nan"),
        ({"friction": "30"}, "friction = '30'"),
        (
            {"dilatancy": 31.0},
            "dilatancy above the friction .* 31.0 degrees, friction = 30.0 degrees",
        ),
        ({"dilatancy": -1.0}, r"dilatancy must lie in \[0, 90\) degrees: dilatancy = -1.0"),
        ({"cohesion": -1.0}, "cohesion must be finite and not negative: cohesion = -1.0 Pa"),
        ({"cohesion": math.inf}, "cohesion = inf"),
        ({"cohesion": 0.0, "friction": 0.0}, "has no strength: cohesion = 0"),
        ({"tension": 30.0}, "above the tip of the yield surface: tension = 30 Pa, tip 17.32"),
        ({"tension": -1.0}, "tension = -1.0 Pa"),
        ({"residual_cohesion": 1.0}, "residual_cohesion = 1.0 without softening_strain"),
        ({"softening_strain": 0.1}, "softening_strain = 0.1 without a residual value"),
        ({"softening_strain": 0.0, "residual_cohesion": 1.0}, "softening_strain = 0.0"),
        (
            {"softening_strain": 0.1, "residual_cohesion": 11.0},
            "residual_cohesion = 11 Pa is",
        ),
        ({"softening_strain": 0.1, "residual_friction": 31.0}, "residual_friction = 31 degrees is"),
        ({"softening_strain": 0.1, "residual_friction": -1.0}, "residual_friction = -1.0"),
        ({"softening_strain": 1e-4, "residual_cohesion": 0.0}, "steeper than the elastic"),
        (
            {"softening_strain": 0.1, "residual_friction": 10.0, "dilatancy": 20.0},
            "residual_dilatancy = 20.0 degrees, residual_friction = 10.0 degrees",
        ),
    ],
)
def test_wrong_parameters_of_frictional_laws(kind, change, message):
    right = {"E": E, "nu": NU, "cohesion": 10.0, "friction": 30.0}
    with pytest.raises(ValueError, match=message):
        kind(**{**right, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mu": 0.0}, "mu = 0.0"),
        ({"M": 0.0}, "slope of the critical state line must be positive and finite: M = 0.0"),
        ({"M": -1.0}, "M = -1.0"),
        ({"M": None}, "M = None"),
        ({"swelling": 0.0}, "swelling = 0.0"),
        ({"compression": 0.02}, "larger than swelling: compression = 0.02, swelling = 0.02"),
        ({"pressure": 0.0}, "pressure = 0.0"),
        ({"preconsolidation": 50.0}, "preconsolidation = 50.0 Pa is below pressure = 100.0 Pa"),
        ({"preconsolidation": math.nan}, "preconsolidation = nan"),
    ],
)
def test_wrong_parameters_of_cam_clay(change, message):
    right = {"mu": 1e3, "M": 1.2, "compression": 0.1, "swelling": 0.02, "pressure": 100.0}
    with pytest.raises(ValueError, match=message):
        ModifiedCamClay(**{**right, **change})


def test_a_match_that_there_is_not():
    with pytest.raises(ValueError, match="'compression', 'extension' or 'plane strain', not 'in"):
        DruckerPrager(E, NU, 1.0, 30.0, match="inner")


@every_law
def test_inverted_deformation_is_not_a_number(name):
    F = np.diag([1.0, 1.0, -0.5])[None]
    assert np.isnan(materials.stress(made(name), F)).any()


def test_softening_warns(said):
    MohrCoulomb(E, NU, 1.0, 30.0)
    assert not said
    MohrCoulomb(E, NU, 10.0, 30.0, softening_strain=0.1, residual_cohesion=1.0)
    (line,) = said
    assert "without a length scale" in line


def test_print():
    text = repr(MohrCoulomb(E, NU, 10.0, 30.0, 5.0, **{**SOFTENING, "residual_dilatancy": 5.0}))
    assert "10 Pa, 30 degrees, 5 degrees, residual: 1 Pa, 20 degrees, 5 degrees" in text
    assert "tension=17.32" in text
    assert "M=1.2" in repr(cam_clay()) and "preconsolidation=100 Pa" in repr(cam_clay())


def test_bulk_to_shear():
    """Sand without pressure has no shear stress, and clay has a pressure without strain."""
    for law in (DruckerPrager(E, NU, 0.0, 30.0), MohrCoulomb(E, NU, 0.0, 30.0)):
        assert materials.bulk_to_shear(law) == pytest.approx(KAPPA / MU, rel=1e-3)
    # of Cauchy's stress -p / J: p / kappa + p
    assert materials.bulk_to_shear(cam_clay(2.0)) == pytest.approx(5100.0 / 1000.0, rel=1e-2)
