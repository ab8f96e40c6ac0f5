# SPDX-License-Identifier: MIT
"""ImplicitMPM: the implicit time loop (VMS, algorithm 1)."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._display import Described, Facts
from fenicsmpm.cells import Tying
from fenicsmpm.forms import FieldUpdates, PointExpression
from fenicsmpm.formulations import Kinematics
from fenicsmpm.formulations.contact import SLIP
from fenicsmpm.formulations.lumped_projection import all_coefficients
from fenicsmpm.formulations.time_scheme import TimeScheme, check_time_step
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.exits import Exits
from fenicsmpm.points.point_field import ComputedField
from fenicsmpm.simulation.description import facts_of_bodies
from fenicsmpm.simulation.motion import memory_of_schemes, motions_of, remember_schemes
from fenicsmpm.simulation.observer import Observers, Watcher
from fenicsmpm.simulation.parameters import of_points, of_residual
from fenicsmpm.simulation.renewals import check_updates, renewals
from fenicsmpm.simulation.rigid_state import memory_of, remember, rigid_bodies_in
from fenicsmpm.simulation.step import Step
from fenicsmpm.simulation.torn_off import TornOff
from fenicsmpm.solvers import LinearSolver, NewtonError, NewtonResult, NewtonSolver
from fenicsmpm.solvers.checks import require_points, warn_of_points_that_stay
from fenicsmpm.solvers.stopwatch import Stopwatch

logger = logging.getLogger(__name__)


# Reasons of failures that shorter steps do not mend
_HOPELESS = ("load without material", "no support")
# Number of Newton iterations up to which a load step counts as easy
_EASY = 5


class ImplicitMPM(Described):
    """Updated Lagrangian dynamics of material points on a fixed background mesh.

    A step consists of the stages ``map_to_grid``, ``predict``, ``solve``, ``map_to_points`` and
    ``convect``. A user's own loop may call them, too.

    Args:
        R: Residual, with inertia from the scheme.
        unknown: Unknown of the residual, with a part that moves the points. Fields of the points
            are mapped to ``unknown.old`` at the beginning of a step. The conditions of the unknown
            are set for each step. Bodies in contact have several ``coupled_unknowns``.
        scheme: Time scheme of the same unknown; with several unknowns one for each, all of one
            kind.
        bodies: Material points with the fields of ``set_initial_state``; with several unknowns a
            body or a sequence of bodies for each.
        carried: Further points that move with the grid, such as those that carry loads. Each set
            gets a field "u" if it has none. With several unknowns a sequence for each.
        bcs: Further Dirichlet conditions of dolfinx. Their displacement is ``scheme.share`` times
            the step's increment (1 except for ``GeneralizedAlpha``). ``data`` updates those that
            change in time.
        updates: For each body, more fields to be updated at the end of a step, in addition to
            those that the residual needs and ``PointField.renew`` defines: UFL over its points,
            or functions that return new arrays.
        data: Function of the times at the beginning and end of the motion u. It sets boundary
            values of this motion, and loads: those at its end, where equations hold, or at its
            middle for ``Midpoint``.
        taylor: Whether velocities are extrapolated linearly from points to nodes when they are
            mapped, see ``transfer.project``. The paper does not do so.
        on_exit: Treatment of points that leave the mesh: "error", "delete" or "clamp".
        observers: ``Observer`` objects called around the steps in their order, or functions of the
            simulation and the finished ``Step``, such as one that corrects weights. An error in an
            observer ends the run after a complete step.
        newton: Options of ``NewtonSolver``.

    Raises:
        ValueError: For a scheme of another unknown, no bodies, bodies without their fields or
            without any points, unknowns that are not coupled or differ in number from the other
            arguments, points that move by two unknowns, a displacement on the boundary that is not
            a function of time, updates of points or fields that do not exist, fields that are
            renewed twice, tied nodes of other bodies, or an unknown value of ``on_exit``.

    Attributes:
        unknowns: All unknowns, also if there is one.
        schemes: All schemes, also if there is one.
        unknown: The first unknown.
        scheme: The first scheme.
        motions: Each unknown with its scheme and the points that move by it.
        rigid: Rigid bodies in the residual.
        time: Time in s.
        number: Number of steps done.
        laws: Law at the points of each body that has one in the residual.
        next_dt: Length in s of the next step that ``run`` will try.
        seconds: Computing time spent in each stage so far, in s.
    """

    def __init__(
        self,
        R: ufl.Form,
        unknown: Unknown | Sequence[Unknown],
        scheme: TimeScheme | Sequence[TimeScheme],
        bodies: MaterialPoints | Sequence[Any],
        *,
        carried: Sequence[Any] = (),
        bcs: Sequence[fem.DirichletBC] = (),
        updates: Mapping[MaterialPoints, Mapping[str, Any]] | None = None,
        data: Callable[[float, float], None] | None = None,
        taylor: bool = False,
        on_exit: str = "error",
        observers: Sequence[Watcher] = (),
        newton: Mapping[str, Any] | None = None,
    ) -> None:
        """Compile the residual, its tangent and the updates. Collective."""
        tying: Tying | None = (newton or {}).get("tying")
        self.motions = motions_of(unknown, scheme, bodies, carried, taylor, tying)
        self.unknowns = [motion.unknown for motion in self.motions]
        self.schemes = [motion.scheme for motion in self.motions]
        self.unknown, self.scheme = self.unknowns[0], self.schemes[0]
        self.bodies = [body for motion in self.motions for body in motion.bodies]
        self.carried = [points for motion in self.motions for points in motion.carried]
        require_points(self.bodies)
        self.exits = Exits(on_exit)
        self.data = data
        self._observers = Observers(observers)
        self.time, self.number = 0.0, 0
        self.seconds = Stopwatch()
        self.next_dt = self._dt = float(self.scheme.dt.value)
        for z in self.unknowns:
            _check_conditions(z)
        self._fixed = [z.bcs for z in self.unknowns]
        conditions = [bc for own in self._fixed for bc in own]
        self.newton = NewtonSolver(R, self.unknown.U, [*conditions, *bcs], **(newton or {}))
        self._described = of_residual(R)
        self.rigid = rigid_bodies_in(R)
        self.laws: dict[MaterialPoints, Law] = {
            field.points: field.source
            for field in all_coefficients(R)
            if isinstance(field, ComputedField) and isinstance(field.source, Law)
        }
        if tying is not None and set(self.bodies) != set(tying.bodies):
            raise ValueError(
                "the bodies of the simulation fill cells together, which decides on tied nodes: "
                "give Tying all of them, and no other"
            )
        moving = [*self.bodies, *self.carried]
        self._volumes = [
            PointExpression(Kinematics(motion.scheme.u, body).j, body)
            for motion in self.motions
            for body in motion.bodies
        ]
        domains = [integral.points for integral in self.newton.R.point_integrals]
        warn_of_points_that_stay(domains, moving)
        moved = {p: m for m in self.motions for p in [*m.bodies, *m.carried]}
        renewed = renewals(R, {p: m.scheme.increment for p, m in moved.items()})
        check_updates(updates or {}, moving, renewed)
        _check_times(renewed, self.scheme)
        self._updates = {
            points: FieldUpdates(
                points,
                motion.new_fields(points) | renewed[points] | dict((updates or {}).get(points, {})),
            )
            for points, motion in moved.items()
        }
        self._torn_off = [TornOff(motion.bodies, motion.carried) for motion in self.motions]
        self._warn_of_torn_off()

    # --- stages ------------------------------------------------------------------------------

    def map_to_grid(self) -> None:
        """Map fields to the grid: histories of the scheme by its mass, others by lumped mass."""
        fixed = _compat.fixed_dofs(self.newton.bcs)
        for motion in self.motions:
            motion.map_to_grid(fixed)

    def predict(self) -> None:
        """Set the start of Newton's method from the histories, and continue the present motion.

        Where nodes have little mass, this may turn cells inside out. Newton's method then starts
        without motion.
        """
        x = self.unknown.U.x.array
        for motion in self.motions:
            motion.start_from_histories()
        # schemes of one kind have as many guesses
        guesses = zip(*(motion.scheme.predictions() for motion in self.motions), strict=True)
        for guess in (*guesses, (0.0,) * len(self.motions)):
            for motion, values in zip(self.motions, guess, strict=True):
                x[motion.dofs] = values
            for bc in self.newton.bcs:
                _compat.bc_set(bc, x, None, 1.0)
            if self._least_stretch() > 0.5:
                break

    def _least_stretch(self) -> float:
        """Return the smallest det f of all points. Collective."""
        least = min(float(np.min(j.evaluate(), initial=1.0)) for j in self._volumes)
        return self.unknown.mesh.comm.allreduce(least, MPI.MIN)

    def solve(self) -> NewtonResult:
        """Solve for the increment of displacement and the pressure on the grid."""
        return self.newton.solve()

    def map_to_points(self) -> dict[MaterialPoints, dict[str, npt.NDArray[np.float64]]]:
        """Evaluate new fields of all points, with new positions "x"; nothing is assigned yet."""
        new = {points: update.evaluate() for points, update in self._updates.items()}
        for points, fields in new.items():
            increment = fields["x"]
            fields["u"] = points["u"] + increment
            fields["x"] = points.x + increment
        return new

    def convect(self, new: Mapping[MaterialPoints, Mapping[str, npt.NDArray[np.float64]]]) -> int:
        """Assign new fields, move all points, and set the new volumes as weights.

        Args:
            new: New fields of each point set, as ``map_to_points`` returns them.

        Returns:
            Number of points that left the mesh and were deleted, or held back for the first time.

        Raises:
            NewtonError: If points are turned inside out; nothing is assigned then.
        """
        least = min(float(np.min(new[body]["J"], initial=1.0)) for body in self.bodies)
        least = self.unknown.mesh.comm.allreduce(least, MPI.MIN)
        if not least > 0:
            raise NewtonError("inverted", f"J = {least:g} at a point after the step", [])
        removed = 0
        for points, fields in new.items():
            points.assign({name: array for name, array in fields.items() if name != "x"})
            removed += self.exits.move(points, fields["x"])
        for body in self.bodies:
            body.assign({"weight": body["V_0"] * body["J"]})
        return removed

    # --- steps -------------------------------------------------------------------------------

    def step(self, dt: float | None = None) -> Step:
        """Do one step. If it fails, points and time are as they were before it. Collective.

        Args:
            dt: Length of the step in s; None for ``next_dt``.

        Raises:
            NewtonError: If the equations cannot be solved.
            LinearSolverError: If velocities cannot be mapped with the consistent mass.
            PointsOutsideError: If points leave the mesh.
        """
        dt = self.next_dt if dt is None else dt
        check_time_step(dt)
        require_points(self.bodies)
        self._observers.start(self)
        before, old_dt = self._snapshot(), float(self.scheme.dt.value)
        clock = self.seconds
        try:
            self._set_length(dt)
            if self.number == 0:
                self._start()
            self._set_data(self.scheme.share * dt)
            for scheme in self.schemes:
                scheme.begin()
            self._observers.call("begin", self)
            with clock("map"):
                self.map_to_grid()
            self._observers.call("mapped", self)
            with clock("predict"):
                self.predict()
            result = self.solve()
            self._observers.call("solved", self)
            with clock("map"):
                new = self.map_to_points()
            with clock("convect"):
                removed = self.convect(new)
        except BaseException:
            self._restore(before)
            self._set_length(old_dt)
            raise
        for name, seconds in result.seconds.items():
            clock.add(name, seconds)
        for scheme in self.schemes:
            scheme.end()
        for body in self.rigid:
            body.carry(self.time, self.time + dt)
            body.settle()
        self.time += dt
        self.number += 1
        self._warn_of_torn_off()
        step = Step(self.number, self.time, dt, result, removed=removed)
        with clock("observers"):
            self._observers.done(self, step)
        return step

    def run(
        self,
        until: float,
        *,
        step_length: Callable[[], float] | None = None,
        smallest: float = 1e-3,
        largest: float | None = None,
    ) -> Iterator[Step]:
        """Do steps until a time. A step that cannot be solved is tried again with half its length.

        After a success, the step length grows again up to its initial value.

        Args:
            until: End in s.
            step_length: Function that returns the greatest length of each step in s instead, such
                as ``solvers.CourantStep``. Collective.
            smallest: Fraction of the greatest length below which the loop gives up.
            largest: Length in s up to which steps grow if Newton's method converges easily, for
                load steps; None for the initial length.

        Yields:
            Each step that was done.

        Raises:
            NewtonError: If a step of the smallest length fails, too.
            LinearSolverError, PointsOutsideError: As for ``step``.
            ValueError: For an end that is not finite.
        """
        if not math.isfinite(until):
            raise ValueError(f"the end of a run must be finite: {until} s")
        attempts = 1
        while until - self.time > 1e-9 * self._dt:
            if step_length is not None and attempts == 1:
                # unless a failure has cut it, the last step had the greatest length
                was_cut = self.next_dt < self._dt
                self._dt = step_length()
                self.next_dt = min(self.next_dt, self._dt) if was_cut else self._dt
            left = until - self.time
            # the rest must not become a last step of nearly no length
            dt = left if left < 1.001 * self.next_dt else self.next_dt
            number = self.number
            try:
                step = self.step(dt)
            except NewtonError as error:
                hopeless = error.reason in _HOPELESS or self.number > number
                if hopeless or dt / 2 < smallest * self._dt:
                    raise
                self.next_dt, attempts = dt / 2, attempts + 1
                why = str(error).partition(";")[0]
                logger.warning("step %d halved to %g s: %s", self.number + 1, self.next_dt, why)
                continue
            step.attempts, attempts = attempts, 1
            easy = step.newton is not None and step.newton.iterations <= _EASY
            if largest is not None and step.attempts == 1 and easy:
                self._dt = min(1.5 * self._dt, largest)
            self.next_dt = min(2 * self.next_dt, self._dt)
            yield step

    def settle(self) -> None:
        """Do nothing: all points are up to date after each step."""

    @property
    def linear(self) -> LinearSolver:
        """Solver of the linear systems, with its method, iterations and computing time."""
        return self.newton.linear

    @property
    def method(self) -> str:
        """Name of the time scheme, for checkpoints."""
        return type(self.scheme).__name__

    @property
    def parameters(self) -> dict[str, str]:
        """Return choices of the script, for checkpoints."""
        return {"residual": self._described, **of_points([*self.bodies, *self.carried])}

    @property
    def memory(self) -> dict[str, float]:
        """Numbers that the next step depends on, in addition to the points, for checkpoints."""
        dt = {"dt": float(self.scheme.dt.value), "next_dt": self.next_dt, "longest": self._dt}
        parts = memory_of_schemes(self.motions), memory_of(self.rigid), self._observers.memory
        return {**dt, **{name: value for part in parts for name, value in part.items()}}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        rest = dict(values)
        self._set_length(rest.pop("dt"))
        self.next_dt, self._dt = rest.pop("next_dt"), rest.pop("longest")
        remember(self.rigid, rest)
        self._observers.remember(rest)
        remember_schemes(self.motions, rest)

    def _warn_of_torn_off(self) -> None:
        for torn_off in self._torn_off:
            torn_off.look(self.time)

    def _set_length(self, dt: float) -> None:
        for scheme in self.schemes:
            scheme.dt.value = dt

    def _snapshot(self) -> Any:
        sets = [
            (points, points.snapshot(copy=False), points.size_global) for points in self._updates
        ]
        return sets, dict(self.exits.held)

    def _restore(self, snapshot: Any) -> None:
        """Restore a snapshot without communication: the error may be on one rank only."""
        sets, self.exits.held = snapshot
        for points, arrays, size_global in sets:
            points.restore(arrays, size_global)

    def _set_data(self, length: float) -> None:
        """Set boundary values and the user's data for a motion of some length in s."""
        for z, known in zip(self.unknowns, self._fixed, strict=True):
            z.require_conditions(known)
            z.set_conditions(self.time, self.time + length)
        for body in self.rigid:
            body.carry(self.time, self.time + length)
        if self.data is not None:
            self.data(self.time, self.time + length)

    def _start(self) -> None:
        """Find initial accelerations by a step in which they are constant; nothing moves.

        Otherwise a load that acts from the beginning would be delayed by half a step. This step has
        the usual length: if dt is far less than the time that shear waves take through a cell,
        tau_1 does not fit the problem.
        """
        schemes: Sequence[Any] = self.schemes
        if not hasattr(schemes[0], "start_up"):
            return
        self._set_data(float(schemes[0].dt.value))
        for scheme in schemes:
            scheme.start_up(True)
        try:
            self.map_to_grid()
            self.predict()
            self.solve()
            for body in self.bodies:
                new = self._updates[body].evaluate()
                body.assign({name: new[name] for name in ("a", "p") if name in new})
        finally:
            for scheme in schemes:
                scheme.start_up(False)

    def _facts(self) -> Facts:
        dofs = self.unknown.space.dofmap
        n = dofs.index_map.size_global * dofs.index_map_bs
        return [
            ("time", f"{self.time:g} s"),
            ("steps done", str(self.number)),
            *facts_of_bodies(self.bodies, self.laws, self.carried, self.rigid),
            ("unknown", f"{', '.join(map(repr, self.unknowns))}, {n} degrees of freedom"),
            ("scheme", ", ".join(map(repr, self.schemes))),
            ("linear solver", repr(self.linear)),
            ("time spent", str(self.seconds)),
        ]

    def __repr__(self) -> str:
        """Return the same text as printing."""
        return str(self)


