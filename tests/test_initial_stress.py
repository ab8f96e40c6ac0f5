# SPDX-License-Identifier: MIT
"""Stress to begin with: F of a stress, bodies at rest under their weight, what cannot be."""

import math

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import mesh

from fenicsmpm import ExplicitMPM, ImplicitMPM, basis, points
from fenicsmpm import formulations as fm
from fenicsmpm.forms import evaluate
from fenicsmpm.materials import (
    Hencky,
    Law,
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


LAWS = [
    NeoHookean(1000.0, 0.3).pointwise(),
    VonMises(1000.0, 0.4, sigma_y=500.0, H=10.0),
    from_energy(
        lambda F, mu, lame: mu / 2 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(ufl.det(F)))
        + lame / 2 * ufl.ln(ufl.det(F)) ** 2,
        (1.0e3, 2.0e3),
    ),
    # anisotropic: fibres along (1, 1, 0)
    from_energy(
        lambda F, mu, fibre: mu / 2 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(ufl.det(F)))
        + fibre / 4 * (ufl.dot(F.T * F * ufl.as_vector((1, 1, 0)), ufl.as_vector((1, 1, 0))) - 2) ** 2,
        (1.0e3, 5.0e2),
    ),
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
        F, reached = stretch_of(law, shear - 500 * np.eye(3))
        # the surface is one of J sigma, here J < 1
        J = np.linalg.det(F[0])
        assert list(stretch_of(law, shear / J - 500 * np.eye(3))[1]) == [True, True, False]


@compiled
def _flows_at_once(F, L, parameters, state, sigma):
    sigma[:, :] = 0.0


def test_a_law_without_resistance():
    law = Law(_flows_at_once, np.empty(0), 1.0)
    assert list(stretch_of(law, np.array([np.zeros((3, 3)), np.eye(3)]))[1]) == [True, False]
