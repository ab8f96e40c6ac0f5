# SPDX-License-Identifier: MIT
"""Seeding of material points in cells, regions, other meshes and on boundaries.

Functions with a predicate `inside` call it as dolfinx calls its markers: with positions in m of
shape (3, n), so that x[0] holds the first coordinates. It must return a mask of shape (n,).
All functions are collective. They raise errors on all ranks, also if a predicate fails on one rank.

Ids do not depend on the number of ranks, with two exceptions: points on facets between cells, and
points in meshes that dolfinx made from another mesh, whose cell numbers depend on the ranks.
"""

import itertools
from collections.abc import Iterator
from functools import partial

from mpi4py import MPI

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, locate_entities_boundary

from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.geometry import CellGeometry, cell_geometry
from fenicsmpm.points.location import locator
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.of_position import CaughtMarker, OfPosition, mask_at
from fenicsmpm.points.seed_blocks import (
    Array,
    Cells,
    check_any,
    lattice_indices,
    lattice_numbers,
    make_points,
    mesh_bounds,
    own_bounds,
    owned_of,
    split,
)

# Lattice points closer to a facet than this fraction of a cell may be claimed by several ranks.
_NEAR_FACET = 1e-9
# Number of cells for which random numbers are drawn at a time.
_BLOCK = 1 << 14


def quadrature(
    mesh: Mesh,
    degree: int,
    cells: npt.ArrayLike | None = None,
    inside: OfPosition | None = None,
    tag: int = 0,
) -> MaterialPoints:
    """Seed points at the quadrature points that dolfinx uses for integrals of this degree.

    Args:
        mesh: Background mesh.
        degree: Polynomial degree that the rule integrates exactly on affine cells.
        cells: Local cells to fill; cells that other ranks own are ignored here. None for all.
        inside: Predicate; only points where it is true are kept.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        ValueError: If there are no points at all, or if the rule has weights that are not positive
            (as on tetrahedra the rules of degree 3, 7 and 8).
    """
    if degree < 0:
        raise ValueError(f"a quadrature degree must be at least 0, not {degree}")
    geometry = cell_geometry(mesh)
    points, weights = basix.make_quadrature(geometry.cell, degree)
    if weights.min() <= 0.0:
        raise ValueError(
            f"the rule of degree {degree} on a {geometry.cell.name} has the weight "
            f"{weights.min():.3g}, but points need positive ones: take another degree"
        )
    filled = owned_of(mesh, geometry, cells)

    def weigh(some: Cells, xi: Array) -> Array:
        det = geometry.determinant(np.repeat(some, len(weights)), xi)
        return np.tile(weights, len(some)) * det

    blocks = ((some, np.tile(points, (len(some), 1))) for some in split(filled, len(points)))
    what = f"quadrature of degree {degree}"
    return make_points(mesh, geometry, blocks, weigh, inside, tag, what)


def fill(
    mesh: Mesh,
    per_side: int,
    cells: npt.ArrayLike | None = None,
    inside: OfPosition | None = None,
    tag: int = 0,
) -> MaterialPoints:
    """Seed points at the centres of equal parts of each cell.

    Each cell is cut into per_side**d parts of its own kind. Its points share the volume of the
    cell: equally in affine cells, otherwise in proportion to det dx/dxi.

    Args:
        mesh: Background mesh.
        per_side: Number of parts along each edge of a cell.
        cells: Local cells to fill, as for `quadrature`.
        inside: Predicate; only points where it is true are kept.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        ValueError: If there are no points at all, or `per_side` is less than 1.
    """
    if per_side < 1:
        raise ValueError(f"per_side must be at least 1, not {per_side}: cells are cut into parts")
    geometry = cell_geometry(mesh)
    points = _centres(geometry, per_side)
    filled = owned_of(mesh, geometry, cells)
    blocks = ((some, np.tile(points, (len(some), 1))) for some in split(filled, len(points)))
    what = f"filling with {per_side} points a side"
    return make_points(mesh, geometry, blocks, partial(_shares, geometry), inside, tag, what)


