# SPDX-License-Identifier: MIT
"""Stabilization of equal-order mixed elements: PPP, ASGS and OSGS (VMS, section 4), by terms.

Every function returns UFL that is added to the Galerkin residual of ``mixed``.
"""

from __future__ import annotations

from typing import Any

import ufl

from fenicsmpm.basis import functions_of
from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations.interior_penalty import hessian_penalty, interior_penalty
from fenicsmpm.formulations.kinematics import Kinematics
from fenicsmpm.formulations.lumped_projection import LumpedProjection
from fenicsmpm.formulations.mixed import MixedLaw, mixed
from fenicsmpm.formulations.stabilization_parameters import squared_size, tau
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints

STABILIZATIONS = ("none", "ppp", "asgs", "osgs", "split_osgs", "cip", "hessian")


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

    Raises:
        ValueError: for points that see quadratic splines or uGIMP.
    """
    z.require("u", "p", of="PPP")
    name = functions_of(points)
    if name not in ("linear", "cubic"):
        raise ValueError(
            "PPP takes averages over the points of a cell, which do not see the same functions if "
            f'these are {name} ones: use "cip", "split_osgs" or, with splines, "hessian"'
        )
    p, q, j = z.p, z.test.p, Kinematics(z.u, points).j
    rough_p = p - ufl.cell_avg(p)
    rough_q = q - ufl.cell_avg(q)
    return -alpha / law.modulus(squared_size(points)) * j * rough_p * rough_q * points.dx


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


def split_osgs(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    c1: float = 1.0,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Orthogonal subscales of the pressure alone: -tau_1 (grad p - its projection, grad q).

    The term of OSGS that keeps pressures smooth (R. Codina, Appl. Numer. Math. 58, 2008). It needs
    no residual, so it is consistent for functions of any smoothness.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points with weights V_n [m^d].
        law: constitutive law.
        c1: constant of tau_1.
        scheme: time scheme, for subscales with inertia, see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: for parts with nodes beside the vertices, or a law and a scheme that both have
            inertia.
    """
    z.require("u", "p", of="split OSGS")
    z.require_linear("split OSGS")
    k = Kinematics(z.u, points)
    force = _pressure_force(k, z.p)
    tau1, _ = tau(points, law, c1, scheme=scheme)
    rough = force - LumpedProjection(points, force)
    return -tau1 / k.j * ufl.inner(rough, _pressure_force(k, z.test.p)) * points.dx


def stabilized(
    name: str,
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    force: Any = None,
    scheme: TimeScheme | None = None,
    cells: ActiveCells | None = None,
) -> ufl.Form:
    """Residual of the mixed formulation with a stabilization chosen by name.

    Args:
        name: "none", "ppp", "asgs", "osgs", "split_osgs", "cip" (``interior_penalty``) or
            "hessian" (``hessian_penalty``).
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points with weights V_n [m^d].
        law: constitutive law.
        force: body force per volume before the step, rho_n b [N/m^d]; None for none.
        scheme: time scheme, for tau_1 with inertia, see ``tau``.
        cells: active cells of the body and of loads, for "cip". Of several bodies with the same
            cells, take ``mixed`` for each and ``interior_penalty`` once.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: for an unknown name, or one that does not suit the functions, see there.
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
    if name == "split_osgs":
        return R + split_osgs(z, points, law, scheme=scheme)
    if name == "cip":
        return R + interior_penalty(z, cells, law, scheme=scheme)
    if name == "hessian":
        return R + hessian_penalty(z, points, law, scheme=scheme)
    raise ValueError(f"unknown stabilization {name!r}: use one of {', '.join(STABILIZATIONS)}")


def residuals(
    z: Unknown, points: MaterialPoints, law: MixedLaw, force: Any = None
) -> tuple[Any, Any]:
    """Residuals of momentum and of the volumetric law, for linear elements.

    They leave out the divergence of the deviatoric stress: zero for linear triangles and
    tetrahedra, small for linear quadrilaterals and hexahedra. Quadratic elements are accepted for
    trials; there the residuals add an error of their own.

    Args:
        z: unknown with the increment of displacement u [m] and the pressure p [Pa].
        points: material points.
        law: constitutive law.
        force: body force per volume before the step [N/m^d].

    Returns:
        j (rho b + grad p) per volume before the step [N/m^3], and the law's volumetric residual,
        of a solid U'(J)/kappa - p/kappa [-].

    Raises:
        ValueError: for points that see smooth functions, for which that is not small.
    """
    z.require("u", "p", of="stabilization by residuals")
    name = functions_of(points)
    if name != "linear":
        raise ValueError(
            "ASGS and OSGS leave out the divergence of the deviatoric stress, which is small for "
            f'linear functions only, not for {name} ones: use "cip", "split_osgs" or, with '
            'splines, "hessian"'
        )
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
