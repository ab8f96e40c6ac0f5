# SPDX-License-Identifier: MIT
"""Modified Cam-Clay plasticity in Hencky strains."""

from __future__ import annotations

import math

import numpy as np

from fenicsmpm._numbers import positive
from fenicsmpm.materials.law import Law, compiled, p_wave_modulus
from fenicsmpm.materials.principal_stress import (
    elastic_deformation,
    principal_strains,
    quotients,
    set_cauchy_stress,
    set_gradient,
    set_plastic_deformation,
    set_tangent,
    work_derivatives,
)
from fenicsmpm.materials.tensors import volume_change

# Columns of the state, in the order of ModifiedCamClay.state
_EPS_V_P, _EPS_P, _DISSIPATION = 9, 10, 11

# Lower bound of the pressure relative to the initial one, exp(-30), so that material that has
# separated can still be computed
_LEAST = -30.0


@compiled
def _invariants(strain, mu):  # type: ignore[no-untyped-def]
    """Return volumetric strain, deviatoric stresses 2 mu e, and q^2 with q = sqrt(3/2) |2 mu e|."""
    volume = strain[0] + strain[1] + strain[2]
    mean, two_mu = volume / 3, 2 * mu
    s = two_mu * (strain[0] - mean), two_mu * (strain[1] - mean), two_mu * (strain[2] - mean)
    return volume, s, 1.5 * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2])


@compiled
def _pressures(volume, eps_v_p, parameters):  # type: ignore[no-untyped-def]
    """Return pressure, its derivative by volumetric strain, and preconsolidation pressure."""
    swelling, difference = parameters[3], parameters[2] - parameters[3]
    exponent = -volume / swelling
    p = parameters[4] * math.exp(max(exponent, _LEAST))
    slope = -p / swelling if exponent > _LEAST else 0.0
    return p, slope, parameters[5] * math.exp(max(-eps_v_p / difference, _LEAST))


@compiled
def _plastic_volume(gamma, p, p_c, parameters):  # type: ignore[no-untyped-def]
    """Return the volumetric plastic strain x = -gamma (2 p - p_c) of a step.

    Here p and p_c are the pressures after the step. The equation is monotone in x, and x lies
    between 0 and its value in the critical state, 2 p = p_c. It is solved by Newton's method, with
    bisection if that leaves the bracket.
    """
    a, b = 1 / parameters[3], 1 / (parameters[2] - parameters[3])
    critical = math.log(p_c / (2 * p)) / (a + b)
    low, high = min(critical, 0.0), max(critical, 0.0)
    x = 0.0
    for _ in range(100):
        new_p, new_c = p * math.exp(a * x), p_c * math.exp(-b * x)
        excess = x + gamma * (2 * new_p - new_c)
        if excess < 0:
            low = x
        else:
            high = x
        step = excess / (1 + gamma * (2 * a * new_p + b * new_c))
        before = x
        x -= step
        if not low <= x <= high:
            x = 0.5 * (low + high)
        if not abs(x - before) > 1e-16 * (abs(low) + abs(high)):
            break
    return x


@compiled
def _solve(volume, Q, eps_v_p, parameters):  # type: ignore[no-untyped-def]
    """Return to the ellipse; return gamma, volumetric plastic strain and pressures after it.

    gamma = 0 means no plastic flow. The unknown is y = ln(1 + 6 mu gamma / M^2); the return divides
    q by exp(y). It is found by Newton's method, with bisection if that leaves the bracket or is
    slow.
    """
    mu, M = parameters[0], parameters[1]
    a, b = 1 / parameters[3], 1 / (parameters[2] - parameters[3])
    p, _slope, p_c = _pressures(volume, eps_v_p, parameters)
    q = Q / (M * M)
    if not q + p * (p - p_c) > 0:
        return 0.0, 0.0, p, p_c
    c = 6 * mu / (M * M)
    low, high, y, last = 0.0, 60.0, 0.0, math.inf
    gamma, x, new_p, new_c = 0.0, 0.0, p, p_c
    for _ in range(200):
        gamma = math.expm1(y) / c
        x = _plastic_volume(gamma, p, p_c, parameters)
        new_p, new_c = p * math.exp(a * x), p_c * math.exp(-b * x)
        r = math.exp(-2 * y)
        f = q * r + new_p * (new_p - new_c)
        size = q * r + new_p * (new_p + new_c)
        if not abs(f) > 4e-15 * size:
            break
        if f > 0:
            low = y
        else:
            high = y
        # dx / dgamma from the equation for x
        away = 2 * new_p - new_c
        rate = -away / (1 + gamma * (2 * a * new_p + b * new_c))
        df = -2 * q * r + (a * new_p * away + b * new_p * new_c) * rate * math.exp(y) / c
        before = y
        y -= f / df
        if not low < y < high or abs(f) > 0.5 * last:
            y = 0.5 * (low + high)
        last = abs(f)
        if not abs(y - before) > 1e-16 * y:
            break
    return gamma, x, new_p, new_c


