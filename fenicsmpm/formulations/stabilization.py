# SPDX-License-Identifier: MIT
"""Stabilization of equal-order mixed elements: PPP, ASGS and OSGS (VMS, section 4).

Every function returns UFL that is added to the Galerkin residual of ``mixed``.
"""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.lumped_projection import LumpedProjection
from fenicsmpm.formulations.mixed import MixedLaw, mixed
from fenicsmpm.formulations.time_scheme import TimeScheme, density
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints

STABILIZATIONS = ("none", "ppp", "asgs", "osgs")


def element_size(points: MaterialPoints) -> Any:
    """Cell size h = |K|^(1/d) [m] of the cell that holds the point (VMS, below equation 21)."""
    return _cell_volume(points) ** (1 / points.mesh.geometry.dim)


def _cell_volume(points: MaterialPoints) -> Any:
    return ufl.CellVolume(points.mesh.ufl_domain())


def tau(
    points: MaterialPoints,
    law: MixedLaw,
    c1: float = 1.0,
    c2: float = 1.0,
    scheme: TimeScheme | None = None,
) -> Any:
    """Stabilization parameters of VMS, equation 21.

    Subscales without inertia let Newton's method fail where steps are much shorter than
    h sqrt(rho / mu). With it, 1 / tau_1 = 2 mu / (c1 h^2) + rho r_a (R. Codina, CMAME 191, 2002),
    r_a u being the change of acceleration in a step.

    Args:
        points: material points.
        law: constitutive law.
        c1: algorithmic constant of tau_1.
        c2: algorithmic constant of tau_2.
        scheme: time scheme, for subscales with inertia; None for those of the paper, and for a law
            that has inertia itself (``NewtonianFlow``).

    Returns:
        tau_1 = c1 h^2 / (2 mu) [m^2/Pa], with inertia as above, and tau_2 = 2 c2 mu [Pa], with the
        law's moduli as mu.

    Raises:
        ValueError: for a scheme and a law that has inertia itself.
    """
    if scheme is not None and hasattr(law, "scheme"):
        raise ValueError("the law's subscales have inertia themselves: leave out the scheme")
    h_squared = _h_squared(points)
    mu, mu_p = law.modulus(h_squared), law.subscale_modulus(points, h_squared)
    if scheme is not None:
        mu += c1 * density(points) * scheme.rates[1] * h_squared / 2
    return c1 * h_squared / (2 * mu), 2 * c2 * mu_p


def _h_squared(points: MaterialPoints) -> Any:
    return _cell_volume(points) ** (2 / points.mesh.geometry.dim)


def ppp(z: Unknown, points: MaterialPoints, law: MixedLaw, *, alpha: float = 1.0) -> ufl.Form:
    """Polynomial pressure projection of Dohrmann and Bochev, used by VMS for comparison.

    -alpha / mu (p - p_K, q - q_K) with the averages over the points of a cell p_K, q_K.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points.
        law: constitutive law.
        alpha: factor [-].

    Returns:
        UFL form of rank 1.
    """
    z.require("u", "p", of="PPP")
    p, q, j = z.p, z.test.p, Kinematics(z.u, points).j
    rough_p = p - ufl.cell_avg(p)
    rough_q = q - ufl.cell_avg(q)
    return -alpha / law.modulus(_h_squared(points)) * j * rough_p * rough_q * points.dx


