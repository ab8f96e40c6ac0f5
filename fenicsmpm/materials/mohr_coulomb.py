# SPDX-License-Identifier: MIT
"""Mohr-Coulomb plasticity with Hencky's law."""

from __future__ import annotations

import math

from fenicsmpm.materials.frictional import NO_LIMIT, Frictional
from fenicsmpm.materials.law import compiled
from fenicsmpm.materials.tensors import inverse

# Planes of the yield surface that sorted principal stresses can reach: friction planes of two
# stresses, and tension planes of one stress. 0 means no plane.
_NONE, _13, _12, _23, _1, _2, _3 = range(7)

# Active planes at the places where a return can end: planes, edges and corners. Where four planes
# meet, any three of them with positive multipliers suffice.
_PLACES = (
    (_13, _NONE, _NONE),
    (_13, _12, _NONE),  # triaxial compression
    (_13, _23, _NONE),  # triaxial extension
    (_1, _2, _3),  # the tip
    (_1, _NONE, _NONE),
    (_1, _2, _NONE),
    (_1, _13, _NONE),
    (_1, _13, _12),
    (_1, _13, _23),
    (_1, _2, _13),
)
_WITHOUT_TENSION = 3  # number of places that exist without a limit of tension


@compiled
def _normal(plane, s):  # type: ignore[no-untyped-def]
    """Return the normal of a plane with the sine s of friction, or the flow direction.

    For the flow direction, s is the sine of dilatancy. The friction planes are (tau_1 - tau_3) / 2
    + s (tau_1 + tau_3) / 2 <= c cos(phi), and so on.
    """
    major, minor = 0.5 * (1 + s), -0.5 * (1 - s)
    if plane == _13:
        return major, 0.0, minor
    if plane == _12:
        return major, minor, 0.0
    if plane == _23:
        return 0.0, major, minor
    return 1.0 * (plane == _1), 1.0 * (plane == _2), 1.0 * (plane == _3)


@compiled
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _stress(lame, two_mu, m):  # type: ignore[no-untyped-def]
    """Return the principal stresses for principal strains."""
    p = lame * (m[0] + m[1] + m[2])
    return p + two_mu * m[0], p + two_mu * m[1], p + two_mu * m[2]


@compiled
def _place(number):  # type: ignore[no-untyped-def]
    planes = _PLACES[number]
    return planes[0], planes[1], planes[2]


@compiled
def _solve(number, trial, lame, two_mu, strength, sines):  # type: ignore[no-untyped-def]
    """Return multipliers for the return of trial stresses to a place, and data for tangents.

    Returns:
        Normals a_i, stresses C m_i of the flow directions m_i, the inverse of a_i C m_j (a tuple of
        9), and multipliers. The multipliers of absent planes are zero.
    """
    x, y, z = _place(number)
    a = _normal(x, sines[0]), _normal(y, sines[0]), _normal(z, sines[0])
    c = (
        _stress(lame, two_mu, _normal(x, sines[1])),
        _stress(lame, two_mu, _normal(y, sines[1])),
        _stress(lame, two_mu, _normal(z, sines[1])),
    )
    # Absent planes have zero normals. Adding 2 mu makes the matrix regular.
    G = (
        _dot(a[0], c[0]), _dot(a[0], c[1]), _dot(a[0], c[2]),
        _dot(a[1], c[0]), _dot(a[1], c[1]) + two_mu * (y == _NONE), _dot(a[1], c[2]),
        _dot(a[2], c[0]), _dot(a[2], c[1]), _dot(a[2], c[2]) + two_mu * (z == _NONE),
    )  # fmt: skip
    H = inverse(G)
    f = (
        _dot(a[0], trial) - _limit(x, strength),
        _dot(a[1], trial) - _limit(y, strength),
        _dot(a[2], trial) - _limit(z, strength),
    )
    gamma = _dot(H[0:3], f), _dot(H[3:6], f), _dot(H[6:9], f)
    return a, c, H, gamma


@compiled
def _limit(plane, strength):  # type: ignore[no-untyped-def]
    """Return the bound of the stress at a plane [Pa], or its derivative."""
    if plane == _NONE:
        return 0.0
    return strength[2] if plane >= _1 else strength[1]


@compiled
def _returned(trial, c, gamma):  # type: ignore[no-untyped-def]
    return (
        trial[0] - gamma[0] * c[0][0] - gamma[1] * c[1][0] - gamma[2] * c[2][0],
        trial[1] - gamma[0] * c[0][1] - gamma[1] * c[1][1] - gamma[2] * c[2][1],
        trial[2] - gamma[0] * c[0][2] - gamma[1] * c[1][2] - gamma[2] * c[2][2],
    )


@compiled
def _violation(tau, gamma, two_mu, strength):  # type: ignore[no-untyped-def]
    """Return by how much a return is inadmissible [Pa]: order, yield surface, multipliers."""
    outside = 0.5 * (tau[0] - tau[2] + strength[0] * (tau[0] + tau[2])) - strength[1]
    disorder = max(tau[1] - tau[0], tau[2] - tau[1])
    backwards = -two_mu * min(gamma[0], gamma[1], gamma[2])
    return max(outside, tau[0] - strength[2], disorder, backwards)


