# SPDX-License-Identifier: MIT
"""Rebalanced: a simulation that is built anew on other ranks' cells when its points gather."""

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

# What a new mesh must promise at least: so much less than the most that a rank has now
_WORTH_IT = 0.9
# Steps from one question in vain to the next one at most: it costs less than a few of them
_LONGEST_WAIT = 100


def imbalance(sim: Simulation) -> float:
    """Points of the rank that has most, over the mean of all ranks (collective).

    Args:
        sim: whose bodies and carried points count.

    Returns:
        From 1 to the number of ranks.
    """
    points = point_sets(sim)
    here, mesh = sum(len(p) for p in points), points[0].mesh
    most = mesh.comm.allreduce(here, MPI.MAX)
    total = sum(p.size_global for p in points)
    return most * mesh.comm.size / total if total else 1.0


class Rebalanced:
    """A simulation that goes on elsewhere when its points have gathered on few ranks.

    A mesh cannot be spread anew in place. So a new one is made of the same cells, shared out by
    the points in them; ``build`` builds the simulation on it as at the start, and gets the state of
    the old one: what a checkpoint has. It goes on as if nothing had happened, to round-off, or
    where systems are solved by iterations, to the tolerance of Newton's method. Grid functions
    have their values again after the next step. On one rank nothing is ever done.

    Args:
        build: function of a mesh, and of tags on it if there are any, that makes all that hangs on
            the mesh and returns the simulation. Observers that outlast a mesh, such as an
            ``io.History``, are made outside of it.
        mesh: background mesh at first.
        tags: of entities of the mesh, such as those that Gmsh brings; they go along.
        most: points of the rank that has most over the mean from which on ``run`` spreads them
            anew, if that takes a tenth off that rank. If not, as where a few cells hold all
            points, it asks again after 1, 2, 4, .. steps, 100 at most.

    Raises:
        TypeError: on all ranks, for ``build`` that does not return a simulation.
        ValueError: on all ranks, for ``most`` that is not above 1, or a simulation on another mesh.

    Attributes:
        sim: the simulation now; its ``seconds`` go on, too, with those of "rebalance".
        mesh: its mesh.
        tags: on that.
    """

    def __init__(
        self,
        build: Callable[..., Simulation],
        mesh: Mesh,
        *tags: MeshTags,
        most: float = 1.5,
    ) -> None:
        """Build the simulation (collective)."""
        if not most > 1:
            raise ValueError(
                f"most = {most}: it is over the mean, so it must be above 1, such as 1.5"
            )
        self._build, self._most = build, most
        self._wait = self._left = 0
        self.mesh, self.tags = mesh, tags
        self.sim = self._built(mesh, tags)

    def run(self, until: float, **options: Any) -> Iterator[Step]:
        """Steps until a time, on a new mesh whenever points have gathered (collective).

        Args:
            until: end [s].
            options: of the ``run`` of the loop. Where they need points, they take those of ``sim``
                at that time.

        Yields:
            Each step as the loop does; ``sim`` is the simulation that has done it.

        Raises:
            Exception: as the loop does, and ``rebalance``.
        """
        steps: Iterator[Step] | None = None
        while True:
            # a new mesh is of no use after the last step
            plan = self._better() if self.sim.time < until else None
            if plan is not None:
                steps = None  # which would keep the old simulation
                self._go_to(plan)
                del plan  # which has the old mesh
            if steps is None:
                steps = self.sim.run(until, **options)
            step = next(steps, None)
            if step is None:
                return
            yield step

    def rebalance(self) -> None:
        """Spread the points anew, however they are now (collective).

        Raises:
            TypeError, ValueError: on all ranks, if ``build`` makes something else than before: on
                another mesh, with another time scheme, other point sets or fields. The simulation
                is as it was.
        """
        if self.mesh.comm.size > 1:
            self._go_to(self._plan())

    def _better(self) -> Redistribution | None:
        """A distribution that is worth a new mesh, if points have gathered (collective)."""
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
        """Where the cells are to go (collective)."""
        count = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        points = [np.bincount(p.cell, minlength=count) for p in point_sets(self.sim)]
        return Redistribution(self.mesh, np.sum(points, axis=0))

    def _go_to(self, plan: Redistribution) -> None:
        """Make the new mesh and the simulation on it, in the state of the old one (collective)."""
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
        for name, seconds in old.seconds.items():
            sim.seconds.add(name, seconds)
        # at the same moment on all ranks: what is left of the old one has communicators
        del old, state, sets
        gc.collect()
        collect_garbage(mesh.comm)
        sim.seconds.add("rebalance", time.perf_counter() - start)
        logger.info(
            "step %d: the fullest rank had %.2f times the mean of points, now it has %.2f",
            *(sim.number, most, imbalance(sim)),
        )

    def _built(self, mesh: Mesh, tags: tuple[MeshTags, ...]) -> Simulation:
        """What the user's function makes, if it is a simulation on this mesh (collective)."""
        sim = self._build(mesh, *tags)
        error: Exception | None = None
        if not isinstance(sim, Simulation):
            error = TypeError(
                f"build must return an ImplicitMPM or ExplicitMPM, not {type(sim).__name__}"
            )
        elif any(points.mesh is not mesh for points in point_sets(sim)):
            error = ValueError(
                "build has made a simulation on another mesh: it gets the mesh, and makes points, "
                "unknowns and conditions on that"
            )
        raise_together(mesh.comm, error)
        return sim


def _check(old: Simulation, new: Simulation) -> None:
    """Raise ValueError if a simulation cannot take the state of another one (collective)."""
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
    """Arrays of points of the old mesh, sent to the ranks that own their cells (collective).

    Args:
        points: on the new mesh.
        arrays: with the cells of the old one.
        cells: where they are on the new one.
    """
    away = {**arrays, "cell": np.full_like(arrays["cell"], -1)}
    place = locator(points.mesh)
    return dict(send_home(points.mesh.comm, place, cells[arrays["cell"]], away))
