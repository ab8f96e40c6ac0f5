# SPDX-License-Identifier: MIT
"""Ghost penalty: cut cells follow their neighbours (E. Burman, C. R. Math. 348, 2010)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem

from fenicsmpm.basis import is_linear
from fenicsmpm.cells import ActiveCells
from fenicsmpm.formulations.mixed import MixedLaw
from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Hencky, VonMises
from fenicsmpm.points.geometry import cell_geometry


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
    h, jump = _facets(cells)
    parts = ["u", "p"] if "p" in z else ["u"]
    dS = _measure(cells, [z.part_space(part) for part in parts])
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
    h, jump = _facets(cells)
    inertia = ufl.inner(jump(scheme.acceleration), jump(scheme.w))
    assert scheme.unknown.moving is not None  # checked by the scheme
    dS = _measure(cells, [scheme.unknown.part_space(scheme.unknown.moving)])
    return gamma * density * h**3 * inertia * dS


def _check(gamma: float) -> None:
    if not gamma > 0:
        raise ValueError(f"the factor of the ghost penalty must be positive: gamma = {gamma}")


def _measure(cells: ActiveCells, spaces: Sequence[fem.FunctionSpace]) -> ufl.Measure:
    """Of the facets; gradients of linear functions on simplices are constant, UFL thinks not."""
    simple = cell_geometry(cells.mesh).is_simplex
    if simple and all(is_linear(V.ufl_element()) for V in spaces):
        return cells.dS(metadata={"quadrature_degree": 0})
    return cells.dS


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
