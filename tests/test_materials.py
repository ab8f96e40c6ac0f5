# SPDX-License-Identifier: MIT
"""Constitutive laws at points against UFL, matrix logarithms and closed solutions."""

import math

import numpy as np
import pytest
import scipy.linalg
import ufl

from fenicsmpm import materials
from fenicsmpm.materials import Hencky, Law, NeoHookean, NewtonianFluid, VonMises, compiled
from fenicsmpm.materials.tensors import eigen

pytestmark = pytest.mark.once

E, NU = 1000.0, 0.3
MU, KAPPA = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
STRAINS = [1e-9, 1e-4, 0.02, 0.3]

LAWS = {
    "quadratic": lambda: NeoHookean(E, NU, "quadratic").pointwise(),
    "miehe": lambda: NeoHookean(E, NU, "miehe").pointwise(),
    "simo-taylor": lambda: NeoHookean(E, NU, "simo-taylor").pointwise(),
    "Hencky": lambda: Hencky(E, NU),
    "hardening": lambda: VonMises(E, NU, 20.0, H=50.0),
    "softening": lambda: VonMises(E, NU, 20.0, sigma_r=5.0, eta=3.0),
    "fluid": lambda: NewtonianFluid(KAPPA, 0.1),
}
ELASTIC = ["quadratic", "miehe", "simo-taylor", "Hencky"]
PLASTIC = ["hardening", "softening"]
laws = pytest.mark.parametrize("law", LAWS)


def deformations(strain, n=50, seed=0):
    """Random deformation gradients with a positive determinant."""
    F = np.eye(3) + strain * np.random.default_rng(seed).standard_normal((4 * n, 3, 3))
    return np.ascontiguousarray(F[np.linalg.det(F) > 0.1][:n])


def rotations(n, seed=1):
    """Random rotations, exact to round-off (LAPACK makes Q of two reflections)."""
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((n, 3, 3)))[0]


def dev(a):
    return a - np.trace(a, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)


def relative(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


def mises(law, F, sigma):
    """Equivalent Kirchhoff stress."""
    tau = np.linalg.det(F)[:, None, None] * sigma
    return np.sqrt(1.5) * np.linalg.norm(dev(tau), axis=(1, 2))


# --- eigenvalues -----------------------------------------------------------------------------


@pytest.mark.parametrize("values", [(1, 2, 3), (1, 1, 2), (2, 1, 1), (1, 1, 1), (1, 1, 1 + 1e-12)])
@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e-40])
def test_eigenvalues(values, scale):
    for Q in [np.eye(3), *rotations(20)]:
        A = scale * Q @ np.diag(values) @ Q.T
        w, n = eigen((A[0, 0], A[1, 1], A[2, 2], A[0, 1], A[0, 2], A[1, 2]))
        n = np.reshape(n, (3, 3))
        assert np.allclose(sorted(w), np.linalg.eigvalsh(A), rtol=4e-15, atol=0)
        assert np.allclose(n.T @ n, np.eye(3), rtol=0, atol=2e-15)
        assert np.allclose(n @ np.diag(w) @ n.T, A, rtol=0, atol=1e-14 * scale)


# --- elasticity ------------------------------------------------------------------------------


@pytest.mark.parametrize("strain", STRAINS)
@pytest.mark.parametrize("name", ELASTIC[:3])
def test_neo_hookean_against_ufl(name, strain):
    """The same numbers as the UFL law that the mixed formulation uses."""
    law = NeoHookean(E, NU, name)
    F = deformations(strain)
    expected = []
    for f in F:
        f = ufl.as_matrix(f.tolist())
        s = law.deviatoric_stress(f) + KAPPA * law.volumetric_strain(ufl.det(f)) * ufl.Identity(3)
        expected.append([[float(s[i, j](())) for j in range(3)] for i in range(3)])
    # UFL's numbers come from the differences of numbers near one
    error = np.abs(materials.stress(law.pointwise(), F) - expected).max()
    assert error < 1e-12 * np.abs(expected).max() + 1e-14 * E


