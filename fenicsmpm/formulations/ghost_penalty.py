# SPDX-License-Identifier: MIT
"""Ghost penalty: cut cells follow their neighbours (E. Burman, C. R. Math. 348, 2010)."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

from fenicsmpm.formulations.mixed import parts
from fenicsmpm.mapping import ActiveCells
from fenicsmpm.materials import NeoHookean
from fenicsmpm.points.geometry import cell_geometry


def ghost_penalty(
    U: fem.Function, V: Any, cells: ActiveCells, law: NeoHookean, *, gamma: float = 0.1
) -> ufl.Form:
    """Penalty on jumps of gradients over the facets of cut cells.

    Nodes with little or no material nearby then follow the linear continuation of their
    neighbours: gamma mu h [dn u] . [dn w] - gamma h^3 / (2 mu) [dn p] [dn q]. The increment of
    displacement is penalized, not the displacement itself, so that no force builds up.

    Args:
        U: increment of displacement [m] and pressure [Pa].
        V: test function.
        cells: active cells of the body and of boundary points that carry loads.
        law: constitutive law.
        gamma: factor [-]; 1 begins to stiffen the body.

    Returns:
        UFL form of rank 1 over facets.
    """
    if not gamma > 0:
        raise ValueError(f"the factor of the ghost penalty must be positive: gamma = {gamma}")
    u, p = parts(U)[:2]
    w, q = parts(V)[:2]
    mesh = cells.mesh
    n = ufl.FacetNormal(mesh.ufl_domain())("+")
    domain = mesh.ufl_domain()
    # FFCx has no volume of quadrilaterals and hexahedra; that of the reference cell is one
    is_simplex = cell_geometry(mesh).is_simplex
    volume = ufl.CellVolume(domain) if is_simplex else abs(ufl.JacobianDeterminant(domain))
    h = ufl.avg(volume) ** (1 / mesh.geometry.dim)

    def jump(f: Any) -> Any:
        return ufl.dot(ufl.grad(f)("+") - ufl.grad(f)("-"), n)

    displacement = law.mu * h * ufl.inner(jump(u), jump(w))
    pressure = h**3 / (2 * law.mu) * jump(p) * jump(q)
    return gamma * (displacement - pressure) * cells.dS
