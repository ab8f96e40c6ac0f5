# SPDX-License-Identifier: MIT
"""ExplicitMPM: the explicit time loop (F-bar, section 2.2 and algorithm 1)."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit.checks import check_points, check_space
from fenicsmpm.explicit.contact import RigidBox
from fenicsmpm.explicit.engine import LatticeEngine
from fenicsmpm.explicit.fbar import FBar, default_fbar
from fenicsmpm.formulations.time_scheme import check_time_step
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
from fenicsmpm.solvers.checks import check_bcs
from fenicsmpm.solvers.stopwatch import Stopwatch

logger = logging.getLogger(__name__)

# Steps after which cells are found and points sorted: more would cost time, as would fewer
STEPS_OF_A_BLOCK = 100


class UnstableError(RuntimeError):
    """A point is inverted, not finite, or outside; the points are as they were at ``time``."""


@dataclass
class Step:
    """Where the simulation is.

    Attributes:
        number: of the step, from 1.
        time: at its end [s].
        dt: its length [s].
    """

    number: int
    time: float
    dt: float


class ExplicitMPM:
    """Explicit dynamics of material points on a lattice.

    Args:
        V: space of velocities on the background mesh, linear Lagrange with d components.
        bodies: material points with the fields of ``explicit.set_initial_state``, and their laws.
            Bodies meet on the grid, without slip; each has averages of J of its own.
        basis: grid functions: "linear", "gimp", "quadratic" or "cubic".
        bcs: Dirichlet conditions on velocities, on V or its components: all for fixed nodes, the
            normal component for rollers and slip walls.
        gravity: acceleration (d,) [m/s^2].
        dt: time step [s]; None for the share ``cfl`` of what is stable, found again at times.
        cfl: time step times wave speed per cell size.
        flip: share of FLIP in velocities, the rest is PIC (eq. 13).
        damping: share of local damping, for static problems.
        fbar: how J is averaged; None for no averaging (standard MPM); by default for each law what
            ``explicit.default_fbar`` says.
        loads: points that carry forces in a field "force" (d,) [N] and move with the grid.
        rigid: boxes that bodies cannot enter.
        data: called with the time at the beginning of each step, to set loads and boundary values;
            positions of points are those of when ``run`` yielded last or up to 100 steps before.

    Attributes:
        time: [s].
        number: of steps done.
        dt: length of the last step [s], before the first of that.
        bodies: material points.
        carried: points that carry forces.
        laws: law of each body; may be replaced by one of the same kind with other parameters.
        bcs: may be changed between steps, as may gravity (3,), flip, damping and data.
        rigid: boxes.
        reaction: force on the grid by Dirichlet conditions in the last step, (3,) [N].
        seconds: time spent in each stage so far [s].

    Raises:
        ValueError: for a mesh that is no lattice, another space, points without their fields, and
            options out of range.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        bodies: Mapping[MaterialPoints, Law],
        *,
        basis: str = "quadratic",
        bcs: Sequence[fem.DirichletBC] = (),
        gravity: npt.ArrayLike | None = None,
        dt: float | None = None,
        cfl: float = 0.4,
        flip: float = 1.0,
        damping: float = 0.0,
        fbar: FBar | Literal["default"] | None = "default",
        loads: Sequence[MaterialPoints] = (),
        rigid: Sequence[RigidBox] = (),
        data: Callable[[float], None] | None = None,
    ) -> None:
        """Check everything; kernels are compiled in the first step (collective)."""
        if dt is not None:
            check_time_step(dt)
        if not (0 < cfl < math.inf and 0 <= flip <= 1 and 0 <= damping < 1):
            raise ValueError(
                f"cfl must be positive, flip lie in [0, 1] and damping in [0, 1): {cfl}, {flip}, "
                f"{damping}"
            )
        if basis not in KINDS:
            raise ValueError(f"no grid functions {basis!r}: there are {', '.join(KINDS)}")
        check_points(V, [*bodies, *loads], len(bodies))
        lattice = lattice_of(V.mesh)
        self.V, self._spacing = V, lattice.spacing
        self._kind = KINDS[basis]
        check_space(V, lattice.shape, WIDTH[self._kind])
        fbars = [default_fbar(law) if fbar == "default" else fbar for law in bodies.values()]
        self._engine = LatticeEngine(V, bodies, fbars, loads, self._kind)
        check_bcs(bcs, V)
        self.bodies, self.carried, self.laws = list(bodies), list(loads), dict(bodies)
        self.bcs, self.rigid = list(bcs), list(rigid)
        self.gravity = np.zeros(3)
        dim = len(self._spacing)
        if gravity is not None:
            if np.shape(gravity) != (dim,) or not np.isfinite(gravity).all():
                raise ValueError(f"gravity must be {dim} finite numbers, not {gravity!r}")
            self.gravity[:dim] = gravity
        if any(len(box.force) != dim for box in rigid):
            raise ValueError(f"a rigid box needs corners of {dim} numbers here")
        self.flip, self.damping, self.data = flip, damping, data
        self.time, self.number = 0.0, 0
        self.reaction = np.zeros(3)
        self.seconds = Stopwatch()
        self._cfl, self._given_dt, self._unsorted, self._warned = cfl, dt, 0, False
        self.dt = self._step_length()

    # --- steps -------------------------------------------------------------------------------

    def step(self) -> Step:
        """Do one step (collective).

        Raises:
            UnstableError: a point is inverted, not finite or outside; all are as before.
        """
        self._advance(1, self._step_length())
        return Step(self.number, self.time, self.dt)

    def run(self, until: float, interval: float | None = None) -> Iterator[Step]:
        """Do steps until a time (collective).

        Args:
            until: end [s].
            interval: time between the steps that are yielded [s]; None for each step. In between,
                the arrays of points are not up to date, which saves time.

        Yields:
            Steps at whose end all points and fields are up to date.

        Raises:
            UnstableError: a point is inverted, not finite or outside; all points are as they were
                when they were looked at last, which is at ``time``.
            ValueError: for an end that is not finite or an interval that is not positive.
        """
        if not math.isfinite(until) or not (interval is None or interval > 0):
            raise ValueError(f"run until {until} s at intervals of {interval} s")
        while until - self.time > 1e-9 * self.dt:
            # from where it is, so that a restart there does the same
            stop = until if interval is None else min(until, self.time + interval)
            while stop - self.time > 1e-9 * self.dt:
                # equal steps that end at the stop, none longer than it may be
                left = stop - self.time
                steps = max(1, math.ceil(left / self._step_length() - 1e-9))
                self._advance(min(steps, 1 if interval is None else STEPS_OF_A_BLOCK), left / steps)
                if interval is None:
                    break
            else:
                self.time = stop  # without the round-off of the sum of steps
            yield Step(self.number, self.time, self.dt)

    def _advance(self, steps: int, dt: float) -> None:
        """Do some steps; the points are up to date after the last."""
        self.dt = dt
        before = self.time, self.number, [box.moved for box in self.rigid]
        clock, engine = self.seconds, self._engine
        try:
            with clock("begin"):
                engine.begin(self.laws, self.bcs)
            for k in range(steps):
                self._one_step(again=k < steps - 1)
                self.time += self.dt
                self.number += 1
            self._raise_if([p.describe(bad) for p in engine.parts if (bad := p.bad_stress()) >= 0])
        except BaseException:
            self.time, self.number, ways = before
            for box, way in zip(self.rigid, ways, strict=True):
                box.moved = way
            raise
        with clock("settle"):
            self._unsorted += steps
            sort = self._unsorted >= STEPS_OF_A_BLOCK
            engine.settle(sort)
            if sort:
                self._unsorted = 0

    def _one_step(self, again: bool) -> None:
        clock, engine, dt = self.seconds, self._engine, self.dt
        if self.data is not None:
            self.data(self.time)
            engine.read_supports()
        with clock("nodes"):
            velocities = [box.velocity_at(self.time) for box in self.rigid]
            messages = []
            for box, velocity in zip(self.rigid, velocities, strict=True):
                box.force = np.zeros_like(box.force)
                messages += engine.push(box, velocity, dt)
            engine.sum_nodes()
            messages += engine.add_loads()
            reaction = engine.move_nodes(dt, self.gravity, self.damping)
            messages += engine.move_loads(dt)
        with clock("gather"):
            messages += engine.gather(dt, self.flip)
            for box, velocity in zip(self.rigid, velocities, strict=True):
                box.moved = box.moved + dt * velocity
                messages += engine.hold_back(box, velocity, dt)
        with clock("nodes"):
            anew = self._agree(messages, reaction)
            engine.average()
        with clock("finish"):
            engine.finish(again, anew)

    def _agree(self, messages: list[str], reaction: npt.NDArray[np.float64]) -> bool:
        """Sum up over ranks what each has found in a step (collective).

        Returns:
            Whether points have left their tiles on any rank.
        """
        strays, comm = self._engine.strays, self.V.mesh.comm
        failed = len(messages) > 0
        if comm.size > 1:
            forces = [box.force for box in self.rigid]
            mine = np.concatenate([[float(failed), float(strays)], reaction, *forces])
            comm.Allreduce(MPI.IN_PLACE, mine, MPI.SUM)
            failed, strays, reaction = mine[0] > 0, mine[1] > 0, mine[2:5].copy()
            for i, box in enumerate(self.rigid):
                first = 5 + i * len(box.force)
                box.force = mine[first : first + len(box.force)].copy()
        if failed:
            self._raise_if(messages)
        self.reaction = reaction
        return bool(strays)

    def _raise_if(self, messages: list[str]) -> None:
        """Raise on all ranks if there is a message on any (collective)."""
        comm = self.V.mesh.comm
        if comm.size > 1:
            messages = [m for some in comm.allgather(messages) for m in some]
        if messages:
            raise UnstableError(
                f"step {self.number + 1}, t = {self.time + self.dt:g} s, dt = {self.dt:g} s: "
                f"{messages[0]}; the stable step is about {self._stable_step():g} s{self._hint()}"
            )

    def _hint(self) -> str:
        """What may have made points unstable."""
        hints = [
            f"the rigid box {box.lower} ... {box.upper} pushed with {box.force} N: give it a larger"
            " reach or a lower stiffness, or begin further away from it"
            for box in self.rigid
            if np.any(box.force)
        ]
        if self.dt > self._stable_step():
            hints.append("the step is longer than that: take smaller ones")
        elif self._kind == KINDS["linear"] and not hints:
            hints.append(
                "linear functions have kinks, where points cross cells and nodes are light: "
                'take basis="quadratic", or smaller steps'
            )
        return "".join(f"; {hint}" for hint in hints)

    # --- checkpoints ---------------------------------------------------------------------------

    @property
    def method(self) -> str:
        """Name of the method, with the number of boxes, whose ways are in ``memory``."""
        boxes = f" with {len(self.rigid)} rigid boxes" if self.rigid else ""
        return type(self).__name__ + boxes

    @property
    def memory(self) -> dict[str, float]:
        """What the next step depends on, beside the points."""
        ways = {
            f"box {i} moved {k}": float(way)
            for i, box in enumerate(self.rigid)
            for k, way in enumerate(box.moved)
        }
        return {"unsorted": float(self._unsorted), **ways}

    @memory.setter
    def memory(self, values: Mapping[str, float]) -> None:
        self._unsorted = int(values["unsorted"])
        for i, box in enumerate(self.rigid):
            box.moved = np.array([values[f"box {i} moved {k}"] for k in range(len(box.moved))])

    # --- time step -----------------------------------------------------------------------------

    def _stable_step(self) -> float:
        """Time that a wave takes through a cell: the limit of stability, about [s] (collective)."""
        fastest = 0.0
        for points in self.bodies:
            if len(points):
                modulus = self.laws[points].wave_speed_modulus
                density = float(np.min(points["mass"] / points["V_0"]))
                speed = float(np.sqrt(np.max(np.sum(points["v"] ** 2, axis=1))))
                fastest = max(fastest, speed + math.sqrt(modulus / density))
        fastest = self.V.mesh.comm.allreduce(fastest, MPI.MAX)
        if fastest == 0.0:
            raise ValueError("all bodies are empty: there are no points to move")
        return float(np.min(self._spacing)) / fastest

    def _step_length(self) -> float:
        stable = self._stable_step()
        dt = self._cfl * stable if self._given_dt is None else self._given_dt
        if dt > stable and not self._warned:
            self._warned = True
            logger.warning(
                "the time step of %g s is above the limit of stability, about %g s", dt, stable
            )
        return dt

    def __repr__(self) -> str:
        """Bodies and time."""
        bodies = ", ".join(f"{body.size_global} points of {law}" for body, law in self.laws.items())
        return (
            f"ExplicitMPM: {bodies}\n  step {self.number}, t = {self.time:g} s, dt = {self.dt:g} s"
        )
