# SPDX-License-Identifier: MIT
"""Background cells as filled by points: active and cut cells, tying, weight correction."""

from fenicsmpm.cells.active_cells import ActiveCells
from fenicsmpm.cells.balanced_weights import BalancedWeights
from fenicsmpm.cells.filled_fraction import FilledFraction
from fenicsmpm.cells.tying import Tying
from fenicsmpm.cells.weight_correction import correct_weights

__all__ = ["ActiveCells", "BalancedWeights", "FilledFraction", "Tying", "correct_weights"]
