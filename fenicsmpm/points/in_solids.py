# SPDX-License-Identifier: MIT
"""Material points in solids and on their boundaries.

All functions are collective. Each rank has the whole `Solid` and searches a part of the lattice.
Ids do not depend on the number of ranks.
"""

import itertools
import logging

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm.points.geometry import cell_geometry
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.seed_blocks import mesh_bounds
from fenicsmpm.shapes import Solid, fractions
from fenicsmpm.shapes.tree import all_near, all_windings

logger = logging.getLogger(__name__)

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Number of lattice points that are tested at a time.
_MANY = 1 << 16
# A final correction of volumes by more than this fraction is logged as a warning.
_COARSE = 0.05


def in_solid(mesh: Mesh, solid: Solid, spacing: float | Array, tag: int = 0) -> MaterialPoints:
    """Seed points of a regular lattice in a solid, such that their volumes add up to its volume.

    The lattice is that of `lattice`. Each lattice point stands for the box of one spacing around
    it. A box that the boundary cuts counts with the fraction that lies inside
    (`fenicsmpm.shapes.fractions`). If its centre is inside, its point gets this volume; if the
    centre is outside, the points of the neighbouring boxes share it. The fractions have a small
    error, below 1 % of the volume with 8 points across the solid. One factor for all points near
    the boundary removes it: the total is the volume of the solid to round-off. Points farther
    inside have the volume spacing^d.

    Args:
        mesh: Background mesh, which contains the solid.
        solid: Solid from `fenicsmpm.shapes` or `read_solid`.
        spacing: Distance of neighbours in m, one number or one for each direction: the size of a
            cell divided by the number of points along its side.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        ValueError: If the spacing is not positive, the solid has another dimension than the mesh,
            or no lattice point is inside.
        PointsOutsideError: If some point is outside of the mesh.
    """
    _check_dimension(mesh, solid)
    step = np.asarray(spacing, dtype=np.float64)
    if step.shape not in ((), (solid.dim,)) or not np.all((step > 0) & (step < np.inf)):
        raise ValueError(f"the spacing of points in a solid must be positive, not {spacing}")
    lattice = _Lattice(mesh, solid, np.array(np.broadcast_to(step, solid.dim)))
    kept, number = lattice.inside(mesh.comm)
    if mesh.comm.allreduce(len(kept)) == 0:
        raise ValueError(
            f"no point of a lattice with spacing {spacing} lies in {solid!r}: "
            "make the spacing smaller"
        )
    weight = np.full(len(kept), np.prod(lattice.step))
    near = lattice.near(kept)
    weight[near] *= lattice.shares(kept[near])
    clear, cut = (mesh.comm.allreduce(float(weight[part].sum())) for part in (~near, near))
    if cut > 0.0:
        factor = (solid.volume - clear) / cut
        if abs(factor - 1.0) > _COARSE and mesh.comm.rank == 0:
            logger.warning(
                "a spacing of %s is coarse for %r: volumes near the boundary were "
                "multiplied by %.3f",
                spacing,
                solid,
                factor,
            )
        weight[near] *= factor
    points = MaterialPoints(mesh, lattice.position(kept), weight, tag=tag, number=number)
    points.sort()
    return points


