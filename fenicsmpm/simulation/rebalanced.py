# SPDX-License-Identifier: MIT
"""Rebalanced: a simulation that moves to a new distribution of cells when its points gather."""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, MeshTags

from fenicsmpm._garbage import collect_garbage
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.location import locator
from fenicsmpm.points.migration import send_home
from fenicsmpm.simulation.redistribution import Redistribution, cells_on, tags_on
from fenicsmpm.simulation.state import (
    Arrays,
    Simulation,
    chosen_otherwise,
    differences,
    fields_of,
    point_sets,
    put,
    take,
)
from fenicsmpm.simulation.step import Step

logger = logging.getLogger(__name__)

# A new mesh must reduce the largest number of points on a rank by at least this fraction.
_WORTH_IT = 0.9
# Largest number of steps between one useless question and the next: it costs less than a few steps.
_LONGEST_WAIT = 100


def imbalance(sim: Simulation) -> float:
    """Return the largest number of points on a rank over the mean of all ranks. Collective.

    Args:
        sim: Simulation whose bodies and carried points count.

    Returns:
        A number from 1 to the number of ranks.
    """
    points = point_sets(sim)
    here, mesh = sum(len(p) for p in points), points[0].mesh
    most = mesh.comm.allreduce(here, MPI.MAX)
    total = sum(p.size_global for p in points)
    return most * mesh.comm.size / total if total else 1.0


