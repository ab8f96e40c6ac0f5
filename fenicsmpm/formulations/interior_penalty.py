# SPDX-License-Identifier: MIT
"""Stabilization of the pressure by its roughness, for functions of any smoothness.

Both forms see how the gradient of the pressure changes from cell to cell, one at the facets, the
other at the points. They need no residual, so they are the same in statics and dynamics.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import ufl

from fenicsmpm.basis import functions_of
from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations.facet_jumps import jumps, of_jumps
from fenicsmpm.formulations.initial_state import require_initial_state
from fenicsmpm.formulations.mixed import MixedLaw
from fenicsmpm.formulations.stabilization_parameters import modulus, squared_size, tau
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints

GAMMA = 0.05


def interior_penalty(
    z: Unknown,
    cells: ActiveCells | None,
    law: MixedLaw,
    *,
    gamma: float = GAMMA,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Continuous interior penalty -gamma h tau_1 [dn p] [dn q] (Burman and Hansbo).

    It is taken over all facets between two active cells, with tau_1 = h^2 / (2 mu) as in ASGS, and
    on the linear functions of the same nodal values, also where the points see splines or uGIMP:
    these have no jumps, and their second differences are what oscillates (E. Burman, P. Hansbo,
    CMAME 195, 2006).

    Args:
        z: unknown with the pressure p [Pa].
        cells: active cells of the body and of boundary points that carry loads.
        law: constitutive law.
        gamma: factor [-]; results hardly depend on it between 0.01 and 1.
        scheme: time scheme, for tau_1 with inertia as in ``tau``, here of the mean density of all
            bodies (collective); for steps much shorter than h sqrt(rho / mu).

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: for an unknown without a linear pressure, a factor that is not positive, no
            active cells, a law and a scheme that both have inertia, or with a scheme bodies without
            ``set_initial_state``.
    """
    _check(z, gamma, "the interior penalty")
    if not isinstance(cells, ActiveCells):
        raise ValueError(
            "the interior penalty is taken over the facets of active cells: give "
            f"ActiveCells(body, loads=[..]), not {cells!r}"
        )
    z.require_linear("the interior penalty", "p")
    h, jump = jumps(cells.mesh)
    mu = modulus(law, h**2, scheme, None if scheme is None else _mean_density(cells))
    dS = of_jumps(cells.dS_all, [z.part_space("p")])
    return -gamma * h**3 / (2 * mu) * jump(z.p) * jump(z.test.p) * dS


def hessian_penalty(
    z: Unknown,
    points: MaterialPoints,
    law: MixedLaw,
    *,
    gamma: float = GAMMA,
    scheme: TimeScheme | None = None,
) -> ufl.Form:
    """Penalty on second derivatives -gamma h^2 tau_1 (grad grad p, grad grad q) at the points.

    For quadratic splines, whose second derivatives are the second differences of neighbouring nodal
    values over h^2, it is the interior penalty as an integral over the points.

    Args:
        z: unknown with the pressure p [Pa].
        points: material points that see splines.
        law: constitutive law.
        gamma: factor [-].
        scheme: time scheme, for tau_1 with inertia, see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: for an unknown without pressure, a factor that is not positive, points that see
            functions without second derivatives, or a law and a scheme that both have inertia.
    """
    _check(z, gamma, "the penalty on second derivatives")
    require_second_derivatives(points, "the penalty on second derivatives")
    tau1, _ = tau(points, law, scheme=scheme)
    curvature, variation = (ufl.grad(ufl.grad(f)) for f in (z.p, z.test.p))
    factor = gamma * squared_size(points) * tau1
    return -factor * ufl.inner(curvature, variation) * points.dx


def require_second_derivatives(points: MaterialPoints, what: str) -> None:
    """Raise ValueError for points that do not see splines.

    Args:
        points: the point set.
        what: needs them.
    """
    name = functions_of(points)
    if name not in ("quadratic", "cubic"):
        raise ValueError(
            f"{what} is for points that see splines, whose second derivatives are bounded, not for "
            f'{name} functions: basis.use(points, "quadratic") on a lattice, or the interior '
            "penalty over facets"
        )


def _check(z: Unknown, gamma: float, what: str) -> None:
    z.require("p", of=what)
    if not 0 < gamma < np.inf:
        raise ValueError(f"the factor of {what} must be positive and finite: gamma = {gamma}")


def _mean_density(cells: ActiveCells) -> float:
    """Mass over initial volume of all bodies [kg/m^d] (collective)."""
    for body in cells.bodies:
        require_initial_state(body, "the interior penalty with inertia")
    sums = np.sum([[np.sum(p["mass"]), np.sum(p["V_0"])] for p in cells.bodies], axis=0)
    mass, volume = cells.mesh.comm.allreduce(sums, MPI.SUM)
    return float(mass / volume)
