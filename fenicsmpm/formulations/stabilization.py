# SPDX-License-Identifier: MIT
"""Stabilization of equal-order mixed elements: PPP, ASGS and OSGS (VMS, section 4), among others.

Each function returns UFL that is added to the Galerkin residual of ``mixed``. ``stabilized``
returns the sum.
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
    """Return the polynomial pressure projection of Dohrmann and Bochev, which VMS compares with.

    The term is -alpha / mu (p - p_K, q - q_K), where p_K and q_K are averages over the points of a
    cell.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points.
        law: Constitutive law.
        alpha: Stabilization factor [-].

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If the points use quadratic splines or uGIMP.
    """
    z.require("u", "p", of="PPP")
    name = functions_of(points)
    if name not in ("linear", "cubic"):
        raise ValueError(
            "PPP averages over the points of a cell, which do not share the same functions if "
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
    """Return algebraic subgrid scales, in which subscales are residuals times tau (VMS, section 4).

    The divergence of the deviatoric stress is neglected. It is zero for linear triangles and
    tetrahedra.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points with the volumes V_n as weights [m^d].
        law: Constitutive law.
        force: Body force per volume at the start of the step, rho_n b ``(d,)`` [N/m^d]. None for
            none.
        c1: Constant of tau_1 [-].
        c2: Constant of tau_2 [-].
        scheme: Time scheme, for subscales with inertia; see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If the points use functions that are not linear, or both law and scheme have
            inertia.
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
    """Return orthogonal subgrid scales: residuals minus their lumped projection to the grid.

    The projection depends on the unknown. ``NewtonSolver`` includes this dependence in the tangent
    and therefore converges quadratically. VMS instead takes the projection from the previous
    iteration.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points with the volumes V_n as weights [m^d].
        law: Constitutive law.
        force: Body force per volume at the start of the step, rho_n b ``(d,)`` [N/m^d]. None for
            none.
        c1: Constant of tau_1 [-].
        c2: Constant of tau_2 [-].
        scheme: Time scheme, for subscales with inertia; see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If a part has nodes other than the vertices, the points use functions that are
            not linear, or both law and scheme have inertia.
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
    """Return orthogonal subscales of the pressure alone, -tau_1 (grad p - projection, grad q).

    This is the term of OSGS that smooths the pressure (R. Codina, Appl. Numer. Math. 58, 2008). It
    needs no residual, so it is consistent for functions of any smoothness.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points with the volumes V_n as weights [m^d].
        law: Constitutive law.
        c1: Constant of tau_1 [-].
        scheme: Time scheme, for subscales with inertia; see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If a part has nodes other than the vertices, or both law and scheme have
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
    """Return the residual of the mixed formulation with a stabilization chosen by name.

    Args:
        name: "none", "ppp", "asgs", "osgs", "split_osgs", "cip" (``interior_penalty``) or "hessian"
            (``hessian_penalty``).
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points with the volumes V_n as weights [m^d].
        law: Constitutive law.
        force: Body force per volume at the start of the step, rho_n b ``(d,)`` [N/m^d]. None for
            none.
        scheme: Time scheme, which adds inertia to tau_1; see ``tau``.
        cells: Active cells of the body and of loads, for "cip". If several bodies share these
            cells, add ``mixed`` for each body and ``interior_penalty`` once.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If the name is unknown, or the stabilization does not suit the functions of the
            points; see the function of that stabilization.
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
    """Return the residuals of momentum and of the volumetric law, for linear elements.

    The divergence of the deviatoric stress is neglected. It is zero for linear triangles and
    tetrahedra, and small for linear quadrilaterals and hexahedra. Quadratic elements are accepted
    for experiments, but there the neglected term adds an error.

    Args:
        z: Unknown with the displacement increment u [m] and the pressure p [Pa].
        points: Material points.
        law: Constitutive law.
        force: Body force per volume at the start of the step, rho_n b ``(d,)`` [N/m^d]. None for
            none.

    Returns:
        Momentum residual j (rho b + grad p) per volume at the start of the step ``(d,)`` [N/m^d],
        and the residual of the volumetric law [-], U'(J)/kappa - p/kappa for a solid.

    Raises:
        ValueError: If the points use smooth functions, for which the neglected term is not small.
    """
    z.require("u", "p", of="stabilization by residuals")
    name = functions_of(points)
    if name != "linear":
        raise ValueError(
            "ASGS and OSGS neglect the divergence of the deviatoric stress, which is small for "
            f'linear functions only, not for {name} ones: use "cip", "split_osgs" or, with '
            'splines, "hessian"'
        )
    k = Kinematics(z.u, points)
    R_u = _pressure_force(k, z.p)
    if force is not None:
        R_u += force
    return R_u, law.volumetric_residual(z.p, k)


def _pressure_force(k: Kinematics, p: Any) -> Any:
    """Return the vector j f^-T grad(p), which is j times the spatial gradient of the pressure."""
    return ufl.dot(k.cofactor(), ufl.grad(p))


def _subscales(
    z: Unknown, points: MaterialPoints, law: MixedLaw,
    S_u: Any, S_p: Any, c1: float, c2: float, scheme: TimeScheme | None,
) -> ufl.Form:  # fmt: skip
    """Return the subscales tau S, tested with the adjoint operator (VMS, equation 20).

    This is the version for linear elements. Let r = j f^-T grad(p) be the pressure term of momentum
    per volume at the start of the step. The adjoint of the momentum operator is -D r[V], which
    contains both geometric terms of equation 20 and grad q. S_u is per volume at the start of the
    step, hence the division by j.
    """
    k = Kinematics(z.u, points)
    tau1, tau2 = tau(points, law, c1, c2, scheme)
    adjoint_u = -ufl.derivative(_pressure_force(k, z.p), z.U, z.V)
    adjoint_p = ufl.derivative(k.j, z.U, z.V) - law.inverse_kappa * z.test.p
    return (tau1 / k.j * ufl.inner(S_u, adjoint_u) + tau2 * S_p * adjoint_p) * points.dx