class Rebalanced:
    """A simulation that is redistributed when its points have gathered on few ranks.

    A mesh cannot be redistributed in place. A new one is therefore made of the same cells,
    distributed by the points in them. ``build`` builds the simulation on it as at the start, and
    the new simulation gets the state of the old one, as from a checkpoint. It continues as if
    nothing had happened, to round-off, or to the tolerance of Newton's method if linear systems are
    solved iteratively. Grid functions have their values again after the next step. On one rank
    nothing is ever done.

    Args:
        build: Function of a mesh, and of tags on it if there are any, that makes everything that
            depends on the mesh and returns the simulation. Observers that outlast a mesh, such as
            an ``io.History``, must be made outside of it.
        mesh: Initial background mesh.
        tags: Tags of entities of the mesh, such as those from Gmsh; they move along.
        most: Points of the fullest rank over the mean from which on ``run`` redistributes them, if
            that reduces this rank's points by a tenth. If it does not, for example because a few
            cells hold all points, ``run`` tries again after 1, 2, 4, ... steps, 100 at most.

    Raises:
        TypeError: On all ranks, if ``build`` does not return a simulation.
        ValueError: On all ranks, if ``most`` is not above 1, or the simulation is on another mesh.

    Attributes:
        sim: The current simulation. Its ``seconds`` continue those of the old one, with an entry
            "rebalance".
        mesh: The current mesh.
        tags: The tags on this mesh.
    """

    def __init__(
        self,
        build: Callable[..., Simulation],
        mesh: Mesh,
        *tags: MeshTags,
        most: float = 1.5,
    ) -> None:
        """Build the simulation. Collective."""
        if not most > 1:
            raise ValueError(
                f"most must be above 1, as it is relative to the mean, such as 1.5, not {most}"
            )
        self._build, self._most = build, most
        self._wait = self._left = self._moves = 0
        self.mesh, self.tags = mesh, tags
        self.sim = self._built(mesh, tags)

    def run(self, until: float, **options: Any) -> Iterator[Step]:
        """Do steps until a time, on a new mesh whenever points have gathered. Collective.

        Args:
            until: End in s.
            **options: Options of ``run`` of the time loop. Options that depend on points must use
                those of the current ``sim``.

        Yields:
            Each step of the loop; ``sim`` is the simulation that has done it.

        Raises:
            Exception: As for the loop and for ``rebalance``.
        """
        steps: Iterator[Step] | None = None
        moves = self._moves
        while True:
            if self._moves != moves:  # by rebalance() since the last step
                steps, moves = None, self._moves
                gc.collect()
                collect_garbage(self.mesh.comm)
            # a new mesh is useless after the last step
            plan = self._better() if self.sim.time < until else None
            if plan is not None:
                steps = None  # it would keep the old simulation alive
                self._go_to(plan)
                moves = self._moves
                del plan  # it refers to the old mesh
            if steps is None:
                steps = self.sim.run(until, **options)
            step = next(steps, None)
            if step is None:
                return
            yield step

    def rebalance(self) -> None:
        """Redistribute the points, whatever their present distribution. Collective.

        Raises:
            TypeError, ValueError: On all ranks, if ``build`` makes something else than before: on
                another mesh, with another time scheme, other point sets or fields. The simulation
                does not change then.
        """
        if self.mesh.comm.size > 1:
            self._go_to(self._plan())

    def _better(self) -> Redistribution | None:
        """Return a distribution that is worth a new mesh, if points have gathered. Collective."""
        if self._left > 0:
            self._left -= 1
            return None
        now = imbalance(self.sim)
        if not now > self._most:
            return None
        plan = self._plan()
        if plan.points.max() / plan.points.mean() <= _WORTH_IT * now:
            self._wait = 0
            return plan
        self._left = self._wait = min(max(1, 2 * self._wait), _LONGEST_WAIT)
        return None

    def _plan(self) -> Redistribution:
        """Return the new distribution of the cells. Collective."""
        count = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        points = [np.bincount(p.cell, minlength=count) for p in point_sets(self.sim)]
        return Redistribution(self.mesh, np.sum(points, axis=0))

    def _go_to(self, plan: Redistribution) -> None:
        """Make the new mesh and the simulation on it, in the state of the old one. Collective."""
        start, old, most = time.perf_counter(), self.sim, imbalance(self.sim)
        state, mesh = take(old), plan.make()
        tags = tuple(tags_on(t, self.mesh, mesh) for t in self.tags)
        sim = self._built(mesh, tags)
        _check(old, sim)
        cells = cells_on(self.mesh, mesh)
        for there, points in zip(state.sets, point_sets(sim), strict=True):
            there.arrays = _at_home(points, there.arrays, cells)
        put(state, sim)
        sets = dict(zip(point_sets(old), point_sets(sim), strict=True))
        sim.exits = old.exits  # with the points that it holds back
        sim.exits.held = {sets[points]: ids for points, ids in sim.exits.held.items()}
        self.sim, self.mesh, self.tags = sim, mesh, tags
        self._moves += 1
        for name, seconds in old.seconds.items():
            sim.seconds.add(name, seconds)
        # at the same moment on all ranks, since the rest of the old simulation has communicators
        del old, state, sets
        gc.collect()
        collect_garbage(mesh.comm)
        sim.seconds.add("rebalance", time.perf_counter() - start)
        logger.info(
            "step %d: the fullest rank had %.2f times the mean of points, now it has %.2f",
            *(sim.number, most, imbalance(sim)),
        )

    def _built(self, mesh: Mesh, tags: tuple[MeshTags, ...]) -> Simulation:
        """Return what the user's function makes, if it is a simulation on this mesh. Collective."""
        sim = self._build(mesh, *tags)
        error: Exception | None = None
        if not isinstance(sim, Simulation):
            error = TypeError(
                f"build must return an ImplicitMPM or ExplicitMPM, not {type(sim).__name__}"
            )
        elif any(points.mesh is not mesh for points in point_sets(sim)):
            error = ValueError(
                "build must make points, unknowns and conditions on the mesh that it gets, but the "
                "simulation is on another mesh"
            )
        raise_together(mesh.comm, error)
        return sim


def _check(old: Simulation, new: Simulation) -> None:
    """Raise ValueError if a simulation cannot take the state of another one. Collective."""
    described = [
        (sim.method, [fields_of(points) for points in point_sets(sim)]) for sim in (old, new)
    ]
    found = differences(*described)
    error = ValueError(
        f"the state does not fit the simulation that build has made anew: {'; '.join(found)}. "
        "Let build make the same on each mesh, with all fields"
    )
    raise_together(new.bodies[0].mesh.comm, error if found else None)
    for name, was, now in chosen_otherwise(old.parameters, new.parameters):
        logger.warning("the simulation had the %s %s; build has made it %s", name, was, now)


def _at_home(points: MaterialPoints, arrays: Arrays, cells: npt.NDArray[np.int64]) -> Arrays:
    """Send arrays of points of the old mesh to the ranks that own their new cells. Collective.

    Args:
        points: Points on the new mesh.
        arrays: Arrays with the cells of the old mesh.
        cells: Cells of the new mesh for those of the old one.
    """
    away = {**arrays, "cell": np.full_like(arrays["cell"], -1)}
    place = locator(points.mesh)
    return dict(send_home(points.mesh.comm, place, cells[arrays["cell"]], away))
