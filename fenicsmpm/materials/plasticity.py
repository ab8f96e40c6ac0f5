# SPDX-License-Identifier: MIT
"""Von Mises plasticity with Hencky's law and radial return."""

from __future__ import annotations

import logging
import math

import numpy as np

from fenicsmpm._numbers import number, positive
from fenicsmpm.lanes import between, choose
from fenicsmpm.materials.hencky import (
    are_small,
    deviatoric_strain,
    principal_deviatoric_strain,
    set_cauchy_stress,
    set_tangent,
    small_deviatoric_strain,
    stored_energy,
)
from fenicsmpm.materials.law import Law, compiled, elastic_moduli, p_wave_modulus
from fenicsmpm.materials.principal_stress import elastic_deformation
from fenicsmpm.materials.tensors import (
    SMALL,
    congruence,
    cube_root,
    exponential,
    exprel,
    exprel_small,
    inverse,
    log_of_one_plus,
    log_of_one_plus_small,
    norm_squared,
    rows,
    small_exponential,
    volume_change,
)

logger = logging.getLogger(__name__)

# Columns of the state, in the order of VonMises.state
_EPS_P, _DISSIPATION = 9, 10


@compiled
def _decay(eps_p, parameters):  # type: ignore[no-untyped-def]
    """Return the remaining share exp(-eta eps_p) of sigma_y - sigma_r."""
    return math.exp(-parameters[4] * eps_p)


@compiled
def yield_stress(eps_p, decay, parameters):  # type: ignore[no-untyped-def]
    """Return sigma_r + (sigma_y - sigma_r) exp(-eta eps_p) + H eps_p and its derivative [Pa].

    Args:
        eps_p: Accumulated plastic strain [-].
        decay: exp(-eta eps_p) [-].
        parameters: Parameters of the law.
    """
    sigma_y, sigma_r, eta, H = parameters[2], parameters[3], parameters[4], parameters[5]
    excess = (sigma_y - sigma_r) * decay
    return sigma_r + excess + H * eps_p, H - eta * excess


@compiled
def _equivalent_stress(mu, ee):  # type: ignore[no-untyped-def]
    """Return the von Mises stress sqrt(3/2) |2 mu e| for a deviatoric strain with ee = e : e."""
    return mu * math.sqrt(6 * ee)


@compiled
def _plastic_increment(q, eps_p, parameters):  # type: ignore[no-untyped-def]
    """Return the increment d of eps_p: zero, or the root of q - 3 mu d = sigma_y(eps_p + d).

    Newton's method converges from any starting point, because the function is monotone and either
    convex or concave. With linear hardening the first step is exact.
    """
    mu = parameters[0]
    d = 0.0
    value, slope = yield_stress(eps_p, _decay(eps_p, parameters), parameters)
    excess = q - value
    if excess <= 0:
        return d
    for _ in range(30):
        if not abs(excess) > 1e-15 * q:  # also ends for NaN
            break
        d += excess / (3 * mu + slope)
        value, slope = yield_stress(eps_p + d, _decay(eps_p + d, parameters), parameters)
        excess = q - 3 * mu * d - value
    return d


@compiled
def _small_plastic_increment(q, eps_p, decay, parameters):  # type: ignore[no-untyped-def]
    """Return ``_plastic_increment`` for eight points, and whether eta d is small, as assumed."""
    mu, eta = parameters[0], parameters[4]
    d = step = 0 * q
    for _ in range(4):
        x = -eta * d
        value, slope = yield_stress(eps_p + d, decay * (1 + x * exprel_small(x)), parameters)
        before = d
        d = max(d + (q - 3 * mu * d - value) / (3 * mu + slope), 0.0)
        step = d - before
    excess = 3 * mu * step
    is_solved = between(1e-28 * q * q - excess * excess, 0.0, math.inf)
    return d, is_solved and between(eta * d, 0.0, SMALL)


@compiled
def _dissipated(d, decay, exprel, parameters):  # type: ignore[no-untyped-def]
    """Return the integral of sigma_y - H eps_p over the increment d, given exprel(-eta d)."""
    sigma_y, sigma_r = parameters[2], parameters[3]
    return sigma_r * d + (sigma_y - sigma_r) * decay * d * exprel


