# SPDX-License-Identifier: MIT
"""Resultants of terms of a residual, such as walls and supports on boundary points."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.diagnostics import resultant, torque
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step


class Resultant(Observer):
    """Total force of terms of a residual, as ``observers=[resultant]`` of any loop.

    Args:
        unknown: Unknown of the residual.
        form: Terms of the residual, UFL of rank 1, such as ``formulations.wall(...)``.

    Attributes:
        value: Force on the bodies in the last step in N, ``(d,)``.
        torque: Moment of this force about the origin in N m: a number in 2D, ``(3,)`` in 3D.
    """

    def __init__(self, unknown: Unknown, form: ufl.Form) -> None:
        """Create the observer; the force is not known yet."""
        self._unknown, self._form = unknown, form
        self.value: npt.NDArray[np.float64] = np.full(unknown.mesh.geometry.dim, np.nan)
        self.torque: Any = np.nan

    def solved(self, sim: Any) -> None:
        """Sum up the terms while points are where the step began. Collective.

        Args:
            sim: The simulation.
        """
        self._find()

    def done(self, sim: Any, step: Step) -> None:
        """Sum up the terms in explicit steps, for the current points. Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        if isinstance(sim, ExplicitMPM):
            self._find()

    def _find(self) -> None:
        self.value = resultant(self._unknown, self._form)
        self.torque = torque(self._unknown, self._form)
