# SPDX-License-Identifier: MIT
"""Audit of steps: where momentum and kinetic energy come from and where they go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm.diagnostics import angular_momentum, kinetic_energy, moment, momentum
from fenicsmpm.points import MaterialPoints
from fenicsmpm.simulation.implicit import ImplicitMPM
from fenicsmpm.simulation.step import Step
from fenicsmpm.solvers import EffectiveProjection

Array = npt.NDArray[np.float64]


@dataclass
class Balance:
    """Momenta and kinetic energy of points, or of a grid.

    Attributes:
        momentum: linear momentum [kg m/s], ``(d,)``.
        angular_momentum: about the origin [kg m^2/s], a number in the plane, ``(3,)`` in space.
        kinetic_energy: [J].
    """

    momentum: Array
    angular_momentum: float | Array
    kinetic_energy: float

    def __sub__(self, other: Balance) -> Balance:
        """What was gained since another balance."""
        return Balance(
            self.momentum - other.momentum,
            self.angular_momentum - other.angular_momentum,
            self.kinetic_energy - other.kinetic_energy,
        )


@dataclass
class StepAudit:
    """Balances around the stages of a step (conservation paper, tables 1 and 2).

    Attributes:
        points_before: of the points before the step.
        grid_before: of the grid after velocities were mapped to it.
        grid_after: of the grid after the solution, at the nodes' new positions.
        points_after: of the points after the step.
    """

    points_before: Balance
    grid_before: Balance
    grid_after: Balance
    points_after: Balance

    @property
    def changes(self) -> dict[str, Balance]:
        """What each stage changed, and the whole step."""
        return {
            "map to the grid": self.grid_before - self.points_before,
            "solve": self.grid_after - self.grid_before,
            "map to the points": self.points_after - self.grid_after,
            "whole step": self.points_after - self.points_before,
        }

    def __str__(self) -> str:
        """A table with a line for each stage."""
        lines = [f"{'change by':<20}{'momentum':>12}{'angular':>12}{'kinetic energy':>16}"]
        for stage, change in self.changes.items():
            lines.append(
                f"{stage:<20}{np.linalg.norm(change.momentum):12.3e}"
                f"{np.linalg.norm(change.angular_momentum):12.3e}{change.kinetic_energy:16.6e}"
            )
        return "\n".join(lines)


class AuditedMPM(ImplicitMPM):
    """``ImplicitMPM`` that keeps a balance of each step; arguments are the same.

    Attributes:
        audit: of the last step; None before the first.
    """

    audit: StepAudit | None = None

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Compile the mass of the grid, too (collective)."""
        super().__init__(*arguments, **options)
        space = self.scheme.histories["v"].function_space
        self._effective = EffectiveProjection(self.bodies, space, self.scheme.lumping)
        points = _compat.interpolation_points(space)
        self._nodal_velocity = fem.Expression(self.scheme.grid_velocity(), points)
        self._nodal_motion = fem.Expression(self.scheme.increment, points)
        self._found: dict[str, Balance] = {}
        self._mass = PETSc.Mat()

    def map_to_grid(self) -> None:
        """See ``ImplicitMPM``; then take the balance of the grid."""
        before = self._points_balance()
        super().map_to_grid()
        self._mass.destroy()  # of a step that failed
        self._mass = self._effective.mass()
        grid = self._grid_balance(self._mass, self.scheme.histories["v"], None)
        self._found = {"points_before": before, "grid_before": grid}

    def convect(self, new: Mapping[MaterialPoints, Mapping[str, Array]]) -> int:
        """See ``ImplicitMPM``; before that, take the balance of the grid."""
        space = self._effective.space
        velocity, motion = fem.Function(space), fem.Function(space)
        velocity.interpolate(self._nodal_velocity)
        motion.interpolate(self._nodal_motion)
        self._found["grid_after"] = self._grid_balance(self._mass, velocity, motion)
        self._mass.destroy()
        return super().convect(new)

    def step(self, dt: float | None = None) -> Step:
        """See ``ImplicitMPM``."""
        step = super().step(dt)
        self.audit = StepAudit(**self._found, points_after=self._points_balance())
        return step

    def _points_balance(self) -> Balance:
        return Balance(
            np.sum([momentum(body) for body in self.bodies], axis=0),
            sum(angular_momentum(body) for body in self.bodies),
            sum(kinetic_energy(body) for body in self.bodies),
        )

    def _grid_balance(
        self, mass: PETSc.Mat, velocity: fem.Function, motion: fem.Function | None
    ) -> Balance:
        space = self._effective.space
        dim, comm = space.mesh.geometry.dim, space.mesh.comm
        n = space.dofmap.index_map.size_local
        v = velocity.x.array.reshape(-1, dim)[:n]
        x = space.tabulate_dof_coordinates()[:n, :dim]
        if motion is not None:
            x = x + motion.x.array.reshape(-1, dim)[:n]
        column, product = mass.createVecs()
        column.array_w[:] = v.ravel()
        mass.mult(column, product)
        p = product.array_r.reshape(-1, dim).copy()
        column.destroy()
        product.destroy()
        return Balance(
            comm.allreduce(p.sum(axis=0)),
            comm.allreduce(moment(x, p)),
            float(comm.allreduce(np.vdot(v, p) / 2)),
        )
