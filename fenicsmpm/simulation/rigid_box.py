# SPDX-License-Identifier: MIT
"""Rigid boxes that push bodies in explicit steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt


class RigidBox:
    """An axis-parallel rigid box with a prescribed motion.

    Args:
        lower: corner (d,) at the start [m].
        upper: opposite corner (d,) [m]; infinite for boxes without end.
        reach: gap from which on there is a contact force [m], such as half the points' distance.
        velocity: (d,) [m/s], or a function of time [s].
        friction: coefficient; infinite for no slip.
        stiffness: of the barrier, in units of a point's mass over the square of the time step.

    Attributes:
        moved: way of the box so far (d,) [m].
        force: of the box on the bodies in the last step, (d,) [N].

    Raises:
        ValueError: for corners in the wrong order, a reach that is not positive, or negative
            friction or stiffness.
    """

    def __init__(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        reach: float,
        velocity: npt.ArrayLike | Callable[[float], npt.ArrayLike] = 0.0,
        friction: float = 0.0,
        stiffness: float = 0.1,
    ) -> None:
        """Check and copy."""
        self._lower = np.array(lower, dtype=np.float64)
        self._upper = np.array(upper, dtype=np.float64)
        if self._lower.shape != self._upper.shape or not np.all(self._lower < self._upper):
            raise ValueError(f"corners of a box in the wrong order: {self._lower}, {self._upper}")
        if not (0 < reach < np.inf and friction >= 0 and stiffness > 0):
            raise ValueError(
                "a rigid box needs a positive reach and stiffness and no negative friction: "
                f"{reach}, {stiffness}, {friction}"
            )
        self.reach, self.velocity = reach, velocity
        self.friction, self.stiffness = friction, stiffness
        self.moved: npt.NDArray[np.float64] = np.zeros(len(self._lower))
        self.force: npt.NDArray[np.float64] = np.zeros(len(self._lower))

    @property
    def lower(self) -> npt.NDArray[np.float64]:
        """Corner (d,) now [m]."""
        return self._lower + self.moved

    @property
    def upper(self) -> npt.NDArray[np.float64]:
        """Opposite corner (d,) now [m]."""
        return self._upper + self.moved

    def velocity_at(self, time: float) -> npt.NDArray[np.float64]:
        """Velocity (d,) [m/s].

        Raises:
            ValueError: if it is not finite.
        """
        value = self.velocity(time) if callable(self.velocity) else self.velocity
        velocity = np.broadcast_to(np.asarray(value, dtype=np.float64), self.force.shape).copy()
        if not np.isfinite(velocity).all():
            raise ValueError(f"velocity of a rigid box must be finite: {velocity} at t = {time} s")
        return velocity
