# SPDX-License-Identifier: MIT
"""The lattice of an explicit step in tiles, which exist where there are points.

Tiles have 8 x 8 nodes in the plane and 4 x 4 x 4 in space, and are numbered through, the last
direction fastest, as nodes are, whatever dolfinx' numbers are. Points are sorted by the tile of the
first node of their stencil; those of a tile are a *unit* of work. What they give to the nodes is
summed up in a *window*, the tile with a rim, which stays in the first cache. The rim has a margin
for points that drift; when one has drifted further, tiles are laid anew.
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

# Points that are as near to a facet, in cells, may belong to either cell
_ON_FACET = 1e-6

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.int32]


class Nodes(NamedTuple):
    """Nodes of a lattice on all ranks, for compiled loops.

    In the plane, the third direction has one node.

    Attributes:
        origin: ``(3,)`` lowest node [m].
        upper: ``(3,)`` highest node [m].
        per_metre: ``(3,)`` cells per metre.
        shape: ``(3,)`` number of nodes in each direction.
        side: ``(3,)`` nodes of a tile in each direction.
        tiles: ``(3,)`` number of tiles in each direction.
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
        """Numbers of the nodes of tiles in each direction, ``(n_tiles, nodes of a tile, 3)``.

        Tiles at the upper ends go on beyond the lattice.
        """
        each = [np.arange(n) for n in self.side]
        in_tile = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
        first = np.stack(np.unravel_index(tiles, tuple(self.tiles)), axis=-1) * self.side
        return np.asarray(first[:, None] + in_tile)

    def places(self, x: Floats) -> tuple[Integers, Integers]:
        """Tiles of the nodes at positions ``(n, 3)`` [m], and their numbers in them."""
        index = np.rint((x - self.origin) * self.per_metre).astype(np.int64)
        tile, node = index // self.side, index % self.side
        flat = [
            np.ravel_multi_index(tuple(i.T), tuple(n))
            for i, n in ((tile, self.tiles), (node, self.side))
        ]
        return flat[0].astype(np.int64), flat[1].astype(np.int64)


def make_nodes(origin: Floats, spacing: Floats, cells: Integers) -> Nodes:
    """Nodes of a lattice by its lowest corner, and size and number of its cells, each ``(d,)``."""
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
    """Nodes of a lattice."""
    return make_nodes(lattice.origin, lattice.spacing, lattice.shape)


@njit
def first_node(t, n, width):
    """First node of the stencil of a point at t, in cells, of n nodes in a direction."""
    first = int(np.floor(t + 0.5)) - 1 if width == 3 else int(np.floor(t)) - (width - 1) // 2
    return min(max(first, 0), n - width)


