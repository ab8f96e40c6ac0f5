# SPDX-License-Identifier: MIT
"""Between points and grid."""

from fenicsmpm.mapping.active_cells import ActiveCells
from fenicsmpm.mapping.filled_fraction import FilledFraction
from fenicsmpm.mapping.transfer import p2g, project
from fenicsmpm.mapping.tying import Tying
from fenicsmpm.mapping.weight_correction import correct_weights

__all__ = ["ActiveCells", "FilledFraction", "Tying", "correct_weights", "p2g", "project"]
