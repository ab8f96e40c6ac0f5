# SPDX-License-Identifier: MIT
"""Forces of terms of a residual, such as those of walls and supports on boundary points."""

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
    """Sum of what terms of a residual do to the bodies, as ``observers=[resultant]`` of any loop.

    Args:
        unknown: of the residual.
        form: its terms, UFL of rank 1, such as ``formulations.wall(...)``.

    Attributes:
        value: force on the bodies in the last step, ``(d,)`` [N].
        torque: its moment about the origin, a number in the plane, else ``(3,)`` [N m].
    """

    def __init__(self, unknown: Unknown, form: ufl.Form) -> None:
        """Nothing is known yet."""
        self._unknown, self._form = unknown, form
        self.value: npt.NDArray[np.float64] = np.full(unknown.mesh.geometry.dim, np.nan)
        self.torque: Any = np.nan

    def solved(self, sim: Any) -> None:
        """Sum up the terms while points are where the step began (collective)."""
        self._find()

    def done(self, sim: Any, step: Step) -> None:
        """The same of explicit steps, for points where they are now (collective)."""
        if isinstance(sim, ExplicitMPM):
            self._find()

    def _find(self) -> None:
        self.value = resultant(self._unknown, self._form)
        self.torque = torque(self._unknown, self._form)
