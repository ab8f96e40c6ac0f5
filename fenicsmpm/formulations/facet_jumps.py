# SPDX-License-Identifier: MIT
"""Jumps of normal derivatives over facets, in UFL."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem

from fenicsmpm.basis import is_linear
from fenicsmpm.points.geometry import cell_geometry


def jumps(mesh: Any) -> Any:
    """Size of the cells at a facet [m], and the jump of a normal derivative.

    Args:
        mesh: background mesh.
    """
    n = ufl.FacetNormal(mesh.ufl_domain())("+")
    domain = mesh.ufl_domain()
    # FFCx has no volume of quadrilaterals and hexahedra; that of the reference cell is one
    is_simplex = cell_geometry(mesh).is_simplex
    volume = ufl.CellVolume(domain) if is_simplex else abs(ufl.JacobianDeterminant(domain))
    h = ufl.avg(volume) ** (1 / mesh.geometry.dim)

    def jump(f: Any) -> Any:
        return ufl.dot(ufl.grad(f)("+") - ufl.grad(f)("-"), n)

    return h, jump


def of_jumps(measure: ufl.Measure, spaces: Sequence[fem.FunctionSpace]) -> ufl.Measure:
    """A measure for products of two jumps, with as few quadrature points as they need.

    Normal derivatives of linear functions are constant on simplices, and linear along the facets of
    boxes; UFL counts with more.

    Args:
        measure: over facets.
        spaces: of the functions.
    """
    geometry = cell_geometry(spaces[0].mesh)
    if not all(is_linear(V.ufl_element()) for V in spaces):
        return measure
    if geometry.is_simplex:
        return measure(metadata={"quadrature_degree": 0})
    if geometry.boxes is not None:
        return measure(metadata={"quadrature_degree": 2})
    return measure