@pytest.mark.parametrize("strain", STRAINS[1:])
@pytest.mark.parametrize("law", ["Hencky", "hardening", "softening"])
def test_hencky_against_the_matrix_logarithm(law, strain):
    law = Hencky(E, NU) if law == "Hencky" else VonMises(E, NU, 1e6, H=1.0)
    F = deformations(strain)
    J = np.linalg.det(F)
    eps = np.stack([scipy.linalg.logm(f @ f.T) / 2 for f in F])
    tau = KAPPA * np.log(J)[:, None, None] * np.eye(3) + 2 * MU * dev(eps)
    error = np.abs(materials.stress(law, F) - tau / J[:, None, None]).max()
    assert error < 1e-12 * np.abs(tau).max() + 1e-14 * E


@pytest.mark.parametrize("eps", [1e-12, 1e-6, 0.01, 0.5, 2.0])
def test_hencky_strain_has_all_digits(eps):
    """Equal and different stretches, down to strains where 1 + eps loses most digits."""
    law = Hencky(E, 0.0)  # kappa = 2 mu / 3: tau = 2 mu eps
    cases = [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, -1, 0), (1, -0.5, -0.5)]
    stretches = np.array([1 + np.expm1(eps * np.array(c)) for c in cases])
    F = np.stack([np.diag(s) for s in stretches])
    expected = E * np.log1p(stretches - 1) / np.prod(stretches, axis=1)[:, None]
    sigma = materials.stress(law, F)
    for s, e in zip(sigma, expected, strict=True):
        assert np.abs(s - np.diag(e)).max() < 1e-13 * np.abs(e).max()


@laws
def test_no_strain_no_stress(law):
    law = LAWS[law]()
    F = np.eye(3)[None]
    assert np.all(materials.stress(law, F) == 0)
    assert np.all(materials.energy(law, F) == 0)


