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
    """Return the cell size at a facet [m] and a function for jumps of normal derivatives.

    Args:
        mesh: Background mesh.

    Returns:
        Size h of the two cells at a facet [m], UFL, and a function that maps a UFL expression to
        the jump of its normal derivative across the facet.
    """
    n = ufl.FacetNormal(mesh.ufl_domain())("+")
    domain = mesh.ufl_domain()
    # FFCx has no volume of quadrilaterals and hexahedra. Their reference cells have the volume 1.
    is_simplex = cell_geometry(mesh).is_simplex
    volume = ufl.CellVolume(domain) if is_simplex else abs(ufl.JacobianDeterminant(domain))
    h = ufl.avg(volume) ** (1 / mesh.geometry.dim)

    def jump(f: Any) -> Any:
        return ufl.dot(ufl.grad(f)("+") - ufl.grad(f)("-"), n)

    return h, jump


def of_jumps(measure: ufl.Measure, spaces: Sequence[fem.FunctionSpace]) -> ufl.Measure:
    """Return a measure for products of two jumps, with as few quadrature points as possible.

    Normal derivatives of linear functions are constant on the facets of simplices and linear along
    the facets of boxes. The degree that UFL estimates is higher.

    Args:
        measure: Measure over facets.
        spaces: Function spaces of the arguments of the jumps.

    Returns:
        The measure, with a lower quadrature degree if all functions are linear.
    """
    geometry = cell_geometry(spaces[0].mesh)
    if not all(is_linear(V.ufl_element()) for V in spaces):
        return measure
    if geometry.is_simplex:
        return measure(metadata={"quadrature_degree": 0})
    if geometry.boxes is not None:
        return measure(metadata={"quadrature_degree": 2})
    return measure
