# SPDX-License-Identifier: MIT
"""The mid-point rule, which conserves momenta, and with a suitable stress also energy."""

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
    (equations 18 and 26). The inertia uses the same mass. With the consistent mass and FLIP, the
    mapping conserves momenta and the energy that the grid gains (tables 1 and 2).

    Time-dependent loads and stresses must be evaluated at the middle of a step. Suitable stresses
    are ``EnergyMomentum``, ``MixedEnergyMomentum``, or any stress computed from U / 2. With
    stresses at the full U, as in ``mixed``, the method is of first order and strongly dissipative.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m].
        dt: Time step [s].
        flip: Share of FLIP in the velocity update [-], from 0 (PIC, equation 28) to 1 (FLIP,
            equation 29).
        lumping: Share epsilon of the lumped mass [-].

    Attributes:
        dt: Length of the current step [s], a constant that the time loop sets.
        histories: Grid functions of the fields that are mapped from the points, by field name.
        increment: Displacement increment u of the step ``(d,)`` [m], UFL.
        acceleration: Acceleration at the middle of the step ``(d,)`` [m/s^2], UFL.

    Raises:
        ValueError: If the time step is not positive and finite, a share lies outside [0, 1], or no
            part of the unknown moves the points.
    """

    def __init__(
        self, unknown: Unknown, *, dt: float, flip: float = 1.0, lumping: float = 0.0
    ) -> None:
        """Define velocity and acceleration."""
        super().__init__(unknown, dt, flip, ("v",))
        if not 0 <= lumping <= 1:
            raise ValueError(f"the share of the lumped mass must lie in [0, 1]: {lumping}")
        self.lumping = lumping
        self.increment = self.u
        self._velocity = 2 * self.increment / self.dt - self.histories["v"]
        self.acceleration = (self._velocity - self.histories["v"]) / self.dt

    def inertia(self, points: MaterialPoints) -> ufl.Form:
        """Return the inertia (rho a, w) with the effective mass (equation 18).

        Velocities are mapped to the grid with the same mass.

        Args:
            points: The body, with the field "mass" [kg].

        Returns:
            UFL form of rank 1 over the points.
        """
        if self.lumping == 0:
            return super().inertia(points)
        if self.lumping == 1:
            return super().lumped(points)
        consistent, lumped = super().inertia(points), super().lumped(points)
        return (1 - self.lumping) * consistent + self.lumping * lumped

    def lumped(self, points: MaterialPoints) -> ufl.Form:
        """Return the inertia (rho a, w) with the lumped mass of the points; needs lumping = 1.

        Args:
            points: The body, with the field "mass" [kg].

        Returns:
            UFL form of rank 1 over the points.

        Raises:
            ValueError: If lumping < 1, because velocities are then mapped with another mass, or if
                the functions of the motion are not linear.
        """
        if self.lumping < 1:
            raise ValueError(
                f"velocities are mapped with a share of {self.lumping:g} of the lumped mass: "
                "create Midpoint with lumping=1, or use scheme.inertia, which has the same share"
            )
        return super().lumped(points)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """Return no predictions: zero motion is where Newton's method needs the fewest iterations.

        For a rotating body, an extrapolated motion would stretch and compress the body.
        """
        return []

    def middle(self, part: str) -> Any:
        """Return the value of a history at the middle of the step, UFL.

        Args:
            part: Name of the history.
        """
        return (getattr(self.unknown.old, part) + getattr(self.unknown, part)) / 2

    def velocity(self) -> Any:
        """Return the grid velocity at the middle of the step ``(d,)`` [m/s], UFL."""
        return self.increment / self.dt

    @property
    def rates(self) -> tuple[Any, Any]:
        """Derivatives of velocity [1/s] and acceleration [1/s^2] with respect to u, UFL."""
        return 1 / self.dt, 2 / self.dt**2

    def grid_velocity(self) -> Any:
        """Return the grid velocity at the end of the step ``(d,)`` [m/s], UFL."""
        return self._velocity

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """Return the new values of the point fields, as UFL over the points.

        Args:
            points: The body.
        """
        change = self._velocity - self.histories["v"]
        velocity = self.flip * (points.field("v") + change) + (1 - self.flip) * self._velocity
        return {"v": velocity, "a": self.acceleration}

    def __repr__(self) -> str:
        """Name and parameters."""
        return (
            f"Midpoint(dt={float(self.dt.value):g} s, flip={self.flip:g}, lumping={self.lumping:g})"
        )
