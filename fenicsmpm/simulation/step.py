# SPDX-License-Identifier: MIT
"""Reports of time steps."""

from __future__ import annotations

from dataclasses import dataclass

from fenicsmpm._display import Described, Facts
from fenicsmpm.solvers import NewtonResult


@dataclass
class Step(Described):
    """Report of a time step.

    Attributes:
        number: Number of the step, from 1.
        time: Time at its end in s.
        dt: Length in s.
        newton: Result of Newton's method; None for explicit steps.
        attempts: 1 plus the number of times that the step was halved.
        removed: Number of points that left the mesh and were deleted, or held back for the first
            time.
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