@laws
@pytest.mark.parametrize("strain", STRAINS)
def test_objectivity(law, strain):
    """Q F gives Q sigma Q^T, and the same state."""
    law = LAWS[law]()
    F, Q = deformations(strain), rotations(50)
    a, b = law.initial_state(50), law.initial_state(50)
    sigma = materials.stress(law, F, state=a)
    rotated = materials.stress(law, Q @ F, state=b)
    error = np.abs(rotated - Q @ sigma @ np.swapaxes(Q, 1, 2)).max()
    assert error < 1e-12 * np.abs(sigma).max() + 1e-14 * E
    assert np.allclose(a, b, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("name", [*ELASTIC, "fluid"])
@pytest.mark.parametrize("strain", STRAINS[1:])
def test_stress_is_the_derivative_of_the_energy(name, strain):
    law = LAWS[name]()
    F = deformations(strain)
    P = np.linalg.det(F)[:, None, None] * materials.stress(law, F) @ np.linalg.inv(F.mT)
    h = 1e-4
    for i, j in np.ndindex(3, 3):
        d = np.zeros((3, 3))
        d[i, j] = h
        psi = [materials.energy(law, F + k * d) for k in (-2, -1, 1, 2)]  # fourth order
        slope = (psi[0] - 8 * psi[1] + 8 * psi[2] - psi[3]) / (12 * h)
        # the law of neo-Hooke is steep where J is small
        assert np.abs(slope - P[:, i, j]).max() < 1e-8 * max(np.abs(P).max(), E)


def test_uniaxial_energy_of_hencky():
    """E eps^2 / 2 for logarithmic strain eps in uniaxial stress."""
    eps = 0.7
    F = np.diag(np.exp([eps, -NU * eps, -NU * eps]))[None]
    assert np.isclose(materials.energy(Hencky(E, NU), F)[0], E * eps**2 / 2, rtol=1e-14)


@laws
def test_inverted_deformation_is_not_a_number(law):
    F = np.diag([1.0, 1.0, -0.5])[None]
    assert np.isnan(materials.stress(LAWS[law](), F)).any()


# --- fluid -----------------------------------------------------------------------------------


def test_fluid():
    law = NewtonianFluid(2e9, 1e-3)
    F, L = deformations(0.1), 1e9 * deformations(1.0, seed=3)
    J = np.linalg.det(F)
    D = (L + L.mT) / 2
    expected = 2e9 * (J - 1)[:, None, None] * np.eye(3) + 2e-3 * dev(D)
    assert relative(materials.stress(law, F, L), expected) < 1e-14
    assert law.wave_speed_modulus == 2e9


# --- plasticity ------------------------------------------------------------------------------


def history(law, F):
    """Stress along a path of one point, and the state at its end."""
    state = law.initial_state(1)
    return np.concatenate([materials.stress(law, f[None], state=state) for f in F]), state


def simple_shear(gamma):
    F = np.tile(np.eye(3), (len(gamma), 1, 1))
    F[:, 0, 1] = gamma
    return F


def test_simple_shear_reaches_the_shear_strength():
    """Plane strain: the shear strength is sigma_y / sqrt(3) (F-bar paper, section 4.2)."""
    strength = 0.1e3
    law = VonMises(1000e3, 0.49, math.sqrt(3) * strength)
    sigma, state = history(law, simple_shear(np.linspace(0, 0.01, 101)))
    elastic = min(strength, law.mu * 0.0001)
    assert np.isclose(sigma[1, 0, 1], elastic, rtol=1e-6)
    # the principal directions of finite shear turn by less than gamma
    assert np.isclose(sigma[-1, 0, 1], strength, rtol=1e-4)
    assert abs(np.trace(sigma[-1])) < 1e-8 * strength
    gamma_p = 0.01 - strength / law.mu
    assert np.isclose(law.state_field(state, "eps_p")[0], gamma_p / math.sqrt(3), rtol=1e-3)
    dissipation = law.state_field(state, "dissipation")[0]
    assert np.isclose(dissipation, strength * gamma_p, rtol=1e-3)


def test_biaxial_compression_in_plane_strain():
    """Shortening at constant volume: sigma_1 - sigma_2 = 2 sigma_y / sqrt(3), exactly."""
    law = VonMises(E, NU, 3.0)
    F = np.stack([np.diag([math.exp(-e), math.exp(e), 1]) for e in np.linspace(0, 1, 11)])
    sigma, state = history(law, F)
    assert np.allclose(sigma[1:, 1, 1] - sigma[1:, 0, 0], 2 * 3.0 / math.sqrt(3), rtol=1e-12)
    assert np.allclose(sigma[:, 2, 2], 0, atol=1e-12)
    eps_p = 2 / math.sqrt(3) * (1 - 3.0 / math.sqrt(3) / (2 * law.mu))
    assert np.isclose(law.state_field(state, "eps_p")[0], eps_p, rtol=1e-12)
    assert np.isclose(law.state_field(state, "dissipation")[0], 3.0 * eps_p, rtol=1e-12)


def uniaxial_plastic_strain(law, eps, sigma_y, H):
    """Plastic strain in uniaxial logarithmic strain eps: |tau_1 - tau_2| = sigma_y + H eps_p."""
    return (2 * law.mu * eps - sigma_y) / (3 * law.mu + H)


@pytest.mark.parametrize("sign", [1, -1])
def test_uniaxial_strain_with_linear_hardening(sign):
    law = VonMises(E, NU, 20.0, H=50.0)
    eps = np.linspace(0, 0.3, 7)
    F = np.stack([np.diag([math.exp(sign * e), 1, 1]) for e in eps])
    sigma, state = history(law, F)
    tau = np.exp(sign * eps)[:, None, None] * sigma
    eps_p = np.maximum(uniaxial_plastic_strain(law, eps, 20.0, 50.0), 0)
    difference = 2 * law.mu * (eps - 1.5 * eps_p)
    assert np.allclose(tau[:, 0, 0] - tau[:, 1, 1], sign * difference, rtol=1e-12)
    assert np.allclose(np.trace(tau, axis1=1, axis2=2) / 3, sign * law.kappa * eps, rtol=1e-12)
    assert np.isclose(law.state_field(state, "eps_p")[0], eps_p[-1], rtol=1e-12)
    # work = energy + dissipation, which is sigma_y deps_p here: hardening is stored
    assert np.isclose(law.state_field(state, "dissipation")[0], 20.0 * eps_p[-1], rtol=1e-12)
    energy = materials.energy(law, F[-1:], state)[0]
    elastic = law.kappa / 2 * eps[-1] ** 2 + law.mu * 2 / 3 * (eps[-1] - 1.5 * eps_p[-1]) ** 2
    assert np.isclose(energy, elastic + 25.0 * eps_p[-1] ** 2, rtol=1e-12)


def test_softening_against_the_closed_solution():
    """Uniaxial strain: 2 mu eps = sigma_y(eps_p) + 3 mu eps_p, solved for eps."""
    law = VonMises(E, NU, 20.0, sigma_r=5.0, eta=3.0)
    eps_p = np.linspace(0.01, 1.5, 30)
    strength = 5.0 + 15.0 * np.exp(-3.0 * eps_p)
    eps = (strength + 3 * law.mu * eps_p) / (2 * law.mu)
    F = np.stack([np.diag([math.exp(e), 1, 1]) for e in eps])
    sigma, state = history(law, F)
    tau = np.exp(eps)[:, None, None] * sigma
    assert np.allclose(tau[:, 0, 0] - tau[:, 1, 1], strength, rtol=1e-12)
    assert np.isclose(law.state_field(state, "eps_p")[0], eps_p[-1], rtol=1e-12)


@pytest.mark.parametrize("name", PLASTIC)
def test_work_is_energy_and_dissipation(name):
    """Along a path that loads and unloads; at least of first order in the step."""
    law = LAWS[name]()
    errors = []
    for n in (800, 1600):
        t = np.linspace(0, 1, n + 1)
        F = simple_shear(np.sin(4 * t))
        F[:, 1, 1] += 0.1 * t
        sigma, state = history(law, F)
        P = np.linalg.det(F)[:, None, None] * sigma @ np.linalg.inv(F).mT
        work = np.sum((P[1:] + P[:-1]) / 2 * np.diff(F, axis=0))
        stored = materials.energy(law, F[-1:], state)[0]
        errors.append(abs((stored + law.state_field(state, "dissipation")[0]) / work - 1))
    assert errors[0] < 0.002 and errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("n", [1, 100])
def test_dissipation_of_softening(n):
    """The area under the yield stress, all of which is dissipated, for steps of any length."""
    law = VonMises(E, NU, 20.0, sigma_r=5.0, eta=3.0)
    F = np.stack([np.diag([math.exp(-e), math.exp(e), 1]) for e in np.linspace(0, 1, n + 1)])
    _, state = history(law, F)
    eps_p = law.state_field(state, "eps_p")[0]
    area = 5.0 * eps_p + 15.0 / 3.0 * (1 - math.exp(-3.0 * eps_p))
    assert np.isclose(law.state_field(state, "dissipation")[0], area, rtol=1e-12)


@pytest.mark.parametrize("name", PLASTIC)
@pytest.mark.parametrize("strain", [0.05, 0.3])
def test_yield_condition_and_plastic_volume(name, strain):
    law = LAWS[name]()
    n = 50
    state = law.initial_state(n)
    F = np.tile(np.eye(3), (n, 1, 1))
    for step in range(20):
        F = F @ deformations(strain / 5, n, seed=step)
        old = law.state_field(state, "eps_p").copy()
        sigma = materials.stress(law, F, state=state)
        eps_p = law.state_field(state, "eps_p")
        if name == "hardening":
            strength = 20.0 + 50.0 * eps_p
        else:
            strength = 5.0 + 15.0 * np.exp(-3.0 * eps_p)
        q = mises(law, F, sigma)
        yields = eps_p > old
        assert np.all(eps_p >= old)
        assert np.allclose(q[yields], strength[yields], rtol=1e-12)
        assert np.all(q <= strength * (1 + 1e-12))
        # the last increment only: b_e = F C_p^-1 F^T loses digits with the condition of F
        C = law.state_field(state, "C_p_inverse")
        error = np.abs(np.linalg.det(C) - 1)
        assert np.all(error < 1e-12 * np.linalg.cond(F) ** 2)
        again = state.copy()
        assert relative(materials.stress(law, F, state=again), sigma) < 1e-11
        assert np.allclose(again, state, rtol=1e-10, atol=1e-13)
    assert np.all(eps_p > 0)


def test_small_increments_at_yield():
    """A million of them would be a simulation; the yield condition holds after each."""
    law = LAWS["softening"]()
    state = law.initial_state(1)
    for e in 0.1 + 1e-9 * np.arange(1000):
        F = np.diag([math.exp(-e), math.exp(e), 1])[None]
        sigma = materials.stress(law, F, state=state)
        strength = 5.0 + 15.0 * math.exp(-3.0 * law.state_field(state, "eps_p")[0])
        assert np.isclose(mises(law, F, sigma)[0], strength, rtol=1e-12)


def test_plastic_flow_keeps_volume():
    """After a moderate step to round-off."""
    law = VonMises(E, NU, 1.0)
    state = law.initial_state(50)
    materials.stress(law, deformations(0.1), state=state)
    assert np.abs(np.linalg.det(law.state_field(state, "C_p_inverse")) - 1).max() < 1e-12


def test_elastic_steps_leave_the_state():
    law = VonMises(E, NU, 1e6)
    state = law.initial_state(50)
    materials.stress(law, deformations(0.3), state=state)
    assert np.all(state == law.initial_state(50))


@pytest.mark.parametrize("name", ["Hencky", *PLASTIC])
@pytest.mark.parametrize("strain", [0.0, 1e-7, 0.02, 0.2])
def test_tangent(name, strain):
    """Differences of the stress, from undeformed and from plastic states, with equal strains."""
    law, n = LAWS[name](), 20
    state = law.initial_state(n)
    F = np.tile(np.eye(3), (n, 1, 1))
    for step in range(3):
        if step > 0:
            materials.stress(law, F, state=state)
        F = F @ deformations(strain, n, seed=step)
        F[0] = np.diag([1 + strain, 1, 1]) ** (step + 1)
        F[1] = np.eye(3)

        def stress(F):
            J = np.linalg.det(F)[:, None, None]
            return J * materials.stress(law, F, state=state.copy()) @ np.linalg.inv(F).mT

        old = state.copy()
        tangent = materials.tangent(law, F, state)
        assert np.all(state == old)
        h = 1e-5
        for k, m in np.ndindex(3, 3):
            d = np.zeros((3, 3))
            d[k, m] = h
            slope = (stress(F + d) - stress(F - d)) / (2 * h)
            assert np.abs(slope - tangent[..., k, m]).max() < 1e-6 * np.abs(tangent).max()
    if name != "Hencky":
        assert (strain > 0.01) == np.any(law.state_field(state, "eps_p") > 0)


# --- parameters ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Hencky(-1.0, 0.3), "Young's modulus must be positive and finite: E = -1.0 Pa"),
        (lambda: Hencky(0.0, 0.3), "E = 0.0"),
        (lambda: Hencky(math.nan, 0.3), "E = nan"),
        (lambda: Hencky(1.0, 0.5), r"\(-1, 0.5\): nu = 0.5.*use 0.499"),
        (lambda: Hencky(1.0, -1.0), "nu = -1.0"),
        (lambda: Hencky(1.0, math.nan), "nu = nan"),
        (lambda: NeoHookean(1.0, 0.5).pointwise(), "finite bulk modulus"),
        (lambda: VonMises(1.0, 0.3, 0.0), "yield stress must be positive and finite: sigma_y"),
        (lambda: VonMises(1.0, 0.3, -1.0), "sigma_y = -1.0"),
        (lambda: VonMises(1.0, 0.3, math.nan), "sigma_y = nan"),
        (lambda: VonMises(1.0, 0.3, 1.0, H=-1.0), "H = -1.0 Pa. Softening is described"),
        (lambda: VonMises(1.0, 0.3, 1.0, eta=1.0), "without a residual yield stress"),
        (lambda: VonMises(1.0, 0.3, 1.0, sigma_r=-1.0, eta=1.0), "sigma_r = -1.0"),
        (lambda: VonMises(1.0, 0.3, 1.0, sigma_r=0.1), "eta = 0.0"),
        (lambda: VonMises(1.0, 0.3, 1.0, sigma_r=0.1, eta=5.0), "steeper than the elastic"),
        (lambda: NewtonianFluid(0.0), "bulk modulus must be positive and finite: kappa = 0.0"),
        (lambda: NewtonianFluid(1.0, -1.0), "viscosity must be finite and not negative: mu = -1.0"),
        (lambda: materials.stress(Hencky(1.0, 0.3), np.eye(3)), r"shape \(n, 3, 3\), not \(3, 3\)"),
        (
            lambda: materials.stress(VonMises(1.0, 0.3, 1.0), [np.eye(3)], state=np.zeros((1, 2))),
            r"float64 of shape \(1, 11\)",
        ),
        (
            lambda: materials.stress(Hencky(1.0, 0.3), [np.eye(3)], np.zeros((2, 3, 3))),
            "velocity gradients",
        ),
        (lambda: Law(shear_only, [math.nan], 1.0), "parameters of a law must be finite"),
        (lambda: Law(shear_only, [1.0], 0.0), "wave_speed_modulus = 0.0"),
        (lambda: Law(shear_only, [1.0], 1.0, {"a": ((), math.inf)}), "state field 'a'"),
        (lambda: materials.energy(Law(shear_only, [1.0], 1.0), [np.eye(3)]), "no energy"),
        (lambda: materials.tangent(Law(shear_only, [1.0], 1.0), [np.eye(3)]), "no tangent"),
    ],
)
def test_what_is_wrong_is_said(make, message):
    with pytest.raises(ValueError, match=message):
        make()


