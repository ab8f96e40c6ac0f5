# SPDX-License-Identifier: MIT
"""Audit of steps: changes of momentum and kinetic energy in each stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat, _jit
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, moment, momentum
from fenicsmpm.simulation.explicit import ExplicitMPM
from fenicsmpm.simulation.motion import Motion
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.step import Step
from fenicsmpm.solvers import EffectiveProjection

Array = npt.NDArray[np.float64]


@dataclass
class Balance:
    """Momenta and kinetic energy of points, or of a grid.

    Attributes:
        momentum: Linear momentum in kg m/s, ``(d,)``.
        angular_momentum: Angular momentum about the origin in kg m^2/s: a number in 2D, ``(3,)``
            in 3D.
        kinetic_energy: Kinetic energy in J.
    """

    momentum: Array
    angular_momentum: float | Array
    kinetic_energy: float

    def __sub__(self, other: Balance) -> Balance:
        """Return the gain since another balance."""
        return Balance(
            self.momentum - other.momentum,
            self.angular_momentum - other.angular_momentum,
            self.kinetic_energy - other.kinetic_energy,
        )


@dataclass
class StepAudit:
    """Balances around the stages of a step (conservation paper, tables 1 and 2).

    Attributes:
        points_before: Balance of the points before the step.
        grid_before: Balance of the grid after velocities were mapped to it.
        grid_after: Balance of the grid after the solution, at the nodes' new positions.
        points_after: Balance of the points after the step.
    """

    points_before: Balance
    grid_before: Balance
    grid_after: Balance
    points_after: Balance

    @property
    def changes(self) -> dict[str, Balance]:
        """Return the changes in each stage, and in the whole step."""
        return {
            "map to the grid": self.grid_before - self.points_before,
            "solve": self.grid_after - self.grid_before,
            "map to the points": self.points_after - self.grid_after,
            "whole step": self.points_after - self.points_before,
        }

    def __str__(self) -> str:
        """Return a table with a line for each stage."""
        lines = [f"{'change by':<20}{'momentum':>12}{'angular':>12}{'kinetic energy':>16}"]
        for stage, change in self.changes.items():
            lines.append(
                f"{stage:<20}{np.linalg.norm(change.momentum):12.3e}"
                f"{np.linalg.norm(change.angular_momentum):12.3e}{change.kinetic_energy:16.6e}"
            )
        return "\n".join(lines)


class Audit(Observer):
    """Balances of each step of a loop, as ``observers=[audit]``. Coupled unknowns are summed up.

    In explicit steps, ``grid_before`` is the balance of the step's own momenta. If a loop yields
    blocks of steps, the balances of the points are those before and after the block.

    Attributes:
        last: Balances of the last step.
    """

    last: StepAudit

    def start(self, sim: Any) -> None:
        """Compile the mass of the grid. Collective.

        Args:
            sim: The simulation.
        """
        self._found: dict[str, Balance] = {}
        self._grids: list[_Grid] = []
        if not isinstance(sim, ExplicitMPM):
            self._grids = [_Grid(motion) for motion in sim.motions]

    def begin(self, sim: Any) -> None:
        """Store the balance of the points.

        Args:
            sim: The simulation.
        """
        self._found = {"points_before": _of_points(sim)}

    def mapped(self, sim: Any) -> None:
        """Store the balance of the grid with the mapped velocities.

        Args:
            sim: The simulation.
        """
        self._found["grid_before"] = _sum([grid.before() for grid in self._grids])

    def solved(self, sim: Any) -> None:
        """Store the balance of the grid with the new velocities, at the nodes' new positions.

        Args:
            sim: The simulation.
        """
        self._found["grid_after"] = _sum([grid.after() for grid in self._grids])

    def done(self, sim: Any, step: Step) -> None:
        """Complete the balances of the step.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        if isinstance(sim, ExplicitMPM):
            mass, dim = sim.mass().x.array, sim.velocity.function_space.mesh.geometry.dim
            v, a = (f.x.array.reshape(-1, dim) for f in (sim.velocity, sim.acceleration()))
            space = sim.velocity.function_space
            n = space.dofmap.index_map.size_local
            x, m = space.tabulate_dof_coordinates()[:n, :dim], mass[:n, None]
            v, before = v[:n], v[:n] - step.dt * a[:n]
            comm = space.mesh.comm
            self._found["grid_before"] = _balance(comm, x, before, m * before)
            self._found["grid_after"] = _balance(comm, x + step.dt * v, v, m * v)
        self.last = StepAudit(**self._found, points_after=_of_points(sim))


class _Grid:
    """Nodes and mass by which the bodies of one unknown move. Collective."""

    def __init__(self, motion: Motion) -> None:
        scheme = motion.scheme
        self._old = scheme.histories["v"]
        space = self._old.function_space
        self._effective = EffectiveProjection(motion.bodies, space, scheme.lumping)
        self._mass = PETSc.Mat()
        points = _compat.interpolation_points(space)
        self._velocity, self._motion = (
            _jit.expression(value, points, space.mesh.comm)
            for value in (scheme.grid_velocity(), scheme.increment)
        )

    def before(self) -> Balance:
        """Return the balance with the mapped velocities."""
        self._mass.destroy()  # of a step that failed
        self._mass = self._effective.mass()
        return self._balance(self._old, None)

    def after(self) -> Balance:
        """Return the balance with the new velocities, at the nodes' new positions."""
        velocity, motion = (fem.Function(self._effective.space) for _ in range(2))
        velocity.interpolate(self._velocity)
        motion.interpolate(self._motion)
        result = self._balance(velocity, motion)
        self._mass.destroy()
        return result

    def _balance(self, velocity: fem.Function, motion: fem.Function | None) -> Balance:
        space = self._effective.space
        dim = space.mesh.geometry.dim
        n = space.dofmap.index_map.size_local
        v = velocity.x.array.reshape(-1, dim)[:n].copy()
        v[self._effective.empty_nodes] = 0.0  # tied nodes may move where no point is
        x = space.tabulate_dof_coordinates()[:n, :dim]
        if motion is not None:
            x = x + motion.x.array.reshape(-1, dim)[:n]
        column, product = self._mass.createVecs()
        column.array_w[:] = v.ravel()
        self._mass.mult(column, product)
        p = product.array_r.reshape(-1, dim).copy()
        column.destroy()
        product.destroy()
        return _balance(space.mesh.comm, x, v, p)


def _sum(balances: Sequence[Balance]) -> Balance:
    return Balance(
        np.sum([b.momentum for b in balances], axis=0),
        sum(b.angular_momentum for b in balances),
        sum(b.kinetic_energy for b in balances),
    )


def _of_points(sim: Any) -> Balance:
    return Balance(
        np.sum([momentum(body) for body in sim.bodies], axis=0),
        sum(angular_momentum(body) for body in sim.bodies),
        sum(kinetic_energy(body) for body in sim.bodies),
    )


def _balance(comm: Any, x: Array, v: Array, p: Array) -> Balance:
    """Return the balance of owned nodes on all ranks from positions, velocities and momenta."""
    return Balance(
        comm.allreduce(p.sum(axis=0)),
        comm.allreduce(moment(x, p)),
        float(comm.allreduce(np.vdot(v, p) / 2)),
    )