@compiled
def _flow(F, change, b, d, dissipated, state):  # type: ignore[no-untyped-def]
    """Update the state where d > 0, given the volume-preserving part exp(2 e) of b_e."""
    # C_p^-1 = F^-1 b_e F^-T. Its determinant follows from J, so that errors do not accumulate.
    root = cube_root(1 + change)
    r = root * root
    c = congruence(inverse(rows(F)), (r * b[0], r * b[1], r * b[2], r * b[3], r * b[4], r * b[5]))
    state[0] = choose(d, c[0], state[0])
    state[4] = choose(d, c[1], state[4])
    state[8] = choose(d, c[2], state[8])
    state[1] = state[3] = choose(d, c[3], state[3])
    state[2] = state[6] = choose(d, c[4], state[6])
    state[5] = state[7] = choose(d, c[5], state[7])
    state[_EPS_P] += d
    state[_DISSIPATION] += dissipated


@compiled
def _scaled(f, e):  # type: ignore[no-untyped-def]
    return f * e[0], f * e[1], f * e[2], f * e[3], f * e[4], f * e[5]


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa, eta = parameters[0], parameters[1], parameters[4]
    change = volume_change(F)
    log_j = log_of_one_plus(change)
    e = deviatoric_strain(elastic_deformation(F, state))
    q = _equivalent_stress(mu, norm_squared(e))
    d = _plastic_increment(q, state[_EPS_P], parameters)
    if d > 0:
        e = _scaled(1 - 3 * mu * d / q, e)
        decay = _decay(state[_EPS_P], parameters)
        dissipated = _dissipated(d, decay, exprel(-eta * d), parameters)
        _flow(F, change, exponential(_scaled(2.0, e)), d, dissipated, state)
    set_cauchy_stress(sigma, kappa * log_j, 2 * mu, e, 1 + change)


@compiled
def _least_yield_stress(eps_p, parameters):  # type: ignore[no-untyped-def]
    """Return a lower bound of the yield stress without an exponential, exact at eps_p = 0."""
    sigma_y, sigma_r, eta, H = parameters[2], parameters[3], parameters[4], parameters[5]
    x = eta * eps_p
    if sigma_y > sigma_r:  # (1 - x/8)^8 < exp(-x)
        y = max(1 - x / 8, 0)
        y *= y
        y *= y
        y *= y
    else:
        y = 1 / (1 + x)
    return sigma_r + (sigma_y - sigma_r) * y + H * eps_p


