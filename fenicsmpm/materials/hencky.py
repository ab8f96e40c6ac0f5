# SPDX-License-Identifier: MIT
"""Hencky's law, which is linear in the logarithmic strain."""

from __future__ import annotations

import numpy as np

from fenicsmpm.lanes import between
from fenicsmpm.materials.law import Law, compiled, elastic_moduli, p_wave_modulus
from fenicsmpm.materials.principal_stress import set_tangent as set_principal_tangent
from fenicsmpm.materials.tensors import (
    SMALL,
    deviator,
    eigen,
    log_of_one_plus,
    log_of_one_plus_small,
    logarithm,
    metric_change,
    norm_squared,
    small_logarithm,
    volume_change,
)


@compiled
def deviatoric_strain(b):  # type: ignore[no-untyped-def]
    """Return the deviatoric logarithmic strain 1/2 dev(ln b), a symmetric tensor.

    Args:
        b: Symmetric tensor b - I, as in ``tensors``.
    """
    return _half(deviator(logarithm(b)))


@compiled
def small_deviatoric_strain(b):  # type: ignore[no-untyped-def]
    """Return ``deviatoric_strain`` for ``|b - I| < SMALL``, without a branch.

    Args:
        b: Symmetric tensor b - I, as in ``tensors``.
    """
    return _half(deviator(small_logarithm(b)))


@compiled
def _half(A):  # type: ignore[no-untyped-def]
    return 0.5 * A[0], 0.5 * A[1], 0.5 * A[2], 0.5 * A[3], 0.5 * A[4], 0.5 * A[5]


@compiled
def are_small(change, b):  # type: ignore[no-untyped-def]
    """Return whether J - 1 and b - I are small enough for series at all eight points.

    Args:
        change: J - 1.
        b: Symmetric tensor b - I, as in ``tensors``.
    """
    return between(change, -SMALL, SMALL) and between(norm_squared(b), 0.0, SMALL**2)


@compiled
def principal_deviatoric_strain(b):  # type: ignore[no-untyped-def]
    """Return the principal values of ``deviatoric_strain`` [-], and the principal directions.

    The directions are the columns of a tuple of 9.

    Args:
        b: Symmetric tensor b - I, as in ``tensors``.
    """
    change, n = eigen(b)
    e1 = 0.5 * log_of_one_plus(change[0])
    e2 = 0.5 * log_of_one_plus(change[1])
    e3 = 0.5 * log_of_one_plus(change[2])
    mean = (e1 + e2 + e3) / 3
    return (e1 - mean, e2 - mean, e3 - mean), n


@compiled
def set_cauchy_stress(sigma, mean, two_mu, e, jacobian):  # type: ignore[no-untyped-def]
    """Set sigma to (mean I + 2 mu e) / J.

    Args:
        sigma: Result ``(3, 3)`` [Pa].
        mean: Mean Kirchhoff stress [Pa].
        two_mu: 2 mu [Pa].
        e: Deviatoric strain, a symmetric tensor [-].
        jacobian: J [-].
    """
    r = 1 / jacobian
    s = r * two_mu
    sigma[0, 0] = s * e[0] + r * mean
    sigma[1, 1] = s * e[1] + r * mean
    sigma[2, 2] = s * e[2] + r * mean
    sigma[0, 1] = sigma[1, 0] = s * e[3]
    sigma[0, 2] = sigma[2, 0] = s * e[4]
    sigma[1, 2] = sigma[2, 1] = s * e[5]


@compiled
def stored_energy(mu, kappa, log_j, e):  # type: ignore[no-untyped-def]
    """Return the energy kappa/2 (ln J)^2 + mu e : e per initial volume [J/m^3].

    Args:
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa].
        log_j: ln J [-].
        e: Deviatoric strain, a symmetric tensor [-].
    """
    return 0.5 * kappa * log_j**2 + mu * norm_squared(e)


@compiled
def set_tangent(F, log_j, e, n, mu, kappa, c, dPdF):  # type: ignore[no-untyped-def]
    """Set dPdF for d tau_a / d eps_b = kappa + 2 mu (delta_ab - 1/3) + c e_a e_b.

    Args:
        F: Deformation gradient ``(3, 3)``.
        log_j: ln J.
        e: Principal deviatoric strains, in plasticity those before the return mapping.
        n: Tuple of 9 with the principal directions in its columns.
        mu: Ratio of tau_a - tau_b to 2 (e_a - e_b) [Pa].
        kappa: Bulk modulus [Pa].
        c: Coefficient c above [Pa].
        dPdF: Result ``(3, 3, 3, 3)`` [Pa].
    """
    p, third = kappa * log_j, log_j / 3
    x, y, z = e
    tau = p + 2 * mu * x, p + 2 * mu * y, p + 2 * mu * z
    strain = x + third, y + third, z + third
    same, other = kappa + 4 / 3 * mu, kappa - 2 / 3 * mu
    D = (
        same + c * x * x, other + c * x * y, other + c * x * z,
        other + c * y * x, same + c * y * y, other + c * y * z,
        other + c * z * x, other + c * z * y, same + c * z * z,
    )  # fmt: skip
    set_principal_tangent(F, strain, n, tau, D, (2 * mu, 2 * mu, 2 * mu), dPdF)


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa = parameters[0], parameters[1]
    change = volume_change(F)
    e = deviatoric_strain(metric_change(F))
    set_cauchy_stress(sigma, kappa * log_of_one_plus(change), 2 * mu, e, 1 + change)


@compiled
def _update_eight(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa = parameters[0], parameters[1]
    change, b = volume_change(F), metric_change(F)
    if not are_small(change, b):
        return False
    mean = kappa * log_of_one_plus_small(change)
    set_cauchy_stress(sigma, mean, 2 * mu, small_deviatoric_strain(b), 1 + change)
    return True


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    e = deviatoric_strain(metric_change(F))
    return stored_energy(parameters[0], parameters[1], log_of_one_plus(volume_change(F)), e)


@compiled
def _tangent(F, parameters, state, dPdF):  # type: ignore[no-untyped-def]
    e, n = principal_deviatoric_strain(metric_change(F))
    log_j = log_of_one_plus(volume_change(F))
    set_tangent(F, log_j, e, n, parameters[0], parameters[1], 0.0, dPdF)


class Hencky(Law):
    """Hencky's law (F-bar paper, sections 4.2 and 4.4; conservation paper, equation A.14).

    The Kirchhoff stress is tau = J sigma = kappa ln(J) I + 2 mu dev(eps), with the logarithmic
    strain eps = 1/2 ln(F F^T). The energy per initial volume is kappa/2 (ln J)^2 + mu dev(eps) :
    dev(eps).

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa].

    Raises:
        ValueError: If a parameter is out of range.
    """

    def __init__(self, E: float, nu: float) -> None:
        """Check and store the parameters."""
        self.mu, self.kappa = elastic_moduli(E, nu)
        self.E, self.nu = float(E), float(nu)
        modulus = p_wave_modulus(self.mu, self.kappa)
        super().__init__(
            _update,
            np.array([self.mu, self.kappa]),
            modulus,
            energy=_energy,
            tangent=_tangent,
            update_eight=_update_eight,
            needs_rate=False,
        )

    def __repr__(self) -> str:
        """Parameters with units."""
        return f"Hencky(E={self.E:g} Pa, nu={self.nu:g})"
