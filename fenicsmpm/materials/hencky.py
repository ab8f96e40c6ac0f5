# SPDX-License-Identifier: MIT
"""Hencky's law: linear in the logarithmic strain."""

from __future__ import annotations

import math

import numpy as np

from fenicsmpm.materials.law import Law, compiled, elastic_moduli, p_wave_modulus
from fenicsmpm.materials.tensors import compose, eigen, metric_change, volume_change


@compiled
def deviatoric_strain(b):  # type: ignore[no-untyped-def]
    """Principal values and directions of the deviatoric logarithmic strain 1/2 dev(ln b).

    Args:
        b: symmetric tensor b - I.

    Returns:
        Three values [-], and a tuple of 9 with the directions in its columns.
    """
    change, n = eigen(b)
    e1 = 0.5 * math.log1p(change[0])
    e2 = 0.5 * math.log1p(change[1])
    e3 = 0.5 * math.log1p(change[2])
    mean = (e1 + e2 + e3) / 3
    return (e1 - mean, e2 - mean, e3 - mean), n


@compiled
def set_cauchy_stress(sigma, mean, s, n, jacobian):  # type: ignore[no-untyped-def]
    """Set sigma to (mean I + s) / J, with principal values s in directions n."""
    t11, t22, t33, t12, t13, t23 = compose(s, n)
    r = 1 / jacobian
    sigma[0, 0] = r * (t11 + mean)
    sigma[1, 1] = r * (t22 + mean)
    sigma[2, 2] = r * (t33 + mean)
    sigma[0, 1] = sigma[1, 0] = r * t12
    sigma[0, 2] = sigma[2, 0] = r * t13
    sigma[1, 2] = sigma[2, 1] = r * t23


@compiled
def stored_energy(mu, kappa, log_j, e):  # type: ignore[no-untyped-def]
    """kappa/2 (ln J)^2 + mu e : e per initial volume, with deviatoric principal strains e."""
    return 0.5 * kappa * log_j**2 + mu * (e[0] ** 2 + e[1] ** 2 + e[2] ** 2)


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa = parameters[0], parameters[1]
    change = volume_change(F)
    e, n = deviatoric_strain(metric_change(F))
    s = (2 * mu * e[0], 2 * mu * e[1], 2 * mu * e[2])
    set_cauchy_stress(sigma, kappa * math.log1p(change), s, n, 1 + change)


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    e, _ = deviatoric_strain(metric_change(F))
    return stored_energy(parameters[0], parameters[1], math.log1p(volume_change(F)), e)


class Hencky(Law):
    """Hencky's law (F-bar paper, sections 4.2 and 4.4; conservation paper, equation A.14).

    Kirchhoff stress tau = J sigma = kappa ln(J) I + 2 mu dev(eps), with the logarithmic strain
    eps = 1/2 ln(F F^T); energy kappa/2 (ln J)^2 + mu dev(eps) : dev(eps) per initial volume.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: shear modulus [Pa].
        kappa: bulk modulus [Pa].

    Raises:
        ValueError: for parameters out of range.
    """

    def __init__(self, E: float, nu: float) -> None:
        """Check and store the parameters."""
        self.E, self.nu = E, nu
        self.mu, self.kappa = elastic_moduli(E, nu)
        modulus = p_wave_modulus(self.mu, self.kappa)
        super().__init__(_update, np.array([self.mu, self.kappa]), modulus, energy=_energy)

    def __repr__(self) -> str:
        """Parameters with units."""
        return f"Hencky(E={self.E:g} Pa, nu={self.nu:g})"