@compiled
def _return_map(strain, mu, kappa, strength, slopes, dilatancy):  # type: ignore[no-untyped-def]
    """Return to the surface; see ``frictional.functions``. k is c cos(phi), angles are sines."""
    two_mu, lame = 2 * mu, kappa - 2 / 3 * mu
    trial = _stress(lame, two_mu, strain)
    excess = _violation(trial, (0.0, 0.0, 0.0), two_mu, strength)
    D = (
        lame + two_mu, lame, lame,
        lame, lame + two_mu, lame,
        lame, lame, lame + two_mu,
    )  # fmt: skip
    if not excess > 0:
        return False, trial, D, (0.0, 0.0, 0.0), 0.0
    sines = strength[0], dilatancy
    count = _WITHOUT_TENSION if strength[2] >= NO_LIMIT else len(_PLACES)
    # Take the first admissible place. If round-off makes all inadmissible, take the closest one.
    enough = 1e-13 * (abs(trial[0]) + abs(trial[1]) + abs(trial[2]))
    best, least = 0, math.inf
    for number in range(count):
        _a, c, _H, gamma = _solve(number, trial, lame, two_mu, strength, sines)
        violation = _violation(_returned(trial, c, gamma), gamma, two_mu, strength)
        if violation < least:
            best, least = number, violation
        if violation <= enough:
            break
    x, y, z = _place(best)
    a, c, H, gamma = _solve(best, trial, lame, two_mu, strength, sines)
    tau = _returned(trial, c, gamma)
    opened = (x >= _1) * gamma[0] + (y >= _1) * gamma[1] + (z >= _1) * gamma[2]
    # d gamma = H (a_j C d eps + d f_j), with d f_j = d a_j . tau - d k_j at the end
    sheared = 0.5 * slopes[0]
    d = (
        _slope(x, tau, sheared, slopes),
        _slope(y, tau, sheared, slopes),
        _slope(z, tau, sheared, slopes),
    )
    d_gamma = _dot(H[0:3], d), _dot(H[3:6], d), _dot(H[6:9], d)
    softening = _returned((0.0, 0.0, 0.0), c, d_gamma)
    b = _stress(lame, two_mu, a[0]), _stress(lame, two_mu, a[1]), _stress(lame, two_mu, a[2])
    p, q, r = _column(0, D, b, c, H), _column(1, D, b, c, H), _column(2, D, b, c, H)
    D = p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2]
    return True, tau, D, softening, opened


@compiled
def _column(j, D, b, c, H):  # type: ignore[no-untyped-def]
    """Return d tau / d eps_j from the elastic D, b_i = C a_i and c_i = C m_i."""
    f = b[0][j], b[1][j], b[2][j]
    return _returned(
        (D[j], D[3 + j], D[6 + j]), c, (_dot(H[0:3], f), _dot(H[3:6], f), _dot(H[6:9], f))
    )


@compiled
def _slope(plane, tau, sheared, slopes):  # type: ignore[no-untyped-def]
    """Return the derivative of a plane's yield function with respect to eps_p at fixed stress."""
    if plane == _NONE:
        return 0.0
    if plane >= _1:
        return -slopes[2]
    major = tau[1] if plane == _23 else tau[0]
    minor = tau[1] if plane == _12 else tau[2]
    return sheared * (major + minor) - slopes[1]


class MohrCoulomb(Frictional):
    """Mohr-Coulomb plasticity with Hencky's law.

    With the principal Kirchhoff stresses tau_1 >= tau_2 >= tau_3 (positive in tension), the yield
    criterion is

        (tau_1 - tau_3) / 2 + (tau_1 + tau_3) / 2 sin(phi) <= c cos(phi),    tau_1 <= tension .

    Plastic flow is normal to the same planes with psi instead of phi, and to the planes of tension.
    The return is implicit in time. It ends on a plane, on an edge, at a corner or at the tip, with
    the corresponding number of multipliers (E. A. de Souza Neto, D. Peric, D. R. J. Owen,
    "Computational Methods for Plasticity", section 8.2). It is linear in principal strains and
    needs no iterations.

    State and softening are those of ``DruckerPrager``, with sin(phi), c cos(phi) and sin(psi)
    linear in eps_p. All flow on planes of tension counts as opening, also that of cracks with
    compression along them. Such cracks go on carrying their mean stress, but must close before it
    becomes more compressive. Unloading lowers what they carry until they have closed. The opening
    has no direction: it closes by isotropic strain, from whatever side the material is pressed.
    Material that is open does not dilate.

    Args:
        E: Young's modulus [Pa], positive.
        nu: Poisson's ratio [-], -1 < nu < 0.5.
        cohesion: Cohesion c [Pa], not negative.
        friction: Friction angle phi [degrees], 0 <= friction < 90. With 0 this is the law of
            Tresca.
        dilatancy: Dilatancy angle psi [degrees], 0 <= dilatancy <= friction.
        tension: Largest principal stress [Pa], not negative, at most that of the tip, c / tan(phi).
            None for the tip.
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
        tension: Largest principal stress before softening [Pa].

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
        softening_strain: float | None = None,
        residual_cohesion: float | None = None,
        residual_friction: float | None = None,
        residual_dilatancy: float | None = None,
    ) -> None:
        """Check and store the parameters."""

        def coefficients(c: float, phi: float, psi: float) -> tuple[float, float, float]:
            return math.sin(phi), c * math.cos(phi), math.sin(psi)

        super().__init__(
            E, nu, cohesion, friction, dilatancy, tension,
            softening_strain, residual_cohesion, residual_friction, residual_dilatancy,
            return_map=_return_map, coefficients=coefficients,
        )  # fmt: skip
