# SPDX-License-Identifier: MIT
"""Seeding block by block.

The mesh may have room for many more points than the body has. Only one block of candidates is kept
in memory at a time.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.geometry import CellGeometry
from fenicsmpm.points.material_points import MaterialPoints
from fenicsmpm.points.of_position import OfPosition, mask_at, name_of

Array: TypeAlias = npt.NDArray[np.float64]
Cells: TypeAlias = npt.NDArray[np.int32]

# Points in a block.
_MANY = 1 << 16


def owned_of(mesh: Mesh, geometry: CellGeometry, cells: npt.ArrayLike | None) -> Cells:
    """Return the cells to fill on this rank, ascending."""
    if cells is None:
        return np.arange(geometry.num_owned, dtype=np.int32)
    given = np.unique(np.asarray(cells))
    error = None
    if given.size and (given[0] < 0 or given[-1] >= geometry.num_cells):
        error = ValueError(
            f"cells to fill must be 0 to {geometry.num_cells - 1}, not {given[0]} to {given[-1]}"
        )
    raise_together(mesh.comm, error)
    return given[given < geometry.num_owned].astype(np.int32)


def mesh_bounds(mesh: Mesh, geometry: CellGeometry) -> tuple[Array, Array]:
    """Return the lowest and highest coordinates in m of the mesh, shape (d,) each. Collective."""
    lower, upper = own_bounds(geometry)
    origin, end = np.empty((2, geometry.dim))
    mesh.comm.Allreduce(lower, origin, MPI.MIN)
    mesh.comm.Allreduce(upper, end, MPI.MAX)
    return origin, end


def own_bounds(geometry: CellGeometry) -> tuple[Array, Array]:
    """Return the lowest and highest coordinates in m of this rank's cells; infinity without any."""
    lower, upper = np.full(geometry.dim, np.inf), np.full(geometry.dim, -np.inf)
    for block in geometry.blocks(geometry.num_owned):
        corners = geometry.corners(block)
        lower = np.minimum(lower, corners.min(axis=(0, 1)))
        upper = np.maximum(upper, corners.max(axis=(0, 1)))
    return lower, upper


def lattice_indices(
    lower: Array, upper: Array, origin: Array, spacing: Array
) -> Iterator[npt.NDArray[np.int64]]:
    """Yield indices (n, d) of the lattice points in a box, and of a few around it, in blocks.

    The box extends from `lower` to `upper`, which are infinite if there is none.
    """
    if not np.all(np.isfinite(upper)):
        return
    first = np.maximum(np.floor((lower - origin) / spacing - 0.5).astype(np.int64), 0)
    counts = np.maximum(_last(upper, origin, spacing) - first + 1, 0)
    for start in range(0, int(np.prod(counts)), _MANY):
        numbers = np.arange(start, min(start + _MANY, int(np.prod(counts))))
        yield first + np.stack(np.unravel_index(numbers, tuple(counts)), axis=-1)


def lattice_numbers(
    index: npt.NDArray[np.int64], upper: Array, origin: Array, spacing: Array
) -> npt.NDArray[np.int64]:
    """Return the numbers (n,) of points with indices (n, d) in the whole lattice up to `upper`."""
    counts = tuple(_last(upper, origin, spacing) + 1)
    return np.asarray(np.ravel_multi_index(tuple(index.T), counts), dtype=np.int64)


def _last(upper: Array, origin: Array, spacing: Array) -> npt.NDArray[np.int64]:
    """Return the highest indices (d,) of lattice points up to `upper`, or slightly more."""
    last: npt.NDArray[np.int64] = np.ceil((upper - origin) / spacing - 0.5).astype(np.int64)
    return last


def split(filled: Cells, per_cell: int) -> Iterator[Cells]:
    """Yield the filled cells in blocks."""
    step = max(1, _MANY // per_cell)
    for start in range(0, len(filled), step):
        yield filled[start : start + step]


def make_points(
    mesh: Mesh,
    geometry: CellGeometry,
    blocks: Iterable[tuple[Cells, Array]],
    weigh: Callable[[Cells, Array], Array],
    inside: OfPosition | None,
    tag: int,
    what: str,
) -> MaterialPoints:
    """Create points at given reference coordinates, where they are inside the region.

    Points are numbered cell by cell, in the order of the cells in the input mesh.

    Args:
        mesh: Background mesh.
        geometry: Shapes of its cells.
        blocks: Pairs of cells, shape (n,), and reference coordinates of their points, shape (m, d),
            cell by cell with the same number in each cell. Only one block is kept at a time, as
            there may be many more candidates than points inside.
        weigh: Function from a block to the weights, shape (m,).
        inside: Predicate; only points where it is true are kept.
        tag: Tag of the points.
        what: Name of the seeding in the message if there are no points.
    """
    none = np.zeros((0, geometry.dim))
    kept: list[tuple[npt.NDArray, ...]] = [
        (np.zeros(0, dtype=np.int32), none, np.zeros(0), none, np.zeros(0, dtype=np.int64)),
    ]
    error = None
    for some, xi in blocks:
        if not len(some):
            continue
        per_cell = len(xi) // len(some)
        cell = np.repeat(some, per_cell)
        x = geometry.push_forward(cell, xi)
        mask: npt.NDArray[np.bool_] = np.full(len(x), True)
        if inside is not None:
            error, mask = mask_at(inside, x)
        if error is not None:
            break
        if mask.any():
            number = geometry.key[cell] * per_cell + np.tile(np.arange(per_cell), len(some))
            kept.append((cell[mask], xi[mask], weigh(some, xi)[mask], x[mask], number[mask]))
    raise_together(mesh.comm, error)
    cell, xi, weight, x, number = (np.concatenate(arrays) for arrays in zip(*kept, strict=True))
    del kept
    check_any(mesh, len(x), what, inside)
    order = np.argsort(cell, kind="stable")
    return MaterialPoints(
        mesh,
        x[order],
        weight[order],
        cells=cell[order],
        xi=xi[order],
        tag=tag,
        number=number[order],
    )


def check_any(mesh: Mesh, count: int, what: str, inside: OfPosition | None) -> None:
    """Raise on all ranks if there are no points at all. Collective."""
    if mesh.comm.allreduce(count) == 0:
        region = name_of(inside) if inside else "the given cells"
        raise ValueError(f"{what} gives no points in {region}")