@compiled
def _flow(gamma, x, s, parameters):  # type: ignore[no-untyped-def]
    """Return 1 / (1 + 6 mu gamma / M^2), and the principal plastic strains of the step."""
    mu, M = parameters[0], parameters[1]
    share = 1 / (1 + 6 * mu * gamma / (M * M))
    third, r = x / 3, (1 - share) / (2 * mu)
    return share, (third + r * s[0], third + r * s[1], third + r * s[2])


@compiled
def _update(F, L, parameters, state, sigma):  # type: ignore[no-untyped-def]
    strain, n = principal_strains(elastic_deformation(F, state))
    volume, s, Q = _invariants(strain, parameters[0])
    gamma, x, p, p_c = _solve(volume, Q, state[_EPS_V_P], parameters)
    share, flow = _flow(gamma, x, s, parameters)
    if gamma > 0:
        elastic = strain[0] - flow[0], strain[1] - flow[1], strain[2] - flow[2]
        set_plastic_deformation(F, elastic, n, state)
        state[_EPS_V_P] += x
        state[_EPS_P] += math.sqrt(2 / 3 * (flow[0] ** 2 + flow[1] ** 2 + flow[2] ** 2))
        state[_DISSIPATION] += gamma * p * p_c
    tau = share * s[0] - p, share * s[1] - p, share * s[2] - p
    set_cauchy_stress(sigma, tau, n, 1 + volume_change(F))


@compiled
def _energy(F, parameters, state):  # type: ignore[no-untyped-def]
    strain, _n = principal_strains(elastic_deformation(F, state))
    volume, _s, Q = _invariants(strain, parameters[0])
    swelling, p = parameters[3], parameters[4]
    return p * swelling * math.expm1(-volume / swelling) + Q / (6 * parameters[0])


@compiled
def _linearize(strain, state, parameters):  # type: ignore[no-untyped-def]
    """Return principal stresses, d tau_a / d eps_b, and derivatives of energy plus dissipation."""
    mu, M = parameters[0], parameters[1]
    a, b = 1 / parameters[3], 1 / (parameters[2] - parameters[3])
    volume, s, Q = _invariants(strain, mu)
    trial, slope, _p_c = _pressures(volume, state[_EPS_V_P], parameters)
    gamma, x, p, p_c = _solve(volume, Q, state[_EPS_V_P], parameters)
    share, flow = _flow(gamma, x, s, parameters)
    p_v, p_Q, g_v, g_Q = slope, 0.0, 0.0, 0.0
    if gamma > 0:
        # Derivatives of A = x + gamma (2 p - p_c) = 0 and B = share^2 Q / M^2 + p (p - p_c) = 0
        # with respect to x and gamma, and to the trial volume and Q
        away, c = 2 * p - p_c, 6 * mu / (M * M)
        p_t = slope * p / trial
        A_x, A_g, A_v = 1 + gamma * (2 * a * p + b * p_c), away, 2 * gamma * p_t
        B_x, B_g = a * p * away + b * p * p_c, -2 * c * Q * share**3 / (M * M)
        B_v, B_Q = p_t * away, (share / M) ** 2
        det = A_x * B_g - A_g * B_x
        p_v = p_t - a * p * (A_v * B_g - A_g * B_v) / det
        p_Q = a * p * A_g * B_Q / det
        g_v = -c * share * share * (B_x * A_v - A_x * B_v) / det
        g_Q = c * share * share * A_x * B_Q / det
    # d tau_a = -dp + share ds_a + s_a d share, dQ = 6 mu s_b d eps_b
    t0, t1, t2 = 6 * mu * s[0], 6 * mu * s[1], 6 * mu * s[2]
    q0, q1, q2 = -p_v - p_Q * t0, -p_v - p_Q * t1, -p_v - p_Q * t2
    r0, r1, r2 = g_v + g_Q * t0, g_v + g_Q * t1, g_v + g_Q * t2
    same, other = 4 / 3 * mu * share, -2 / 3 * mu * share
    D = (
        q0 + s[0] * r0 + same, q1 + s[0] * r1 + other, q2 + s[0] * r2 + other,
        q0 + s[1] * r0 + other, q1 + s[1] * r1 + same, q2 + s[1] * r2 + other,
        q0 + s[2] * r0 + other, q1 + s[2] * r1 + other, q2 + s[2] * r2 + same,
    )  # fmt: skip
    tau = share * s[0] - p, share * s[1] - p, share * s[2] - p
    return tau, D, work_derivatives(tau, D, flow)


