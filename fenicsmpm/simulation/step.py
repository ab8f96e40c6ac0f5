# SPDX-License-Identifier: MIT
"""What a time loop says of a step."""

from __future__ import annotations

from dataclasses import dataclass

from fenicsmpm._display import Described, Facts
from fenicsmpm.solvers import NewtonResult


@dataclass
class Step(Described):
    """What happened in a time step.

    Attributes:
        number: of the step, from 1.
        time: at its end [s].
        dt: its length [s].
        newton: how its equations were solved; None for explicit steps, which solve none.
        attempts: 1 plus the number of times that the step was halved.
        removed: points that left the mesh and were deleted, or held back for the first time.
    """

    number: int
    time: float
    dt: float
    newton: NewtonResult | None = None
    attempts: int = 1
    removed: int = 0

    def _facts(self) -> Facts:
        facts = [
            ("step", str(self.number)),
            ("time", f"{self.time:g} s"),
            ("length", f"{self.dt:g} s"),
        ]
        if self.attempts > 1:
            facts.append(("attempts", f"{self.attempts}, with half the length each time"))
        if self.removed:
            facts.append(("points that left the mesh", str(self.removed)))
        return facts + ([] if self.newton is None else self.newton._facts())
