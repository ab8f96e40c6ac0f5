# SPDX-License-Identifier: MIT
"""BDF2, the second-order backward differentiation formula, for implicit dynamics."""

from __future__ import annotations

from typing import Any

from dolfinx import fem

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class BDF2(TimeScheme):
    """BDF2 for displacement and velocity, with steps of variable length.

    The points carry the previous increments of displacement "du" and of velocity "dv". They also
    carry the previous increment of each history whose ``rate`` is requested. The first step uses
    the implicit Euler method.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m].
        dt: Time step [s].
        flip: Share of FLIP in the velocity update [-], from 0 (PIC) to 1 (FLIP).

    Attributes:
        dt: Length of the current step [s], a constant that the time loop sets.
        histories: Grid functions of the fields that are mapped from the points, by field name.
        increment: Displacement increment u of the step ``(d,)`` [m], UFL.
        acceleration: Acceleration at the end of the step ``(d,)`` [m/s^2], UFL.

    Raises:
        ValueError: If the time step is not positive and finite, the share of FLIP lies outside
            [0, 1], or no part of the unknown moves the points.
    """

    def __init__(self, unknown: Unknown, *, dt: float, flip: float = 1.0) -> None:
        """Define velocity and acceleration."""
        super().__init__(unknown, dt, flip, ("v", "du", "dv"))
        mesh = unknown.mesh
        self._new = fem.Constant(mesh, 1.0)  # coefficients of the new and the previous increment
        self._old = fem.Constant(mesh, 0.0)
        self._previous_dt: float | None = None
        v, du, dv = self.histories.values()
        self.increment = self.u
        self._velocity = self._rate(self.increment, du)
        self.acceleration = self._rate(self._velocity - v, dv)

    def _rate(self, new: Any, old: Any) -> Any:
        return (self._new * new - self._old * old) / self.dt

    def rate(self, part: str) -> Any:
        """Return the rate of a history [1/s] as UFL, of second order in dt.

        Args:
            part: Name of the history.

        Raises:
            ValueError: If the part is not a history.
        """
        super().rate(part)
        name = f"d{part}"
        if name not in self.histories:
            self.histories[name] = fem.Function(self.unknown.part_space(part), name=name)
        return self._rate(self.change(part), self.histories[name])

    def begin(self) -> None:
        """Adapt the coefficients to the lengths of this step and of the previous one, if any."""
        dt = float(self.dt.value)
        ratio = 0.0 if self._previous_dt is None else dt / self._previous_dt
        self._new.value = (1 + 2 * ratio) / (1 + ratio)
        self._old.value = ratio**2 / (1 + ratio)

    def end(self) -> None:
        """Store the length of the completed step."""
        self._previous_dt = float(self.dt.value)

    @property
    def memory(self) -> dict[str, float]:
        """Length of the previous step [s]; empty before the first step."""
        return {} if self._previous_dt is None else {"previous_dt": self._previous_dt}

    @memory.setter
    def memory(self, values: dict[str, float]) -> None:
        self._previous_dt = values.get("previous_dt")

    @property
    def rates(self) -> tuple[Any, Any]:
        """Derivatives of velocity [1/s] and acceleration [1/s^2] with respect to u, UFL."""
        return self._new / self.dt, (self._new / self.dt) ** 2

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
        return {
            "v": velocity,
            "a": self.acceleration,
            "du": self.increment,
            "dv": velocity - points.field("v"),
            **{f"d{part}": self.change(part) for part in self._with_rates},
        }

    def __repr__(self) -> str:
        """Name and parameters."""
        return f"BDF2(dt={float(self.dt.value):g} s, flip={self.flip:g})"