def random(
    mesh: Mesh,
    per_cell: int,
    seed: int,
    cells: npt.ArrayLike | None = None,
    inside: OfPosition | None = None,
    tag: int = 0,
) -> MaterialPoints:
    """Seed uniformly distributed random points in each cell.

    Positions depend on the seed and on the number of the cell in the input mesh, but not on the
    number of ranks. The points of a cell share its volume as in `fill`.

    Args:
        mesh: Background mesh.
        per_cell: Number of points per cell.
        seed: Seed of the random number generator.
        cells: Local cells to fill, as for `quadrature`.
        inside: Predicate; only points where it is true are kept.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        ValueError: If there are no points at all, or `per_cell` is less than 1.
    """
    if per_cell < 1:
        raise ValueError(f"per_cell must be at least 1 random point, not {per_cell}")
    geometry = cell_geometry(mesh)
    filled = owned_of(mesh, geometry, cells)
    highest = mesh.comm.allreduce(int(geometry.key.max(initial=-1)), MPI.MAX)
    blocks = _draw(geometry, filled, highest, per_cell, seed)
    what = f"filling with {per_cell} random points a cell"
    return make_points(mesh, geometry, blocks, partial(_shares, geometry), inside, tag, what)


def lattice(
    mesh: Mesh,
    spacing: float | npt.NDArray[np.float64],
    inside: OfPosition | None = None,
    tag: int = 0,
) -> MaterialPoints:
    """Seed points on a regular lattice, independently of the cells.

    The lattice starts half a spacing from the lower corner of the bounding box of the mesh. Each
    point in the mesh (and `inside`) has the weight spacing**d, or the product of the spacings.

    Args:
        mesh: Background mesh.
        spacing: Distance of neighbours in m, one number or one for each direction.
        inside: Predicate; only points where it is true are kept.
        tag: Tag of the points.

    Returns:
        The points; their weights are volumes in m^d, in 2D per unit thickness.

    Raises:
        ValueError: If a spacing is not positive or there are no points at all.
    """
    geometry = cell_geometry(mesh)
    step = np.asarray(spacing, dtype=np.float64)
    if step.shape not in ((), (geometry.dim,)) or not np.all((step > 0) & (step < np.inf)):
        raise ValueError(f"the spacing of a lattice must be positive, not {spacing}")
    step = np.broadcast_to(step, geometry.dim)
    lower, upper = own_bounds(geometry)
    origin, end = mesh_bounds(mesh, geometry)

    def position(index: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        return origin + (index + 0.5) * step

    error = None
    parts: list[npt.NDArray[np.int64]] = [np.zeros((0, geometry.dim), dtype=np.int64)]
    for some in lattice_indices(lower, upper, origin, step):
        if inside is not None:
            error, mask = mask_at(inside, position(some))
            if error is not None:
                break
            some = some[mask]
        parts.append(some)
    raise_together(mesh.comm, error)
    index = np.concatenate(parts)
    cell, xi = locator(mesh).locate(position(index))
    margin = xi.min(axis=1)
    highest = xi.sum(axis=1) if geometry.is_simplex else xi.max(axis=1)
    clear = np.minimum(margin, 1.0 - highest) > _NEAR_FACET
    mine = index[(cell >= 0) & (cell < geometry.num_owned) & clear]
    # Several ranks, or none, may see points on facets between ranks: collect these points once
    # and let MaterialPoints find their owners.
    shared = np.concatenate(mesh.comm.allgather(index[(cell >= 0) & ~clear]))
    shared = np.unique(shared, axis=0)[mesh.comm.rank :: mesh.comm.size]
    index = np.concatenate([mine, shared])
    check_any(mesh, len(index), f"a lattice of spacing {spacing}", inside)
    number = lattice_numbers(index, end, origin, step)
    x = position(index)
    points = MaterialPoints(mesh, x, float(np.prod(step)), tag=tag, number=number)
    points.sort()
    return points


def from_mesh(background: Mesh, body: MaterialPoints) -> MaterialPoints:
    """Copy points with weights, tags, fields and order of ids to another mesh.

    This serves bodies with a mesh of their own: `from_mesh(background, quadrature(body_mesh, 2))`.

    Args:
        background: Mesh to put the points on, on the same ranks.
        body: Points seeded on any other mesh.

    Returns:
        Points on the background mesh, in the cells that contain them.

    Raises:
        PointsOutsideError: If some point is outside of the background mesh.
    """
    fields = {name: body[name] for name in body.field_names}
    points = MaterialPoints(
        background, body.x, body.weight, tag=body.tag, number=body.id, fields=fields
    )
    points.sort()
    return points


def on_facets(
    mesh: Mesh, facets: npt.ArrayLike | OfPosition, degree: int = 1, tag: int = 0
) -> MaterialPoints:
    """Seed the points of a quadrature rule on facets, weighted by area (3D) or length (2D).

    The points have a field "normal" of shape (d,): the unit normal that points out of the cell of
    the facet. If a facet lies between two cells, it points out of the one that dolfinx lists first.

    Args:
        mesh: Mesh of the facets; `from_mesh` brings the points to another mesh.
        facets: Local facets (those that other ranks own are ignored here), or a predicate like
            `inside`. A predicate selects the boundary facets at whose vertices it is true.
        degree: Degree that the rule integrates exactly on affine facets. Degree 1 gives one point
            per facet on simplices and quadrilaterals.
        tag: Tag of the points.

    Returns:
        The points; their weights are areas in m^2, in 2D lengths in m.

    Raises:
        ValueError: If there are no points at all, or no such facets.
    """
    geometry = cell_geometry(mesh)
    d = geometry.dim
    mesh.topology.create_entities(d - 1)
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    if callable(facets):
        marker = CaughtMarker(facets)
        chosen = locate_entities_boundary(mesh, d - 1, marker)
        raise_together(mesh.comm, marker.error)
    else:
        chosen = np.unique(np.asarray(facets, dtype=np.int32))
    index_map = mesh.topology.index_map(d - 1)
    error = None
    if len(chosen) and (chosen[0] < 0 or chosen[-1] >= index_map.size_local + index_map.num_ghosts):
        error = ValueError(
            f"facets on rank {mesh.comm.rank} must be local indices from 0, not {chosen[0]} to "
            f"{chosen[-1]}"
        )
    raise_together(mesh.comm, error)
    chosen = chosen[chosen < index_map.size_local]

    to_cells = mesh.topology.connectivity(d - 1, d)
    cell = to_cells.array[to_cells.offsets[chosen]]
    of_cell = mesh.topology.connectivity(d, d - 1).array.reshape(geometry.num_cells, -1)
    side = np.argmax(of_cell[cell] == chosen[:, None], axis=1)

    points, weights = basix.make_quadrature(
        basix.cell.subentity_types(geometry.cell)[d - 1][0], degree
    )
    start = np.array([v[0] for v in basix.topology(geometry.cell)[d - 1]])
    edges = basix.cell.facet_jacobians(geometry.cell)
    xi = basix.geometry(geometry.cell)[start][:, None] + np.einsum("fij,qj->fqi", edges, points)
    cell, side = np.repeat(cell, len(weights)), np.repeat(side, len(weights))
    xi = xi[side[:: len(weights)]].reshape(-1, d)
    tangents = geometry.jacobian(cell, xi) @ edges[side]
    metric = np.swapaxes(tangents, 1, 2) @ tangents
    weight = np.tile(weights, len(chosen)) * np.sqrt(np.linalg.det(metric))
    check_any(mesh, len(weight), "a rule on facets", facets if callable(facets) else None)
    # A facet is numbered by the cell from which it is seen; on the boundary there is only one.
    number = geometry.key[cell] * of_cell.shape[1] + side
    number = number * len(weights) + np.tile(np.arange(len(weights)), len(chosen))
    x = geometry.push_forward(cell, xi)
    normal = np.einsum(
        "pkj,pk->pj",
        geometry.inverse_jacobian(cell, xi),
        basix.cell.facet_outward_normals(geometry.cell)[side],
    )
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    fields = {"normal": normal}
    body = MaterialPoints(mesh, x, weight, cells=cell, tag=tag, number=number, fields=fields)
    body.sort()
    return body


def at(mesh: Mesh, x: npt.ArrayLike, weight: float = 1.0, tag: int = 0) -> MaterialPoints:
    """Seed points at given positions, such as a probe that moves with the material.

    Args:
        mesh: Background mesh.
        x: Positions in m, the same on all ranks, shape (d,) for one point or (n, d).
        weight: Weight of each point.
        tag: Tag of the points.

    Returns:
        The points, in the order of the positions.

    Raises:
        ValueError: If the positions have another shape.
        PointsOutsideError: If some point is outside of the mesh.
    """
    positions = np.atleast_2d(np.asarray(x, dtype=np.float64))
    here = positions if mesh.comm.rank == 0 else positions[:0]
    return MaterialPoints(mesh, here, weight, tag=tag)


def on_curve(
    mesh: Mesh, a: npt.ArrayLike, b: npt.ArrayLike, spacing: float, tag: int = 0
) -> MaterialPoints:
    """Seed the midpoints of equal segments of the straight line from a to b, weighted by length.

    In 2D the points have a field "normal" of shape (2,): the unit normal to the right of the line
    from a to b. It points out of a body whose boundary is traversed counter-clockwise.

    Args:
        mesh: Background mesh.
        a: Start in m, shape (d,).
        b: End in m, shape (d,).
        spacing: Largest length of a segment in m.
        tag: Tag of the points.

    Returns:
        The points; their weights are lengths in m.

    Raises:
        ValueError: If the spacing is not positive or the line has no length.
        PointsOutsideError: If some point is outside of the mesh.
    """
    start, end = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    dim = mesh.geometry.dim
    if start.shape != (dim,) or end.shape != (dim,):
        raise ValueError(f"ends of a line need {dim} coordinates, not {start} and {end}")
    length = float(np.linalg.norm(end - start))
    if not (0.0 < spacing < np.inf and 0.0 < length < np.inf):
        raise ValueError(
            f"a line needs a positive length and a positive spacing, not {length} and {spacing}"
        )
    n = max(1, int(np.ceil(length / spacing * (1.0 - 1e-12))))
    here = n if mesh.comm.rank == 0 else 0  # rank 0 sends them to the owners of their cells
    x = start + (np.arange(here)[:, None] + 0.5) / n * (end - start)
    line = MaterialPoints(mesh, x, length / n, tag=tag)
    if dim == 2:
        t = (end - start) / length
        line.add_field("normal", (2,), (t[1], -t[0]))
    return line


def _centres(geometry: CellGeometry, k: int) -> npt.NDArray[np.float64]:
    """Return the centres of k**d equal parts of the reference cell, shape (k**d, d)."""
    d = geometry.dim
    boxes = np.array(list(itertools.product(range(k), repeat=d)), dtype=np.float64)
    if not geometry.is_simplex:
        return (boxes + 0.5) / k
    # Kuhn's subdivision: each of k**d boxes holds d! equal simplices. The simplex
    # 1 > y_1 > .. > y_d > 0 consists of those that lie in it.
    inner = np.arange(d, 0, -1) / (d + 1)
    corners = np.array(list(itertools.permutations(inner)))
    y = ((boxes[:, None] + corners) / k).reshape(-1, d)
    y = y[np.all(np.diff(y, axis=1) < 0.0, axis=1)]
    return np.append(y[:, :-1] - y[:, 1:], y[:, -1:], axis=1)


def _shares(
    geometry: CellGeometry, filled: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the fractions of the cells' volumes, with the same points xi in each filled cell."""
    if not len(filled):
        return np.zeros(0)
    n = len(xi) // len(filled)
    weight = geometry.determinant(np.repeat(filled, n), xi).reshape(-1, n)
    weight *= (geometry.volume(filled) / weight.sum(axis=1))[:, None]
    return weight.ravel()


def _draw(
    geometry: CellGeometry, filled: Cells, highest: int, per_cell: int, seed: int
) -> Iterator[tuple[Cells, Array]]:
    """Yield random reference coordinates in the filled cells, some cells at a time."""
    rng = np.random.default_rng(seed)
    key = geometry.key[filled]
    for start in range(0, highest + 1, _BLOCK):
        # All ranks draw the numbers of all cells, a block at a time, and keep those of their cells.
        numbers = rng.random((min(_BLOCK, highest + 1 - start), per_cell, geometry.dim))
        mine = np.flatnonzero((key >= start) & (key < start + _BLOCK))
        xi = numbers[key[mine] - start]
        if geometry.is_simplex:
            # The gaps between sorted uniform numbers are uniform barycentric coordinates.
            xi = np.diff(np.sort(xi, axis=2), axis=2, prepend=0.0)
        yield filled[mine], xi.reshape(-1, geometry.dim)
