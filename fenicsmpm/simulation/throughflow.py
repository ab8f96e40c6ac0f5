# SPDX-License-Identifier: MIT
"""Inflow and outflow of material: sources and sinks, as observers of any loop."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm._numbers import finite, number, positive
from fenicsmpm.cells.weight_correction import filled_fractions
from fenicsmpm.formulations.boundary import require_normals
from fenicsmpm.formulations.initial_state import set_initial_state
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.material_points import Selection
from fenicsmpm.points.of_position import OfPosition, vectors_at
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.staging import add_points, remove_points
from fenicsmpm.simulation.step import Step

# Filled fraction of a cell from which on a source adds no points
_OVERFULL = 1.5
# Layers are complete slightly early, so that round-off of times does not delay them by a step.
_EARLY = 1e-9


class Source(Observer):
    """Inlet that adds points as fast as material flows in.

    Each inlet point sends a row of points into the mesh, at a distance of ``spacing``. A point is
    added when the previous one has moved by this distance, in the middle of the gap. After the
    time t, the added mass is density * area * speed * t for each inlet point, up to one point. The
    velocity must be prescribed at the nodes of the inlet, too.

    Args:
        body: Body of the simulation to which points are added.
        inlet: Boundary points with areas in m^(d-1) as weights and a field "normal" that points
            against the flow, such as those of ``points.on_curve`` and ``points.on_facets``.
        density: Density of the inflow in kg/m^d.
        velocity: Velocity of all points in m/s, ``(d,)``, or a function as in dolfinx, from
            positions ``(3, n)`` in m to velocities ``(d, n)``.
        spacing: Spacing of points along the flow in m.

    Attributes:
        mass: Mass that has come in so far in kg; it goes on in a restart and in ``Rebalanced``.
        count: Number of points that have come in, likewise.

    Raises:
        ValueError: On all ranks, for an inlet without points, or with normals that are missing,
            zero or not finite; a velocity that is not
            finite, has another shape, or points out of the mesh somewhere; a density or spacing
            that is not positive and finite. In the loop, if points would be added to cells that
            are already full.
    """

    totals = ("mass", "count")

    def __init__(
        self,
        body: MaterialPoints,
        inlet: MaterialPoints,
        density: float,
        velocity: npt.ArrayLike | OfPosition,
        spacing: float,
    ) -> None:
        """Check the inlet and the velocity. Collective."""
        spacing = number(spacing, "spacing", "the spacing of points of a source", "m")
        if not 0 < spacing < np.inf:
            raise ValueError(f"the spacing of points of a source must be positive, not {spacing} m")
        if inlet.mesh is not body.mesh or "normal" not in inlet or inlet.size_global == 0:
            raise ValueError(
                "an inlet needs boundary points on the body's mesh with the field 'normal', such "
                "as those of points.on_curve and points.on_facets"
            )
        require_normals(inlet)
        self._body, self._inlet, self._spacing = body, inlet, float(spacing)
        self._density = positive(density, "density", "density of what flows in", "kg/m^d")
        dim = inlet.mesh.geometry.dim
        if not callable(velocity):
            velocity = finite(velocity, "velocities of a source")
            if velocity.shape != (dim,):
                raise ValueError(
                    f"a velocity of all points needs the shape ({dim},), not {velocity.shape}"
                )
        self._velocity = velocity
        error, v = self._velocities(inlet.x)
        raise_together(inlet.mesh.comm, error)
        self._speed = -np.einsum("pk,pk->p", v, inlet["normal"])
        if not np.isfinite(self._speed).all():
            error = ValueError("velocities of a source must be finite")
        elif len(v) and self._speed.min() < 0:
            worst = int(np.argmin(self._speed))
            error = ValueError(
                f"the velocity of a source must point against the normals of the inlet, but flows "
                f"out with {-self._speed[worst]:g} m/s at {inlet.x[worst]}"
            )
        raise_together(inlet.mesh.comm, error)
        self._time, self.mass, self.count = 0.0, 0.0, 0

    def _velocities(self, x: npt.NDArray[np.float64]) -> tuple[Exception | None, Any]:
        if callable(self._velocity):
            return vectors_at(self._velocity, x)
        return None, np.tile(np.asarray(self._velocity), (len(x), 1))

    def begin(self, sim: Any) -> None:
        """Store the time at which the step begins.

        Args:
            sim: The simulation.
        """
        self._time = sim.time

    def done(self, sim: Any, step: Step) -> None:
        """Add the points that have come in. Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        way = self._speed * sim.time
        before = np.floor(self._speed * self._time / self._spacing + _EARLY).astype(np.int64)
        number = np.floor(way / self._spacing + _EARLY).astype(np.int64)
        rows = np.repeat(np.arange(len(way)), number - before)
        # the k-th point is complete when the path is k spacings long
        first = np.cumsum(number - before) - (number - before)
        k = before[rows] + 1 + np.arange(len(rows)) - first[rows]
        comm = self._inlet.mesh.comm
        if comm.allreduce(len(rows)) == 0:
            return
        inlet = self._inlet
        ahead = way[rows] - (k - 0.5) * self._spacing
        most = comm.allreduce(int(number.max(initial=0)), op=MPI.MAX) + 1
        new = MaterialPoints(
            inlet.mesh,
            inlet.x[rows] - ahead[:, None] * inlet["normal"][rows],
            inlet.weight[rows] * self._spacing,
            number=inlet.id[rows] * most + k,
        )
        self._check_room(new)
        if "grad_v" in self._body:
            set_initial_state(new, self._density, self._velocity)
        else:
            set_initial_state(new, self._density)
            error, v = self._velocities(new.x)
            raise_together(comm, error)
            new["v"][:] = v
        came = add_points(sim, self._body, new)
        self.mass += came.mass
        self.count += came.count

    def _check_room(self, new: MaterialPoints) -> None:
        """Raise ValueError if points are added to cells that are full. Collective."""
        filled = filled_fractions(new)
        bad = np.flatnonzero((filled > 0) & (filled + filled_fractions(self._body) > _OVERFULL))
        error = None
        if len(bad):
            here = new.x[new.cell == bad[0]]
            error = ValueError(
                "a source adds points where there is matter already"
                + (f", such as at {here[0]}" if len(here) else "")
                + ": it flows in faster than away from the inlet"
            )
        raise_together(new.mesh.comm, error)


class Sink(Observer):
    """Outlet that removes points from a region after each step.

    Args:
        body: One of the bodies, or of the carried points, of the simulation.
        where: Region as for ``MaterialPoints.remove``, such as a marker from positions
            ``(3, n)`` in m to a mask.

    Attributes:
        mass: Mass that has gone out so far in kg, zero for carried points; it goes on in a restart
            and in ``Rebalanced``.
        count: Number of points that have gone out, likewise.

    Raises:
        ValueError: If the region is no marker, mask or indices.
    """

    totals = ("mass", "count")

    def __init__(self, body: MaterialPoints, where: Selection) -> None:
        """Create the observer; nothing has gone out yet."""
        if not callable(where) and np.ndim(where) != 1:
            raise ValueError(
                "the region of a sink must be a marker, such as lambda x: x[0] > 2.0, a mask or "
                f"indices, not {where!r}"
            )
        self._body, self._where = body, where
        self.mass, self.count = 0.0, 0

    def done(self, sim: Any, step: Step) -> None:
        """Remove points. Collective.

        Args:
            sim: The simulation.
            step: The finished step.
        """
        gone = remove_points(sim, self._body, self._where)
        self.mass += gone.mass
        self.count += gone.count
