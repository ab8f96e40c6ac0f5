# SPDX-License-Identifier: MIT
"""Meshes whose cells are equal axis-parallel boxes on a lattice.

Positions of such cells follow from their numbers. Large domains that are mostly empty are meshed
this way, so only one number is stored for each: the cell at each place.
"""

import itertools
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit

# Largest distance of a node from its lattice place, in units of a cell.
_SLACK = 1e-9


class Boxes(NamedTuple):
    """The lattice and this rank's cells (owned and ghosts), as a tuple that numba understands.

    Cells may be turned: axis a of the reference cell is direction ``axis[turn, a]`` of the lattice,
    downwards if ``down[turn, a]``.

    Attributes:
        origin: Lowest corner of the mesh, shape (d,), in m.
        spacing: Size of a cell, shape (d,), in m.
        shape: Number of cells of the whole mesh in each direction, shape (d,), int64.
        first: Lowest number of this rank's cells in each direction, shape (d,), int64.
        box: Size of the bounding box of this rank's cells in cells, shape (d,), int64.
        cell: Local cell at each place of that box, last direction fastest, -1 for none, int32.
        turn: Turn of each cell, uint8; one entry if it is the same for all cells.
        axis: Lattice direction of each reference axis, shape (turns, d), int64.
        down: Whether the reference axis points downwards, shape (turns, d), bool.
        x: dolfinx' nodes in m, shape (n, 3).
        vertices: dolfinx' nodes of each cell, the first one in the first column, int32.
    """

    origin: npt.NDArray[np.float64]
    spacing: npt.NDArray[np.float64]
    shape: npt.NDArray[np.int64]
    first: npt.NDArray[np.int64]
    box: npt.NDArray[np.int64]
    cell: npt.NDArray[np.int32]
    turn: npt.NDArray[np.uint8]
    axis: npt.NDArray[np.int64]
    down: npt.NDArray[np.bool_]
    x: npt.NDArray[np.float64]
    vertices: npt.NDArray[np.int32]

    def numbers(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
        """Return numbers of `cells` (n,) in each direction, from 0 at the origin, shape (n, d)."""
        result = np.empty((len(cells), len(self.box)), dtype=np.int64)
        _numbers(self, np.asarray(cells), result)
        return result

    def at(self, index: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
        """Return local cells by numbers (..., d), -1 if not on this rank, shape (...)."""
        inside = np.all((index >= self.first) & (index < self.first + self.box), axis=-1)
        result = np.full(index.shape[:-1], -1, dtype=np.int32)
        places = np.moveaxis(index[inside] - self.first, -1, 0)
        result[inside] = self.cell[np.ravel_multi_index(tuple(places), tuple(self.box))]
        return result

    def turns(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.uint8]:
        """Return the turn of each of `cells` (n,)."""
        return self.turn[cells] if len(self.turn) > 1 else np.broadcast_to(self.turn, len(cells))

    def corners(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return the vertices of `cells` (n,) in m, in dolfinx's order, shape (n, 2**d, d)."""
        offsets = np.array([self._offsets(t) for t in range(len(self.axis))])
        index = self.numbers(cells)[:, None, :] + offsets[self.turns(cells)]
        return self.origin + index * self.spacing

    def vertex(self, cells: npt.NDArray[np.int32], upper: npt.NDArray) -> npt.NDArray[np.int64]:
        """Return the vertex of each cell that lies at a given corner of the box.

        Args:
            cells: Local cells, shape (n,).
            upper: 1 in directions in which the corner is the upper one, else 0, shape (d,).

        Returns:
            Local vertex numbers from 0 to 2**d - 1, shape (n,).
        """
        of_turn = [
            int(np.flatnonzero((self._offsets(t) == upper).all(axis=1))[0])
            for t in range(len(self.axis))
        ]
        return np.array(of_turn, dtype=np.int64)[self.turns(cells)]

    def _offsets(self, turn: int) -> npt.NDArray[np.int64]:
        """Return the vertices (0 or 1) of a cell of size one, shape (2**d, d)."""
        d = len(self.box)
        # vertex v lies at the end of reference axis a if bit a of v is set
        reference = np.arange(2**d)[:, None] >> np.arange(d) & 1
        result = np.empty_like(reference)
        result[:, self.axis[turn]] = reference ^ self.down[turn]
        return result

    def jacobian(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return dx/dxi in `cells` (n,), shape (n, d, d)."""
        return self._axes(self.spacing)[self.turns(cells)]

    def inverse_jacobian(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return dxi/dx in `cells` (n,), shape (n, d, d)."""
        return np.swapaxes(self._axes(1.0 / self.spacing), 1, 2)[self.turns(cells)]

    def _axes(self, length: npt.NDArray) -> npt.NDArray[np.float64]:
        """Return matrices (turns, d, d) whose column a points along reference axis a."""
        turns, d = self.axis.shape
        result = np.zeros((turns, d, d))
        for t, a in itertools.product(range(turns), range(d)):
            k = self.axis[t, a]
            result[t, k, a] = -length[k] if self.down[t, a] else length[k]
        return result

    def push_forward(
        self, cells: npt.NDArray[np.int32], xi: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Return positions in m of points with reference coordinates xi (n, d) in `cells` (n,)."""
        x = np.empty(xi.shape)
        _push_forward(self, cells, xi, x)
        return x


def find_boxes(
    comm: MPI.Intracomm, x: npt.NDArray[np.float64], nodes: npt.NDArray[np.int32], dim: int
) -> tuple[Boxes | None, float]:
    """Find out whether a mesh is a lattice of equal boxes. Collective.

    Args:
        comm: Communicator of the mesh.
        x: This rank's nodes in m, shape (n, 3).
        nodes: Nodes of each cell, shape (cells, vertices).
        dim: Dimension d of the cells.

    Returns:
        The lattice, or None if the mesh is none on some rank; and the largest distance of a node
        of any rank from its place, in units of a cell. Holes in the mesh are allowed.
    """
    nothing = None, np.inf
    if nodes.shape[1] != 2**dim:
        return nothing
    here = None
    if len(nodes):
        first = x[nodes[0], :dim]
        size = np.abs(first[2 ** np.arange(dim)] - first[0]).max(axis=0)
        here = (size, x.min(axis=0)[:dim], x.max(axis=0)[:dim])
    known = [bounds for bounds in comm.allgather(here) if bounds is not None]
    origin = np.min([lower for _, lower, _ in known], axis=0)
    extent = np.max([upper for _, _, upper in known], axis=0) - origin
    size = known[0][0]
    if not np.all((size > 0) & (extent < 2.0**31 * size)):
        return nothing
    shape = np.maximum(np.rint(extent / size), 1).astype(np.int64)
    spacing = extent / shape

    low, box = np.zeros(dim, dtype=np.int64), np.zeros(dim, dtype=np.int64)
    if here is not None:
        low = np.rint((here[1] - origin) / spacing).astype(np.int64)
        box = np.rint((here[2] - origin) / spacing).astype(np.int64) - low
    # A few cells in a large box (bodies far apart) must not cost much memory.
    fits = np.prod(box.astype(np.float64)) <= 8 * len(nodes) + 1000
    off = np.inf
    if fits:
        cell = np.full(np.prod(box), -1, dtype=np.int32)
        code = np.empty(len(nodes), dtype=np.uint8)
        off = _place_cells(x, nodes, origin, spacing, low, box, cell, code)
    off = comm.allreduce(float(off), MPI.MAX)
    if off > _SLACK:
        return nothing
    codes = np.flatnonzero(np.bincount(code, minlength=1))
    turn = np.searchsorted(codes, code).astype(np.uint8) if len(codes) > 1 else code[:0]
    turn = turn if len(turn) else np.zeros(1, dtype=np.uint8)
    digits = codes[:, None] // 6 ** np.arange(dim) % 6
    axis, down = digits // 2, digits % 2 == 1
    # from 0.10 on, dolfinx gives a copy of its table
    vertices = nodes if nodes.base is not None else nodes[:, :1].copy()
    return Boxes(origin, spacing, shape, low, box, cell, turn, axis, down, x, vertices), off


@njit
def _place_cells(  # type: ignore[no-untyped-def]
    x, nodes, origin, spacing, first, box, cell, code
):
    """Fill the tables of `Boxes`; the turn is coded in base 6.

    Digit a is twice the direction of reference axis a, plus one if the axis points downwards.

    Returns:
        Largest distance of a node from its place, in units of a cell; infinity if the cells are
        no boxes.
    """
    dim = len(origin)
    off = 0.0
    axis = np.empty(dim, np.int64)
    down = np.empty(dim, np.bool_)
    for c in range(len(nodes)):
        turn = 0
        seen = 0
        for a in range(dim - 1, -1, -1):
            longest = -1.0
            for k in range(dim):
                step = (x[nodes[c, 1 << a], k] - x[nodes[c, 0], k]) / spacing[k]
                if abs(step) > longest:
                    longest = abs(step)
                    axis[a] = k
                    down[a] = step < 0.0
            seen |= 1 << axis[a]
            turn = 6 * turn + 2 * axis[a] + int(down[a])
        if seen != (1 << dim) - 1:
            return np.inf
        code[c] = turn
        place = 0
        for k in range(dim):
            lowest = x[nodes[c, 0], k]
            for v in range(1, nodes.shape[1]):
                lowest = min(lowest, x[nodes[c, v], k])
            t = (lowest - origin[k]) / spacing[k]
            i = int(np.rint(t)) - first[k]
            if i < 0 or i >= box[k]:
                return np.inf
            place = place * box[k] + i
            for a in range(dim):
                if axis[a] == k:
                    for v in range(nodes.shape[1]):
                        upper = bool(v >> a & 1) != down[a]
                        t = (x[nodes[c, v], k] - origin[k]) / spacing[k]
                        off = max(off, abs(t - (first[k] + i + int(upper))))
        if cell[place] >= 0:
            return np.inf  # two cells at the same place
        cell[place] = c
    return off


@njit
def number_along(boxes: Boxes, c, k):  # type: ignore[no-untyped-def]
    """Return the number of cell c in direction k, from 0 at the origin.

    It follows from the cell's first vertex: a table would need memory for all empty cells, too.
    """
    t = boxes.turn[c] if len(boxes.turn) > 1 else boxes.turn[0]
    i = np.rint((boxes.x[boxes.vertices[c, 0], k] - boxes.origin[k]) / boxes.spacing[k])
    for a in range(len(boxes.box)):
        if boxes.axis[t, a] == k and boxes.down[t, a]:
            i -= 1.0
    return np.int64(i)


@njit
def _numbers(boxes: Boxes, cells, result):  # type: ignore[no-untyped-def]
    for n in range(len(cells)):
        for k in range(result.shape[1]):
            result[n, k] = number_along(boxes, cells[n], k)


@njit
def locate_in_boxes(boxes: Boxes, key, tolerance, count, x, cell, xi):  # type: ignore[no-untyped-def]
    """Find cells `cell` (n,), -1 for none, and reference coordinates xi (n, d) of points x (n, d).

    Only the first `count` cells are searched. A point within the tolerance of a facet is in the
    cell of lowest `key` that touches it.
    """
    n, d = x.shape
    for p in range(n):
        place = 0
        near = False
        inside = True
        for i in range(d):
            t = (x[p, i] - boxes.origin[i]) / boxes.spacing[i] - boxes.first[i]
            if not -tolerance <= t <= boxes.box[i] + tolerance:
                inside = False
                break
            k = min(int(t), boxes.box[i] - 1)
            place = place * boxes.box[i] + k
            s = t - k
            near |= s <= tolerance or s >= 1.0 - tolerance
            xi[p, i] = s
        c = -1
        if inside:
            if near:
                c = _touching(boxes, key, tolerance, count, place, xi[p])
            elif boxes.cell[place] < count:
                c = boxes.cell[place]
        cell[p] = c
        if c < 0:
            xi[p] = 0.0
        else:
            _turn(boxes, c, xi[p])


@njit
def all_owned(boxes: Boxes, count, lower, upper):  # type: ignore[no-untyped-def]
    """Return whether this rank owns all cells with numbers from ``lower`` to ``upper``.

    Args:
        boxes: The lattice.
        count: Number of cells that this rank owns.
        lower: Lowest number in each direction, shape (n, 3); 0 in directions that the lattice
            does not have.
        upper: Highest number, likewise.

    Returns:
        Mask of shape (n,).
    """
    result = np.ones(len(lower), dtype=np.bool_)
    d = len(boxes.box)
    for n in range(len(lower)):
        for k in range(d):
            result[n] &= lower[n, k] >= boxes.first[k]
            result[n] &= upper[n, k] < boxes.first[k] + boxes.box[k]
        if not result[n]:
            continue
        for i in range(lower[n, 0], upper[n, 0] + 1):
            for j in range(lower[n, 1], upper[n, 1] + 1):
                for k in range(lower[n, 2], upper[n, 2] + 1):
                    place = (i - boxes.first[0]) * boxes.box[1] + j - boxes.first[1]
                    if d == 3:
                        place = place * boxes.box[2] + k - boxes.first[2]
                    cell = boxes.cell[place]
                    result[n] &= 0 <= cell < count
    return result


@njit
def _touching(boxes: Boxes, key, tolerance, count, place, s):  # type: ignore[no-untyped-def]
    """Return the cell of lowest key that touches a point; s (d,) becomes the position in it.

    Args:
        boxes: The lattice.
        key: Keys of the cells.
        tolerance: Distance up to which cells touch a point, in units of a cell.
        count: Number of cells to consider.
        place: A place that touches the point.
        s: Position of the point at this place, from 0 to 1 up to the tolerance.
    """
    d = len(s)
    best, best_way = -1, 0
    for way in range(1 << d):
        stride = 1
        rest = place
        other = place
        for i in range(d - 1, -1, -1):
            k = rest % boxes.box[i]
            rest //= boxes.box[i]
            if way >> i & 1:
                step = _step(s[i], tolerance)
                if step == 0 or k + step < 0 or k + step >= boxes.box[i]:
                    other = -1
                    break
                other += step * stride
            stride *= boxes.box[i]
        if other >= 0:
            c = boxes.cell[other]
            if 0 <= c < count and (best < 0 or key[c] < key[best]):
                best, best_way = c, way
    for i in range(d):
        if best_way >> i & 1:
            s[i] -= _step(s[i], tolerance)
    return best


@njit
def _step(s, tolerance):  # type: ignore[no-untyped-def]
    """Return the neighbour near a position s in a cell: -1 below, 1 above, 0 none."""
    return -1 if s <= tolerance else 1 if s >= 1.0 - tolerance else 0


@njit
def _turn(boxes: Boxes, c, s):  # type: ignore[no-untyped-def]
    """Turn the position s (d,) along the lattice directions into reference coordinates."""
    t = boxes.turn[c] if len(boxes.turn) > 1 else boxes.turn[0]
    s0, s1, s2 = s[0], s[1], s[len(s) - 1]
    for a in range(len(s)):
        k = boxes.axis[t, a]
        along = s0 if k == 0 else s1 if k == 1 else s2
        s[a] = 1.0 - along if boxes.down[t, a] else along


@njit
def pull_back_to_boxes(boxes: Boxes, x, cell, xi):  # type: ignore[no-untyped-def]
    """Compute reference coordinates xi (n, d) of points x (n, d) in given cells (n,)."""
    for p in range(len(x)):
        for i in range(x.shape[1]):
            t = (x[p, i] - boxes.origin[i]) / boxes.spacing[i]
            xi[p, i] = t - number_along(boxes, cell[p], i)
        _turn(boxes, cell[p], xi[p])


@njit
def _push_forward(boxes: Boxes, cell, xi, x):  # type: ignore[no-untyped-def]
    d = xi.shape[1]
    for p in range(len(xi)):
        c = cell[p]
        t = boxes.turn[c] if len(boxes.turn) > 1 else boxes.turn[0]
        for a in range(d):
            x[p, boxes.axis[t, a]] = 1.0 - xi[p, a] if boxes.down[t, a] else xi[p, a]
        for i in range(d):
            x[p, i] = boxes.origin[i] + (number_along(boxes, c, i) + x[p, i]) * boxes.spacing[i]
