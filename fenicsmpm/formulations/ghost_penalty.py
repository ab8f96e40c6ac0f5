# SPDX-License-Identifier: MIT
"""Ghost penalty: cut cells follow their neighbours (E. Burman, C. R. Math. 348, 2010)."""

from __future__ import annotations

import ufl

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
    """Penalty on jumps of gradients over the facets of cut cells.

    Nodes with little or no material nearby then follow the linear continuation of their
    neighbours: gamma mu h [dn u] . [dn w] - gamma h^3 / (2 mu) [dn p] [dn q], the latter if there
    is a pressure. The increment of displacement is penalized, not the displacement itself, so that
    no force builds up; its work is lost. A load on such nodes moves them by the same length in each
    step, however short: in short steps take ``cells.Tying``.

    Args:
        z: unknown with the increment of displacement u [m], and the pressure p [Pa] if it has one.
        cells: active cells of the body and of boundary points that carry loads.
        law: constitutive law.
        gamma: factor [-]; 1 begins to stiffen the body.

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: for a factor that is not positive, or a law without a shear modulus.
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
    """Inertia of nodes with little material: gamma rho h^3 [dn a] . [dn w] over cut cells' facets.

    It bounds the condition number of the mass (S. Sticko, G. Ludvigsson, G. Kreiss, Adv. Comput.
    Math. 46, 2020; conservation paper, section 7.4). Points do not gain what its kinetic energy
    loses; ``cells.Tying`` regularizes the mass as well, and conserves energy.

    Args:
        cells: active cells of the body.
        scheme: time scheme, whose acceleration it takes [m/s^2].
        density: of the undeformed body [kg/m^d].
        gamma: factor [-].

    Returns:
        UFL form of rank 1 over facets.
    """
    _check(gamma)
    h, jump = jumps(cells.mesh)
    inertia = ufl.inner(jump(scheme.acceleration), jump(scheme.w))
    assert scheme.unknown.moving is not None  # checked by the scheme
    dS = of_jumps(cells.dS, [scheme.unknown.part_space(scheme.unknown.moving)])
    return gamma * density * h**3 * inertia * dS


def _check(gamma: float) -> None:
    if not gamma > 0:
        raise ValueError(f"the factor of the ghost penalty must be positive: gamma = {gamma}")
