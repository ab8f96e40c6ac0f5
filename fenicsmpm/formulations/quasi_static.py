# SPDX-License-Identifier: MIT
"""Steps without inertia, in which time is what loads depend on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class QuasiStatic(TimeScheme):
    """Equilibrium at the end of each load step.

    Steps of ``ImplicitMPM.run`` shrink where they fail and may grow where they are easy.

    Args:
        unknown: with a part that moves the points, the displacement increment u [m].
        dt: load step, in terms of the time on which loads depend [s].

    Attributes:
        dt: length of the present step, which the time loop sets.
        increment: displacement increment u of the step [m].
        acceleration: zero.

    Raises:
        ValueError: for a step that is not positive and finite.
    """

    def __init__(self, unknown: Unknown, *, dt: float) -> None:
        """Write down that nothing accelerates."""
        super().__init__(unknown, dt, 0.0, ())
        self.increment = self.u
        self.acceleration = ufl.zero(unknown.mesh.geometry.dim)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """None: load steps start from no motion."""
        return []

    @property
    def rates(self) -> tuple[Any, Any]:
        """By how much u changes velocity [1/s] and acceleration [1/s^2] in the equations."""
        return 1 / self.dt, ufl.as_ufl(0.0)

    def grid_velocity(self) -> Any:
        """Mean velocity on the grid in the step [m/s], UFL."""
        return self.increment / self.dt

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New values of the points' fields, as UFL over the points.

        Args:
            points: the body.
        """
        return {"v": self.grid_velocity()}

    def __repr__(self) -> str:
        """Name and step."""
        return f"QuasiStatic(dt={float(self.dt.value):g} s)"