def on_surface(mesh: Mesh, solid: Solid, spacing: float, tag: int = 0) -> MaterialPoints:
    """Seed points on the boundary of a solid, weighted by area (in 2D by length).

    Facets are cut into pieces: segments into equal parts, triangles into halves through their
    longest side until no side is longer than the spacing. Points are the centroids of the pieces,
    and those of a facet share its area. Their area vectors add up to zero to round-off. Each facet
    has at least one point, so a surface of triangles much smaller than the spacing should be
    coarsened first.

    Args:
        mesh: Background mesh.
        solid: Solid from `fenicsmpm.shapes` or `read_solid`.
        spacing: Largest length of a side of a piece in m.
        tag: Tag of the points.

    Returns:
        Points with the outer unit normal as the field "normal", shape (d,).

    Raises:
        ValueError: If the spacing is not positive, or the solid has another dimension than the
            mesh.
        PointsOutsideError: If some point is outside of the mesh.
    """
    _check_dimension(mesh, solid)
    if not 0.0 < spacing < np.inf:
        raise ValueError(f"the spacing of points on a surface must be positive, not {spacing}")
    comm = mesh.comm
    first, last = (len(solid.facets) * r // comm.size for r in (comm.rank, comm.rank + 1))
    cut = _cut_segments if solid.dim == 2 else _cut_triangles
    pieces, facet = cut(solid.facets[first:last], spacing * (1.0 + 1e-12))
    count = np.bincount(facet, minlength=last - first)
    weight = (solid.areas[first:last] / count)[facet]
    normal = solid.normals[first:last][facet]
    # Number the points in the order of the facets, of which each rank has a consecutive part.
    return MaterialPoints(mesh, pieces.mean(axis=1), weight, tag=tag, fields={"normal": normal})


def _check_dimension(mesh: Mesh, solid: Solid) -> None:
    if not isinstance(solid, Solid):
        raise TypeError(
            "a solid is needed, as from read_solid, boundary_of and the functions of shapes, not "
            f"{solid!r}"
        )
    if solid.dim != mesh.geometry.dim:
        raise ValueError(
            f"a solid of {solid.dim} dimensions does not fit a mesh of {mesh.geometry.dim}: "
            f"{solid!r}"
        )


def _cut_segments(facets: Array, longest: float) -> tuple[Array, Indices]:
    """Return equal pieces (m, 2, 2) of segments, and the segment of each piece."""
    start, way = facets[:, 0], facets[:, 1] - facets[:, 0]
    count = np.maximum(np.ceil(np.linalg.norm(way, axis=1) / longest).astype(np.int64), 1)
    facet = np.repeat(np.arange(len(facets)), count)
    place = np.arange(len(facet)) - np.repeat(np.cumsum(count) - count, count)
    ends = (place[:, None] + np.arange(2)) / count[facet][:, None]
    return start[facet][:, None] + ends[:, :, None] * way[facet][:, None], facet


def _cut_triangles(facets: Array, longest: float) -> tuple[Array, Indices]:
    """Return equal pieces (m, 3, 3) of triangles, and the triangle of each piece."""
    pieces, facet = facets, np.arange(len(facets))
    while True:
        sides = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=2)
        long = sides.max(axis=1, initial=0.0) > longest
        if not long.any():
            order = np.argsort(facet, kind="stable")
            return pieces[order], facet[order]
        # the longest side runs from vertex 0 to vertex 1
        turn = (sides[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.swapaxes(np.take_along_axis(pieces[long], turn[:, :, None], axis=1), 0, 1)
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        pieces = np.concatenate([pieces[~long], *halves])
        facet = np.concatenate([facet[~long], facet[long], facet[long]])


class _Lattice:
    """Lattice points around a solid by their indices, and the fractions of their boxes inside."""

    def __init__(self, mesh: Mesh, solid: Solid, step: Array):
        """Set up the lattice. Collective."""
        self.solid, self.step = solid, step
        self._origin = mesh_bounds(mesh, cell_geometry(mesh))[0]
        lower, upper = ((b - self._origin) / step - 0.5 for b in solid.bounds())
        # two more boxes on each side, as neighbours need numbers, too
        self._first = np.floor(lower).astype(np.int64) - 2
        self._counts = tuple(np.ceil(upper).astype(np.int64) + 3 - self._first)
        around = itertools.product((-1, 0, 1), repeat=solid.dim)
        self._around = np.array(list(around), dtype=np.int64)

    def position(self, index: Indices) -> Array:
        """Return positions (n, d) of the points with indices (n, d)."""
        return self._origin + (index + 0.5) * self.step

    def _index(self, number: Indices) -> Indices:
        return self._first + np.stack(np.unravel_index(number, self._counts), axis=-1)

    def _number(self, index: Indices) -> Indices:
        shifted = np.moveaxis(index - self._first, -1, 0)
        return np.asarray(np.ravel_multi_index(tuple(shifted), self._counts), dtype=np.int64)

    def _is_inside(self, index: Indices) -> npt.NDArray[np.bool_]:
        inside: npt.NDArray[np.bool_] = all_windings(self.solid.tree, self.position(index)) > 0
        return inside

    def inside(self, comm: MPI.Intracomm) -> tuple[Indices, Indices]:
        """Return indices (n, d) and numbers (n,) of this rank's part of the points inside."""
        total = int(np.prod(self._counts))
        begin, end = (total * r // comm.size for r in (comm.rank, comm.rank + 1))
        kept: list[Indices] = [np.zeros(0, dtype=np.int64)]
        for start in range(begin, end, _MANY):
            some = np.arange(start, min(start + _MANY, end), dtype=np.int64)
            kept.append(some[self._is_inside(self._index(some))])
        number: Indices = np.concatenate(kept)
        return self._index(number), number

    def near(self, index: Indices) -> npt.NDArray[np.bool_]:
        """Return which points are in, or next to, a box that may not lie inside completely."""
        radius = float(np.linalg.norm(self.step)) * (1.0 + 1e-9)
        near: npt.NDArray[np.bool_] = all_near(self.solid.tree, self.position(index), radius)
        return near

    def shares(self, index: Indices) -> Array:
        """Return the volumes of points inside in boxes: of their own box and shared neighbours."""
        if not len(index):
            return np.zeros(0)
        around = self._number(index[:, None] + self._around)
        number, place = np.unique(around, return_inverse=True)
        boxes = self._index(number)
        outside = ~self._is_inside(boxes)
        part = fractions(self.solid, self.position(boxes), self.step)
        given = np.zeros(len(number))
        cut = np.flatnonzero(outside & (part > 0.0))
        if len(cut):
            beside, at = np.unique(
                self._number(boxes[cut][:, None] + self._around), return_inverse=True
            )
            inside = self._is_inside(self._index(beside))[at.reshape(len(cut), -1)]
            given[cut] = part[cut] / inside.sum(axis=1)
        own = np.maximum(part[np.searchsorted(number, self._number(index))], 0.25 ** index.shape[1])
        result: Array = own + given[place.reshape(around.shape)].sum(axis=1)
        return result
