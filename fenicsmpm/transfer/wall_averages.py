# SPDX-License-Identifier: MIT
"""Averages over the grid at the walls of a lattice.

The average at a node is the value at the centroid of the volume that the node's function weighs.
Away from walls this centroid is the node. At a wall, where functions end, it lies inside the body,
and repeated averaging in each step would flatten the field. The average is therefore extrapolated
to the node along the line through it and the next one,

    J_i <- J_i + c (J_i - J_i+1),    c = (x_i - X_i) / (X_i - X_i+1)

with centroids X of the functions for as many points per cell as the body has. Linear fields are
then averaged exactly in bodies that fill the cells at a wall. Where the slope changes, as at the
corners of a clamp, the correction is limited to twice the difference between the next two nodes, so
that singular fields are not extrapolated.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.lattice_stencil import KINDS, half_size_in_cells
from fenicsmpm.basis.lines import WIDTH, tabulate_line
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.location import locator
from fenicsmpm.transfer.light_nodes import LIGHT
from fenicsmpm.transfer.tiles import Nodes

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Number of cells on a line beyond which functions in the middle do not see its ends
_CELLS = 8
# Largest extrapolated difference in units of the next one
_STEEPEST = 2.0


class WallNodes(NamedTuple):
    """Nodes whose averages are extrapolated; a corner node occurs once for each direction.

    Attributes:
        nodes: Numbers of the nodes, ``(n,)``.
        inner: Numbers of the next nodes away from the wall, ``(n,)``.
        further: Numbers of the nodes after these, ``(n,)``.
        shares: Factors c above, ``(n,)``.
    """

    nodes: Integers
    inner: Integers
    further: Integers
    shares: Array


def wall_shares(kind: int, cells: int, half: float, per_cell: int) -> Array:
    """Return the factors c of the nodes from a wall inwards, up to the last that is not 0.

    Args:
        kind: Kind of the grid functions, see `fenicsmpm.basis.lines`.
        cells: Number of cells between the walls.
        half: Half of a point's size in units of a cell (uGIMP).
        per_cell: Number of points per cell in this direction.
    """
    cells = min(cells, _CELLS)
    weight, moment = np.zeros(cells + 5), np.zeros(cells + 5)
    values = np.zeros((3, WIDTH[kind]))
    for cell in range(cells):
        for t in (np.arange(per_cell) + 0.5) / per_cell:
            first = tabulate_line(kind, cell, t, cells, half, values)
            # nodes beyond walls have the value 0
            nodes = first + 2 + np.arange(WIDTH[kind])
            weight[nodes] += values[0]
            moment[nodes] += (cell + t) * values[0]
    centroids = moment[2 : cells + 3] / weight[2 : cells + 3]
    away = centroids - np.arange(cells + 1)
    shares = (away[:-1] / np.diff(centroids))[: (cells + 1) // 2]
    return np.trim_zeros(np.where(np.abs(shares) > 1e-12, shares, 0.0), "b")


def points_in_a_cell(points: MaterialPoints, volume: float) -> int:
    """Return how many points a body has initially per direction of a full cell. Collective.

    Args:
        points: The body, with the field "V_0".
        volume: Volume of a cell in m^d.
    """
    total = points.mesh.comm.allreduce(float(np.sum(points["V_0"])))
    if total == 0.0:
        return 1
    return max(1, round((volume * points.size_global / total) ** (1 / points.mesh.geometry.dim)))


def find_wall_nodes(
    index: Integers, shape: Integers, shares: list[Array]
) -> tuple[Integers, Integers, Array]:
    """Return the nodes near walls.

    Args:
        index: Numbers of nodes in each direction, ``(n, d)``.
        shape: Number of nodes of the lattice in each direction, ``(d,)``.
        shares: Factors c for each direction, see ``wall_shares``.

    Returns:
        Places in ``index``, steps ``(m, d)`` away from the wall, and factors ``(m,)``.
    """
    nodes, steps, factors = [], [], []
    for k, layers in enumerate(shares):
        for layer, share in enumerate(layers):
            for at, step in ((layer, 1), (shape[k] - 1 - layer, -1)):
                found = np.flatnonzero(index[:, k] == at)
                nodes.append(found)
                steps.append(np.tile(step * (np.arange(index.shape[1]) == k), (len(found), 1)))
                factors.append(np.full(len(found), share))
    if not nodes:
        return np.empty(0, np.int64), np.empty((0, index.shape[1]), np.int64), np.empty(0)
    return np.concatenate(nodes), np.concatenate(steps), np.concatenate(factors)


@njit
def continue_to_walls(means, volumes, walls):
    """Extrapolate nodal averages to walls, in place, unless the next two nodes are light.

    Args:
        means: Averages at nodes, ``(n,)``.
        volumes: Volumes of the body at nodes, ``(n,)``.
        walls: Nodes near walls, see ``WallNodes``.
    """
    change = np.zeros(len(walls.nodes))
    for i in range(len(change)):
        least = LIGHT * volumes[walls.nodes[i]]
        if least > 0.0 and volumes[walls.inner[i]] > least and volumes[walls.further[i]] > least:
            next_one = means[walls.inner[i]]
            limit = _STEEPEST * (next_one - means[walls.further[i]])
            difference = means[walls.nodes[i]] - next_one
            difference = min(max(difference, min(limit, 0.0)), max(limit, 0.0))
            change[i] = walls.shares[i] * difference
    for i in range(len(change)):
        means[walls.nodes[i]] += change[i]


class WallsOfBody:
    """Nodes near walls for the averages of a body, in any numbering.

    Without a lattice there are none.

    Args:
        points: The body, with the field "V_0". Collective.
    """

    def __init__(self, points: MaterialPoints) -> None:
        """Compute the factors."""
        boxes = locator(points.mesh).geometry.boxes
        self._boxes = boxes
        self._shares: list[Array] = []
        if boxes is None:
            return
        chosen = points.grid_functions
        name = "linear" if chosen is None else chosen[0]
        half: Array = np.full(len(boxes.shape), 0.5)
        if chosen is not None:
            half = half_size_in_cells(points.mesh, *chosen)
        per_cell = points_in_a_cell(points, float(np.prod(boxes.spacing)))
        self._shares = [
            wall_shares(KINDS[name], int(n), h, per_cell)
            for n, h in zip(boxes.shape, half, strict=True)
        ]

    def at(self, x: Array) -> WallNodes:
        """Return those among given nodes, numbered in the given order.

        Args:
            x: Positions of the nodes in m, ``(n, 3)``.
        """
        if self._boxes is None:
            return self.among(np.empty(0, np.int64), np.empty((0, 3), np.int64))
        origin, spacing = self._boxes.origin, self._boxes.spacing
        index = np.rint((x[:, : len(spacing)] - origin) / spacing).astype(np.int64)
        return self.among(np.arange(len(x)), index)

    def among(self, numbers: Integers, index: Integers) -> WallNodes:
        """Return those among given nodes whose next two nodes are given, too.

        Args:
            numbers: Numbers of the nodes, ``(n,)``.
            index: Numbers in each direction of the lattice, ``(n, >= d)``.
        """
        if self._boxes is None or len(index) == 0:
            empty = np.empty(0, np.int64)
            return WallNodes(empty, empty, empty, np.empty(0))
        shape = np.asarray(self._boxes.shape + 1)
        index = index[:, : len(shape)]
        nodes, steps, shares = find_wall_nodes(index, shape, self._shares)
        flat = np.atleast_1d(np.ravel_multi_index(tuple(index.T), tuple(shape)))
        order = np.argsort(flat)
        found, there = [], np.ones(len(nodes), np.bool_)
        for count in (1, 2):
            wanted = index[nodes] + count * steps
            there &= ((wanted >= 0) & (wanted < shape)).all(axis=1)
            inside = np.clip(wanted, 0, shape - 1)
            numbers_there = np.atleast_1d(np.ravel_multi_index(tuple(inside.T), tuple(shape)))
            places = np.searchsorted(flat, numbers_there, sorter=order)
            found.append(order[np.minimum(places, len(order) - 1)])
            there &= flat[found[-1]] == numbers_there
        chosen = np.flatnonzero(there)
        # in the order of memory
        chosen = chosen[np.argsort(numbers[nodes[chosen]], kind="stable")]
        inner, further = (numbers[place[chosen]] for place in found)
        return WallNodes(numbers[nodes[chosen]], inner, further, shares[chosen])

    def in_tiles(self, ids: Integers, nodes: Nodes) -> WallNodes:
        """Return those in given tiles, numbered tile by tile.

        Args:
            ids: Numbers of the tiles, ascending, ``(n,)``.
            nodes: Nodes of the lattice.
        """
        tile = np.stack(np.unravel_index(ids, tuple(nodes.tiles)), axis=-1)
        # tiles near a wall in a direction with several nodes, or that have the next nodes of these
        reach = 2 + max((len(layers) for layers in self._shares), default=0)
        near = (tile * nodes.side < reach) | ((tile + 1) * nodes.side > nodes.shape - reach)
        tiles = np.flatnonzero((near & (nodes.shape > 1)).any(axis=1))
        index = nodes.in_tiles(ids[tiles])
        numbers = tiles[:, None] * nodes.per_tile + np.arange(nodes.per_tile)
        inside = np.all(index < nodes.shape, axis=2)
        return self.among(numbers[inside], index[inside])
