# SPDX-License-Identifier: MIT
"""Transfers between points and grid, used by both time loops."""

from fenicsmpm.transfer.points_to_grid import p2g, project

__all__ = ["p2g", "project"]