@compiled
def _update_eight(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    mu, kappa, eta = parameters[0], parameters[1], parameters[4]
    change, b = volume_change(F), elastic_deformation(F, state)
    if not are_small(change, b):
        return False
    e = small_deviatoric_strain(b)
    eps_p = state[_EPS_P]
    q = _equivalent_stress(mu, norm_squared(e))
    if not between(_least_yield_stress(eps_p, parameters) - q, 0.0, math.inf):
        decay = _decay(eps_p, parameters)
        d, is_small = _small_plastic_increment(q, eps_p, decay, parameters)
        if not is_small:
            return False
        e = _scaled(choose(d, 1 - 3 * mu * d / q, 1.0), e)
        dissipated = _dissipated(d, decay, exprel_small(-eta * d), parameters)
        _flow(F, change, small_exponential(_scaled(2.0, e)), d, dissipated, state)
    set_cauchy_stress(sigma, kappa * log_of_one_plus_small(change), 2 * mu, e, 1 + change)
    return True


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    e = deviatoric_strain(elastic_deformation(F, state))
    elastic = stored_energy(parameters[0], parameters[1], log_of_one_plus(volume_change(F)), e)
    return elastic + 0.5 * parameters[5] * state[_EPS_P] ** 2


@compiled
def _tangent(F, parameters, state, dPdF):  # type: ignore[no-untyped-def]
    mu = parameters[0]
    e, n = principal_deviatoric_strain(elastic_deformation(F, state))
    q = _equivalent_stress(mu, e[0] ** 2 + e[1] ** 2 + e[2] ** 2)
    d = _plastic_increment(q, state[_EPS_P], parameters)
    factor, c = 1.0, 0.0
    if d > 0:
        # dev tau = 2 mu factor e with factor = 1 - 3 mu d / q, dd/dq = 1 / (3 mu + slope)
        factor = 1 - 3 * mu * d / q
        eps_p = state[_EPS_P] + d
        slope = yield_stress(eps_p, _decay(eps_p, parameters), parameters)[1]
        c = 36 * mu**4 / q**2 * (d / q - 1 / (3 * mu + slope))
    log_j = log_of_one_plus(volume_change(F))
    set_tangent(F, log_j, e, n, factor * mu, parameters[1], c, dPdF)


class VonMises(Law):
    """Von Mises (J2) plasticity with Hencky's law.

    See the F-bar paper, section 4, and the conservation paper, sections 7.3 and 7.4.

    The Kirchhoff stress tau = J sigma obeys ``sqrt(3/2) |dev tau| <= sigma_y(eps_p)``. Here eps_p
    is the accumulated plastic strain, whose rate is sqrt(2/3) times the norm of the plastic strain
    rate. The yield stress is

        sigma_y(eps_p) = sigma_r + (sigma_y - sigma_r) exp(-eta eps_p) + H eps_p .

    Without sigma_r this is linear hardening, sigma_y + H eps_p (conservation, equation 63). The
    elastic part of the deformation is b_e = F C_p^-1 F^T. Plastic flow is associated and preserves
    volume. It is integrated implicitly (radial return of the logarithmic strain).

    The uniaxial yield stress sigma_y corresponds to the shear strength sigma_y / sqrt(3) in plane
    strain and in simple shear. It corresponds to an undrained strength s_u in triaxial compression
    with sigma_y = 2 s_u.

    The F-bar paper (section 4.4) prints the strengths kappa of its landslide without a yield
    function. This law treats them as bounds of ``|dev tau|``, so sigma_y = sqrt(3/2) kappa. Then
    40.82 and 2.45 kPa correspond to s_u = 25 and 1.5 kPa in triaxial compression. In no other norm
    are the strengths such round numbers.

    The state has three fields:

    - "C_p_inverse" ``(3, 3)`` is the inverse plastic right Cauchy-Green tensor [-].
    - "eps_p" is the accumulated plastic strain [-].
    - "dissipation" is the plastic work per initial volume that is not stored [J/m^3], the integral
      of sigma_y(eps_p) - H eps_p over eps_p. With linear hardening this is the dissipation of the
      paper (conservation, below equation 47).

    Hardening stores H eps_p^2 / 2, which is part of the energy. In all cases, the stress is the
    derivative of energy plus dissipation with respect to F.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.
        sigma_y: Initial yield stress in uniaxial tension [Pa], positive.
        H: Linear hardening modulus [Pa], not negative.
        sigma_r: Residual yield stress [Pa], positive. The material softens if it is below sigma_y
            and hardens up to it otherwise. Softening localizes in bands as narrow as the mesh
            allows, since the law has no length scale. A warning is logged.
        eta: Rate at which the yield stress approaches sigma_r [-]. It must be positive if sigma_r
            is given.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa].

    Raises:
        ValueError: If a parameter is out of range, or softening is so steep that the stress is not
            unique.
    """

    def __init__(
        self,
        E: float,
        nu: float,
        sigma_y: float,
        H: float = 0.0,
        sigma_r: float | None = None,
        eta: float = 0.0,
    ) -> None:
        """Check and store the parameters."""
        self.mu, self.kappa = elastic_moduli(E, nu)
        self.E, self.nu = float(E), float(nu)
        sigma_y = positive(sigma_y, "sigma_y", "yield stress", "Pa")
        H = number(H, "H", "hardening modulus", "Pa")
        if not 0 <= H < math.inf:
            raise ValueError(
                f"hardening modulus must be finite and not negative: H = {H} Pa. "
                "Softening is described by sigma_r and eta."
            )
        if sigma_r is None:
            if number(eta, "eta", "rate of softening", "-") != 0:
                raise ValueError(f"eta = {eta} without a residual yield stress: give sigma_r too")
            sigma_r = sigma_y
        else:
            sigma_r = positive(sigma_r, "sigma_r", "residual yield stress", "Pa")
            eta = positive(eta, "eta", "rate of softening", "-")
        steepest = eta * (sigma_y - sigma_r) - H
        if steepest >= 3 * self.mu:
            raise ValueError(
                f"softening is steeper than the elastic unloading: eta (sigma_y - sigma_r) - H = "
                f"{steepest:g} Pa must be less than 3 mu = {3 * self.mu:g} Pa"
            )
        if steepest > 0:
            logger.warning(
                "softening without a length scale: the width of shear bands, and with it the "
                "dissipation, depends on the mesh"
            )
        super().__init__(
            _update,
            np.array([self.mu, self.kappa, sigma_y, sigma_r, eta, H]),
            p_wave_modulus(self.mu, self.kappa),
            {"C_p_inverse": ((3, 3), np.eye(3)), "eps_p": ((), 0.0), "dissipation": ((), 0.0)},
            energy=_energy,
            tangent=_tangent,
            update_eight=_update_eight,
            needs_rate=False,
        )

    def __repr__(self) -> str:
        """Parameters with units."""
        _, _, sigma_y, sigma_r, eta, H = self.parameters
        return (
            f"VonMises(E={self.E:g} Pa, nu={self.nu:g}, sigma_y={sigma_y:g} Pa, H={H:g} Pa, "
            f"sigma_r={sigma_r:g} Pa, eta={eta:g})"
        )
