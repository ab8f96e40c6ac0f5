# SPDX-License-Identifier: MIT
"""Drucker-Prager plasticity with Hencky's law."""

from __future__ import annotations

import math
from typing import Literal

from fenicsmpm.materials.frictional import Frictional
from fenicsmpm.materials.law import compiled


@compiled
def _return_map(strain, mu, kappa, strength, slopes, dilatancy):  # type: ignore[no-untyped-def]
    """Return to the cone; see ``frictional.functions``.

    The invariants are r = |dev tau| / sqrt(2) and p = tr(tau) / 3.
    """
    friction, k, tension = strength
    d_friction, d_k, d_tension = slopes
    volume = strain[0] + strain[1] + strain[2]
    mean, two_mu = volume / 3, 2 * mu
    s = two_mu * (strain[0] - mean), two_mu * (strain[1] - mean), two_mu * (strain[2] - mean)
    p = kappa * volume
    r = math.sqrt(0.5 * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2]))
    excess = max(r + friction * p - k, 0.0)
    flows = excess > 0 or p > tension
    # values after the return, and their derivatives with respect to p, r and eps_p
    new_p, p_p, p_r, p_x = p, 1.0, 0.0, 0.0
    new_r, r_p, r_r, r_x = r, 0.0, 1.0, 0.0
    opened = 0.0
    if flows:
        G = mu + kappa * friction * dilatancy
        new_p = p - kappa * dilatancy * excess / G
        if new_p <= tension:  # the cone
            new_r = r - mu * excess / G
            c = (d_friction * new_p - d_k) / G
            p_p, p_r, p_x = (
                1 - kappa * dilatancy * friction / G,
                -kappa * dilatancy / G,
                -kappa * dilatancy * c,
            )
            r_p, r_r, r_x = -mu * friction / G, 1 - mu / G, -mu * c
        else:  # the cut-off or its rim, which is the apex without a separate limit
            new_p, p_p, p_r, p_x = tension, 0.0, 0.0, d_tension
            rim = max(k - friction * tension, 0.0)
            if r > rim:
                new_r = rim
                r_r, r_x = 0.0, d_k - d_friction * tension - friction * d_tension
            opened = max((p - tension) / kappa - dilatancy * (r - new_r) / mu, 0.0)
    # tau = p + share s
    share = new_r / r if r > 0 else 1.0
    one = 1 / r if r > 0 else 0.0
    m = one * s[0], one * s[1], one * s[2]
    # d p_new / d eps_b and r d share / d eps_b, with d p = kappa, d r = mu m_b
    u, v, along, across = kappa * p_p, mu * p_r, kappa * r_p, mu * (r_r - share)
    g0, g1, g2 = along + across * m[0], along + across * m[1], along + across * m[2]
    q0, q1, q2 = u + v * m[0], u + v * m[1], u + v * m[2]
    same, other = 4 / 3 * mu * share, -2 / 3 * mu * share
    D = (
        q0 + m[0] * g0 + same, q1 + m[0] * g1 + other, q2 + m[0] * g2 + other,
        q0 + m[1] * g0 + other, q1 + m[1] * g1 + same, q2 + m[1] * g2 + other,
        q0 + m[2] * g0 + other, q1 + m[2] * g1 + other, q2 + m[2] * g2 + same,
    )  # fmt: skip
    tau = new_p + share * s[0], new_p + share * s[1], new_p + share * s[2]
    softening = p_x + r_x * m[0], p_x + r_x * m[1], p_x + r_x * m[2]
    return flows, tau, D, softening, opened


Match = Literal["compression", "extension", "plane strain"]


