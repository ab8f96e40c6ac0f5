# SPDX-License-Identifier: MIT
"""Between points and grid: what both time loops use."""

from fenicsmpm.transfer.points_to_grid import p2g, project

__all__ = ["p2g", "project"]
