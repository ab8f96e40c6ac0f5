# SPDX-License-Identifier: MIT
"""Material points: seeding, location in the mesh, and exchange between ranks."""

from fenicsmpm.points.body_files import read_cloud, read_image, read_solid
from fenicsmpm.points.cells_from_gmsh import boundary_of, in_cells, read_cells
from fenicsmpm.points.in_solids import in_solid, on_surface
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.migration import PointsOutsideError
from fenicsmpm.points.seeding import (
    at,
    fill,
    from_mesh,
    lattice,
    on_curve,
    on_facets,
    quadrature,
    random,
)

__all__ = [
    "MaterialPoints",
    "PointsOutsideError",
    "at",
    "boundary_of",
    "fill",
    "from_mesh",
    "in_cells",
    "in_solid",
    "lattice",
    "on_curve",
    "on_facets",
    "on_surface",
    "quadrature",
    "random",
    "read_cells",
    "read_cloud",
    "read_image",
    "read_solid",
]
