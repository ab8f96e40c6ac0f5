# SPDX-License-Identifier: MIT
"""Linear functions, uGIMP and splines of the nodes of a lattice at material points."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import basix
import basix.ufl
import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm import _compat
from fenicsmpm._njit import njit
from fenicsmpm.basis.lagrange import is_linear
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.basis.lines import CUBIC, GIMP, LINEAR, QUADRATIC, WIDTH, tabulate_line
from fenicsmpm.basis.stencil import LEAST, derivative_rows, round_off
from fenicsmpm.points.agreement import raise_together
from fenicsmpm.points.boxes import number_along
from fenicsmpm.points.sorting import sort_by_number

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints

KINDS = {
    "linear": LINEAR, "quadratic": QUADRATIC, "cubic": CUBIC, "gimp": GIMP, "cpgimp": GIMP,
}  # fmt: skip
# Number of points that a thread treats with one piece of work memory
_CHUNK = 1024
# Number of groups whose nodes are searched at a time
_BLOCK = 1 << 10


class LatticeStencil:
    """Point stencil of products of the functions in ``lines``, one for each node of the mesh.

    These functions replace those of Lagrange spaces of degree 1. A group is a cell for linear and
    cubic functions. For quadratic functions and uGIMP it is a box around a node, of the size of a
    cell. If the box of nodes that a group sees extends beyond the mesh, the nodes at the wall are
    repeated with functions that are zero.

    Args:
        points: The point set.
        name: "linear", "quadratic", "cubic", "gimp" or "cpgimp".
        half_size: Half of the points' initial size in m, ``(d,)`` or one number, for the last two.

    Attributes:
        kind: Stencils of the same kind on a mesh have the same groups.
        groups_are_cells: Whether groups are cells.
    """

    def __init__(self, points: Any, name: str, half_size: npt.ArrayLike | None = None) -> None:
        """Find the groups of the mesh and the nodes that they see. Collective.

        Raises:
            ValueError: On all ranks, for meshes that are no lattices, sizes that are not positive
                or larger than half a cell, and ranks that lack ghost cells.
        """
        self._half = half_size_in_cells(points.mesh, name, half_size)
        self.name = name
        self._kind = KINDS[name]
        # The points are the key of the stencil registry: a strong reference would keep them alive.
        self._points: weakref.ref[MaterialPoints] = weakref.ref(points)
        mesh = points.mesh
        self._lattice = lattice = lattice_of(mesh)
        self._dim = len(lattice.shape)
        self._width = WIDTH[self._kind]
        self.groups_are_cells = self._kind in (LINEAR, CUBIC)
        self.kind = f"{'cells' if self.groups_are_cells else 'nodes'} {self._width}"
        self._element = basix.create_element(basix.ElementFamily.P, mesh.basix_cell(), 1)
        self._nodes = self._find_groups()
        raise_together(mesh.comm, self._unseen())
        # by id; the space (which has no hash) is stored so that its id stays valid
        self._dofs: dict[int, tuple[Any, npt.NDArray[np.int32]]] = {}
        self._version = -1
        self._order = self._offsets = np.empty(0, dtype=np.int64)
        self._tables: dict[int, npt.NDArray[np.float64]] = {}

    # --- groups ------------------------------------------------------------------------------

    def _find_groups(self) -> npt.NDArray[np.int32]:
        """Return local nodes that each group sees, -1 if not here, ``(n_groups, n_nodes)``."""
        lattice = self._lattice
        self._first = self._find_first()
        steps = np.array(list(itertools.product(range(self._width), repeat=self._dim)))
        result = np.empty((len(self._first), len(steps)), dtype=np.int32)
        for some in self._blocks():
            numbers = self._first[some, None, :] + steps
            result[some] = lattice.nodes(np.clip(numbers, 0, lattice.shape))
        return result

    def _find_first(self) -> npt.NDArray[np.int32]:
        """Return the number of the lowest node that each group sees, ``(n_groups, d)``."""
        lattice, dim = self._lattice, self._dim
        count = lattice.geometry.num_owned
        if self.groups_are_cells:
            first = np.empty((count, dim), dtype=np.int32)
            for cells in lattice.geometry.blocks(count):
                first[cells] = lattice.numbers(cells) - int(self._kind == CUBIC)
            return first
        ends = np.array(list(itertools.product((0, 1), repeat=dim)))
        # groups are around nodes, by local numbers of the nodes of this rank's cells
        n = len(self.points.mesh.geometry.x)
        at_node, group = np.empty((n, dim), dtype=np.int32), np.full(n, -1, dtype=np.int32)
        self._group_of = np.empty((count, 2**dim), dtype=np.int32)
        for cells in lattice.geometry.blocks(count):
            numbers = lattice.numbers(cells)[:, None, :] + ends
            nodes = lattice.nodes(numbers)
            at_node[nodes], group[nodes], self._group_of[cells] = numbers, 0, nodes
        seen = np.flatnonzero(group == 0)
        group[seen] = np.arange(len(seen))
        for cells in lattice.geometry.blocks(count):
            self._group_of[cells] = group[self._group_of[cells]]
        return at_node[seen] - 1

    def _blocks(self) -> Iterator[slice]:
        """Yield slices of all groups, some at a time."""
        for start in range(0, len(self._first), _BLOCK):
            yield slice(start, start + _BLOCK)

    def _unseen(self) -> ValueError | None:
        steps = np.array(list(itertools.product(range(self._width - 1), repeat=self._dim)))
        last = self._lattice.shape - 1
        cells = (self._first[some, None, :] + steps for some in self._blocks())
        if np.all(self._nodes >= 0) and all(
            np.all(self._lattice.cells(np.clip(numbers, 0, last)) >= 0) for numbers in cells
        ):
            return None
        return ValueError(
            f"points with {self.name} functions see nodes of cells that touch theirs in a corner, "
            "which this mesh does not have on each rank: create it with "
            "partitioner=fenicsmpm.basis.shared_vertex_partitioner"
        )

    @property
    def points(self) -> MaterialPoints:
        """Return the point set."""
        points = self._points()
        assert points is not None
        return points

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Storage index of each point, in the order of groups, shape ``(n_points,)``."""
        self._refresh()
        return self._order

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Range of the points of each group within ``order``, shape ``(n_groups + 1,)``."""
        self._refresh()
        return self._offsets

    @property
    def n_owned_groups(self) -> int:
        """Number of groups; all of them can hold points."""
        return len(self._nodes)

    @property
    def least(self) -> npt.NDArray[np.float64]:
        """Fraction of the largest function below which others may be round-off, ``(n_groups,)``."""
        return np.full(len(self._nodes), round_off(self._lattice.geometry).max(initial=0.0))

    def _refresh(self) -> None:
        if self._version == self.points.version:
            return
        self._version = self.points.version
        self._tables = {}
        points, lattice = self.points, self._lattice
        if self.groups_are_cells:
            group = points.cell
        else:
            group = np.empty(len(points), dtype=np.int32)
            _find_boxes(points.x, points.cell, lattice.boxes, self._group_of, group)
        self._order, self._offsets = sort_by_number(group, len(self._nodes))

    def n_functions(self, element: Any) -> int:
        """Return the number of functions that a group sees, the same for all scalar elements."""
        return self._nodes.shape[1]

    def dofs(self, space: Any) -> npt.NDArray[np.int32]:
        """Return blocks of a function space that each group sees, shape ``(n_groups, n)``.

        In mixed spaces the blocks are ordered subspace by subspace.

        Raises:
            ValueError: For spaces other than Lagrange of degree 1.
        """
        if id(space) not in self._dofs:
            n, width = self._nodes.shape
            parts = self._node_blocks(space)
            columns = [part[self._nodes].reshape(n, width * part.shape[1]) for part in parts]
            self._dofs[id(space)] = space, np.hstack(columns)
        return self._dofs[id(space)][1]

    def _node_blocks(self, space: Any) -> list[npt.NDArray[np.int32]]:
        """Return blocks of the nodes for each subspace, ``(n_mesh_nodes, size)``."""
        element = space.ufl_element()
        mixed = isinstance(element, basix.ufl._MixedElement)
        result = []
        first = 0
        nodes = _compat.geometry_dofmap(self.points.mesh)
        blocks = space.dofmap.list
        for leaf in _leaves(element):
            if not is_linear(leaf):
                raise ValueError(
                    f"{self.name} functions stand for those of a continuous Lagrange space of "
                    f"degree 1, not of {leaf}: use such a space, or a field of the points"
                )
            size = leaf.block_size if mixed else 1
            n = nodes.shape[1] * size
            of_cells = blocks[:, first : first + n].reshape(*nodes.shape, size)
            of_nodes = np.zeros((len(self.points.mesh.geometry.x), size), dtype=np.int32)
            of_nodes[nodes] = of_cells
            if not np.array_equal(of_nodes[nodes], of_cells):
                raise ValueError(
                    f"{self.name} functions need a space with one function per node and component"
                )
            result.append(of_nodes)
            first += n
        return result

    # --- functions ---------------------------------------------------------------------------

    def table(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        """Tabulate values and derivatives of the functions at the points.

        Args:
            element: Scalar element whose functions are replaced.
            derivatives: Highest order of derivatives, 0 to 2.

        Returns:
            Table of shape ``(n_points, n_rows, n_nodes)``, see ``PointStencil.table``.
        """
        self._refresh()
        if derivatives not in self._tables:
            self._tables[derivatives] = self._tabulate(derivatives)
        return self._tables[derivatives]

    def _tabulate(self, derivatives: int, least: float = 0.0) -> npt.NDArray[np.float64]:
        points, lattice, dim = self.points, self._lattice, self._dim
        rows = [
            [directions.count(k) for k in range(3)]
            for order in range(derivatives + 1)
            for directions in itertools.product(range(dim), repeat=order)
        ]
        table = np.empty((len(points), derivative_rows(derivatives, dim), self._nodes.shape[1]))
        _tabulate(
            self._kind, points.x, points.cell, self._order, lattice.boxes, self._halves(),
            self._width, np.array(rows), least, table,
        )  # fmt: skip
        return table

    def _halves(self) -> npt.NDArray[np.float64]:
        """Return current half sizes of the points in units of a cell, ``(n_points or 1, d)``."""
        half = self._half[None]
        points, dim = self.points, self._dim
        if self.name != "cpgimp" or "F" not in points:
            return half
        F = points["F"][:, :dim, :dim]
        values, axes = np.linalg.eigh(F @ F.transpose(0, 2, 1))
        # stretches along the axes: diagonal of V with V V = F F^T
        stretch = np.einsum("pik,pk,pik->pi", axes, np.sqrt(np.maximum(values, 0.0)), axes)
        return np.minimum(half * stretch, 0.5)

    def positive_table(self, element: Any) -> npt.NDArray[np.float64]:
        """Tabulate values of the functions, such that those with a slope are not zero.

        Args:
            element: Scalar element whose functions are replaced.

        Returns:
            Table of shape ``(n_points, n_nodes)``, see ``PointStencil.positive_table``.
        """
        self._refresh()
        return self._tabulate(0, LEAST)[:, 0]

    def seen_cells(self, which: npt.NDArray[np.bool_] | None = None) -> npt.NDArray[np.int32]:
        """Return cells all of whose nodes are seen, see ``PointStencil.seen_cells``."""
        values = self.table(self._element, 0)[:, 0, :]
        if which is not None:
            values = np.where(which[self._order, None], values, 0.0)
        side = range(self._width - 1)
        steps = np.array(list(itertools.product(side, repeat=self._dim)))
        ends = np.array(list(itertools.product((0, 1), repeat=self._dim)))
        corners = (steps[:, None, :] + ends) @ self._width ** np.arange(self._dim)[::-1]
        seen = np.zeros((len(self._nodes), len(steps)), dtype=np.bool_)
        _mark_cells(values, self._offsets, corners, self.least, seen)
        group, step = np.nonzero(seen)
        return np.unique(self._lattice.cells(self._first[group] + steps[step]))


def half_size_in_cells(
    mesh: Any, name: str, half_size: npt.ArrayLike | None
) -> npt.NDArray[np.float64]:
    """Return half of the points' size in units of a cell, ``(d,)``. Collective.

    Functions without a point size have one half.

    Args:
        mesh: A lattice.
        name: Name of the grid functions.
        half_size: Half size in m, ``(d,)`` or one number, for uGIMP and cpGIMP.

    Raises:
        ValueError: On all ranks, for unknown names, meshes that are no lattices, and sizes that
            are not positive or larger than half a cell.
    """
    if name not in KINDS:
        raise ValueError(f"unknown grid functions {name!r}: choose one of {', '.join(KINDS)}")
    spacing = lattice_of(mesh).spacing
    dim = len(spacing)
    if (half_size is not None) != (KINDS[name] == GIMP):
        raise ValueError(
            "'gimp' and 'cpgimp' need half_size, half of the size of a point; other functions do "
            f"not take it: {name!r} with half_size={half_size!r}"
        )
    if half_size is None:
        return np.full(dim, 0.5)
    half = np.array(half_size, dtype=np.float64)
    if half.shape not in ((), (dim,)):
        raise ValueError(
            f"half_size must be one number or have the shape ({dim},), not {half.shape}"
        )
    half = half / spacing
    if not np.all((half > 0) & (half <= 0.5 + 1e-9)):
        raise ValueError(
            f"half_size must be above 0 and at most half a cell, {spacing / 2} m, not {half_size!r}"
        )
    return np.minimum(half, 0.5)


def _leaves(element: Any) -> list[Any]:
    """Return scalar and blocked elements of a mixed one, in the order of its dofs."""
    if isinstance(element, basix.ufl._MixedElement):
        return [leaf for sub in element.sub_elements for leaf in _leaves(sub)]
    return [element]


@njit
def _position(boxes, x, i, k):  # type: ignore[no-untyped-def]
    """Return the position from 0 to 1 in cell i of direction k, without round-off outside."""
    return min(max((x - boxes.origin[k]) / boxes.spacing[k] - i, 0.0), 1.0)


@njit(parallel=True)
def _find_boxes(x, cell, boxes, group_of, group):  # type: ignore[no-untyped-def]
    """Find the group of each point from those of the quarters (eighths) of its cell."""
    dim = x.shape[1]
    for p in numba.prange(len(x)):
        part = 0
        for k in range(dim):
            if _position(boxes, x[p, k], number_along(boxes, cell[p], k), k) >= 0.5:
                part += 1 << (dim - 1 - k)
        group[p] = group_of[cell[p], part]


@njit(parallel=True)
def _tabulate(  # type: ignore[no-untyped-def]
    kind, x, cell, order, boxes, half, width, rows, least, table
):
    """Write products of the functions along lines into ``table (n_points, n_rows, n_nodes)``.

    ``rows (n_rows, 3)`` holds the orders of derivatives in each direction. Along a line, functions
    with a slope that is not zero get at least the value ``least``.
    """
    n, dim = x.shape
    nz = width if dim == 3 else 1
    for chunk in numba.prange((n + _CHUNK - 1) // _CHUNK):
        lines = np.ones((3, 3, width))
        for k in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            p = order[k]
            for m in range(dim):
                i = number_along(boxes, cell[p], m)
                t = _position(boxes, x[p, m], i, m)
                tabulate_line(kind, i, t, boxes.shape[m], half[p % len(half), m], lines[m])
                for a in range(width):
                    if least > 0.0 and abs(lines[m, 1, a]) > 1e-6:  # a slope, not round-off
                        lines[m, 0, a] = max(lines[m, 0, a], least)
                    lines[m, 1, a] /= boxes.spacing[m]
                    lines[m, 2, a] /= boxes.spacing[m] * boxes.spacing[m]
            for r in range(len(rows)):
                first, second, third = lines[0, rows[r, 0]], lines[1, rows[r, 1]], lines[2, 0]
                if dim == 3:
                    third = lines[2, rows[r, 2]]
                target = table[k, r]
                b = 0
                for i in range(width):
                    for j in range(width):
                        both = first[i] * second[j]
                        for m in range(nz):
                            target[b] = both * third[m]
                            b += 1


@njit
def _mark_cells(values, offsets, corners, least, seen):  # type: ignore[no-untyped-def]
    """Mark cells ``seen (n_groups, n_cells)`` all of whose corners some point sees."""
    for g in range(len(offsets) - 1):
        for k in range(offsets[g], offsets[g + 1]):
            for c in range(len(corners)):
                if not seen[g, c]:
                    all_seen = True
                    for corner in corners[c]:
                        all_seen = all_seen and abs(values[k, corner]) > least[g]
                    seen[g, c] = all_seen
