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
from fenicsmpm.cells import Tying
from fenicsmpm.forms import FieldUpdates, PointExpression
from fenicsmpm.formulations import Kinematics, parts, subspaces
from fenicsmpm.formulations.mixed import require_linear
from fenicsmpm.formulations.time_scheme import TimeScheme, check_time_step
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.exits import check_on_exit, move
from fenicsmpm.simulation.step import Step
from fenicsmpm.solvers import EffectiveProjection, NewtonError, NewtonResult, NewtonSolver
from fenicsmpm.solvers.checks import check_updates, require_fields, warn_of_points_that_stay
from fenicsmpm.solvers.stopwatch import Stopwatch
from fenicsmpm.transfer import project

logger = logging.getLogger(__name__)

# Fields of a body that are mapped to the parts of the unknown, in their order
_PARTS = ("u", "p", "Pi_u", "Pi_p")


class ImplicitMPM:
    """Updated Lagrangian dynamics of material points on a background mesh that stays.

    A step is ``map_to_grid``, ``predict``, ``solve``, ``map_to_points`` and ``convect``; a
    subclass or a loop of one's own may replace any of them.

    Args:
        R: residual, with inertia from the scheme.
        U: its unknown, ``u``, ``(u, p)`` or ``(u, p, Pi_u, Pi_p)``.
        scheme: time scheme made with U.
        bodies: material points with the fields of ``set_initial_state``.
        carried: further points that move with the grid, such as those that carry loads; each gets
            a field "u" if it has none.
        bcs: Dirichlet conditions on U, whose displacement is the share ``scheme.share`` of the
            step's increment (1 but for ``GeneralizedAlpha``); ``data`` sets those that move.
        updates: for each body, more fields to be updated at the end of a step: UFL over its points,
            or functions that return new arrays.
        data: called with the times at the beginning and end of the motion U, to set boundary values
            by it, and loads: those of its end, where equations hold, or of its middle for
            ``Midpoint``.
        taylor: continue velocities linearly from points to nodes when they are mapped, see
            ``transfer.project``; otherwise as in the paper.
        on_exit: what happens to points that leave the mesh: "error", "delete" or "clamp".
        adapt: called with each body at the end of a step, to change its quadrature weights.
        newton: options of ``NewtonSolver``.

    Raises:
        ValueError: for a scheme of another unknown, no bodies, bodies without their fields,
            updates of points or fields that are not there, missing updates of fields on which a
            stress depends, tied nodes of another body or several, or another ``on_exit``.

    Attributes:
        time: [s].
        number: of steps done.
        next_dt: length of the next step that ``run`` will try [s].
        seconds: time spent in each stage so far [s].
    """

    def __init__(
        self,
        R: ufl.Form,
        U: fem.Function,
        scheme: TimeScheme,
        bodies: MaterialPoints | Sequence[MaterialPoints],
        *,
        carried: Sequence[MaterialPoints] = (),
        bcs: Sequence[fem.DirichletBC] = (),
        updates: Mapping[MaterialPoints, Mapping[str, Any]] | None = None,
        data: Callable[[float, float], None] | None = None,
        taylor: bool = False,
        on_exit: str = "error",
        adapt: Callable[[MaterialPoints], None] | None = None,
        newton: Mapping[str, Any] | None = None,
    ) -> None:
        """Compile the residual, its tangent and the updates (collective)."""
        self.U, self.scheme = U, scheme
        self.bodies = [bodies] if isinstance(bodies, MaterialPoints) else list(bodies)
        self.carried = list(carried)
        if not self.bodies or scheme.U is not U:
            raise ValueError("ImplicitMPM needs a body, and a time scheme of the same unknown U")
        check_on_exit(on_exit)
        self.data, self.taylor, self.on_exit, self.adapt = data, taylor, on_exit, adapt
        self.time, self.number = 0.0, 0
        self.seconds = Stopwatch()
        self.next_dt = self._dt = float(scheme.dt.value)
        self.newton = NewtonSolver(R, U, bcs, **(newton or {}))
        shapes = dict(zip(_PARTS, (part.ufl_shape for part in parts(U)), strict=False))
        self._parts = subspaces(U.function_space)
        self._nodal = [fem.Function(space) for space, _ in self._parts[1:]]
        tying = self.newton.tying
        if tying is not None and self.bodies != [tying.body]:
            raise ValueError("nodes are tied by the cells that one body fills: give just this body")
        self._projection = None
        if scheme.lumping > 0:
            require_linear(U, "mapping of velocities by the lumped mass")
        if scheme.lumping < 1:
            if taylor:
                raise ValueError("velocities are continued with the lumped mass only: lumping = 1")
            space = self._parts[0][0]
            if tying is not None and tying.space is not space:
                tying = Tying(space, tying.body, tying.cells, tying.threshold)
            self._projection = EffectiveProjection(self.bodies, space, scheme.lumping, tying)
        for body in self.bodies:
            require_fields(body)
            for name, shape in shapes.items():
                if name not in body:
                    body.add_field(name, shape)
            for name in scheme.histories:
                if name not in body:
                    body.add_field(name, shapes["u"])
            for name, value in scheme.updates(body).items():
                if name not in body:
                    body.add_field(name, value.ufl_shape)
            if "grad_v" not in body:
                body.add_field("grad_v", (*shapes["u"], body.mesh.geometry.dim))
        for points in self.carried:
            if "u" not in points:
                points.add_field("u", shapes["u"])
        moving = [*self.bodies, *self.carried]
        self._volumes = [
            PointExpression(Kinematics(parts(U)[0], body).j, body) for body in self.bodies
        ]
        warn_of_points_that_stay(self.newton.R, moving)
        check_updates(self.newton.R, self.bodies, moving, updates or {}, scheme.share)
        self._updates = {
            points: FieldUpdates(points, self._new_fields(points, updates or {}))
            for points in moving
        }

    # --- stages ------------------------------------------------------------------------------

    def map_to_grid(self) -> None:
        """P2G: histories of the scheme by its mass, pressure and projections by lumped mass."""
        functions = dict(zip(_PARTS[1:], self._nodal, strict=False))
        if self._projection is None:
            functions |= self.scheme.histories
        else:
            fixed = np.isin(self._parts[0][1], _compat.fixed_dofs(self.newton.bcs))
            self._projection.project(self.scheme.histories, np.flatnonzero(fixed))
        slopes = {"v": "grad_v"} if self.taylor else {}
        project(self.bodies, functions, gradients=slopes)

    def predict(self) -> None:
        """Start Newton's method from the old pressure and a motion that goes on as it was.

        At nodes of little mass that may turn cells inside out; then it starts from no motion.
        """
        x = self.U.x.array
        for function, (_, dofs) in zip(self._nodal, self._parts[1:], strict=True):
            x[dofs] = function.x.array
        dofs = self._parts[0][1]
        for guess in (*self.scheme.predictions(), 0.0):
            x[dofs] = guess
            for bc in self.newton.bcs:
                _compat.bc_set(bc, x, None, 1.0)
            if self._least_stretch() > 0.5:
                break

    def _least_stretch(self) -> float:
        """Smallest det f of all points (collective)."""
        least = min(float(np.min(j.evaluate(), initial=1.0)) for j in self._volumes)
        return self.U.function_space.mesh.comm.allreduce(least, MPI.MIN)

    def solve(self) -> NewtonResult:
        """Find the increment of displacement and the pressure on the grid."""
        return self.newton.solve()

    def map_to_points(self) -> dict[MaterialPoints, dict[str, npt.NDArray[np.float64]]]:
        """G2P: new values of the fields of all points; nothing is assigned yet."""
        return {points: update.evaluate() for points, update in self._updates.items()}

    def convect(self, new: Mapping[MaterialPoints, Mapping[str, npt.NDArray[np.float64]]]) -> int:
        """Assign new fields, move all points, and take the new volumes as weights.

        Returns:
            How many points left the mesh and were deleted or held back.

        Raises:
            NewtonError: points are turned inside out; nothing was assigned.
        """
        least = min(float(np.min(new[body]["J"], initial=1.0)) for body in self.bodies)
        least = self.U.function_space.mesh.comm.allreduce(least, MPI.MIN)
        if not least > 0:
            raise NewtonError("inverted", f"J = {least:g} at a point after the step", [])
        removed = 0
        for points, fields in new.items():
            increment = fields["u"] - points["u"]
            points.assign(fields)
            removed += move(points, points.x + increment, self.on_exit)
        for body in self.bodies:
            body.assign({"weight": body["V_0"] * body["J"]})
            if self.adapt is not None:
                self.adapt(body)
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
        before, old_dt = self._snapshot(), float(self.scheme.dt.value)
        clock = self.seconds
        try:
            self.scheme.dt.value = dt
            if self.number == 0:
                self._start()
            if self.data is not None:
                self.data(self.time, self.time + self.scheme.share * dt)
            self.scheme.begin()
            with clock("map"):
                self.map_to_grid()
            with clock("predict"):
                self.predict()
            result = self.solve()
            with clock("map"):
                new = self.map_to_points()
            with clock("convect"):
                removed = self.convect(new)
        except BaseException:
            self._restore(before)
            self.scheme.dt.value = old_dt
            raise
        for name, seconds in result.seconds.items():
            clock.add(name, seconds)
        self.scheme.end()
        self.time += dt
        self.number += 1
        return Step(self.number, self.time, dt, result, removed=removed)

    def run(
        self,
        until: float,
        *,
        step_length: Callable[[], float] | None = None,
        smallest: float = 1e-3,
    ) -> Iterator[Step]:
        """Steps until a time; one that cannot be solved is tried again with half its length.

        After a success, the step grows again up to the length that it had at first.

        Args:
            until: end [s].
            step_length: gives the greatest length of each step [s] instead, such as
                ``solvers.CourantStep`` (collective).
            smallest: share of the greatest length below which there is no use in trying.

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
            try:
                step = self.step(dt)
            except NewtonError as error:
                if dt / 2 < smallest * self._dt:
                    raise
                self.next_dt, attempts = dt / 2, attempts + 1
                why = str(error).partition(";")[0]
                logger.warning("step %d halved to %g s: %s", self.number + 1, self.next_dt, why)
                continue
            step.attempts, attempts = attempts, 1
            self.next_dt = min(2 * self.next_dt, self._dt)
            yield step

    def settle(self) -> None:
        """Nothing: all points are up to date after each step."""

    @property
    def method(self) -> str:
        """Name of the time scheme, for checkpoints."""
        return type(self.scheme).__name__

    @property
    def memory(self) -> dict[str, float]:
        """What the next step depends on, beside the points, for checkpoints."""
        dt = {"dt": float(self.scheme.dt.value), "next_dt": self.next_dt, "longest": self._dt}
        return {**dt, **self.scheme.memory}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        rest = dict(values)
        self.scheme.dt.value, self.next_dt = rest.pop("dt"), rest.pop("next_dt")
        self._dt = rest.pop("longest", self._dt)  # files of earlier versions do not have it
        self.scheme.memory = rest

    def _snapshot(self) -> Any:
        return [
            (points, points.snapshot(copy=False), points.size_global) for points in self._updates
        ]

    def _restore(self, snapshot: Any) -> None:
        """Without communication: an error on one rank only must get out of here."""
        for points, arrays, size_global in snapshot:
            points.restore(arrays, size_global)

    def _start(self) -> None:
        """Find accelerations at the start by a step in which they are constant; nothing moves.

        A load that is there from the beginning would otherwise act late by half a step. The step
        has the usual length: where dt is far less than the time that shear waves take through a
        cell, tau_1 no longer fits the problem.
        """
        scheme = self.scheme
        if not hasattr(scheme, "start_up"):
            return
        if self.data is not None:
            self.data(self.time, self.time + float(scheme.dt.value))
        scheme.start_up(True)
        try:
            self.map_to_grid()
            self.predict()
            self.solve()
            for body in self.bodies:
                new = self._updates[body].evaluate()
                body.assign({name: new[name] for name in ("a", "p") if name in new})
        finally:
            scheme.start_up(False)

    def _new_fields(
        self, points: MaterialPoints, updates: Mapping[MaterialPoints, Mapping[str, Any]]
    ) -> dict[str, Any]:
        increment = self.scheme.increment
        fields = {"u": points.field("u") + increment}
        if points in self.bodies:
            others = zip(_PARTS[1:], parts(self.U)[1:], strict=False)
            k = Kinematics(increment, points)
            fields |= {"F": k.F, "J": k.J, **dict(others)}
            fields |= self.scheme.updates(points)
            fields["grad_v"] = k.grad(self.scheme.grid_velocity())
        return fields | dict(updates.get(points, {}))

    def __repr__(self) -> str:
        """Unknowns, points and scheme."""
        dofs = self.U.function_space.dofmap
        n = dofs.index_map.size_global * dofs.index_map_bs
        bodies = ", ".join(f"{body.size_global} points" for body in self.bodies)
        carried = sum(points.size_global for points in self.carried)
        return (
            f"ImplicitMPM: {n} unknowns on the background mesh, {bodies}, {carried} carried "
            f"points\n  {self.scheme}\n  step {self.number}, t = {self.time:g} s"
        )
