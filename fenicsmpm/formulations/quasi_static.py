# SPDX-License-Identifier: MIT
"""Quasi-static steps without inertia, in which time only controls the loads."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class QuasiStatic(TimeScheme):
    """Quasi-static scheme: equilibrium at the end of each load step.

    ``ImplicitMPM.run`` shortens steps that fail and may lengthen steps that converge quickly.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m].
        dt: Load step, in units of the time that controls the loads [s].

    Attributes:
        dt: Length of the current step [s], a constant that the time loop sets.
        increment: Displacement increment u of the step ``(d,)`` [m], UFL.
        acceleration: Zero ``(d,)`` [m/s^2], UFL.

    Raises:
        ValueError: If the step is not positive and finite, or no part of the unknown moves the
            points.
    """

    def __init__(self, unknown: Unknown, *, dt: float) -> None:
        """Set the acceleration to zero."""
        super().__init__(unknown, dt, 0.0, ())
        self.increment = self.u
        self.acceleration = ufl.zero(unknown.mesh.geometry.dim)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """Return no predictions: load steps start from zero displacement."""
        return []

    @property
    def rates(self) -> tuple[Any, Any]:
        """Derivatives of velocity [1/s] and acceleration [1/s^2] with respect to u, UFL."""
        return 1 / self.dt, ufl.as_ufl(0.0)

    def grid_velocity(self) -> Any:
        """Return the mean grid velocity of the step ``(d,)`` [m/s], UFL."""
        return self.increment / self.dt

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """Return the new values of the point fields, as UFL over the points.

        Args:
            points: The body.
        """
        return {"v": self.grid_velocity()}

    def __repr__(self) -> str:
        """Name and step."""
        return f"QuasiStatic(dt={float(self.dt.value):g} s)"
