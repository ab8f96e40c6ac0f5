# SPDX-License-Identifier: MIT
"""Grid functions seen from the material points."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from fenicsmpm.basis.lagrange import LagrangeStencil
from fenicsmpm.basis.stencil import PointStencil

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints

__all__ = ["LagrangeStencil", "PointStencil", "stencil_of"]

_stencils: weakref.WeakKeyDictionary[MaterialPoints, PointStencil] = weakref.WeakKeyDictionary()


def stencil_of(points: MaterialPoints) -> PointStencil:
    """The stencil of a point set, made at first use (Lagrange functions of the mesh)."""
    if points not in _stencils:
        _stencils[points] = LagrangeStencil(points)
    return _stencils[points]
