# SPDX-License-Identifier: MIT
"""RigidBody: what bodies cannot enter, of any shape, fixed, moved or free."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

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
    """A rigid body that pushes material points by a barrier, with friction that sticks.

    Without ``inertia``, its motion is prescribed; it rests if no velocity is given. With it, the
    body is free, and moves by gravity, loads and contact.

    Args:
        shape: ``shapes.Box``, ``shapes.polygon``, ``shapes.surface``, ``shapes.SignedDistance``, or
            anything with ``distance`` and ``bounds()`` as they have, where the body is at the
            start. All but boxes are sampled.
        reach: gap from which on there is a contact force [m], such as half the points' distance.
        velocity: of the centre ``(d,)`` [m/s]; a number or a function of time [s], but of free
            bodies the one at the start.
        angular_velocity: ``(3,)``, in the plane a number [rad/s]; likewise.
        centre: about which the body turns ``(d,)`` [m]; None for the centre of mass of free bodies,
            and the middle of the bounds of others, 0 where these are infinite.
        rotation: of the shape about the centre before the start, an angle in the plane, in space a
            vector ``(3,)`` whose length is the angle [rad].
        inertia: what makes the body free, such as ``rigid.inertia_of(shape, density)``.
        gravity: force per mass on a free body ``(d,)`` [m/s^2], or a function of time.
        force: further force on its centre ``(d,)`` [N]; likewise.
        torque: and torque ``(3,)``, in the plane a number [N m]; likewise.
        friction: coefficient; infinite for no slip.
        stiffness: of the barrier, in units of a point's mass over the square of the time step.
        spacing: of samples of the distance [m]; None for half the reach.
        name: in messages; None for the shape.

    Attributes:
        dim: d.
        position: of the centre ``(d,)`` [m].
        velocity: of the centre ``(d,)`` [m/s].
        is_free: whether it has an inertia.
        force: of the body on the points in the last step ``(d,)`` [N].
        error: of sampled distances near the surface [m]; 0 for boxes.

    Raises:
        ValueError: for a reach or stiffness that is not positive, negative friction, gravity and
            loads on a body that is not free, values of other shapes or not finite, and shapes that
            cannot be sampled.
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
        """Check, and sample the distance."""
        if not (0 < reach < np.inf and friction >= 0 and 0 < stiffness < np.inf):
            raise ValueError(
                "a rigid body needs a positive reach and stiffness and no negative friction: "
                f"{reach}, {stiffness}, {friction}"
            )
        if spacing is not None and not 0 < spacing < np.inf:
            raise ValueError(f"a spacing of samples is positive: {spacing}")
        lower, upper = shape.bounds()
        self.dim, self.shape, self.reach = len(lower), shape, float(reach)
        self.friction, self.stiffness = float(friction), float(stiffness)
        self.name = repr(shape) if name is None else name
        self.is_free, self.inertia = inertia is not None, inertia
        if inertia is not None and len(inertia.centre) != self.dim:
            raise ValueError(f"{inertia!r} is not that of a body in {self.dim} dimensions")
        self._given = {"velocity": velocity, "angular velocity": angular_velocity}
        self._loads = {"gravity": gravity, "force": force, "torque": torque}
        if not self.is_free:
            for what, value in self._loads.items():
                if callable(value) or np.any(np.asarray(value) != 0):
                    raise ValueError(
                        f"a {what} on a rigid body whose motion is prescribed does nothing: give "
                        "it an inertia to set it free"
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
                    f"the velocity of the free body {self.name} follows from what acts on it: give "
                    "that at the start, not a function of time"
                )
            self._v = self._vector(velocity, "velocity")
            R, axes = matrix(self._q), inertia.axes
            w = self._rotor(angular_velocity, "angular velocity")
            self._L = R @ axes @ (inertia.moments * (axes.T @ R.T @ w))
        # mass [kg] and polar moment [kg m^2] of the points within reach
        self._touched: Array = np.zeros(2)
        self._pushed: Array = np.zeros(TOTALS)
        self._held: Array = np.zeros(TOTALS)
        self.settle()

    def _centre(self, centre: npt.ArrayLike | None) -> npt.ArrayLike:
        if self.inertia is not None:
            if centre is not None:
                raise ValueError("the centre of a free body is that of its inertia")
            return self.inertia.centre
        if centre is not None:
            return centre
        ends = np.array(self.shape.bounds())
        with np.errstate(invalid="ignore"):
            middle = ends.mean(axis=0)
        return np.where(np.isfinite(ends).all(axis=0), middle, 0.0)

    # --- where it is and how it moves ----------------------------------------------------------

    @property
    def rotation(self) -> Array:
        """Rotation of the shape ``(d, d)`` up to now."""
        return np.ascontiguousarray(matrix(self._q)[: self.dim, : self.dim])

    @property
    def moved(self) -> Array:
        """Way of the centre so far ``(d,)`` [m]."""
        return self.position - self._origin

    @property
    def velocity(self) -> Array:
        """Of the centre ``(d,)`` [m/s]; of prescribed motions at the beginning of the last step."""
        return self._v.copy()

    @property
    def angular_velocity(self) -> Any:
        """``(3,)``, in the plane a number [rad/s]; likewise."""
        return self._turning(self._spin())

    @property
    def force(self) -> Array:
        """Of the body on the points in the last step ``(d,)`` [N]."""
        return (self._pushed + self._held)[: self.dim]

    @property
    def torque(self) -> Any:
        """Likewise about its centre, ``(3,)``, in the plane a number [N m]."""
        return self._turning((self._pushed + self._held)[3:6])

    @property
    def momentum(self) -> Array:
        """Of a free body ``(d,)`` [kg m/s]."""
        return self._inertia().mass * self._v

    @property
    def angular_momentum(self) -> Any:
        """Of a free body about the origin ``(3,)``, in the plane a number [kg m^2/s]."""
        x, p = np.zeros(3), np.zeros(3)
        x[: self.dim], p[: self.dim] = self.position, self.momentum
        return self._turning(self._L + np.cross(x, p))

    @property
    def kinetic_energy(self) -> float:
        """Of a free body [J]."""
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
        """Signed distances of positions from the body where it is now, and their gradients.

        Args:
            x: positions ``(n, d)`` [m].

        Returns:
            Distances ``(n,)`` [m], infinite beyond all samples, and normals ``(n, d)``.
        """
        R = self.rotation
        y = self._origin + (np.asarray(x, dtype=np.float64) - self.position) @ R
        distances, normals = distances_at(self._field, np.ascontiguousarray(y))
        return distances, normals @ R.T

    # --- steps of a time loop ------------------------------------------------------------------

    def begin(self, time: float) -> None:
        """Begin a step: take the prescribed motion of its beginning, and forget forces.

        Args:
            time: at the beginning [s].

        Raises:
            ValueError: if a velocity or load is not finite.
        """
        if not self.is_free:
            self._set_motion(time)
        else:
            for what in self._loads:
                self._load(what, time)
        self._pushed, self._held = np.zeros(TOTALS), np.zeros(TOTALS)
        self.settle()

    def settle(self) -> None:
        """What comes now begins where the body is."""
        self._before = self._q, self.position

    def carry(self, start: float, end: float) -> None:
        """Be where a prescribed motion leads, by its velocities in the middle of the time.

        For implicit steps, which may be tried again: it begins where ``settle`` was called last.

        Args:
            start: time there [s].
            end: time [s].

        Raises:
            ValueError: for a free body, or if a velocity is not finite.
        """
        if self.is_free:
            raise ValueError(
                f"the rigid body {self.name} is free: implicit steps take fixed bodies and "
                "prescribed motions, explicit ones move free bodies"
            )
        self._set_motion((start + end) / 2)
        self._q, self.position = self._before
        self._drift(end - start)

    def way(self, x: Array) -> Array:
        """Way of what is at positions in the body, since ``settle`` was called last.

        Args:
            x: positions ``(n, d)`` [m] at that time, inside of the body or not.
        """
        q, centre = self._before
        R = matrix(q)[: self.dim, : self.dim]
        return np.asarray(self.position - x + (x - centre) @ (self.rotation @ R.T).T)

    def _drift(self, dt: float) -> None:
        """Move by the velocities as they are."""
        self.position = self.position + dt * self._v
        self._q = product(about(dt * self._w), self._q)
        self._q = self._q / np.linalg.norm(self._q)

    def contact(self) -> Contact:
        """What the contact law at points needs, for where the body is now."""
        share = 1.0
        if self.inertia is not None:
            mass, polar = self._touched
            share = 1 / (1 + mass / self.inertia.mass + polar / self.inertia.moments[0])
        W = skew(self._spin())[: self.dim, : self.dim]
        q, centre = self._before
        before = np.ascontiguousarray(matrix(q)[: self.dim, : self.dim]), centre
        return Contact(
            self._field, self.rotation, self.position, self._origin, *before, self._v,
            np.ascontiguousarray(W), self.reach, self.stiffness, self.friction, share,
        )  # fmt: skip

    def move(self, time: float, dt: float, pushed: Array) -> None:
        """Move through a step.

        Args:
            time: at its beginning [s].
            dt: its length [s].
            pushed: totals ``(8,)`` of contact forces on the points of all ranks.
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
            dt: its length [s].
            held: totals ``(8,)`` of what has kept points of all ranks out, over the step.
        """
        self._held, self._touched = held, held[6:].copy()
        if self.inertia is not None:
            self._v = self._v - dt / self.inertia.mass * held[: self.dim]
            self._L = self._L - dt * held[3:6]

    @property
    def state(self) -> dict[str, float]:
        """What the next step depends on, for checkpoints."""
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

    # --- values that were given ----------------------------------------------------------------

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
        """``(d,)`` from one number or d."""
        return self._checked(value, (self.dim,), what, time)

    def _rotor(self, value: npt.ArrayLike, what: str, time: float | None = None) -> Array:
        """``(3,)`` from one number in the plane, three in space."""
        if self.dim == 3:
            return self._checked(value, (3,), what, time)
        return np.array([0.0, 0.0, float(self._checked(value, (), what, time))])

    def _checked(
        self, value: npt.ArrayLike, shape: tuple[int, ...], what: str, time: float | None
    ) -> Array:
        array = np.asarray(value, dtype=np.float64)
        when = "" if time is None else f" at t = {time} s"
        if array.shape not in ((), shape) or (shape == (3,) and not array.shape and array != 0):
            raise ValueError(f"the {what} of a rigid body has the shape {shape}, not {array.shape}")
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
