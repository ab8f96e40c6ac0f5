# SPDX-License-Identifier: MIT
"""Ghost penalty, which couples cut cells to their neighbours (E. Burman, C. R. Math. 348, 2010)."""

from __future__ import annotations

import math

import ufl

from fenicsmpm._numbers import number
from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations.facet_jumps import jumps, of_jumps
from fenicsmpm.formulations.mixed import MixedLaw
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, VonMises


def ghost_penalty(
    z: Unknown,
    cells: ActiveCells,
    law: MixedLaw | Hencky | VonMises,
    *,
    gamma: float = 0.1,
) -> ufl.Form:
    """Return a penalty on the jumps of gradients across the facets of cut cells.

    The penalty is gamma mu h [dn u] . [dn w], and with a pressure in addition -gamma h^3 / (2 mu)
    [dn p] [dn q]. Nodes with little or no material nearby then follow the linear extrapolation from
    their neighbours.

    The form penalizes the displacement increment instead of the displacement, so that no force
    builds up. The work of the penalty is lost. A load on nodes without material moves them by the
    same length in each step, however short the step is. For short steps use ``cells.Tying``
    instead.

    Args:
        z: Unknown with the displacement increment u [m] and, if present, the pressure p [Pa].
        cells: Active cells of the body and of boundary points that carry loads.
        law: Constitutive law.
        gamma: Penalty factor [-]. Values of about 1 start to stiffen the body.

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: If the factor is not positive and finite, or the law has no shear modulus.
    """
    _check(gamma)
    z.require("u", of="the ghost penalty")
    h, jump = jumps(cells.mesh)
    parts = ["u", "p"] if "p" in z else ["u"]
    dS = of_jumps(cells.dS, [z.part_space(part) for part in parts])
    mu = law.modulus(h**2) if hasattr(law, "modulus") else getattr(law, "mu", None)
    if mu is None:
        raise ValueError(
            f"the ghost penalty needs a law with a shear modulus mu, such as NeoHookean, Hencky "
            f"or VonMises, not {law!r}"
        )
    penalty = mu * h * ufl.inner(jump(z.u), jump(z.test.u))
    if "p" in z:
        penalty -= h**3 / (2 * mu) * jump(z.p) * jump(z.test.p)
    return gamma * penalty * dS


def ghost_mass(
    cells: ActiveCells, scheme: TimeScheme, density: float, *, gamma: float = 0.1
) -> ufl.Form:
    """Return the ghost mass, an inertia of nodes with little material.

    The form is gamma rho h^3 [dn a] . [dn w] on the facets of cut cells. It bounds the condition
    number of the mass matrix (S. Sticko, G. Ludvigsson, G. Kreiss, Adv. Comput. Math. 46, 2020;
    conservation paper, section 7.4). The kinetic energy that this term loses is not transferred to
    the points. ``cells.Tying`` also regularizes the mass matrix, and conserves energy.

    Args:
        cells: Active cells of the body.
        scheme: Time scheme that defines the acceleration a [m/s^2].
        density: Density of the undeformed body [kg/m^d].
        gamma: Penalty factor [-].

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: If the factor is not positive and finite.
    """
    _check(gamma)
    h, jump = jumps(cells.mesh)
    inertia = ufl.inner(jump(scheme.acceleration), jump(scheme.w))
    assert scheme.unknown.moving is not None  # checked by the scheme
    dS = of_jumps(cells.dS, [scheme.unknown.part_space(scheme.unknown.moving)])
    return gamma * density * h**3 * inertia * dS


def _check(gamma: float) -> None:
    value = number(gamma, "gamma", "the factor of the ghost penalty", "-")
    if not 0 < value < math.inf:
        raise ValueError(
            f"the factor of the ghost penalty must be positive and finite: gamma = {value}"
        )
