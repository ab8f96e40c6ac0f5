# SPDX-License-Identifier: MIT
"""BDF2, the second-order backward differentiation formula, for implicit dynamics."""

from __future__ import annotations

from typing import Any

from dolfinx import fem

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class BDF2(TimeScheme):
    """Velocity and acceleration by BDF2 of displacement and velocity, for steps of any length.

    Points carry the previous increments of displacement "du" and velocity "dv", and that of each
    history whose ``rate`` is asked for. The first step is one of the implicit Euler method.

    Args:
        unknown: with a part that moves the points, the displacement increment u [m].
        dt: time step [s].
        flip: 1 for FLIP, 0 for PIC, or between.

    Attributes:
        dt: length of the present step, which the time loop sets.
        histories: grid function of each field that is mapped from points, by the field's name.
        increment: displacement increment u of the step [m].
        acceleration: at the end of the step [m/s^2].
    """

    def __init__(self, unknown: Unknown, *, dt: float, flip: float = 1.0) -> None:
        """Write down velocity and acceleration."""
        super().__init__(unknown, dt, flip, ("v", "du", "dv"))
        mesh = unknown.mesh
        self._new = fem.Constant(mesh, 1.0)  # factors of the new and of the previous increment
        self._old = fem.Constant(mesh, 0.0)
        self._previous_dt: float | None = None
        v, du, dv = self.histories.values()
        self.increment = self.u
        self._velocity = self._rate(self.increment, du)
        self.acceleration = self._rate(self._velocity - v, dv)

    def _rate(self, new: Any, old: Any) -> Any:
        return (self._new * new - self._old * old) / self.dt

    def rate(self, part: str) -> Any:
        """See ``TimeScheme``; of second order."""
        super().rate(part)
        name = f"d{part}"
        if name not in self.histories:
            self.histories[name] = fem.Function(self.unknown.part_space(part), name=name)
        return self._rate(self.change(part), self.histories[name])

    def begin(self) -> None:
        """Adapt the factors to the lengths of this step and the one before, if there was one."""
        dt = float(self.dt.value)
        ratio = 0.0 if self._previous_dt is None else dt / self._previous_dt
        self._new.value = (1 + 2 * ratio) / (1 + ratio)
        self._old.value = ratio**2 / (1 + ratio)

    def end(self) -> None:
        """Remember the length of the step that was done."""
        self._previous_dt = float(self.dt.value)

    @property
    def memory(self) -> dict[str, float]:
        """Length of the previous step."""
        return {} if self._previous_dt is None else {"previous_dt": self._previous_dt}

    @memory.setter
    def memory(self, values: dict[str, float]) -> None:
        self._previous_dt = values.get("previous_dt")

    @property
    def rates(self) -> tuple[Any, Any]:
        """By how much u changes velocity [1/s] and acceleration [1/s^2] in the equations."""
        return self._new / self.dt, (self._new / self.dt) ** 2

    def grid_velocity(self) -> Any:
        """Velocity on the grid at the end of the step [m/s], UFL."""
        return self._velocity

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New values of the points' fields, as UFL over the points."""
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