PARAMETERS = {
    Hencky: {"E": 1.0, "nu": 0.3},
    NeoHookean: {"E": 1.0, "nu": 0.3},
    VonMises: {"E": 1.0, "nu": 0.3, "sigma_y": 1.0, "H": 1.0, "sigma_r": 0.9, "eta": 0.1},
    NewtonianFluid: {"kappa": 1.0, "mu": 1.0},
}


@pytest.mark.parametrize("law", PARAMETERS)
@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("0.3", "'0.3'"),
        (None, "None"),
        (0.3 + 0j, r"\(0.3\+0j\)"),
        (np.array([0.3, 0.4]), r"array\(\[0.3, 0.4\]\)"),
        ([0.3], r"\[0.3\]"),
        ([[0.3], [0.3, 0.4]], r"\[\[0.3\], \[0.3, 0.4\]\]"),
        (math.nan, "nan"),
        (math.inf, "inf"),
        (-math.inf, "-inf"),
        (np.float32(-2.5), "-2.5"),
    ],
)
def test_wrong_parameters_are_shown(law, value, shown):
    """Any parameter of any law: its name and the value that was given."""
    assert law(**PARAMETERS[law])
    # None is no residual strength
    for name in set(PARAMETERS[law]) - ({"sigma_r"} if value is None else set()):
        with pytest.raises(ValueError, match=f"{name} = {shown}"):
            law(**{**PARAMETERS[law], name: value})