class DruckerPrager(Frictional):
    """Drucker-Prager plasticity with Hencky's law.

    With the Kirchhoff stress tau = J sigma, its mean p (positive in tension) and its deviator s,
    the yield criterion is

        sqrt(s : s / 2) + eta p <= xi c,    p <= tension .

    Plastic flow is directed along s / (2 sqrt(s : s / 2)) + eta_psi I / 3, and integrated
    implicitly. If the return to the cone would miss it, the stress returns to the apex or to the
    rim of the cut-off (E. A. de Souza Neto, D. Peric, D. R. J. Owen, "Computational Methods for
    Plasticity", section 8.3). The parameters eta, xi and eta_psi match the Mohr-Coulomb surface
    (ibid., equations 6.123 to 6.127):

    - "compression" matches its edges of triaxial compression, 6 sin(phi) / (sqrt(3) (3 -
      sin(phi))).
    - "extension" matches its edges of triaxial extension, with 3 + sin(phi) instead.
    - "plane strain" matches its strength during plastic flow in plane strain. This is 3 tan(phi) /
      sqrt(9 + 12 tan^2(phi)) for associated flow, sin(phi) without dilatancy, and sin(phi) /
      (sqrt(1 - eta_psi^2 / 3) + eta_psi sin(phi) / 3) in general.

    The state has five fields:

    - "C_p_inverse" ``(3, 3)`` is the inverse plastic right Cauchy-Green tensor [-].
    - "eps_p" is the accumulated ``sqrt(2/3) |plastic strain increment|`` [-], including the
      volumetric part.
    - "opening" is the logarithmic plastic volumetric strain at the limit of tension, which closes
      without resistance [-] (see ``fenicsmpm.materials.frictional``).
    - "dissipation" is the sum of tau : plastic strain increments [J/m^3].
    - "open_stress" is the mean Kirchhoff stress of open material if it is compressive, else zero
      [Pa]. With this law it is always zero.

    Softening is linear in eps_p. Friction, cohesion and dilatancy, in terms of eta, xi c and
    eta_psi, reach their residual values at ``softening_strain``. A step uses the dilatancy at its
    start.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.
        cohesion: Cohesion c [Pa], not negative.
        friction: Friction angle phi [degrees], 0 <= friction < 90.
        dilatancy: Dilatancy angle psi [degrees], 0 <= dilatancy <= friction.
        tension: Largest mean stress [Pa], not negative, at most that of the apex. None for the
            apex.
        match: How the cone is fitted to the Mohr-Coulomb surface.
        softening_strain: Value of eps_p at which the residual values are reached [-]. None for no
            softening. Softening localizes in bands as narrow as the mesh allows. A warning is
            logged.
        residual_cohesion: Residual cohesion [Pa], at most the cohesion. None for the cohesion.
        residual_friction: Residual friction angle [degrees], at most the friction. None for the
            friction.
        residual_dilatancy: Residual dilatancy angle [degrees], at most the dilatancy. None for the
            dilatancy.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        mu: Shear modulus [Pa].
        kappa: Bulk modulus [Pa].
        tension: Largest mean stress before softening [Pa].

    Raises:
        ValueError: If a parameter is out of range, or the parameters are inconsistent.
    """

    def __init__(
        self,
        E: float,
        nu: float,
        cohesion: float,
        friction: float,
        dilatancy: float = 0.0,
        tension: float | None = None,
        match: Match = "compression",
        softening_strain: float | None = None,
        residual_cohesion: float | None = None,
        residual_friction: float | None = None,
        residual_dilatancy: float | None = None,
    ) -> None:
        """Check and store the parameters."""
        if match not in ("compression", "extension", "plane strain"):
            raise ValueError(
                f"match must be 'compression', 'extension' or 'plane strain', not {match!r}"
            )

        def coefficients(c: float, phi: float, psi: float) -> tuple[float, float, float]:
            eta, xi, eta_psi = _matched(phi, psi, match)
            return eta, xi * c, eta_psi

        super().__init__(
            E, nu, cohesion, friction, dilatancy, tension,
            softening_strain, residual_cohesion, residual_friction, residual_dilatancy,
            return_map=_return_map, coefficients=coefficients,
        )  # fmt: skip


def _matched(phi: float, psi: float, match: Match) -> tuple[float, float, float]:
    """Return eta, xi and eta_psi of the cone for angles in radians."""
    if match == "plane strain":
        eta_psi = 3 * math.tan(psi) / math.sqrt(9 + 12 * math.tan(psi) ** 2)
        divisor = math.sqrt(1 - eta_psi**2 / 3) + eta_psi * math.sin(phi) / 3
        return math.sin(phi) / divisor, math.cos(phi) / divisor, eta_psi
    sign = -1 if match == "compression" else 1

    def divided(numerator: float, angle: float) -> float:
        return 6 * numerator / (math.sqrt(3) * (3 + sign * math.sin(angle)))

    return divided(math.sin(phi), phi), divided(math.cos(phi), phi), divided(math.sin(psi), psi)