@njit
def row_of(i, j, k, nodes, ids):
    """Row of a node by its numbers in each direction; -1 where there is no tile.

    Args:
        i: number in the first direction.
        j: in the second one.
        k: in the third one.
        nodes: of the lattice.
        ids: numbers of the tiles that there are, in ascending order.
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
    """Numbers by which points ``(n, d)`` are sorted, and their occupied tiles.

    Returns:
        keys ``(n,)``, the tile's place among the occupied ones times its nodes, and the first node
        in it; and the tiles in each direction, ``(n_tiles, 3)``.
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
    """Order of points in blocks of eight, of which each belongs to one tile.

    Blocks are filled up by copies of their tile's last point, written ``-1 - p``.

    Returns:
        order ``(8 n_blocks,)`` and the first block of each tile, ``(count + 1,)``.
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
        chunks: ``(threads + 1,)`` first unit of each thread.
        blocks: ``(n + 1,)`` first block of eight points of each unit.
        lower: ``(n, 3)`` first node of each window.
        t_low: ``(n, 3)`` lowest position, in cells, of points whose nodes are in the window.
        t_high: ``(n, 3)`` highest position.
        source: ``(n, 27)`` tiles around each unit's one, among those of all bodies; -1 for none.
        body_source: ``(n, 27)`` among those of the points' body.
        target: ``(n, 27)`` among those of the body that the unit's thread adds to.
        first: ``(n, 3)`` first nodes in the windows that points have where they are; kernels keep
            it up to date.
        last: ``(n, 3)`` last ones.
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
    """First nodes ``(n_tiles, 3)`` that points of each tile may have, lowest and highest."""
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
    """First nodes ``(n, 3)`` that points ``(n, d)`` may have, lowest and highest."""
    low, high = np.zeros((len(x), 3), np.int64), np.zeros((len(x), 3), np.int64)
    for p in range(len(x)):
        for k in range(x.shape[1]):
            t = (x[p, k] - nodes.origin[k]) * nodes.per_metre[k]
            first = first_node(t, nodes.shape[k], width)
            low[p, k] = max(first - margin, 0)
            high[p, k] = min(first + margin, nodes.shape[k] - width)
    return low, high


class Layout(NamedTuple):
    """Tiles that a rank has.

    Attributes:
        ids: ``(n,)`` their numbers, in ascending order.
        touched: ``(n, nodes of a tile)`` whether points of this rank may see and add to a node.
        near: ``(n, nodes of a tile)`` whether it is such a node or next to one, from which forces
            may be moved there if it is light.
        wanted: ``(n, nodes of a tile)`` whether sums of all ranks are needed at a node: it is near
            or next to such, by which light nodes are judged and averages are continued to walls.
        neighbours: ``(n, 27)`` places of the tiles around each; -1 for none.
    """

    ids: Integers
    touched: npt.NDArray[np.bool_]
    near: npt.NDArray[np.bool_]
    wanted: npt.NDArray[np.bool_]
    neighbours: Numbers


def lay(first: Integers, last: Integers, nodes: Nodes) -> Layout:
    """Tiles with the nodes ``first ... last``, ``(n, 3)`` each, and two more around them."""
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
    """First unit of each of some chunks of about as many blocks, ``(count + 1,)``."""
    chunks = np.zeros(count + 1, np.int64)
    for t in range(1, count + 1):
        chunks[t] = np.searchsorted(blocks, blocks[-1] * t // count)
    chunks[count] = len(blocks) - 1
    return chunks


@njit
def targets(units, low, high, layout, nodes, width, chunks):
    """Tiles that units add to; a tile of several chunks has a copy for each but the first.

    Args:
        units: ``(n,)`` places of the units' tiles in the layout.
        low: ``(n, 3)`` lowest first node of the units' points.
        high: ``(n, 3)`` highest one.
        layout: of the body.
        nodes: of the lattice.
        width: nodes of a function in a direction.
        chunks: first unit of each.

    Returns:
        targets ``(n, 27)``, and the tile of each copy, in the order of chunks.
    """
    side, count = nodes.side, len(layout.ids)
    result = np.full((len(units), 27), -1, np.int32)
    # the last chunk that adds to a tile, and what it adds to
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
    """Positions, in cells, of points whose first node is in ``low ... high``, ``(n, 3)`` each."""
    width = WIDTH[kind]
    shift = 0.5 if width == 3 else float((width - 1) // 2)
    t_low = np.asarray(low + shift, dtype=np.float64)
    t_high = np.asarray(high + shift + 1 - ON_WALL, dtype=np.float64)
    t_low[low == 0] = -np.inf
    t_high[high >= nodes.shape - width] = np.inf
    return t_low, t_high


def stays_home(units: Units, nodes: Nodes, geometry: CellGeometry) -> npt.NDArray[np.bool_]:
    """Whether the points of each unit are in cells of this rank as long as tiles are not laid anew.

    Args:
        units: ``n`` of them.
        nodes: of the lattice.
        geometry: of the cells of this rank, on a lattice.

    Returns:
        ``(n,)``; False where some cell in a unit's reach is not of this rank.
    """
    assert geometry.boxes is not None
    highest = np.maximum(nodes.shape - 2, 0)
    lower, upper = (
        np.clip(np.floor(ends), 0, highest).astype(np.int64)
        for ends in (units.t_low - _ON_FACET, units.t_high + _ON_FACET)
    )
    return np.asarray(all_owned(geometry.boxes, geometry.num_owned, lower, upper))