def test_numbers_of_other_types():
    """Integers and numpy's numbers are numbers, and laws with them the same."""
    numbers = (2, np.int32(2), np.float32(2), np.array(2.0))
    for law in (Hencky, NeoHookean):
        for E in numbers:
            assert repr(law(E, np.float32(0.25))) == repr(law(2.0, 0.25))
            assert law(E, 0).mu == 1.0


@pytest.mark.parametrize(
    ("law", "nu", "message"),
    [
        (Hencky, -1, r"\(-1, 0.5\): nu = -1.0. At -1 the shear modulus is infinite$"),
        (NeoHookean, -1, r"\(-1, 0.5\]: nu = -1.0. At -1 the shear modulus is infinite$"),
        (Hencky, 0.5, r"\(-1, 0.5\): nu = 0.5. A stress .* use 0.499"),
        (
            Hencky,
            3,
            r"nu = 3.0. Use nu = 0.5 for .* material. A stress .* use 0.499",
        ),
        (NeoHookean, 0.6, r"nu = 0.6. Use nu = 0.5 for an incompressible material$"),
        (NeoHookean, math.nan, r"\(-1, 0.5\]: nu = nan$"),
    ],
)
def test_what_is_said_of_poissons_ratio(law, nu, message):
    with pytest.raises(ValueError, match=message):
        law(1.0, nu)