def _check_times(renewed: Mapping[MaterialPoints, Mapping[str, Any]], scheme: TimeScheme) -> None:
    """Raise ValueError for states at the end of a step if equations hold before the end."""
    # a fluid updates F itself at the end of the step; normals of carried points have no stress
    if scheme.share != 1 and any(
        fields and "F" in points and "F" not in fields for points, fields in renewed.items()
    ):
        raise ValueError(
            "GeneralizedAlpha cannot be used with a stress that has a state or depends on two "
            "configurations: its state belongs to the end of the step, but equations hold before"
        )
    if scheme.share != 1 and any(n.startswith(SLIP) for fields in renewed.values() for n in fields):
        raise ValueError(
            "friction between bodies is found where equations hold, and its springs belong to the "
            "end of the step: GeneralizedAlpha cannot be used with it, take Bossak"
        )


def _check_conditions(unknown: Unknown) -> None:
    """Raise ValueError for displacements that each step would add again. Collective."""
    for condition in unknown.conditions:
        if condition.moves_again():
            raise ValueError(
                f"a displacement of the boundary by part {condition.part!r} that does not depend "
                "on time would be added again in each step: give it as a function of time, such as "
                'fix("u", where, lambda t: (0.1 * t, 0)); the loop takes its increments'
            )