def asgs(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
    c1: float = 1.0,
    c2: float = 1.0,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Algebraic subgrid scales: subscales are the residuals times tau (VMS, section 4).

    The divergence of the deviatoric stress, zero for linear triangles and tetrahedra, is left out.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points with weights V_n [m^d].
        law: constitutive law.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.
        c1: constant of tau_1.
        c2: constant of tau_2.
        scheme: time scheme, for subscales with inertia, see ``tau``.

    Returns:
        UFL form of rank 1.
    """
    R_u, R_p = residuals(z, points, law, force)
    return _subscales(z, points, law, R_u, R_p, c1, c2, scheme)


def osgs(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
    c1: float = 1.0,
    c2: float = 1.0,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Orthogonal subgrid scales: residuals minus their lumped projection on the grid.

    They depend on the unknown, and ``NewtonSolver`` takes that into the tangent, so that it
    converges quadratically; VMS lags them by an iteration.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points with weights V_n [m^d].
        law: constitutive law.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.
        c1: constant of tau_1.
        c2: constant of tau_2.
        scheme: time scheme, for subscales with inertia, see ``tau``.

    Returns:
        UFL form of rank 1.
    """
    z.require_linear("OSGS")
    R_u, R_p = residuals(z, points, law, force)
    Pi = LumpedProjection(points, ufl.as_vector([*R_u, R_p]))
    Pi_u, Pi_p = ufl.as_vector([Pi[i] for i in range(len(R_u))]), Pi[len(R_u)]
    return _subscales(z, points, law, R_u - Pi_u, R_p - Pi_p, c1, c2, scheme)


def stabilized(
    name: str,
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Residual of the mixed formulation with a stabilization chosen by name.

    Args:
        name: "none", "ppp", "asgs" or "osgs".
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points with weights V_n [m^d].
        law: constitutive law.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.
        scheme: time scheme, for subscales of ASGS and OSGS with inertia, see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: for an unknown name.
    """
    R = mixed(z, points, law, force=force)
    if name == "none":
        return R
    if name == "ppp":
        return R + ppp(z, points, law)
    if name == "asgs":
        return R + asgs(z, points, law, force=force, scheme=scheme)
    if name == "osgs":
        return R + osgs(z, points, law, force=force, scheme=scheme)
    raise ValueError(f"unknown stabilization {name!r}: use one of {', '.join(STABILIZATIONS)}")


def residuals(
    z: Unknown, points: MaterialPoints, law: MixedLaw, force: Any = None
) -> tuple[Any, Any]:
    """Residuals of momentum and of the volumetric law, for linear elements.

    They leave out the divergence of the deviatoric stress: zero for linear triangles and
    tetrahedra, small for linear quadrilaterals and hexahedra, and not small for other functions, to
    which a stabilization by these residuals adds an error of its own.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points.
        law: constitutive law.
        force: body force per volume before the step [N/m^d].

    Returns:
        j (rho b + grad p) per volume before the step [N/m^3], and the law's volumetric residual,
        of a solid U'(J)/kappa - p/kappa [-].
    """
    z.require("u", "p", of="stabilization by residuals")
    k = Kinematics(z.u, points)
    R_u = _pressure_force(k, z.p)
    if force is not None:
        R_u += force
    return R_u, law.volumetric_residual(z.p, k)


def _pressure_force(k: Kinematics, p: Any) -> Any:
    """Vector j f^-T grad(p) = j times the spatial gradient of the pressure."""
    return ufl.dot(k.cofactor(), ufl.grad(p))


def _subscales(
    z: Unknown, points: MaterialPoints, law: MixedLaw,
    S_u: Any, S_p: Any, c1: float, c2: float, scheme: TimeScheme | None,
) -> ufl.Form:  # fmt: skip
    """Subscales tau S tested with the adjoint operator (VMS, equation 20, linear elements).

    With r = j f^-T grad(p), the pressure term of momentum per volume before the step, the adjoint
    of the momentum operator is -D r[V]: both geometric terms of equation 20 and grad q. S_u is
    per volume before the step, hence the division by j.
    """
    k = Kinematics(z.u, points)
    tau1, tau2 = tau(points, law, c1, c2, scheme)
    adjoint_u = -ufl.derivative(_pressure_force(k, z.p), z.U, z.V)
    adjoint_p = ufl.derivative(k.j, z.U, z.V) - law.inverse_kappa * z.test.p
    return (tau1 / k.j * ufl.inner(S_u, adjoint_u) + tau2 * S_p * adjoint_p) * points.dx
