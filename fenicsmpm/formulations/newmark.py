# SPDX-License-Identifier: MIT
"""One-step time integration of implicit dynamics: Newmark, generalized-alpha and Bossak.

The unknown of a step is the displacement increment u on the background mesh. A scheme makes the
acceleration from it, in UFL, with the velocity and acceleration of the beginning of the step as
grid functions, which are mapped from fields of the points of the same name.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.formulations.time_scheme import TimeScheme
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class Newmark(TimeScheme):
    """Newmark's method (VMS, section 3.3), and what its relatives have in common with it.

    With J = 1 imposed at every step, as in incompressible solids, the default is only weakly
    stable: pressures alternate and energy grows. ``GeneralizedAlpha`` is meant for these.

    Args:
        unknown: with a part that moves the points, the displacement increment u [m].
        dt: time step [s].
        beta: parameter [-].
        gamma: parameter [-].
        flip: 1 for the trapezoidal FLIP update of the points' velocities, 0 for PIC, or between.

    Attributes:
        dt: length of the present step, which the time loop sets.
        histories: grid function of each field that is mapped from points, by the field's name.
        increment: displacement increment of the whole step, u_{n+1} - u_n [m].
        acceleration: at which inertia is taken [m/s^2].

    Raises:
        ValueError: for a time step that is not positive and finite, parameters out of range.
    """

    alpha_m = 0.0
    alpha_f = 0.0

    def __init__(
        self,
        unknown: Unknown,
        *,
        dt: float,
        beta: float = 0.25,
        gamma: float = 0.5,
        flip: float = 1.0,
    ) -> None:
        """Write down the acceleration."""
        super().__init__(unknown, dt, flip, ("v", "a"))
        if not (beta > 0 and gamma >= 0.5):
            raise ValueError(
                f"Newmark's parameters must be beta > 0 and gamma >= 0.5: {beta}, {gamma}"
            )
        mesh = unknown.mesh
        self._parameters = (beta, gamma, self.alpha_m, 1 - self.alpha_f)
        constants = [fem.Constant(mesh, float(value)) for value in self._parameters]
        self._beta, self._gamma, self._alpha_m, self._share = constants
        v, a = self.histories["v"], self.histories["a"]
        dt_, beta_ = self.dt, self._beta
        # the equations hold at n + 1 - alpha_f, so u is only a share of the step's increment
        self.increment = self.u / self._share
        predicted = dt_ * v + dt_**2 * (0.5 - beta_) * a
        self._new_acceleration = (self.increment - predicted) / (beta_ * dt_**2)
        self.acceleration = (1 - self._alpha_m) * self._new_acceleration + self._alpha_m * a

    @property
    def share(self) -> float:  # type: ignore[override]
        """Share of the step at whose end the equations hold, 1 - alpha_f; u is that share."""
        return float(self._share.value)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """Constant acceleration, and constant velocity."""
        (steady,) = super().predictions()
        dt = self.share * float(self.dt.value)
        return [steady + dt**2 / 2 * self.histories["a"].x.array, steady]

    def velocity(self) -> Any:
        """Velocity on the grid when the equations hold [m/s], UFL."""
        return self._share * self.grid_velocity() + (1 - self._share) * self.histories["v"]

    @property
    def rates(self) -> tuple[Any, Any]:
        """By how much u changes velocity [1/s] and acceleration [1/s^2] in the equations."""
        velocity = self._gamma / (self._beta * self.dt)
        return velocity, (1 - self._alpha_m) / (self._beta * self.dt**2 * self._share)

    def grid_velocity(self) -> Any:
        """Velocity on the grid at the end of the step [m/s], UFL."""
        return self.histories["v"] + self._velocity_change(self.histories["a"])

    def _velocity_change(self, a: Any) -> Any:
        return self.dt * ((1 - self._gamma) * a + self._gamma * self._new_acceleration)

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New values of the points' fields, as UFL over the points.

        Args:
            points: the body.
        """
        flip = points.field("v") + self._velocity_change(points.field("a"))
        velocity = self.flip * flip + (1 - self.flip) * self.grid_velocity()
        return {"v": velocity, "a": self._new_acceleration}

    def start_up(self, on: bool) -> None:
        """Switch to a step that does not use the acceleration before it, or back.

        Args:
            on: whether the next step is to find the acceleration at the start, as a constant one
                over a step (beta = 1/2, gamma = 1).
        """
        values = (0.5, 1.0, 0.0, 1.0) if on else self._parameters
        for constant, value in zip(
            (self._beta, self._gamma, self._alpha_m, self._share), values, strict=True
        ):
            constant.value = value

    def __repr__(self) -> str:
        """Name and parameters."""
        beta, gamma, alpha_m, share = self._parameters
        return (
            f"{type(self).__name__}(dt={float(self.dt.value):g} s, beta={beta:.4g}, "
            f"gamma={gamma:.4g}, alpha_m={alpha_m:.4g}, alpha_f={1 - share:.4g}, "
            f"flip={self.flip:g})"
        )


class GeneralizedAlpha(Newmark):
    """Generalized-alpha method of Chung and Hulbert (1993), second order with chosen dissipation.

    The equations hold at n + 1 - alpha_f, whose displacement increment and pressure are the
    unknowns; inertia is taken at n + 1 - alpha_m.

    Args:
        unknown: as there, with the displacement increment [m] until n + 1 - alpha_f.
        dt: time step [s].
        rho_inf: spectral radius at infinite frequency, 0 to 1: less dissipates more.
        flip: see ``Newmark``.
    """

    def __init__(
        self, unknown: Unknown, *, dt: float, rho_inf: float = 0.8, flip: float = 1.0
    ) -> None:
        """Find the parameters."""
        if not 0 <= rho_inf <= 1:
            raise ValueError(f"the spectral radius must lie in [0, 1]: rho_inf = {rho_inf}")
        self.alpha_m, self.alpha_f = self._alphas(rho_inf)
        shift = self.alpha_f - self.alpha_m
        super().__init__(unknown, dt=dt, beta=(1 + shift) ** 2 / 4, gamma=0.5 + shift, flip=flip)

    @staticmethod
    def _alphas(rho: float) -> tuple[float, float]:
        return (2 * rho - 1) / (rho + 1), rho / (rho + 1)


class Bossak(GeneralizedAlpha):
    """Method of Wood, Bossak and Zienkiewicz (1980): generalized-alpha with alpha_f = 0.

    All but inertia holds at the end of the step. Arguments as for ``GeneralizedAlpha``.
    """

    @staticmethod
    def _alphas(rho: float) -> tuple[float, float]:
        return (rho - 1) / (rho + 1), 0.0
