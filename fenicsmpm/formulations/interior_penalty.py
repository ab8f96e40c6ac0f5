# SPDX-License-Identifier: MIT
"""Pressure stabilization by penalties on jumps or second derivatives of the pressure.

Both forms penalize how the gradient of the pressure changes between cells. One form works on
facets, the other at the points. Neither needs a residual, so they are the same in statics and
dynamics and suit functions of any smoothness.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import ufl

from fenicsmpm._numbers import number
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
    """Return the interior penalty -gamma h tau_1 [dn p] [dn q] (Burman and Hansbo).

    The integral is taken over all facets between two active cells, with tau_1 = h^2 / (2 mu) as in
    ASGS (E. Burman, P. Hansbo, CMAME 195, 2006).

    The form always uses the linear functions with the nodal values of the pressure, even if the
    points use splines or uGIMP. These smooth functions have no jumps, but the second differences of
    their nodal values can oscillate.

    Args:
        z: Unknown with the pressure p [Pa].
        cells: Active cells of the body and of boundary points that carry loads.
        law: Constitutive law.
        gamma: Penalty factor [-]. Results hardly depend on it between 0.01 and 1.
        scheme: Time scheme, which adds inertia to tau_1 as in ``tau``, here with the mean density
            of all bodies. Collective. Use it for steps much shorter than h sqrt(rho / mu).

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: If the unknown has no linear pressure, the factor is not positive, there are no
            active cells, both law and scheme have inertia, or a scheme is given and a body lacks
            the fields of ``set_initial_state``.
    """
    _check(z, gamma, "the interior penalty")
    if not isinstance(cells, ActiveCells):
        raise ValueError(
            "the interior penalty is an integral over the facets of active cells: give "
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
    """Return the penalty -gamma h^2 tau_1 (grad grad p, grad grad q) at the points.

    The second derivatives of quadratic splines are the second differences of neighbouring nodal
    values over h^2. For these splines the form therefore corresponds to the interior penalty,
    integrated over the points.

    Args:
        z: Unknown with the pressure p [Pa].
        points: Material points that use splines.
        law: Constitutive law.
        gamma: Penalty factor [-].
        scheme: Time scheme, which adds inertia to tau_1; see ``tau``.

    Returns:
        UFL form of rank 1.

    Raises:
        ValueError: If the unknown has no pressure, the factor is not positive, the functions of the
            points have no second derivatives, or both law and scheme have inertia.
    """
    _check(z, gamma, "the penalty on second derivatives")
    require_second_derivatives(points, "the penalty on second derivatives")
    tau1, _ = tau(points, law, scheme=scheme)
    curvature, variation = (ufl.grad(ufl.grad(f)) for f in (z.p, z.test.p))
    factor = gamma * squared_size(points) * tau1
    return -factor * ufl.inner(curvature, variation) * points.dx


def require_second_derivatives(points: MaterialPoints, what: str) -> None:
    """Raise ValueError if points do not use splines.

    Args:
        points: The point set.
        what: Name of the feature that needs splines, for the message.

    Raises:
        ValueError: If the functions of the points are not quadratic or cubic splines.
    """
    name = functions_of(points)
    if name not in ("quadratic", "cubic"):
        raise ValueError(
            f"{what} needs splines, whose second derivatives are bounded, not {name} functions: "
            'call basis.use(points, "quadratic") on a lattice, or use the interior penalty over '
            "facets"
        )


def _check(z: Unknown, gamma: float, what: str) -> None:
    z.require("p", of=what)
    gamma = number(gamma, "gamma", f"the factor of {what}", "-")
    if not 0 < gamma < np.inf:
        raise ValueError(f"the factor of {what} must be positive and finite: gamma = {gamma}")


def _mean_density(cells: ActiveCells) -> float:
    """Return mass over initial volume of all bodies [kg/m^d]. Collective."""
    for body in cells.bodies:
        require_initial_state(body, "the interior penalty with inertia")
    sums = np.sum([[np.sum(p["mass"]), np.sum(p["V_0"])] for p in cells.bodies], axis=0)
    mass, volume = cells.mesh.comm.allreduce(sums, MPI.SUM)
    return float(mass / volume)
