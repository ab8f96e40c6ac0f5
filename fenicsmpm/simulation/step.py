# SPDX-License-Identifier: MIT
"""What a time loop says of a step."""

from __future__ import annotations

from dataclasses import dataclass

from fenicsmpm.solvers import NewtonResult


@dataclass
class Step:
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
