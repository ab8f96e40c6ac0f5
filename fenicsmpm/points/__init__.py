# SPDX-License-Identifier: MIT
"""What the material carries: points, their seeding, location and migration."""

from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.migration import PointsOutsideError

__all__ = ["MaterialPoints", "PointsOutsideError"]
