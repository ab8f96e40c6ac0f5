# SPDX-License-Identifier: MIT
"""Matter that flows into a mesh and out of it: sources and sinks, as observers of any loop."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.cells.weight_correction import filled_fractions
from fenicsmpm.formulations.initial_state import set_initial_state
from fenicsmpm.materials.law import finite, positive
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.material_points import Selection
from fenicsmpm.points.of_position import OfPosition, vectors_at
from fenicsmpm.simulation.observer import Observer
from fenicsmpm.simulation.staging import add_points, remove_points
from fenicsmpm.simulation.step import Step

# Volume of points in a cell, by its own, at which a source does not add to them
_OVERFULL = 1.5
# Layers are complete a little early, so that round-off of times does not delay them by a step
_EARLY = 1e-9


class Source(Observer):
    """Adds points behind an inlet as fast as matter flows in through it.

    Each point of the inlet sends a row of points into the mesh, at a distance of ``spacing``. One
    is added when the one before has gone that far, in the middle of the gap, so that after the
    time t the mass is density * area * speed * t of each inlet point, to within one of its points.
    The velocity is to be prescribed at the nodes of the inlet, too.

    Args:
        body: to which points are added; one of the bodies of the simulation.
        inlet: boundary points with areas as weights [m^(d-1)] and the field "normal" that points
            against the flow, such as those of ``points.on_curve`` and ``points.on_facets``.
        density: of what flows in [kg/m^d].
        velocity: of all points ``(d,)`` [m/s], or a function as in dolfinx, from positions
            ``(3, n)`` [m] to velocities ``(d, n)``.
        spacing: of points along the flow [m].

    Attributes:
        mass: that has come in so far [kg].
        count: of points that have come in.

    Raises:
        ValueError: on all ranks, for an inlet without normals or points; a velocity that is not
            finite, has another shape, or points out of the mesh somewhere; a density or spacing
            that is not positive and finite. In the loop, if
            points would come into cells that are full already.
    """

    def __init__(
        self,
        body: MaterialPoints,
        inlet: MaterialPoints,
        density: float,
        velocity: npt.ArrayLike | OfPosition,
        spacing: float,
    ) -> None:
        """Check (collective)."""
        if not 0 < spacing < np.inf:
            raise ValueError(f"points of a source need a positive distance, not {spacing} m")
        if inlet.mesh is not body.mesh or "normal" not in inlet or inlet.size_global == 0:
            raise ValueError(
                "an inlet are boundary points on the body's mesh with the field 'normal', as "
                "points.on_curve and points.on_facets make them"
            )
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
                f"matter flows out of a source with {-self._speed[worst]:g} m/s at "
                f"{inlet.x[worst]}: its velocity must point against the normals"
            )
        raise_together(inlet.mesh.comm, error)
        self._time, self.mass, self.count = 0.0, 0.0, 0

    def _velocities(self, x: npt.NDArray[np.float64]) -> tuple[Exception | None, Any]:
        if callable(self._velocity):
            return vectors_at(self._velocity, x)
        return None, np.tile(np.asarray(self._velocity), (len(x), 1))

    def begin(self, sim: Any) -> None:
        """Note the time at which the step begins."""
        self._time = sim.time

    def done(self, sim: Any, step: Step) -> None:
        """Add what has come in (collective)."""
        way = self._speed * sim.time
        before = np.floor(self._speed * self._time / self._spacing + _EARLY).astype(np.int64)
        number = np.floor(way / self._spacing + _EARLY).astype(np.int64)
        rows = np.repeat(np.arange(len(way)), number - before)
        # the k-th point is complete when the way is k spacings
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
        """Raise ValueError if points come into cells that are full (collective)."""
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
    """Takes points away where they leave a region, after each step.

    Args:
        body: one of the bodies, or of the carried points, of the simulation.
        where: as for ``MaterialPoints.remove``: a marker from positions ``(3, n)`` [m] to a mask.

    Attributes:
        mass: that has gone out so far [kg]; of carried points, zero.
        count: of points that have gone out.
    """

    def __init__(self, body: MaterialPoints, where: Selection) -> None:
        """Nothing has gone yet."""
        self._body, self._where = body, where
        self.mass, self.count = 0.0, 0

    def done(self, sim: Any, step: Step) -> None:
        """Take points away (collective)."""
        gone = remove_points(sim, self._body, self._where)
        self.mass += gone.mass
        self.count += gone.count
