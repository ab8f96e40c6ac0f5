# SPDX-License-Identifier: MIT
"""Between points and grid."""

from fenicsmpm.mapping.active_cells import ActiveCells
from fenicsmpm.mapping.filled_fraction import FilledFraction
from fenicsmpm.mapping.transfer import p2g, project

__all__ = ["ActiveCells", "FilledFraction", "p2g", "project"]
