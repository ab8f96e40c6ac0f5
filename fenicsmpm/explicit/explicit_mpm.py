# SPDX-License-Identifier: MIT
"""ExplicitMPM: the explicit time loop (F-bar, section 2.2 and algorithm 1)."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mpi4py import MPI

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lattice_stencil import KINDS
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.explicit import grid
from fenicsmpm.explicit.contact import RigidBox
from fenicsmpm.explicit.fbar import FBar, default_fbar
from fenicsmpm.explicit.parts import Load, Part
from fenicsmpm.formulations.time_scheme import check_time_step
from fenicsmpm.lanes import LANES, LINE_LANES
from fenicsmpm.materials import Law
from fenicsmpm.points import MaterialPoints
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
            Bodies meet on the grid, without slip.
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
        data: called with the time at the beginning of each step, to set loads and boundary values.

    Attributes:
        time: [s].
        number: of steps done.
        dt: length of the last step [s], before the first of that.
        laws: law of each body; may be replaced by one of the same kind with other parameters.
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
        if not bodies:
            raise ValueError("ExplicitMPM needs a body")
        lattice = lattice_of(V.mesh)
        self.V, self._spacing = V, lattice.spacing
        self._kind = KINDS[basis]
        _check_space(V, lattice.shape, WIDTH[self._kind])
        self._nodes = grid.nodes_of(lattice)
        self._parts = [
            Part(body, law, self._kind, default_fbar(law) if fbar == "default" else fbar)
            for body, law in bodies.items()
        ]
        self.bodies, self.carried, self.laws = list(bodies), list(loads), dict(bodies)
        self._loads = [Load(points, self._kind) for points in loads]
        self.bcs, self.rigid = list(bcs), list(rigid)
        self.gravity = np.zeros(3)
        if gravity is not None:
            self.gravity[: len(self._spacing)] = gravity
        self.flip, self.damping, self.data = flip, damping, data
        self.time, self.number = 0.0, 0
        self.reaction = np.zeros(3)
        self.seconds = Stopwatch()
        threads, size = numba.get_num_threads(), self._nodes.size
        self._rows = grid.empty_rows(threads, size, LANES)
        self._averages = grid.empty_rows(threads, size, LINE_LANES)
        self._sums = np.zeros(size)
        self._cfl, self._given_dt, self._unsorted, self._warned = cfl, dt, 0, False
        self._fixed = grid.constraints(self._nodes, V, self.bcs)
        masses = [float(np.min(body["mass"], initial=np.inf)) for body in self.bodies]
        # far below any point's share in a node whose support it is in
        self._least_mass = 1e-16 * V.mesh.comm.allreduce(min(masses), MPI.MIN)
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
        start, count = self.time, 0
        while until - self.time > 1e-9 * self.dt:
            count += 1
            stop = until if interval is None else min(until, start + count * interval)
            while stop - self.time > 1e-9 * self.dt:
                # equal steps that end at the stop, none longer than it may be
                left = stop - self.time
                steps = max(1, math.ceil(left / self._step_length() - 1e-9))
                self._advance(min(steps, 1 if interval is None else STEPS_OF_A_BLOCK), left / steps)
                if interval is None:
                    break
            yield Step(self.number, self.time, self.dt)

    def _advance(self, steps: int, dt: float) -> None:
        """Do some steps; the points are up to date after the last."""
        self.dt = dt
        before = self.time, self.number, [box.moved for box in self.rigid]
        clock = self.seconds
        try:
            with clock("begin"):
                grid.clear(self._rows)
                for part in self._parts:
                    part.begin(len(self._rows), self.laws[part.points])
                    part.scatter(self._rows, self._nodes)
                for load in self._loads:
                    load.begin()
                self._fixed = grid.constraints(self._nodes, self.V, self.bcs)
            for k in range(steps):
                self._one_step(again=k < steps - 1)
                self.time += self.dt
                self.number += 1
        except BaseException:
            self.time, self.number, ways = before
            for box, way in zip(self.rigid, ways, strict=True):
                box.moved = way
            raise
        with clock("settle"):
            self._unsorted += steps
            sort = self._unsorted >= STEPS_OF_A_BLOCK
            for part in self._parts:
                part.settle(self._nodes, sort)
            for load in self._loads:
                load.settle()
            if sort:
                self._unsorted = 0

    def _one_step(self, again: bool) -> None:
        rows, averages, nodes, clock = self._rows, self._averages, self._nodes, self.seconds
        if self.data is not None:
            self.data(self.time)
            self._fixed = grid.constraints(nodes, self.V, self.bcs)
        with clock("nodes"):
            self._move_nodes()
            grid.clear(averages)
        with clock("gather"):
            bad = [
                part.gather(rows[0], averages, nodes, self.dt, self.flip) for part in self._parts
            ]
            self._hold_back()
            self._raise_if(bad)
        with clock("nodes"):
            grid.sum_averages(averages, self._sums)
            self._add_ranks(self._sums)
            grid.average_nodes(rows, self._sums, averages[0])
        with clock("finish"):
            for part in self._parts:
                part.finish(averages[0], nodes, again, rows)

    def _move_nodes(self) -> None:
        """From the points' mass, momentum and forces to velocities of the nodes."""
        rows, nodes, dt = self._rows, self._nodes, self.dt
        for load in self._loads:
            load.add_forces(rows[0], nodes)
        for box in self.rigid:
            velocity = box.velocity_at(self.time)
            forces = [part.push(box, velocity, dt, rows[0], nodes) for part in self._parts]
            box.force = np.sum(forces, axis=0)
        grid.sum_threads(rows)
        self._add_ranks(rows[0])
        self.reaction = grid.reactions(rows[0], dt, self.gravity, *self._fixed)
        grid.update_nodes(rows[0], dt, self.gravity, self.damping, self._least_mass)
        grid.constrain(rows[0], *self._fixed)
        for load in self._loads:
            load.follow(rows[0], nodes, dt)

    def _hold_back(self) -> None:
        """Move rigid boxes, and keep points out of them."""
        for box in self.rigid:
            velocity = box.velocity_at(self.time)
            box.moved = box.moved + self.dt * velocity
            forces = [part.hold_back(box, velocity, self.dt) for part in self._parts]
            box.force += np.sum(forces, axis=0)
            self._add_ranks(box.force)

    def _add_ranks(self, array: npt.NDArray[np.float64]) -> None:
        """Sum an array over all ranks. Each has all nodes, of which there are fewer than points."""
        comm = self.V.mesh.comm
        if comm.size > 1:
            comm.Allreduce(MPI.IN_PLACE, array, MPI.SUM)

    def _raise_if(self, bad: list[int]) -> None:
        found = [
            part.describe(block, self._nodes)
            for part, block in zip(self._parts, bad, strict=True)
            if block >= 0
        ]
        comm = self.V.mesh.comm
        message = found[0] if found else None
        if comm.size > 1:
            message = next((m for m in comm.allgather(message) if m is not None), None)
        if message is not None:
            raise UnstableError(
                f"step {self.number + 1}, t = {self.time + self.dt:g} s, dt = {self.dt:g} s: "
                f"{message}; the stable step is about {self._stable_step():g} s"
            )

    # --- checkpoints ---------------------------------------------------------------------------

    @property
    def method(self) -> str:
        """Name of the method."""
        return type(self).__name__

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
        for part in self._parts:
            points = part.points
            if len(points):
                modulus = self.laws[points].wave_speed_modulus
                density = float(np.min(points["mass"] / points["V_0"]))
                speed = float(np.sqrt(np.max(np.sum(points["v"] ** 2, axis=1))))
                fastest = max(fastest, speed + math.sqrt(modulus / density))
        fastest = self.V.mesh.comm.allreduce(fastest, MPI.MAX)
        return float(np.min(self._spacing)) / fastest

    def _step_length(self) -> float:
        stable = self._stable_step()
        if self._given_dt is None:
            return self._cfl * stable
        if self._given_dt > stable and not self._warned:
            self._warned = True
            logger.warning(
                "the time step of %g s is above the limit of stability, about %g s",
                self._given_dt, stable,
            )  # fmt: skip
        return self._given_dt

    def __repr__(self) -> str:
        """Bodies and time."""
        bodies = ", ".join(f"{body.size_global} points of {law}" for body, law in self.laws.items())
        return (
            f"ExplicitMPM: {bodies}\n  step {self.number}, t = {self.time:g} s, dt = {self.dt:g} s"
        )


def _check_space(V: fem.FunctionSpace, cells: npt.NDArray[np.int64], width: int) -> None:
    element, dim = V.ufl_element(), V.mesh.geometry.dim
    if element.degree != 1 or V.num_sub_spaces != dim or V.dofmap.index_map_bs != dim:
        raise ValueError(
            f"velocities need a linear Lagrange space with {dim} components, not {element}: "
            'fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))'
        )
    if np.any(cells < width - 1):
        raise ValueError(f"{cells} cells are too few for functions of {width} nodes a direction")
