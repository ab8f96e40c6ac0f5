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


# Iterations of Newton's method that make a load step an easy one
_EASY = 5


class ImplicitMPM(Described):
    """Updated Lagrangian dynamics of material points on a background mesh that stays.

    A step is ``map_to_grid``, ``predict``, ``solve``, ``map_to_points`` and ``convect``, which a
    loop of one's own may call, too.

    Args:
        R: residual, with inertia from the scheme.
        unknown: its unknown, with a part that moves the points; what they carry is mapped to
            ``unknown.old`` at the beginning of a step. Its conditions are set for each step. Or
            several ``coupled_unknowns``, of bodies in contact.
        scheme: time scheme of the same unknown; one for each, all of one kind, of several.
        bodies: material points with the fields of ``set_initial_state``; of several unknowns, a
            body or a sequence of bodies for each.
        carried: further points that move with the grid, such as those that carry loads; each gets
            a field "u" if it has none. Of several unknowns, a sequence for each.
        bcs: further Dirichlet conditions of dolfinx, whose displacement is the share
            ``scheme.share`` of the step's increment (1 but for ``GeneralizedAlpha``); ``data`` sets
            those that move.
        updates: for each body, more fields to be updated at the end of a step, beside those that
            the residual needs and ``PointField.renew`` says: UFL over its points, or functions that
            return new arrays.
        data: called with the times at the beginning and end of the motion u, to set boundary values
            by it, and loads: those of its end, where equations hold, or of its middle for
            ``Midpoint``.
        taylor: continue velocities linearly from points to nodes when they are mapped, see
            ``transfer.project``; otherwise as in the paper.
        on_exit: what happens to points that leave the mesh: "error", "delete" or "clamp".
        observers: called around the steps, in their order: ``Observer``s, or functions of the
            simulation and the ``Step`` that was done, such as one that corrects weights. Their
            errors end a run after a step that was done.
        newton: options of ``NewtonSolver``.

    Raises:
        ValueError: for a scheme of another unknown, no bodies, bodies without their fields or of
            which none has points, unknowns that are not coupled or not as many as there are of the
            rest, points that move by two unknowns, a displacement on the boundary that does not
            say how it depends on time, updates of points or fields that are not there, fields that
            are renewed twice, tied nodes of other bodies, or another ``on_exit``.

    Attributes:
        unknowns: as above, also of one.
        schemes: as above, also of one.
        unknown: the first of them.
        scheme: the first of them.
        rigid: rigid bodies in the residual.
        time: [s].
        number: of steps done.
        laws: law at the points of each body that has one in the residual.
        next_dt: length of the next step that ``run`` will try [s].
        seconds: time spent in each stage so far [s].
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
        """Compile the residual, its tangent and the updates (collective)."""
        tying: Tying | None = (newton or {}).get("tying")
        self._motions = motions_of(unknown, scheme, bodies, carried, taylor, tying)
        self.unknowns = [motion.unknown for motion in self._motions]
        self.schemes = [motion.scheme for motion in self._motions]
        self.unknown, self.scheme = self.unknowns[0], self.schemes[0]
        self.bodies = [body for motion in self._motions for body in motion.bodies]
        self.carried = [points for motion in self._motions for points in motion.carried]
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
                "nodes are tied by the cells that the bodies of the simulation fill together: give "
                "Tying all of them, and no other"
            )
        moving = [*self.bodies, *self.carried]
        self._volumes = [
            PointExpression(Kinematics(motion.scheme.u, body).j, body)
            for motion in self._motions
            for body in motion.bodies
        ]
        warn_of_points_that_stay(self.newton.R, moving)
        check_updates(updates or {}, moving)
        moved = {p: m for m in self._motions for p in [*m.bodies, *m.carried]}
        renewed = renewals(R, {p: m.scheme.increment for p, m in moved.items()})
        _check_times(renewed, self.scheme)
        self._updates = {
            points: FieldUpdates(
                points,
                motion.new_fields(points) | renewed[points] | dict((updates or {}).get(points, {})),
            )
            for points, motion in moved.items()
        }
        self._torn_off = [TornOff(motion.bodies, motion.carried) for motion in self._motions]
        self._warn_of_torn_off()
        self._observers.call("start", self)

    # --- stages ------------------------------------------------------------------------------

    def map_to_grid(self) -> None:
        """P2G: histories of the scheme by its mass, those of the unknown by lumped mass."""
        fixed = _compat.fixed_dofs(self.newton.bcs)
        for motion in self._motions:
            motion.map_to_grid(fixed)

    def predict(self) -> None:
        """Start Newton's method from the histories and a motion that goes on as it was.

        At nodes of little mass that may turn cells inside out; then it starts from no motion.
        """
        x = self.unknown.U.x.array
        for motion in self._motions:
            motion.start_from_histories()
        # schemes of one kind have as many guesses
        guesses = zip(*(motion.scheme.predictions() for motion in self._motions), strict=True)
        for guess in (*guesses, (0.0,) * len(self._motions)):
            for motion, values in zip(self._motions, guess, strict=True):
                x[motion.dofs] = values
            for bc in self.newton.bcs:
                _compat.bc_set(bc, x, None, 1.0)
            if self._least_stretch() > 0.5:
                break

    def _least_stretch(self) -> float:
        """Smallest det f of all points (collective)."""
        least = min(float(np.min(j.evaluate(), initial=1.0)) for j in self._volumes)
        return self.unknown.mesh.comm.allreduce(least, MPI.MIN)

    def solve(self) -> NewtonResult:
        """Find the increment of displacement and the pressure on the grid."""
        return self.newton.solve()

    def map_to_points(self) -> dict[MaterialPoints, dict[str, npt.NDArray[np.float64]]]:
        """G2P: new fields of all points, and their new positions "x"; nothing is assigned yet."""
        new = {points: update.evaluate() for points, update in self._updates.items()}
        for points, fields in new.items():
            increment = fields["x"]
            fields["u"] = points["u"] + increment
            fields["x"] = points.x + increment
        return new

    def convect(self, new: Mapping[MaterialPoints, Mapping[str, npt.NDArray[np.float64]]]) -> int:
        """Assign new fields, move all points, and take the new volumes as weights.

        Returns:
            How many points left the mesh and were deleted, or held back for the first time.

        Raises:
            NewtonError: points are turned inside out; nothing was assigned.
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
        """Do one step; if it fails, points and time are as they were before it (collective).

        Args:
            dt: its length [s]; None for ``next_dt``.

        Raises:
            NewtonError: the equations could not be solved.
            LinearSolverError: velocities could not be mapped with the consistent mass.
            PointsOutsideError: points left the mesh.
        """
        dt = self.next_dt if dt is None else dt
        check_time_step(dt)
        require_points(self.bodies)
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
        """Steps until a time; one that cannot be solved is tried again with half its length.

        After a success, the step grows again up to the length that it had at first.

        Args:
            until: end [s].
            step_length: gives the greatest length of each step [s] instead, such as
                ``solvers.CourantStep`` (collective).
            smallest: share of the greatest length below which there is no use in trying.
            largest: length up to which steps grow where Newton's method has an easy task, for load
                steps [s]; None for the length at first.

        Yields:
            Each step that was done.

        Raises:
            NewtonError: a step of the smallest length failed as well.
            LinearSolverError, PointsOutsideError: as ``step``.
            ValueError: for an end that is not finite.
        """
        if not math.isfinite(until):
            raise ValueError(f"the end of a run must be finite: {until} s")
        attempts = 1
        while until - self.time > 1e-9 * self._dt:
            if step_length is not None and attempts == 1:
                # where no failure has cut it, the last step has had the greatest length
                was_cut = self.next_dt < self._dt
                self._dt = step_length()
                self.next_dt = min(self.next_dt, self._dt) if was_cut else self._dt
            left = until - self.time
            # what is left is not to become a last step of nearly no length
            dt = left if left < 1.001 * self.next_dt else self.next_dt
            number = self.number
            try:
                step = self.step(dt)
            except NewtonError as error:
                hopeless = error.reason == "load without material" or self.number > number
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
        """Nothing: all points are up to date after each step."""

    @property
    def linear(self) -> LinearSolver:
        """What solves the linear systems: by which method, in how many iterations and seconds."""
        return self.newton.linear

    @property
    def method(self) -> str:
        """Name of the time scheme, for checkpoints."""
        return type(self.scheme).__name__

    @property
    def parameters(self) -> dict[str, str]:
        """What the script has chosen, for checkpoints."""
        return {"residual": self._described, **of_points([*self.bodies, *self.carried])}

    @property
    def memory(self) -> dict[str, float]:
        """What the next step depends on, beside the points, for checkpoints."""
        dt = {"dt": float(self.scheme.dt.value), "next_dt": self.next_dt, "longest": self._dt}
        return {**dt, **memory_of_schemes(self._motions), **memory_of(self.rigid)}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        rest = dict(values)
        self._set_length(rest.pop("dt"))
        self.next_dt, self._dt = rest.pop("next_dt"), rest.pop("longest")
        remember(self.rigid, rest)
        remember_schemes(self._motions, rest)

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
        """Without communication: an error on one rank only must get out of here."""
        sets, self.exits.held = snapshot
        for points, arrays, size_global in sets:
            points.restore(arrays, size_global)

    def _set_data(self, length: float) -> None:
        """Set boundary values, and what the user sets, for a motion of some length [s]."""
        for z, known in zip(self.unknowns, self._fixed, strict=True):
            z.require_conditions(known)
            z.set_conditions(self.time, self.time + length)
        for body in self.rigid:
            body.carry(self.time, self.time + length)
        if self.data is not None:
            self.data(self.time, self.time + length)

    def _start(self) -> None:
        """Find accelerations at the start by a step in which they are constant; nothing moves.

        A load that is there from the beginning would otherwise act late by half a step. The step
        has the usual length: where dt is far less than the time that shear waves take through a
        cell, tau_1 no longer fits the problem.
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
        """The same as is printed."""
        return str(self)


def _check_times(renewed: Mapping[MaterialPoints, Mapping[str, Any]], scheme: TimeScheme) -> None:
    """Raise ValueError for a state of the end of a step where equations hold before."""
    # a fluid renews F itself, at the end of the step; normals of carried points have no stress
    if scheme.share != 1 and any(
        fields and "F" in points and "F" not in fields for points, fields in renewed.items()
    ):
        raise ValueError(
            "a stress with a state or of two configurations is found where equations hold, and its "
            "state belongs to the end of the step: GeneralizedAlpha cannot be used with it"
        )
    if scheme.share != 1 and any(n.startswith(SLIP) for fields in renewed.values() for n in fields):
        raise ValueError(
            "friction between bodies is found where equations hold, and its springs belong to the "
            "end of the step: GeneralizedAlpha cannot be used with it, take Bossak"
        )


def _check_conditions(unknown: Unknown) -> None:
    """Raise ValueError for displacements that each step would add again (collective)."""
    for condition in unknown.conditions:
        if condition.moves_again():
            raise ValueError(
                f"a displacement of the boundary by part {condition.part!r} that does not depend "
                "on time would be added again in each step: give it as a function of time, such as "
                'fix("u", where, lambda t: (0.1 * t, 0)), whose increments the loop takes'
            )
