# SPDX-License-Identifier: MIT
"""Reactions of Dirichlet conditions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm import _compat
from fenicsmpm.formulations.condition import Condition
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step


class Reaction(Observer):
    """Total reaction of a Dirichlet condition, as ``observers=[reaction]`` of any loop.

    Nodes of several conditions count for each of them.

    Args:
        condition: Condition made by ``Unknown.fix``.

    Attributes:
        value: Reaction in the last step. It is the force on the bodies ``(d,)`` in N if the part
            moves the points or is their velocity. Otherwise it is the flux into them, ``(1,)`` for
            a scalar part, in the units of the residual.
    """

    def __init__(self, condition: Condition) -> None:
        """Create the observer; the value is not known yet."""
        self._condition = condition
        self.value: npt.NDArray[np.float64] = np.full(condition.size, np.nan)

    def done(self, sim: Any, step: Step) -> None:
        """Compute the reaction in explicit steps (implicit: ``solved``). Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        if isinstance(sim, ExplicitMPM):
            self.value = sim.reaction_of(self._condition)

    def solved(self, sim: Any) -> None:
        """Sum up the residual at the condition's nodes. Collective.

        Args:
            sim: The simulation.
        """
        residual = sim.newton.residual()
        held = _compat.bc_dofs(self._condition.bc)
        held = held[held < len(residual)]
        unknown = self._condition.unknown
        places = unknown.dofs(self._condition.part)
        value = np.zeros(len(self.value))
        for c in range(len(value)):
            value[c] = residual[np.intersect1d(held, places[c :: len(value)])].sum()
        self.value = unknown.mesh.comm.allreduce(value)
