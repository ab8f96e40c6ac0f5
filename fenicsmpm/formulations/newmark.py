# SPDX-License-Identifier: MIT
"""One-step time integration of implicit dynamics: Newmark, generalized-alpha and Bossak.

The unknown of a step is the displacement increment u on the background mesh. A scheme expresses the
acceleration in terms of u, in UFL. It uses velocity and acceleration at the start of the step as
grid functions, which are mapped from the point fields of the same names.
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
    """Newmark's method (VMS, section 3.3).

    If J = 1 is imposed in every step, as in incompressible solids, the default parameters are only
    weakly stable: pressures alternate and the energy grows. Use ``GeneralizedAlpha`` in this case.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m].
        dt: Time step [s].
        beta: Parameter [-], positive.
        gamma: Parameter [-], at least 0.5.
        flip: Share of FLIP in the velocity update [-], from 0 (PIC) to 1 (FLIP, trapezoidal).

    Attributes:
        dt: Length of the current step [s], a constant that the time loop sets.
        histories: Grid functions of the fields that are mapped from the points, by field name.
        increment: Displacement increment of the whole step, u_{n+1} - u_n ``(d,)`` [m], UFL.
        acceleration: Acceleration in the inertia term ``(d,)`` [m/s^2], UFL.

    Raises:
        ValueError: If the time step is not positive and finite, a parameter is out of range, or no
            part of the unknown moves the points.
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
        """Define the acceleration."""
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
        # The equations hold at n + 1 - alpha_f, so u is only a share of the step's increment.
        self.increment = self.u / self._share
        predicted = dt_ * v + dt_**2 * (0.5 - beta_) * a
        self._new_acceleration = (self.increment - predicted) / (beta_ * dt_**2)
        self.acceleration = (1 - self._alpha_m) * self._new_acceleration + self._alpha_m * a

    @property
    def share(self) -> float:  # type: ignore[override]
        """Share of the step that u covers, 1 - alpha_f [-]; the equations hold at its end."""
        return float(self._share.value)

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """Return the increments [m] for constant acceleration and for constant velocity.

        Returns:
            Degrees of freedom of u, one array for each prediction, the most ambitious one first.
        """
        (steady,) = super().predictions()
        dt = self.share * float(self.dt.value)
        return [steady + dt**2 / 2 * self.histories["a"].x.array, steady]

    def velocity(self) -> Any:
        """Return the grid velocity at the time at which the equations hold ``(d,)`` [m/s], UFL."""
        return self._share * self.grid_velocity() + (1 - self._share) * self.histories["v"]

    @property
    def rates(self) -> tuple[Any, Any]:
        """Derivatives of velocity [1/s] and acceleration [1/s^2] with respect to u, UFL."""
        velocity = self._gamma / (self._beta * self.dt)
        return velocity, (1 - self._alpha_m) / (self._beta * self.dt**2 * self._share)

    def grid_velocity(self) -> Any:
        """Return the grid velocity at the end of the step ``(d,)`` [m/s], UFL."""
        return self.histories["v"] + self._velocity_change(self.histories["a"])

    def _velocity_change(self, a: Any) -> Any:
        return self.dt * ((1 - self._gamma) * a + self._gamma * self._new_acceleration)

    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """Return the new values of the point fields, as UFL over the points.

        Args:
            points: The body.
        """
        flip = points.field("v") + self._velocity_change(points.field("a"))
        velocity = self.flip * flip + (1 - self.flip) * self.grid_velocity()
        return {"v": velocity, "a": self._new_acceleration}

    def start_up(self, on: bool) -> None:
        """Switch to a step that does not use the previous acceleration, or back.

        Args:
            on: True for a step that finds the initial acceleration, which is then constant over the
                step (beta = 1/2, gamma = 1).
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

    The equations hold at n + 1 - alpha_f. The unknowns are the displacement increment until then
    and the pressure at that time. Inertia is evaluated at n + 1 - alpha_m.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m] until n
            + 1 - alpha_f.
        dt: Time step [s].
        rho_inf: Spectral radius at infinite frequency [-], from 0 to 1. Smaller values dissipate
            more.
        flip: Share of FLIP in the velocity update [-], from 0 (PIC) to 1 (FLIP).

    Raises:
        ValueError: If the spectral radius lies outside [0, 1], or for the reasons of ``Newmark``.
    """

    def __init__(
        self, unknown: Unknown, *, dt: float, rho_inf: float = 0.8, flip: float = 1.0
    ) -> None:
        """Compute the parameters from the spectral radius."""
        if not 0 <= rho_inf <= 1:
            raise ValueError(f"the spectral radius must lie in [0, 1]: rho_inf = {rho_inf}")
        self.alpha_m, self.alpha_f = self._alphas(rho_inf)
        shift = self.alpha_f - self.alpha_m
        super().__init__(unknown, dt=dt, beta=(1 + shift) ** 2 / 4, gamma=0.5 + shift, flip=flip)

    @staticmethod
    def _alphas(rho: float) -> tuple[float, float]:
        return (2 * rho - 1) / (rho + 1), rho / (rho + 1)


class Bossak(GeneralizedAlpha):
    """Method of Wood, Bossak and Zienkiewicz (1980), generalized-alpha with alpha_f = 0.

    All terms except inertia are evaluated at the end of the step. The arguments are those of
    ``GeneralizedAlpha``.
    """

    @staticmethod
    def _alphas(rho: float) -> tuple[float, float]:
        return (rho - 1) / (rho + 1), 0.0
