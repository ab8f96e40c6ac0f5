# SPDX-License-Identifier: MIT
"""TimeScheme: from displacement increments to inertia, in UFL."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm.cells import FilledFraction
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints


class TimeScheme(ABC):
    """What all schemes of time integration have in common.

    Args:
        unknown: with a part that moves the points, the displacement increment u [m].
        dt: time step [s].
        flip: 1 for FLIP, 0 for PIC, or between.
        names: fields of the points that are mapped to the grid.

    Attributes:
        dt: length of the present step, which the time loop sets.
        histories: grid function of each field that is mapped from points, by the field's name.
        increment: displacement increment of the whole step [m], set by the scheme.
        acceleration: at which inertia is taken [m/s^2], set by the scheme.
        unknown: whose part moves the points.
        u: that part.
        w: its test function.
        share: of the step that u moves; the equations hold at its end (``Midpoint``: half way).
        lumping: share of the lumped mass in the one by which velocities are mapped to the grid.

    Raises:
        ValueError: for a time step that is not positive and finite, a share of FLIP beyond [0, 1],
            or an unknown that moves nothing.
    """

    increment: Any
    acceleration: Any
    share = 1.0
    lumping = 1.0

    def __init__(self, unknown: Unknown, dt: float, flip: float, names: tuple[str, ...]) -> None:
        """Create the histories, zero by now."""
        check_time_step(dt)
        if not 0 <= flip <= 1:
            raise ValueError(f"the share of FLIP in the velocity must lie in [0, 1]: flip = {flip}")
        if unknown.moving is None:
            raise ValueError(f"a time scheme needs a part that moves the points: {unknown!r}")
        self.unknown, self.flip = unknown, flip
        self.u = getattr(unknown, unknown.moving)
        self.w = getattr(unknown.test, unknown.moving)
        self.dt = fem.Constant(unknown.mesh, float(dt))
        space = unknown.part_space(unknown.moving)
        self._with_rates: set[str] = set()
        self.histories = {name: fem.Function(space, name=name) for name in names}

    def force(self, points: MaterialPoints, b: Any = None) -> Any:
        """Body force less inertia per volume before the step, rho_n (b - a) [N/m^d].

        To be used as ``force`` of the formulations; the mass matrix is then the consistent one.

        Args:
            points: the body, with the field "mass".
            b: body force per mass, such as gravity [m/s^2]; None for none.
        """
        acceleration = -self.acceleration if b is None else b - self.acceleration
        return density(points) * acceleration

    def inertia(self, points: MaterialPoints) -> ufl.Form:
        """Inertia (rho a, w) with the mass of the scheme, here the consistent one.

        For equations without subscales, which take it as part of ``force``.

        Args:
            points: the body, with the field "mass".
        """
        return density(points) * ufl.inner(self.acceleration, self.w) * points.dx

    def lumped(self, points: MaterialPoints) -> ufl.Form:
        """Inertia (rho a, w) with the lumped mass of the points (VMS, section 5).

        Args:
            points: the body, with the field "mass".

        Raises:
            ValueError: for a motion by functions that are not linear, which have nodes beside the
                vertices.
        """
        assert self.unknown.moving is not None  # checked by the constructor
        self.unknown.require_linear("the lumped mass", self.unknown.moving)
        mass = FilledFraction(points, "mass")
        return mass * ufl.inner(self.acceleration, self.w) * mass.vertex_dx

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """First guesses of the dofs of u [m], the boldest one first; here constant velocity."""
        return [self.share * float(self.dt.value) * self.histories["v"].x.array]

    def velocity(self) -> Any:
        """Velocity on the grid when the equations hold [m/s], UFL; here at the end of the step."""
        return self.grid_velocity()

    def change(self, part: str) -> Any:
        """By how much a history of the unknown changes on the grid in a step, UFL.

        What has a rate changes over the whole step; anything else, such as a pressure that follows
        from a constraint, is left as the equations have it, also where these hold earlier.

        Args:
            part: its name.
        """
        change = getattr(self.unknown, part) - getattr(self.unknown.old, part)
        return change / self.share if part in self._with_rates else change

    def rate(self, part: str) -> Any:
        """Rate of a history of the unknown in the equations [1/s], UFL, of first order in dt here.

        ``Midpoint``, whose equations have ``middle(part)``, and ``BDF2`` are of second order. Of
        fields that vary in space, mapping by the lumped mass leaves first order in dt.

        Args:
            part: its name, such as that of a temperature.

        Raises:
            ValueError: for a part that is no history.
        """
        if not hasattr(self.unknown.old, part):
            raise ValueError(
                f"only a history has a rate, not the part {part!r}: Part({part!r}, role='history')"
            )
        self._with_rates.add(part)
        return self.change(part) / self.dt

    @property
    @abstractmethod
    def rates(self) -> tuple[Any, Any]:
        """By how much u changes velocity [1/s] and acceleration [1/s^2] in the equations."""

    @abstractmethod
    def grid_velocity(self) -> Any:
        """Velocity on the grid at the end of the step [m/s], UFL."""

    @abstractmethod
    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """New values of the points' fields at the end of a step, as UFL over the points.

        Args:
            points: the body.
        """

    def begin(self) -> None:
        """To be called before each attempt at a step, when its length is known."""

    def end(self) -> None:
        """To be called after each step that was done."""

    @property
    def memory(self) -> dict[str, float]:
        """What a scheme remembers of the steps before, besides the points' fields."""
        return {}

    @memory.setter
    def memory(self, values: dict[str, float]) -> None:
        """Take up what another run remembered."""


def density(points: MaterialPoints) -> Any:
    """Density per volume before the step, rho_n = m / V_n [kg/m^d], as UFL over the points."""
    return points.field("mass") / points.field("weight")


def check_time_step(dt: float) -> None:
    """Raise ValueError for a time step that is not positive and finite."""
    if not 0 < dt < float("inf"):
        raise ValueError(f"the time step must be positive and finite: dt = {dt}")
