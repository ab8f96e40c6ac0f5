# SPDX-License-Identifier: MIT
"""Gaps between the surfaces of two bodies that move through the same grid, as UFL."""

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

# Gap of points that are over no part of the other surface [m]
_FAR = 1e100


class SurfaceGap:
    """Gap between boundary points of a body and the surface of another one, after a motion.

    At the beginning of a step, the gap g_n of a point is its distance from the plane through the
    nearest point of the other surface, along the normal n there. Both displacements are functions
    on the same grid, so the gap at the end is plain UFL, g_n + (u - u_other) . n, both taken where
    the point is. Where surfaces touch, that is exact but for what they slide in the step: their
    normals stay, and the error is the square of this way by twice the radius of curvature.

    A point that is beside the other surface, by more than the spacing of its points, has no gap.

    Args:
        z: unknown of the first body, with the increment of displacement u [m].
        points: boundary points of this body with initial areas [m^(d-1)].
        other: unknown of the second body, coupled to the first one.
        surface: boundary points of the second body with initial areas [m^(d-1)] and outer normals,
            some times closer than cells. Time loops renew the normals, and need both sets of points
            among those that they carry.

    Attributes:
        points: as above.
        normal: n, of the second body's surface, UFL ``(d,)``.
        way: in the step, of the first body relative to the second one, UFL ``(d,)`` [m].
        gap: after the motion [m], UFL; negative where bodies overlap.
        test: difference of the test functions, UFL ``(d,)``.

    Raises:
        ValueError: for unknowns that are one or are not coupled, sets that are one or empty, a
            surface without normals or with some of no length, and bodies that overlap by more than
            a cell.
    """

    def __init__(
        self, z: Unknown, points: MaterialPoints, other: Unknown, surface: MaterialPoints
    ) -> None:
        """Find the gaps of the points where they are now (collective)."""
        if z is other or points is surface:
            raise ValueError(
                "a contact of a body with itself: give two bodies, each with its own unknown of "
                "coupled_unknowns(..) and its own boundary points"
            )
        if z.U is not other.U:
            raise ValueError(
                "a contact needs one unknown for each body, which are solved for together: make "
                "them by coupled_unknowns(..)"
            )
        for unknown in (z, other):
            unknown.require("u", of="a contact")
        for each in (points, surface):
            require_points(each, "a contact")
        self.points, self._surface = points, surface
        dim = points.mesh.geometry.dim
        normal_there = carried_normal(surface)
        length = np.linalg.norm(surface["normal"], axis=1)
        bad = np.flatnonzero(~((length > 0) & np.isfinite(length)))
        error = None
        if len(bad):
            error = ValueError(
                f"{len(bad)} of {len(surface)} normals of a surface have no length, first at "
                f"{surface.x[bad[0]]}: give outer unit normals by set_normals(points, normals)"
            )
        raise_together(points.mesh.comm, error)
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
        """Smallest gap where the points are now [m]; infinite if there is none (collective)."""
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
        """Gaps and normals at the beginning of a step (collective)."""
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
        """Points of the other surface on all ranks, normals and spacings, near a box (collective).

        What is farther than the size of the box is nearest to none that may touch.
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
        # in the same order on any number of ranks, so that the nearest of two at a distance is, too
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
