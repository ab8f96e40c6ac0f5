# SPDX-License-Identifier: MIT
"""Ghost penalty: cut cells follow their neighbours (E. Burman, C. R. Math. 348, 2010)."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations.mixed import MixedLaw, parts
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.materials import Hencky, VonMises
from fenicsmpm.points.geometry import cell_geometry


def ghost_penalty(
    U: fem.Function,
    V: Any,
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
        U: increment of displacement [m], and pressure [Pa].
        V: test function.
        cells: active cells of the body and of boundary points that carry loads.
        law: constitutive law.
        gamma: factor [-]; 1 begins to stiffen the body.

    Returns:
        UFL form of rank 1 over facets.

    Raises:
        ValueError: for a factor that is not positive, or a law without a shear modulus.
    """
    _check(gamma)
    u, *pressure = parts(U)[:2]
    w, *test = parts(V)[:2]
    h, jump = _facets(cells)
    mu = law.modulus(h**2) if hasattr(law, "modulus") else getattr(law, "mu", None)
    if mu is None:
        raise ValueError(
            f"the ghost penalty needs a law with a shear modulus mu, such as NeoHookean, Hencky "
            f"or VonMises, not {law!r}"
        )
    penalty = mu * h * ufl.inner(jump(u), jump(w))
    for p, q in zip(pressure, test, strict=True):
        penalty -= h**3 / (2 * mu) * jump(p) * jump(q)
    return gamma * penalty * cells.dS


def ghost_mass(
    V: Any, cells: ActiveCells, scheme: TimeScheme, density: float, *, gamma: float = 0.1
) -> ufl.Form:
    """Inertia of nodes with little material: gamma rho h^3 [dn a] . [dn w] over cut cells' facets.

    It bounds the condition number of the mass (S. Sticko, G. Ludvigsson, G. Kreiss, Adv. Comput.
    Math. 46, 2020; conservation paper, section 7.4). Points do not gain what its kinetic energy
    loses; ``cells.Tying`` regularizes the mass as well, and conserves energy.

    Args:
        V: test function.
        cells: active cells of the body.
        scheme: time scheme, whose acceleration it takes [m/s^2].
        density: of the undeformed body [kg/m^d].
        gamma: factor [-].

    Returns:
        UFL form of rank 1 over facets.
    """
    _check(gamma)
    h, jump = _facets(cells)
    inertia = ufl.inner(jump(scheme.acceleration), jump(parts(V)[0]))
    return gamma * density * h**3 * inertia * cells.dS


def _check(gamma: float) -> None:
    if not gamma > 0:
        raise ValueError(f"the factor of the ghost penalty must be positive: gamma = {gamma}")


def _facets(cells: ActiveCells) -> Any:
    """Size of the cells at a facet [m], and the jump of a normal derivative."""
    mesh = cells.mesh
    n = ufl.FacetNormal(mesh.ufl_domain())("+")
    domain = mesh.ufl_domain()
    # FFCx has no volume of quadrilaterals and hexahedra; that of the reference cell is one
    is_simplex = cell_geometry(mesh).is_simplex
    volume = ufl.CellVolume(domain) if is_simplex else abs(ufl.JacobianDeterminant(domain))
    h = ufl.avg(volume) ** (1 / mesh.geometry.dim)

    def jump(f: Any) -> Any:
        return ufl.dot(ufl.grad(f)("+") - ufl.grad(f)("-"), n)

    return h, jump
