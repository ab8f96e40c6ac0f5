# SPDX-License-Identifier: MIT
"""Rigid bodies of any shape that material points cannot enter, fixed, moved or free."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import number
from fenicsmpm.rigid.contact_law import Contact
from fenicsmpm.rigid.distance import distances_at, of_box, sampled
from fenicsmpm.rigid.inertia import Inertia
from fenicsmpm.rigid.rotation import about, matrix, product, skew, spin
from fenicsmpm.shapes import Box

Array = npt.NDArray[np.float64]
Given: TypeAlias = npt.ArrayLike | Callable[[float], npt.ArrayLike]

# Totals of contact: force (3,), moment (3,) about the centre, mass and polar moment of the points
TOTALS = 8


class RigidBody:
    """Rigid body that repels material points by a barrier, with frictional sticking and sliding.

    Without ``inertia``, the motion of the body is prescribed, and the body is at rest if no
    velocity is given. With ``inertia``, the body is free, and gravity, loads and contact move it.

    Args:
        shape: Shape of the body at the start: ``shapes.Box``, ``shapes.polygon``,
            ``shapes.surface``, ``shapes.SignedDistance``, or any object with the same methods
            ``distance`` and ``bounds()``. The distance from all shapes except boxes is sampled.
        reach: Gap below which there is a contact force [m], for example half the distance of
            points.
        velocity: Velocity of the centre ``(d,)`` [m/s], 0 for none, or a function of time [s]. For
            a free body, it is the velocity at the start.
        angular_velocity: Angular velocity [rad/s], a number in the plane or ``(3,)`` in space, or a
            function of time [s]. For a free body, it is the angular velocity at the start.
        centre: Centre of rotation ``(d,)`` [m]. None for the centre of mass of a free body, or for
            the centre of the bounds of any other body (0 where these are infinite).
        rotation: Rotation of the shape about the centre before the start [rad], an angle in the
            plane, or a vector ``(3,)`` in space whose length is the angle.
        inertia: Inertia of a free body, for example ``rigid.inertia_of(shape, density)``.
        gravity: Force per mass on a free body ``(d,)`` [m/s^2], or a function of time [s].
        force: Additional force on the centre of a free body ``(d,)`` [N], or a function of time
            [s].
        torque: Additional torque on a free body [N m], a number in the plane or ``(3,)`` in space,
            or a function of time [s].
        friction: Coefficient of friction [-], infinite for no slip.
        stiffness: Stiffness of the barrier, in units of the mass of a point over the square of the
            longest allowed time step [-].
        spacing: Spacing of the samples of the distance [m]. None for half the reach.
        name: Name in messages. None for the shape.

    Attributes:
        dim: Space dimension d.
        position: Position of the centre ``(d,)`` [m].
        is_free: Whether the body has an inertia.
        error: Error of sampled distances near the surface [m], 0 for boxes.

    Raises:
        ValueError: If reach or stiffness is not positive, friction is negative, gravity or loads
            are given for a body that is not free, a value has a wrong shape or is not finite, or
            the shape cannot be sampled.
    """

    def __init__(
        self,
        shape: Any,
        reach: float,
        *,
        velocity: Given = 0.0,
        angular_velocity: Given = 0.0,
        centre: npt.ArrayLike | None = None,
        rotation: npt.ArrayLike = 0.0,
        inertia: Inertia | None = None,
        gravity: Given = 0.0,
        force: Given = 0.0,
        torque: Given = 0.0,
        friction: float = 0.0,
        stiffness: float = 0.1,
        spacing: float | None = None,
        name: str | None = None,
    ) -> None:
        """Check the arguments, and sample the distance."""
        friction = number(friction, "friction", "a coefficient of friction", "-")
        if not (0 < reach < np.inf and friction >= 0 and 0 < stiffness < np.inf):
            raise ValueError(
                "a rigid body needs a positive reach and stiffness and no negative friction: "
                f"reach = {reach} m, stiffness = {stiffness}, friction = {friction}"
            )
        if spacing is not None and not 0 < spacing < np.inf:
            raise ValueError(f"the spacing of samples must be positive: {spacing} m")
        lower, upper = shape.bounds()
        self.dim, self.shape, self.reach = len(lower), shape, float(reach)
        self.friction, self.stiffness = float(friction), float(stiffness)
        self.name = repr(shape) if name is None else name
        self.is_free, self.inertia = inertia is not None, inertia
        if inertia is not None and len(inertia.centre) != self.dim:
            raise ValueError(
                f"{inertia!r} does not fit a body in {self.dim} dimensions: use "
                "rigid.inertia_of(shape, density)"
            )
        self._given = {"velocity": velocity, "angular velocity": angular_velocity}
        self._loads = {"gravity": gravity, "force": force, "torque": torque}
        if not self.is_free:
            for what, value in self._loads.items():
                if callable(value) or np.any(np.asarray(value) != 0):
                    raise ValueError(
                        f"a {what} on a rigid body with a prescribed motion has no effect: give "
                        "the body an inertia to make it free"
                    )
        self._origin: Array = self._vector(self._centre(centre), "centre")
        self.position: Array = self._origin.copy()
        self._q: Array = about(self._rotor(rotation, "rotation"))
        if isinstance(shape, Box):
            self._field, self.error = of_box(lower, upper), 0.0
        else:
            fine = reach / 2 if spacing is None else spacing
            self._field, self.error = sampled(shape, fine, max(reach, fine))
        self._v: Array = np.zeros(self.dim)
        self._w: Array = np.zeros(3)
        self._L: Array = np.zeros(3)  # angular momentum of a free body about its centre
        if inertia is None:
            self._set_motion(0.0)
        else:
            if callable(velocity) or callable(angular_velocity):
                raise ValueError(
                    f"the velocity of the free body {self.name} follows from the forces on it: "
                    "give its value at the start, not a function of time"
                )
            self._v = self._vector(velocity, "velocity")
            R, axes = matrix(self._q), inertia.axes
            w = self._rotor(angular_velocity, "angular velocity")
            self._L = R @ axes @ (inertia.moments * (axes.T @ R.T @ w))
        # Mass [kg] and polar moment [kg m^2] of the points within reach
        self._touched: Array = np.zeros(2)
        self._pushed: Array = np.zeros(TOTALS)
        self._held: Array = np.zeros(TOTALS)
        self.settle()

    def _centre(self, centre: npt.ArrayLike | None) -> npt.ArrayLike:
        if self.inertia is not None:
            if centre is not None:
                raise ValueError(
                    "the centre of a free body is that of its inertia: leave out the centre"
                )
            return self.inertia.centre
        if centre is not None:
            return centre
        ends = np.array(self.shape.bounds())
        with np.errstate(invalid="ignore"):
            middle = ends.mean(axis=0)
        return np.where(np.isfinite(ends).all(axis=0), middle, 0.0)

    # --- position and motion -------------------------------------------------------------------

    @property
    def rotation(self) -> Array:
        """Rotation matrix of the shape since it was given ``(d, d)`` [-]."""
        return np.ascontiguousarray(matrix(self._q)[: self.dim, : self.dim])

    @property
    def moved(self) -> Array:
        """Displacement of the centre since the start ``(d,)`` [m]."""
        return self.position - self._origin

    @property
    def velocity(self) -> Array:
        """Velocity of the centre ``(d,)`` [m/s]; if prescribed, at the start of the last step."""
        return self._v.copy()

    @property
    def angular_velocity(self) -> Any:
        """Angular velocity [rad/s], a number in the plane or ``(3,)`` in space.

        If the motion is prescribed, it is the value at the start of the last step.
        """
        return self._turning(self._spin())

    @property
    def force(self) -> Array:
        """Force of the body on the points in the last step ``(d,)`` [N]."""
        return (self._pushed + self._held)[: self.dim]

    @property
    def torque(self) -> Any:
        """Torque of the body on the points about its centre in the last step [N m].

        It is a number in the plane or ``(3,)`` in space.
        """
        return self._turning((self._pushed + self._held)[3:6])

    @property
    def momentum(self) -> Array:
        """Momentum of a free body ``(d,)`` [kg m/s]."""
        return self._inertia().mass * self._v

    @property
    def angular_momentum(self) -> Any:
        """Angular momentum of a free body about the origin [kg m^2/s].

        It is a number in the plane or ``(3,)`` in space.
        """
        x, p = np.zeros(3), np.zeros(3)
        x[: self.dim], p[: self.dim] = self.position, self.momentum
        return self._turning(self._L + np.cross(x, p))

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of a free body [J]."""
        return float(self.momentum @ self._v + self._L @ self._spin()) / 2

    def _inertia(self) -> Inertia:
        if self.inertia is None:
            raise ValueError(f"{self.name} has no mass: its motion is prescribed")
        return self.inertia

    def _spin(self) -> Array:
        if self.inertia is None:
            return self._w
        turn = matrix(self._q) @ self.inertia.axes
        return np.asarray(turn @ ((turn.T @ self._L) / self.inertia.moments))

    def distance(self, x: npt.ArrayLike) -> tuple[Array, Array]:
        """Return signed distances of positions from the body now, and their gradients.

        Args:
            x: Positions ``(n, d)`` [m].

        Returns:
            Distances ``(n,)`` [m], infinite outside the samples, and normals ``(n, d)`` [-].
        """
        R = self.rotation
        y = self._origin + (np.asarray(x, dtype=np.float64) - self.position) @ R
        distances, normals = distances_at(self._field, np.ascontiguousarray(y))
        return distances, normals @ R.T

    # --- steps of a time loop ------------------------------------------------------------------

    def begin(self, time: float) -> None:
        """Begin a step: set the prescribed motion at its start, and reset the forces.

        Args:
            time: Time at the start of the step [s].

        Raises:
            ValueError: If a velocity or load is not finite.
        """
        if not self.is_free:
            self._set_motion(time)
        else:
            for what in self._loads:
                self._load(what, time)
        self._pushed, self._held = np.zeros(TOTALS), np.zeros(TOTALS)
        self.settle()

    def settle(self) -> None:
        """Store the current place as the start of the next motion."""
        self._before = self._q, self.position

    def carry(self, start: float, end: float) -> None:
        """Move to the end of a prescribed motion with the velocities in the middle of the interval.

        Implicit steps use this function. They may be repeated, so each call starts from the place
        at the last ``settle``.

        Args:
            start: Time at the last ``settle`` [s].
            end: Time at the end of the motion [s].

        Raises:
            ValueError: If the body is free, or a velocity is not finite.
        """
        if self.is_free:
            raise ValueError(
                f"the rigid body {self.name} is free: implicit steps support fixed bodies and "
                "prescribed motions only. Use explicit steps, or leave out the inertia"
            )
        self._set_motion((start + end) / 2)
        self._q, self.position = self._before
        self._drift(end - start)

    def way(self, x: Array) -> Array:
        """Return the displacements of material points of the body since the last ``settle`` [m].

        Args:
            x: Positions at that time ``(n, d)`` [m], inside the body or not.

        Returns:
            Displacements ``(n, d)`` [m].
        """
        q, centre = self._before
        R = matrix(q)[: self.dim, : self.dim]
        return np.asarray(self.position - x + (x - centre) @ (self.rotation @ R.T).T)

    def _drift(self, dt: float) -> None:
        """Move with the current velocities."""
        self.position = self.position + dt * self._v
        self._q = product(about(dt * self._w), self._q)
        self._q = self._q / np.linalg.norm(self._q)

    def contact(self, longest: float) -> Contact:
        """Return the data of the contact law at points, for the current place of the body.

        Args:
            longest: Longest allowed time step [s].
        """
        share = 1.0
        if self.inertia is not None:
            mass, polar = self._touched
            share = 1 / (1 + mass / self.inertia.mass + polar / self.inertia.moments[0])
        W = skew(self._spin())[: self.dim, : self.dim]
        q, centre = self._before
        before = np.ascontiguousarray(matrix(q)[: self.dim, : self.dim]), centre
        return Contact(
            self._field, self.rotation, self.position, self._origin, *before, self._v,
            np.ascontiguousarray(W), self.reach, self.stiffness, self.friction, share, longest,
        )  # fmt: skip

    def move(self, time: float, dt: float, pushed: Array) -> None:
        """Move through a step.

        Args:
            time: Time at the start of the step [s].
            dt: Length of the step [s].
            pushed: Totals ``(8,)`` of the contact forces on the points of all ranks.
        """
        self._pushed = pushed
        if self.inertia is None:
            self._drift(dt)
            return
        mass = self.inertia.mass
        force = mass * self._load("gravity", time) + self._load("force", time)
        self._v = self._v + dt / mass * (force - pushed[: self.dim])
        self._L = self._L + dt * (self._load("torque", time) - pushed[3:6])
        self.position = self.position + dt * self._v
        self._q = spin(self._q, self._L, self.inertia.axes, self.inertia.moments, dt)

    def end(self, dt: float, held: Array) -> None:
        """End a step.

        Args:
            dt: Length of the step [s].
            held: Totals ``(8,)`` of the forces that kept the points of all ranks outside the body,
                averaged over the step.
        """
        self._held, self._touched = held, held[6:].copy()
        if self.inertia is not None:
            self._v = self._v - dt / self.inertia.mass * held[: self.dim]
            self._L = self._L - dt * held[3:6]

    @property
    def state(self) -> dict[str, float]:
        """Values on which the next step depends, for checkpoints."""
        arrays = {
            "position": self.position, "rotation": self._q, "velocity": self._v,
            "angular momentum": self._L, "touched": self._touched,
        }  # fmt: skip
        return {f"{n} {k}": float(a[k]) for n, a in arrays.items() for k in range(len(a))}

    @state.setter
    def state(self, values: dict[str, float]) -> None:
        def array(name: str, n: int) -> Array:
            return np.array([values[f"{name} {k}"] for k in range(n)])

        self.position, self._q = array("position", self.dim), array("rotation", 4)
        self._v, self._L = array("velocity", self.dim), array("angular momentum", 3)
        self._touched = array("touched", 2)
        self.settle()

    # --- given values --------------------------------------------------------------------------

    def _set_motion(self, time: float) -> None:
        given = {
            name: value(time) if callable(value) else value for name, value in self._given.items()
        }
        self._v = self._vector(given["velocity"], "velocity", time)
        self._w = self._rotor(given["angular velocity"], "angular velocity", time)

    def _load(self, what: str, time: float) -> Array:
        value: Any = self._loads[what]
        value = value(time) if callable(value) else value
        return (self._rotor if what == "torque" else self._vector)(value, what, time)

    def _vector(self, value: npt.ArrayLike, what: str, time: float | None = None) -> Array:
        """Return ``(d,)`` from zero or d numbers."""
        return self._checked(value, (self.dim,), what, time)

    def _rotor(self, value: npt.ArrayLike, what: str, time: float | None = None) -> Array:
        """Return ``(3,)`` from one number in the plane, or three in space."""
        if self.dim == 3:
            return self._checked(value, (3,), what, time)
        return np.array([0.0, 0.0, float(self._checked(value, (), what, time))])

    def _checked(
        self, value: npt.ArrayLike, shape: tuple[int, ...], what: str, time: float | None
    ) -> Array:
        array = np.asarray(value, dtype=np.float64)
        when = "" if time is None else f" at t = {time} s"
        if array.shape not in ((), shape) or (shape == (3,) and not array.shape and array != 0):
            raise ValueError(
                f"the {what} of a rigid body needs the shape {shape}, not {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError(
                f"the {what} of the rigid body {self.name} must be finite: {array}{when}"
            )
        return np.broadcast_to(array, shape).copy()

    def _turning(self, vector: Array) -> Any:
        return vector.copy() if self.dim == 3 else float(vector[2])

    def __repr__(self) -> str:
        """Shape, and how it moves."""
        how = "free" if self.is_free else "prescribed"
        return (
            f"RigidBody({self.shape!r}, {self.reach}, friction={self.friction}, "
            f"stiffness={self.stiffness}), {how}"
        )