@pytest.mark.parametrize("values", ["0.3", ["0.3"], [None], [1.0, "x"], [[1.0], [1.0, 2.0]]])
def test_own_laws_take_numbers(values):
    for make in (
        lambda: Law(shear_only, values, 1.0),
        lambda: Law(shear_only, [1.0], 1.0, {"a": ((), values)}),
        lambda: materials.from_energy(lambda F, c: c * ufl.tr(F), values),
    ):
        with pytest.raises(ValueError, match="must be numbers, not ") as error:
            make()
        assert repr(values) in str(error.value)
    with pytest.raises(ValueError, match="wave_speed_modulus = "):
        Law(shear_only, [1.0], values)


def test_softening_warns(said):
    VonMises(E, NU, 1.0, H=1.0)
    VonMises(E, NU, 1.0, sigma_r=2.0, eta=1.0)
    assert not said
    VonMises(E, NU, 1.0, sigma_r=0.5, eta=1.0)
    (line,) = said
    assert "without a length scale" in line


def test_print():
    assert repr(Hencky(E, NU)) == "Hencky(E=1000 Pa, nu=0.3)"
    assert "sigma_y=20 Pa, H=50 Pa" in repr(LAWS["hardening"]())
    assert repr(NewtonianFluid(2e9, 1e-3)) == "NewtonianFluid(kappa=2e+09 Pa, mu=0.001 Pa s)"
    assert "wave_speed_modulus=" in repr(LAWS["miehe"]())