@compiled
def _tangent(F, parameters, state, dPdF):  # type: ignore[no-untyped-def]
    strain, n = principal_strains(elastic_deformation(F, state))
    tau, D, _w = _linearize(strain, state, parameters)
    set_tangent(F, strain, n, tau, D, quotients(strain, tau, D), dPdF)


@compiled
def _work_gradient(F, parameters, state, G):  # type: ignore[no-untyped-def]
    strain, n = principal_strains(elastic_deformation(F, state))
    _tau, _D, w = _linearize(strain, state, parameters)
    set_gradient(F, n, w, G)


class ModifiedCamClay(Law):
    """Modified Cam-Clay plasticity in logarithmic strains.

    The law is due to K. H. Roscoe and J. B. Burland, 1968. With the pressure p and
    ``q = sqrt(3/2) |dev tau|`` of the Kirchhoff stress tau = J sigma, the yield criterion is

        q^2 / M^2 + p (p - p_c) <= 0,    p_c = preconsolidation exp(-eps_v_p / (lambda - kappa)).

    Plastic flow is associated, and integrated implicitly. The lines of isotropic compression and
    swelling are straight in ln p and ln J (R. I. Borja, C. Tamagnini, "Cam-Clay plasticity part
    III: Extension of the infinitesimal model to include finite strains", CMAME 155, 1998). The
    elastic energy is theirs without coupling (alpha = 0), so that no cycle of deformation creates
    work:

        psi = pressure kappa (exp(-eps_v / kappa) - 1) + mu e : e,
        p = pressure exp(-eps_v / kappa),    dev tau = 2 mu e .

    Undeformed clay has the stress -pressure I, not zero. Clay that separates loses its pressure
    elastically, and regains it at the same volume.

    The state has four fields:

    - "C_p_inverse" ``(3, 3)`` is the inverse plastic right Cauchy-Green tensor [-].
    - "eps_v_p" is the volumetric plastic strain [-], negative in compaction.
    - "eps_p" is the accumulated ``sqrt(2/3) |plastic strain increment|`` [-].
    - "dissipation" is the sum of tau : plastic strain increments [J/m^3].

    ``wave_speed_modulus`` is the modulus at the preconsolidation pressure. Much higher pressures
    need shorter explicit steps.

    Args:
        mu: Shear modulus [Pa], positive.
        M: Slope of the critical state line q = M p [-], positive.
        compression: Lambda, -d ln J / d ln p in isotropic compression [-], larger than kappa.
        swelling: Kappa, -d ln J / d ln p in unloading [-], positive.
        pressure: Pressure of the undeformed clay [Pa], positive.
        preconsolidation: Largest previous pressure [Pa], at least ``pressure``. None for
            ``pressure``.

    Attributes:
        mu: Shear modulus [Pa].
        M: Slope of the critical state line [-].

    Raises:
        ValueError: If a parameter is out of range, or the parameters are inconsistent.
    """

    def __init__(
        self,
        mu: float,
        M: float,
        compression: float,
        swelling: float,
        pressure: float,
        preconsolidation: float | None = None,
    ) -> None:
        """Check and store the parameters."""
        self.mu = positive(mu, "mu", "shear modulus", "Pa")
        self.M = positive(M, "M", "slope of the critical state line", "-")
        compression = positive(compression, "compression", "slope of compression", "-")
        swelling = positive(swelling, "swelling", "slope of swelling", "-")
        if compression <= swelling:
            raise ValueError(
                f"compression must be larger than swelling: compression = {compression}, "
                f"swelling = {swelling}"
            )
        pressure = positive(pressure, "pressure", "pressure of the undeformed clay", "Pa")
        if preconsolidation is None:
            preconsolidation = pressure
        preconsolidation = positive(
            preconsolidation, "preconsolidation", "preconsolidation pressure", "Pa"
        )
        if preconsolidation < pressure:
            raise ValueError(
                f"the clay would yield immediately: preconsolidation = {preconsolidation} Pa is "
                f"below pressure = {pressure} Pa"
            )
        super().__init__(
            _update,
            np.array([self.mu, self.M, compression, swelling, pressure, preconsolidation]),
            p_wave_modulus(self.mu, preconsolidation / swelling),
            {
                "C_p_inverse": ((3, 3), np.eye(3)),
                "eps_v_p": ((), 0.0),
                "eps_p": ((), 0.0),
                "dissipation": ((), 0.0),
            },
            energy=_energy,
            tangent=_tangent,
            work_gradient=_work_gradient,
            needs_rate=False,
        )

    def __repr__(self) -> str:
        """Parameters with units."""
        mu, M, compression, swelling, pressure, preconsolidation = self.parameters
        return (
            f"ModifiedCamClay(mu={mu:g} Pa, M={M:g}, compression={compression:g}, "
            f"swelling={swelling:g}, pressure={pressure:g} Pa, "
            f"preconsolidation={preconsolidation:g} Pa)"
        )
