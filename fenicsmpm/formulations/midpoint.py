# SPDX-License-Identifier: MIT
"""The mid-point rule, which conserves momenta, and energy with the right stress."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class Midpoint(TimeScheme):
    """Mid-point rule (conservation paper, equations 22 to 24): v_m = u / dt, a_m = (v - v_n) / dt.

    Velocities are mapped to the grid with the effective mass (1 - epsilon) M + epsilon M_lumped
    (equations 18 and 26), the same as that of inertia. With the consistent mass and FLIP, mapping
    keeps momenta and the energy that the grid gains (tables 1 and 2). Loads that depend on time are
    to be taken in the middle of a step, and so are stresses: ``EnergyMomentum``,
    ``MixedEnergyMomentum``, or those of U / 2. With stresses of the whole U, as in ``mixed``, the
    method is of first order and damps strongly.

    Args:
        unknown: with a part that moves the points, the displacement increment u [m].
        dt: time step [s].
        flip: 1 for FLIP (equation 29), 0 for PIC (equation 28), or between.
        lumping: share epsilon of the lumped mass [-].

    Attributes:
        dt: length of the present step, which the time loop sets.
        histories: grid function of each field that is mapped from points, by the field's name.
        increment: displacement increment u of the step [m].
        acceleration: in the middle of the step [m/s^2].

    Raises:
        ValueError: for a time step that is not positive and finite, shares beyond [0, 1].
    """

    def __init__(
        self, unknown: Unknown, *, dt: float, flip: float = 1.0, lumping: float = 0.0
    ) -> None:
        """Write down velocity and acceleration."""
        super().__init__(unknown, dt, flip, ("v",))
        if not 0 <= lumping <= 1:
            raise ValueError(f"the share of the lumped mass must lie in [0, 1]: {lumping}")
        self.lumping = lumping
        self.increment = self.u
        self._velocity = 2 * self.increment / self.dt - self.histories["v"]
        self.acceleration = (self._velocity - self.histories["v"]) / self.dt

    def inertia(self, points: MaterialPoints) -> ufl.Form:
        """See ``TimeScheme``; with the effective mass (equation 18), as velocities are mapped."""
        if self.lumping == 0:
            return super().inertia(points)
        if self.lumping == 1:
            return super().lumped(points)
        consistent, lumped = super().inertia(points), super().lumped(points)
        return (1 - self.lumping) * consistent + self.lumping * lumped

    def lumped(self, points: MaterialPoints) -> ufl.Form:
        """See ``TimeScheme``.

        Raises:
            ValueError: also for lumping < 1, when velocities are mapped with another mass.
        """
        if self.lumping < 1:
            raise ValueError(
                f"velocities are mapped with a share of {self.lumping:g} of the lumped mass: give "
                "Midpoint lumping=1, or take scheme.inertia, which has the same share"
            )
        return super().lumped(points)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """None: steps start from no motion, from where Newton's method needs the fewest iterations.

        A motion that goes on as it was turns, stretches and presses together what only turns.
        """
        return []

    def middle(self, part: str) -> Any:
        """Value of a history of the unknown in the middle of the step, UFL.

        Args:
            part: its name.
        """
        return (getattr(self.unknown.old, part) + getattr(self.unknown, part)) / 2

    def velocity(self) -> Any:
        """Velocity on the grid in the middle of the step [m/s], UFL."""
        return self.increment / self.dt

    @property
    def rates(self) -> tuple[Any, Any]:
        """By how much u changes velocity [1/s] and acceleration [1/s^2] in the equations."""
        return 1 / self.dt, 2 / self.dt**2

    def grid_velocity(self) -> Any:
        """Velocity on the grid at the end of the step [m/s], UFL."""
        return self._velocity

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New values of the points' fields, as UFL over the points.

        Args:
            points: the body.
        """
        change = self._velocity - self.histories["v"]
        velocity = self.flip * (points.field("v") + change) + (1 - self.flip) * self._velocity
        return {"v": velocity, "a": self.acceleration}

    def __repr__(self) -> str:
        """Name and parameters."""
        return (
            f"Midpoint(dt={float(self.dt.value):g} s, flip={self.flip:g}, lumping={self.lumping:g})"
        )
