# SPDX-License-Identifier: MIT
"""Gaps between the surfaces of two bodies that move through the same grid, in UFL."""

from __future__ import annotations

import functools

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from scipy.spatial import cKDTree

from fenicsmpm.formulations.boundary import carried_normal, require_points
from fenicsmpm.formulations.unknown import Unknown
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.point_field import ComputedField

Array = npt.NDArray[np.float64]

# Gap of points that do not face the other surface [m]
_FAR = 1e100


class SurfaceGap:
    """Gap between boundary points of a body and the surface of another body, after a motion.

    At the start of a step, the gap g_n of a point is its distance from the tangent plane at the
    nearest point of the other surface, along the normal n there. Both displacements are functions
    on the same grid, so the gap at the end of the step is g_n + (u - u_other) . n in UFL, with both
    displacements at the position of the point. For surfaces in contact, the only error is due to
    sliding in the step, because normals are fixed. It is the square of the sliding distance over
    twice the radius of curvature.

    A point that lies beside the other surface by more than the spacing of its points has no gap.

    Args:
        z: Unknown of the first body, with the displacement increment u [m].
        points: Boundary points of the first body with initial areas as weights [m^(d-1)].
        other: Unknown of the second body, coupled to the first one.
        surface: Boundary points of the second body with initial areas as weights [m^(d-1)] and
            outer normals. Their spacing should be several times smaller than the cells. Time loops
            update the normals. Both point sets must be among the ``carried`` points.

    Attributes:
        points: Boundary points of the first body.
        normal: Normal n of the surface of the second body ``(d,)`` [-], UFL.
        way: Displacement of the first body relative to the second one in the step ``(d,)`` [m],
            UFL.
        gap: Gap after the motion [m], UFL, negative where the bodies overlap.
        test: Difference of the test functions ``(d,)``, UFL.

    Raises:
        ValueError: If the unknowns are the same or not coupled, the point sets are the same or
            empty, the surface has no normals or normals of length zero, or the bodies overlap by
            more than a cell.
    """

    def __init__(
        self, z: Unknown, points: MaterialPoints, other: Unknown, surface: MaterialPoints
    ) -> None:
        """Compute the gaps of the points at their current positions. Collective."""
        if z is other or points is surface:
            raise ValueError(
                "a contact of a body with itself: give two bodies, each with its own unknown from "
                "coupled_unknowns(..) and its own boundary points"
            )
        if z.U is not other.U:
            raise ValueError(
                "a contact needs coupled unknowns, one for each body: create them with "
                "coupled_unknowns(..)"
            )
        for unknown in (z, other):
            unknown.require("u", of="a contact")
        for each in (points, surface):
            require_points(each, "a contact")
        self.points, self._surface = points, surface
        dim = points.mesh.geometry.dim
        normal_there = carried_normal(surface)
        self._values: dict[str, Array] = {}
        self._known: tuple[int, int] | None = None
        fields = []
        for name, shape in (("gap", ()), ("normal", (dim,))):
            read = functools.partial(self._read, name)
            field = ComputedField(points, name, shape, self._update, read)
            field.inputs = (normal_there,)
            fields.append(field)
        gap_before, self.normal = fields
        self.way = z.u - other.u
        self.gap = gap_before + ufl.inner(self.way, self.normal)
        self.test = z.test.u - other.test.u
        self._update()
        self._require_no_overlap()

    def least(self) -> float:
        """Return the smallest gap at the current positions [m]. Collective.

        The result is infinite if no point has a gap.
        """
        self._update()
        gap = float(self._values["gap"].min(initial=_FAR))
        gap = self.points.mesh.comm.allreduce(gap, MPI.MIN)
        return gap if gap < _FAR else np.inf

    def __repr__(self) -> str:
        """Numbers of points."""
        n, m = self.points.size_global, self._surface.size_global
        return f"SurfaceGap(of {n} points to a surface of {m} points)"

    def _read(self, name: str) -> Array:
        return self._values[name]

    def _update(self) -> None:
        """Compute gaps and normals at the start of a step. Collective."""
        comm, points = self.points.mesh.comm, self.points
        versions = points.version, self._surface.version
        if not comm.allreduce(versions != self._known, MPI.LOR):
            return
        self._known = versions
        x, normal, spacing = self._surface_near(*points.bounds())
        gap: Array = np.full(len(points), _FAR)
        normals = np.zeros((len(points), x.shape[1]))
        if len(x) and len(points):
            nearest = cKDTree(x).query(points.x)[1]
            away, normals = points.x - x[nearest], normal[nearest]
            height = np.einsum("pi,pi->p", away, normals)
            beside = np.linalg.norm(away - height[:, None] * normals, axis=1)
            gap = np.where(beside <= spacing[nearest], height, _FAR)
        self._values = {"gap": gap, "normal": normals}

    def _surface_near(self, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return positions, normals and spacings of the other surface near a box. Collective.

        The points of all ranks are returned. Points farther away than the size of the box cannot be
        nearest to a point in contact.
        """
        surface, dim = self._surface, self.points.mesh.geometry.dim
        margin = np.linalg.norm(upper - lower)
        near = ((surface.x > lower - margin) & (surface.x < upper + margin)).all(axis=1)
        normal = surface["normal"][near]
        length = np.linalg.norm(normal, axis=1)
        spacing = (length * surface.weight[near]) ** (1 / (dim - 1))
        here = np.column_stack(
            [surface.id[near], surface.x[near], normal / length[:, None], spacing]
        )
        everywhere = np.concatenate(surface.mesh.comm.allgather(here))
        # The order does not depend on the number of ranks, so neither does the choice between two
        # points at the same distance.
        everywhere = everywhere[np.argsort(everywhere[:, 0])]
        x, normal, spacing = np.split(everywhere[:, 1:], [dim, 2 * dim], axis=1)
        return x, normal, spacing[:, 0]

    def _require_no_overlap(self) -> None:
        points, gap = self.points, self._values["gap"]
        h = points.geometry.volume(points.cell) ** (1 / points.mesh.geometry.dim)
        deep = np.flatnonzero(gap < -h)
        error = None
        if len(deep):
            worst = deep[np.argmin(gap[deep])]
            error = ValueError(
                f"bodies overlap by {-gap[worst]:.6g} m at {points.x[worst]}, more than a cell "
                f"({h[worst]:.6g} m): move them apart, or turn normals that point into the body"
            )
        raise_together(points.mesh.comm, error)
