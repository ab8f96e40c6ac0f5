# SPDX-License-Identifier: MIT
"""Base class of time schemes, which express inertia in terms of displacement increments, in UFL."""

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
    """Base class of all time integration schemes.

    Args:
        unknown: Unknown with a part that moves the points, the displacement increment u [m].
        dt: Time step [s].
        flip: Share of FLIP in the velocity update [-], from 0 (PIC) to 1 (FLIP).
        names: Fields of the points that are mapped to the grid.

    Attributes:
        dt: Length of the current step [s], a constant that the time loop sets.
        histories: Grid functions of the fields that are mapped from the points, by field name.
        increment: Displacement increment of the whole step ``(d,)`` [m], UFL, defined by the
            scheme.
        acceleration: Acceleration in the inertia term ``(d,)`` [m/s^2], UFL, defined by the scheme.
        unknown: The unknown.
        u: The part of the unknown that moves the points ``(d,)`` [m].
        w: Test function of u.
        share: Share of the step that u covers [-]. The equations hold at its end, except for
            ``Midpoint``, where they hold at the middle.
        lumping: Share of the lumped mass in the mass with which velocities are mapped to the grid
            [-].

    Raises:
        ValueError: If the time step is not positive and finite, the share of FLIP lies outside
            [0, 1], or no part of the unknown moves the points.
    """

    increment: Any
    acceleration: Any
    share = 1.0
    lumping = 1.0

    def __init__(self, unknown: Unknown, dt: float, flip: float, names: tuple[str, ...]) -> None:
        """Create the histories, with zero values."""
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
        """Return body force minus inertia per volume V_n, rho_n (b - a) ``(d,)`` [N/m^d], UFL.

        Pass the result as ``force`` to the formulations. The mass matrix is then the consistent
        one.

        Args:
            points: The body, with the field "mass" [kg].
            b: Body force per mass, such as gravity [m/s^2]: d numbers, a ``fem.Constant``, or a
                UFL vector. None for none.

        Raises:
            ValueError: If there are no masses, the numbers are not finite, or the shape is wrong.
        """
        own = -self.acceleration
        return density(points) * (own if b is None else force_per_mass(points, b) + own)

    def inertia(self, points: MaterialPoints) -> ufl.Form:
        """Return the inertia (rho a, w) with the mass of the scheme, here the consistent one.

        Use it in equations without subscales. With subscales, inertia is part of ``force``.

        Args:
            points: The body, with the field "mass" [kg].

        Returns:
            UFL form of rank 1 over the points.
        """
        return density(points) * ufl.inner(self.acceleration, self.w) * points.dx

    def lumped(self, points: MaterialPoints) -> ufl.Form:
        """Return the inertia (rho a, w) with the lumped mass of the points (VMS, section 5).

        Args:
            points: The body, with the field "mass" [kg].

        Returns:
            UFL form of rank 1 over the active cells, with the vertices as quadrature points.

        Raises:
            ValueError: If the functions of the motion are not linear and so have nodes other than
                the vertices.
        """
        assert self.unknown.moving is not None  # checked by the constructor
        self.unknown.require_linear("the lumped mass", self.unknown.moving)
        mass = FilledFraction(points, "mass")
        return mass * ufl.inner(self.acceleration, self.w) * mass.vertex_dx

    def predictions(self) -> list[npt.NDArray[np.float64]]:
        """Return initial guesses of u [m], here for constant velocity.

        Returns:
            Degrees of freedom of u, one array for each guess, the most ambitious one first.
        """
        return [self.share * float(self.dt.value) * self.histories["v"].x.array]

    def velocity(self) -> Any:
        """Return the grid velocity [m/s] when the equations hold, here at the end of the step."""
        return self.grid_velocity()

    def change(self, part: str) -> Any:
        """Return the change of a history on the grid in a step, UFL.

        A history with a rate changes over the whole step. Any other history, such as a pressure
        that follows from a constraint, changes by what the equations give, even if these hold
        before the end of the step.

        Args:
            part: Name of the history.
        """
        change = getattr(self.unknown, part) - getattr(self.unknown.old, part)
        return change / self.share if part in self._with_rates else change

    def rate(self, part: str) -> Any:
        """Return the rate of a history in the equations [1/s], UFL, here of first order in dt.

        ``BDF2`` and ``Midpoint`` are of second order; the equations of ``Midpoint`` contain
        ``middle(part)``. For fields that vary in space, the mapping with the lumped mass reduces
        the order in dt to one.

        Args:
            part: Name of the history, such as a temperature.

        Raises:
            ValueError: If the part is not a history.
        """
        if not hasattr(self.unknown.old, part):
            raise ValueError(
                f"only a history has a rate, not the part {part!r}: define it as "
                f"Part({part!r}, role='history')"
            )
        self._with_rates.add(part)
        return self.change(part) / self.dt

    @property
    @abstractmethod
    def rates(self) -> tuple[Any, Any]:
        """Derivatives of velocity [1/s] and acceleration [1/s^2] with respect to u, UFL."""

    @abstractmethod
    def grid_velocity(self) -> Any:
        """Return the grid velocity at the end of the step ``(d,)`` [m/s], UFL."""

    @abstractmethod
    def updates(self, points: MaterialPoints) -> dict[str, Any]:
        """Return the values of the point fields at the end of a step, as UFL over the points.

        Args:
            points: The body.

        Returns:
            New values by field name.
        """

    def begin(self) -> None:
        """Prepare a step of known length; time loops call this before each attempt."""

    def end(self) -> None:
        """Finish a step; time loops call this after each completed step."""

    @property
    def memory(self) -> dict[str, float]:
        """Values from previous steps that the scheme needs in addition to the point fields."""
        return {}

    @memory.setter
    def memory(self, values: dict[str, float]) -> None:
        """Restore the values of another run."""


def density(points: MaterialPoints) -> Any:
    """Return the density at the start of the step, rho_n = m / V_n [kg/m^d], as UFL.

    Args:
        points: The body, with the field "mass" [kg].

    Raises:
        ValueError: If the points have no masses.
    """
    if "mass" not in points:
        raise ValueError(
            "a body without the field mass has no density: call set_initial_state(points, density) "
            "first"
        )
    return points.field("mass") / points.field("weight")


def force_per_mass(points: MaterialPoints, b: Any) -> Any:
    """Return a force per mass ``(d,)`` [m/s^2] as UFL.

    Args:
        points: The body on which it acts.
        b: D numbers, a ``fem.Constant``, or a UFL vector.

    Raises:
        ValueError: If the numbers are not finite, or the shape is wrong.
    """
    dim = points.mesh.geometry.dim
    if not isinstance(b, ufl.core.expr.Expr):
        values = np.asarray(b, dtype=np.float64)
        if values.shape != (dim,) or not np.isfinite(values).all():
            raise ValueError(f"a body force must be {dim} finite numbers, not {b!r}")
        return fem.Constant(points.mesh, values)
    if b.ufl_shape != (dim,):
        raise ValueError(f"a body force must have shape ({dim},), not {b.ufl_shape}")
    return b


def check_time_step(dt: float) -> None:
    """Raise ValueError if a time step is not positive and finite.

    Args:
        dt: Time step [s].

    Raises:
        ValueError: If the time step is not positive and finite.
    """
    if not 0 < dt < float("inf"):
        raise ValueError(f"the time step must be positive and finite: dt = {dt}")
