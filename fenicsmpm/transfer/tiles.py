# SPDX-License-Identifier: MIT
"""The lattice of an explicit step in tiles, which exist only where there are points.

Tiles have 8 x 8 nodes in 2D and 4 x 4 x 4 in 3D. Tiles and nodes are numbered with the last
direction fastest, independently of dolfinx' numbers. Points are sorted by the tile of the first
node of their stencil; those of a tile are a *unit* of work. Their contributions to the nodes are
summed up in a *window*, the tile with a rim, which fits into the first-level cache. The rim has a
margin for points that drift. If a point has drifted further, tiles are built anew.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.lattice import Lattice
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import ON_WALL, SIDE
from fenicsmpm.lanes import LANES
from fenicsmpm.points.boxes import all_owned
from fenicsmpm.points.geometry import CellGeometry
from fenicsmpm.points.sorting import sort_by_number

# Points closer to a facet than this, in cells, may belong to either cell.
_ON_FACET = 1e-6

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.int32]


class Nodes(NamedTuple):
    """Nodes of a lattice on all ranks, for compiled loops.

    In 2D the third direction has one node.

    Attributes:
        origin: Position of the lowest node in m, ``(3,)``.
        upper: Position of the highest node in m, ``(3,)``.
        per_metre: Cells per metre, ``(3,)``.
        shape: Number of nodes in each direction, ``(3,)``.
        side: Number of nodes of a tile in each direction, ``(3,)``.
        tiles: Number of tiles in each direction, ``(3,)``.
    """

    origin: Floats
    upper: Floats
    per_metre: Floats
    shape: Integers
    side: Integers
    tiles: Integers

    @property
    def per_tile(self) -> int:
        """Number of nodes in a tile."""
        return int(np.prod(self.side))

    def in_tiles(self, tiles: Integers) -> Integers:
        """Return node numbers in each direction, ``(n_tiles, nodes of a tile, 3)``.

        Tiles at the upper ends extend beyond the lattice.
        """
        each = [np.arange(n) for n in self.side]
        in_tile = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
        first = np.stack(np.unravel_index(tiles, tuple(self.tiles)), axis=-1) * self.side
        return np.asarray(first[:, None] + in_tile)

    def places(self, x: Floats) -> tuple[Integers, Integers]:
        """Return tiles of the nodes at positions ``(n, 3)`` in m, and their places in these."""
        index = np.rint((x - self.origin) * self.per_metre).astype(np.int64)
        tile, node = index // self.side, index % self.side
        flat = [
            np.ravel_multi_index(tuple(i.T), tuple(n))
            for i, n in ((tile, self.tiles), (node, self.side))
        ]
        return flat[0].astype(np.int64), flat[1].astype(np.int64)


def make_nodes(origin: Floats, spacing: Floats, cells: Integers) -> Nodes:
    """Return nodes from lowest corner, size and number of cells of a lattice, each ``(d,)``."""
    dim = len(spacing)
    lowest, highest = np.zeros(3), np.zeros(3)
    per_metre, shape = np.ones(3), np.ones(3, dtype=np.int64)
    side = np.ones(3, dtype=np.int64)
    lowest[:dim] = origin
    highest[:dim] = origin + spacing * cells
    per_metre[:dim] = 1.0 / spacing
    shape[:dim] = cells + 1
    side[:dim] = SIDE[dim]
    return Nodes(lowest, highest, per_metre, shape, side, -(-shape // side))


def nodes_of(lattice: Lattice) -> Nodes:
    """Return the nodes of a lattice."""
    return make_nodes(lattice.origin, lattice.spacing, lattice.shape)


@njit
def first_node(t, n, width):
    """Return the first node of a point at t, in cells, of n nodes in a direction."""
    first = int(np.floor(t + 0.5)) - 1 if width == 3 else int(np.floor(t)) - (width - 1) // 2
    return min(max(first, 0), n - width)


@njit
def row_of(i, j, k, nodes, ids):
    """Return the row of a node by its numbers in each direction; -1 without a tile.

    Args:
        i: Number in the first direction.
        j: Number in the second direction.
        k: Number in the third direction.
        nodes: Nodes of the lattice.
        ids: Numbers of the existing tiles, ascending.
    """
    side, tiles = nodes.side, nodes.tiles
    tile = ((i // side[0]) * tiles[1] + j // side[1]) * tiles[2] + k // side[2]
    place = np.searchsorted(ids, tile)
    if place == len(ids) or ids[place] != tile:
        return -1
    node = ((i % side[0]) * side[1] + j % side[1]) * side[2] + k % side[2]
    return (place * side[0] * side[1] * side[2]) + node


@njit
def sort_keys(x, nodes, width):
    """Return keys by which points ``(n, d)`` are sorted, and their occupied tiles.

    Returns:
        Keys ``(n,)``: the tile's place among the occupied ones times its nodes, plus the first node
        in it. And the tiles in each direction, ``(n_tiles, 3)``.
    """
    n, dim = x.shape
    side, per_tile = nodes.side, nodes.side[0] * nodes.side[1] * nodes.side[2]
    tile, local = np.zeros((n, 3), np.int32), np.empty(n, np.int32)
    lower, upper = np.full(3, np.iinfo(np.int64).max), np.full(3, np.int64(-1))
    for p in range(n):
        number = 0
        for k in range(dim):
            t = (x[p, k] - nodes.origin[k]) * nodes.per_metre[k]
            first = first_node(t, nodes.shape[k], width)
            tile[p, k] = first // side[k]
            number = number * side[k] + first % side[k]
        local[p] = number
        for k in range(3):
            lower[k], upper[k] = min(lower[k], tile[p, k]), max(upper[k], tile[p, k])
    box = np.maximum(upper - lower + 1, 0)
    numbers = np.zeros(box[0] * box[1] * box[2], np.int32)
    for p in range(n):
        flat = ((tile[p, 0] - lower[0]) * box[1] + tile[p, 1] - lower[1]) * box[2]
        numbers[flat + tile[p, 2] - lower[2]] = 1
    occupied = np.empty((numbers.sum(), 3), np.int64)
    count = 0
    for flat in range(len(numbers)):
        if numbers[flat] > 0:
            occupied[count, 0] = lower[0] + flat // (box[1] * box[2])
            occupied[count, 1] = lower[1] + flat // box[2] % box[1]
            occupied[count, 2] = lower[2] + flat % box[2]
            numbers[flat] = count
            count += 1
    keys = np.empty(n, np.int64)
    for p in range(n):
        flat = ((tile[p, 0] - lower[0]) * box[1] + tile[p, 1] - lower[1]) * box[2]
        keys[p] = numbers[flat + tile[p, 2] - lower[2]] * per_tile + local[p]
    return keys, occupied


@njit
def fill_blocks(keys, per_tile, count):
    """Return the order of points in blocks of eight, each of which belongs to one tile.

    Blocks are filled up with copies of their tile's last point, written ``-1 - p``.

    Returns:
        The order ``(8 n_blocks,)`` and the first block of each tile, ``(count + 1,)``.
    """
    order, offsets = sort_by_number(keys, count * per_tile)
    blocks = np.zeros(count + 1, np.int64)
    for tile in range(count):
        n = offsets[(tile + 1) * per_tile] - offsets[tile * per_tile]
        blocks[tile + 1] = blocks[tile] + (n + LANES - 1) // LANES
    filled = np.empty(blocks[count] * LANES, np.int32)
    for tile in range(count):
        slot = blocks[tile] * LANES
        for i in range(offsets[tile * per_tile], offsets[(tile + 1) * per_tile]):
            filled[slot] = order[i]
            slot += 1
        for copy in range(slot, blocks[tile + 1] * LANES):
            filled[copy] = -1 - filled[slot - 1]
    return filled, blocks


class Units(NamedTuple):
    """Points by tile, for compiled loops.

    Attributes:
        chunks: First unit of each thread, ``(threads + 1,)``.
        blocks: First block of eight points of each unit, ``(n + 1,)``.
        lower: First node of each window, ``(n, 3)``.
        t_low: Lowest position, in cells, of points whose nodes are in the window, ``(n, 3)``.
        t_high: Highest position, likewise.
        source: Tiles around the unit's tile, among those of all bodies; -1 for none; ``(n, 27)``.
        body_source: Tiles among those of the points' body, ``(n, 27)``.
        target: Tiles of the body that the unit's thread adds to, ``(n, 27)``.
        first: First nodes in the windows that the points see now, updated by the kernels,
            ``(n, 3)``.
        last: Last nodes, likewise.
    """

    chunks: Integers
    blocks: Integers
    lower: Floats
    t_low: Floats
    t_high: Floats
    source: Numbers
    body_source: Numbers
    target: Numbers
    first: Integers
    last: Integers


@njit
def reaches(keys, nodes, occupied, width, margin):
    """Return lowest and highest first nodes ``(n_tiles, 3)`` that points of each tile may have."""
    side = nodes.side
    per_tile = side[0] * side[1] * side[2]
    low = np.full((len(occupied), 3), np.iinfo(np.int64).max)
    high = np.full((len(occupied), 3), np.int64(-1))
    for key in keys:
        tile, local = key // per_tile, key % per_tile
        for k in (2, 1, 0):
            first = occupied[tile, k] * side[k] + local % side[k]
            local //= side[k]
            low[tile, k], high[tile, k] = min(low[tile, k], first), max(high[tile, k], first)
    for tile in range(len(occupied)):
        for k in range(3):
            if nodes.shape[k] > 1:
                low[tile, k] = max(low[tile, k] - margin, 0)
                high[tile, k] = min(high[tile, k] + margin, nodes.shape[k] - width)
    return low, high


@njit
def around(x, nodes, width, margin):
    """Return lowest and highest first nodes ``(n, 3)`` that points ``(n, d)`` may have."""
    low, high = np.zeros((len(x), 3), np.int64), np.zeros((len(x), 3), np.int64)
    for p in range(len(x)):
        for k in range(x.shape[1]):
            t = (x[p, k] - nodes.origin[k]) * nodes.per_metre[k]
            first = first_node(t, nodes.shape[k], width)
            low[p, k] = max(first - margin, 0)
            high[p, k] = min(first + margin, nodes.shape[k] - width)
    return low, high


class Layout(NamedTuple):
    """Tiles of a rank.

    Attributes:
        ids: Numbers of the tiles, ascending, ``(n,)``.
        touched: Whether points of this rank may see and add to a node, ``(n, nodes of a tile)``.
        near: Whether a node is touched or next to a touched one, from which forces may move to it
            if that one is light, ``(n, nodes of a tile)``.
        wanted: Whether sums of all ranks are needed at a node, ``(n, nodes of a tile)``. It is near
            or next to such a node; these sums decide which nodes are light, and continue averages
            to walls.
        neighbours: Places of the tiles around each one; -1 for none; ``(n, 27)``.
    """

    ids: Integers
    touched: npt.NDArray[np.bool_]
    near: npt.NDArray[np.bool_]
    wanted: npt.NDArray[np.bool_]
    neighbours: Numbers


def lay(first: Integers, last: Integers, nodes: Nodes) -> Layout:
    """Return tiles with the nodes ``first ... last``, ``(n, 3)`` each, and two more around them."""
    touched, near, wanted = (
        (np.maximum(first - ring, 0), np.minimum(last + ring, nodes.shape - 1)) for ring in range(3)
    )
    numbers, low, ids, neighbours = _lay(
        wanted[0] // nodes.side, wanted[1] // nodes.side, nodes.tiles
    )
    masks = np.zeros((3, len(ids), nodes.per_tile), dtype=np.bool_)
    for mask, (lower, upper) in zip(masks, (touched, near, wanted), strict=True):
        _mark(lower, upper, nodes.side, numbers, low, mask)
    return Layout(ids, masks[0], masks[1], masks[2], neighbours)


@njit
def _mark(lower, upper, side, numbers, low, mask):
    """Mark the nodes ``lower ... upper``, ``(n, 3)`` each, in tiles ``(n_tiles, nodes)``."""
    for n in range(len(lower)):
        for i in range(lower[n, 0], upper[n, 0] + 1):
            for j in range(lower[n, 1], upper[n, 1] + 1):
                for k in range(lower[n, 2], upper[n, 2] + 1):
                    tile = numbers[
                        i // side[0] - low[0], j // side[1] - low[1], k // side[2] - low[2]
                    ]
                    node = (i % side[0] * side[1] + j % side[1]) * side[2] + k % side[2]
                    mask[tile, node] = True


@njit
def _lay(lower, upper, tiles):
    low, box = np.zeros(3, np.int64), np.zeros(3, np.int64)
    if len(lower) > 0:
        for k in range(3):
            low[k] = lower[:, k].min()
            box[k] = upper[:, k].max() - low[k] + 1
    numbers, count = np.full((box[0], box[1], box[2]), -1, np.int32), 0
    for n in range(len(lower)):
        for i in range(lower[n, 0], upper[n, 0] + 1):
            for j in range(lower[n, 1], upper[n, 1] + 1):
                for k in range(lower[n, 2], upper[n, 2] + 1):
                    numbers[i - low[0], j - low[1], k - low[2]] = 0
    for i in range(box[0]):
        for j in range(box[1]):
            for k in range(box[2]):
                if numbers[i, j, k] == 0:
                    numbers[i, j, k] = count
                    count += 1
    ids, neighbours = np.empty(count, np.int64), np.full((count, 27), -1, np.int32)
    for i in range(box[0]):
        for j in range(box[1]):
            for k in range(box[2]):
                n = numbers[i, j, k]
                if n < 0:
                    continue
                ids[n] = ((i + low[0]) * tiles[1] + j + low[1]) * tiles[2] + k + low[2]
                for a in range(max(i - 1, 0), min(i + 2, box[0])):
                    for b in range(max(j - 1, 0), min(j + 2, box[1])):
                        for c in range(max(k - 1, 0), min(k + 2, box[2])):
                            place = ((a - i + 1) * 3 + b - j + 1) * 3 + c - k + 1
                            neighbours[n, place] = numbers[a, b, c]
    return numbers, low, ids, neighbours


@njit
def chunks_of(blocks, count):
    """Return the first unit of chunks of about equally many blocks, ``(count + 1,)``."""
    chunks = np.zeros(count + 1, np.int64)
    for t in range(1, count + 1):
        chunks[t] = np.searchsorted(blocks, blocks[-1] * t // count)
    chunks[count] = len(blocks) - 1
    return chunks


@njit
def targets(units, low, high, layout, nodes, width, chunks):
    """Return the tiles that units add to; a tile of several chunks has copies for the others.

    Args:
        units: Places of the units' tiles in the layout, ``(n,)``.
        low: Lowest first node of the units' points, ``(n, 3)``.
        high: Highest first node, ``(n, 3)``.
        layout: Layout of the body.
        nodes: Nodes of the lattice.
        width: Number of nodes per direction that a point sees.
        chunks: First unit of each chunk.

    Returns:
        Targets ``(n, 27)``, and the tile of each copy, in the order of chunks.
    """
    side, count = nodes.side, len(layout.ids)
    result = np.full((len(units), 27), -1, np.int32)
    # the last chunk that adds to a tile, and its target
    chunk_of, place_in = np.full(count, -1, np.int32), np.empty(count, np.int32)
    copies = np.empty(count * max(len(chunks) - 2, 0), np.int32)
    n_copies = 0
    for t in range(len(chunks) - 1):
        for u in range(chunks[t], chunks[t + 1]):
            for place in range(27):
                tile = layout.neighbours[units[u], place]
                if tile < 0:
                    continue
                number, away = layout.ids[tile], False
                for k in (2, 1, 0):
                    first = number % nodes.tiles[k] * side[k]
                    number //= nodes.tiles[k]
                    w = width if nodes.shape[k] > 1 else 1
                    away |= first > high[u, k] + w - 1 or first + side[k] <= low[u, k]
                if away:
                    continue
                if chunk_of[tile] < 0:
                    place_in[tile] = tile
                elif chunk_of[tile] < t:
                    place_in[tile] = count + n_copies
                    copies[n_copies] = tile
                    n_copies += 1
                chunk_of[tile] = t
                result[u, place] = place_in[tile]
    return result, copies[:n_copies].copy()


def limits(low: Integers, high: Integers, nodes: Nodes, kind: int) -> tuple[Floats, Floats]:
    """Return positions, in cells, of points with first nodes in ``low ... high``, ``(n, 3)``."""
    width = WIDTH[kind]
    shift = 0.5 if width == 3 else float((width - 1) // 2)
    t_low = np.asarray(low + shift, dtype=np.float64)
    t_high = np.asarray(high + shift + 1 - ON_WALL, dtype=np.float64)
    t_low[low == 0] = -np.inf
    t_high[high >= nodes.shape - width] = np.inf
    return t_low, t_high


def stays_home(units: Units, nodes: Nodes, geometry: CellGeometry) -> npt.NDArray[np.bool_]:
    """Return whether points of each unit stay in cells of this rank until tiles are built anew.

    Args:
        units: The n units.
        nodes: Nodes of the lattice.
        geometry: Shapes of this rank's cells, on a lattice.

    Returns:
        Mask ``(n,)``; False if some cell in a unit's reach belongs to another rank.
    """
    assert geometry.boxes is not None
    highest = np.maximum(nodes.shape - 2, 0)
    lower, upper = (
        np.clip(np.floor(ends), 0, highest).astype(np.int64)
        for ends in (units.t_low - _ON_FACET, units.t_high + _ON_FACET)
    )
    return np.asarray(all_owned(geometry.boxes, geometry.num_owned, lower, upper))