def test_wave_speed_of_cooks_membrane():
    """The F-bar paper's time step 0.3 h / c = 2.773 ms (section 4.1), with density 1."""
    law = NeoHookean(70.0, 0.499).pointwise()
    assert np.isclose(0.3 / math.sqrt(law.wave_speed_modulus), 2.773e-3, rtol=3e-4)


def test_wave_speed_of_the_strip_footing():
    """Hencky: ratio of modulus and density from E and nu, lambda + 2 mu."""
    law = Hencky(E, NU)
    lame = E * NU / ((1 + NU) * (1 - 2 * NU))
    assert np.isclose(law.wave_speed_modulus, lame + 2 * law.mu, rtol=1e-14)


# --- energies in UFL ---


def neo_hookean_energy(F, mu, kappa):
    J = ufl.det(F)
    return mu / 2 * (J ** (-2 / 3) * ufl.inner(F, F) - 3) + kappa / 2 * (J - 1) ** 2


@pytest.mark.parametrize("strain", STRAINS)
def test_law_from_an_energy(strain):
    """Of the same law as the compiled one; parameters can be others without compilation."""
    F = deformations(strain)
    for E in (1000.0, 70.0):
        mu, kappa = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
        law = materials.from_energy(neo_hookean_energy, (mu, kappa))
        exact = NeoHookean(E, NU).pointwise()
        assert np.isclose(law.wave_speed_modulus, exact.wave_speed_modulus, rtol=1e-7)
        sigma, expected = materials.stress(law, F), materials.stress(exact, F)
        assert np.abs(sigma - expected).max() < 1e-12 * np.abs(expected).max() + 1e-14 * E
        psi, expected = materials.energy(law, F), materials.energy(exact, F)
        assert np.abs(psi - expected).max() < 1e-12 * np.abs(expected).max() + 1e-14 * E


def test_energies_share_the_compiled_loop():
    a = materials.from_energy(neo_hookean_energy, (MU, KAPPA))
    b = materials.from_energy(lambda F: 3 * (ufl.tr(F) - 3) ** 2)
    assert a.update is b.update
    F = deformations(0.1)
    # P = 6 (tr F - 3) I
    P = 6 * (np.trace(F, axis1=1, axis2=2) - 3)[:, None, None] * np.eye(3)
    assert np.isclose(b.wave_speed_modulus, 6.0, rtol=1e-7)
    assert relative(materials.stress(b, F), P @ F.mT / np.linalg.det(F)[:, None, None]) < 1e-12
    assert np.isnan(materials.stress(b, -F)).all()
    assert "EnergyLaw(parameters=[], wave_speed_modulus=6" in repr(b)


def test_wrong_energies():
    with pytest.raises(ValueError, match=r"must be scalar: its shape is \(3, 3\)"):
        materials.from_energy(lambda F: F)
    with pytest.raises(ValueError, match="must be positive and finite: wave_speed_modulus = -"):
        materials.from_energy(lambda F: -ufl.inner(F - ufl.Identity(3), F - ufl.Identity(3)))


# --- one's own law ---------------------------------------------------------------------------


@compiled
def shear_only(F, L, parameters, state, sigma):
    """Shear stress by shear strain, and a count of the steps."""
    sigma[:, :] = 0.0
    sigma[0, 1] = sigma[1, 0] = parameters[0] * F[0, 1]
    state[0] += 1


def test_a_law_of_ones_own():
    law = Law(shear_only, [3.0], 10.0, {"count": ((), 5.0), "other": ((2,), [1.0, 2.0])})
    assert law.n_state == 3
    state = law.initial_state(4)
    sigma = materials.stress(law, simple_shear(np.arange(4.0)), state=state)
    assert np.all(sigma[:, 0, 1] == 3.0 * np.arange(4))
    assert np.all(law.state_field(state, "count") == 6)
    assert np.all(law.state_field(state, "other") == [1, 2])
    with pytest.raises(KeyError, match="no state field 'C_p'"):
        law.state_field(state, "C_p")


def test_a_law_must_be_compiled():
    with pytest.raises(TypeError, match=r"Decorate it with @fenicsmpm\.materials\.compiled"):
        Law(lambda F, L, parameters, state, sigma: None, [1.0], 1.0)
