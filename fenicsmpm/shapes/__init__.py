# SPDX-License-Identifier: MIT
"""Solids as predicates and signed distances, independent of meshes and ranks."""

from fenicsmpm.shapes.box import Box
from fenicsmpm.shapes.fractions import fractions
from fenicsmpm.shapes.polygon import polygon
from fenicsmpm.shapes.signed_distance import SignedDistance
from fenicsmpm.shapes.solid import Solid
from fenicsmpm.shapes.surface import OpenSurfaceError, surface
from fenicsmpm.shapes.voxels import contour, mask

__all__ = [
    "Box",
    "OpenSurfaceError",
    "SignedDistance",
    "Solid",
    "contour",
    "fractions",
    "mask",
    "polygon",
    "surface",
]
