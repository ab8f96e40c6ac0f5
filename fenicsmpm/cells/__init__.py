# SPDX-License-Identifier: MIT
"""Cells of the background mesh as the points fill them."""

from fenicsmpm.cells.active_cells import ActiveCells
from fenicsmpm.cells.filled_fraction import FilledFraction
from fenicsmpm.cells.tying import Tying
from fenicsmpm.cells.weight_correction import correct_weights

__all__ = ["ActiveCells", "FilledFraction", "Tying", "correct_weights"]
