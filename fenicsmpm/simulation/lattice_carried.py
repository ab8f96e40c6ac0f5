# SPDX-License-Identifier: MIT
"""Points that move along in an explicit simulation on a lattice, and may carry forces."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.basis.blocks import in_blocks, out_of_blocks, plain_order
from fenicsmpm.basis.lattice_stencil import half_size_in_cells
from fenicsmpm.basis.lines import WIDTH
from fenicsmpm.basis.windows import MARGIN
from fenicsmpm.points import MaterialPoints
from fenicsmpm.transfer.carriers import carriers
from fenicsmpm.transfer.grid_rows import COLUMNS
from fenicsmpm.transfer.tiles import Integers, Nodes, around, limits, reaches, sort_keys

Array = npt.NDArray[np.float64]


class Carried:
    """Points without material that move with the grid, and may carry forces.

    Args:
        points: Boundary points with a field "u".
        kind: Kind of the grid functions.
    """

    def __init__(self, points: MaterialPoints, kind: int) -> None:
        """Prepare the kernels, which are compiled at first use."""
        dim = points.mesh.geometry.dim
        self.points = points
        kernels = carriers(dim, kind)
        self._add_forces, self._follow, self._kind = kernels.add_forces, kernels.follow, kind
        self._half = half_size(points)
        self._x: Array | None = None

    def begin(self) -> None:
        """Copy the current positions."""
        self._order = plain_order(len(self.points))
        self._x = in_blocks(self.points.x, self._order)
        self._version = self.points.version

    @property
    def is_changed(self) -> bool:
        """Return whether somebody has changed the set of points."""
        return self.points.version != self._version

    def find(self, nodes: Nodes) -> tuple[Integers, Integers]:
        """Return first and last nodes ``(n_tiles, 3)`` that points of each tile may see.

        This holds until tiles are built anew.
        """
        width, dim = WIDTH[self._kind], self.points.mesh.geometry.dim
        x, margin = self.positions, MARGIN[dim]
        low, high = around(x, nodes, width, margin)
        self._t_low, self._t_high = limits(low, high, nodes, self._kind)
        keys, occupied = sort_keys(x, nodes, width)
        low, high = reaches(keys, nodes, occupied, width, margin)
        return low, high + width - 1

    @property
    def positions(self) -> Array:
        """Return the positions of the points in m, ``(n, d)``."""
        assert self._x is not None
        return out_of_blocks(self._x, self._order, len(self.points), self.points.x.shape[1:])

    def add_forces(
        self, force: Array, rows: Array, forces: Array, nodes: Nodes, ids: Integers
    ) -> int:
        """Add forces ``(n, d)`` in N to those of the nodes ``(n_tiles, nodes, 3)``.

        Returns:
            A point without any mass at its nodes, or -1.
        """
        return self._add_forces(
            nodes, ids, self._half, self._x, force, flat(rows), forces.reshape(-1, 3)
        )  # fmt: skip

    def follow(self, rows: Array, nodes: Nodes, ids: Integers, dt: float) -> tuple[int, bool]:
        """Move the points with the updated nodes.

        Returns:
            A point that has left the lattice, or -1; and whether a point has moved beyond the
            tiles.
        """
        bad, strays = self._follow(
            nodes, ids, self._half, self._x, len(self.points), self._t_low, self._t_high,
            flat(rows), dt,
        )  # fmt: skip
        return int(bad), bool(strays)

    def describe(self, point: int, what: str) -> str:
        """Return a message with the point and its position."""
        x = self.positions[point]
        return (
            f"point {self.points.id[point]} of a load {what} at {np.array2string(x, precision=6)}"
        )

    def settle(self) -> None:
        """Bring cells and displacements up to date. Collective.

        Changes by others since then are kept.
        """
        points = self.points
        if points.mesh.comm.allreduce(self.is_changed, MPI.LOR):
            return
        x = self.positions
        points.assign({"u": points["u"] + (x - points.x)})
        points.move(x)
        self._version = points.version


def flat(tiles: Array) -> Array:
    """Return the rows of all tiles, one after the other."""
    return tiles.reshape(-1, COLUMNS)


def half_size(points: MaterialPoints) -> Array:
    """Return half of the points' size in cells, ``(3,)``, for uGIMP only. Collective."""
    half = np.full(3, 0.5)
    if points.grid_functions is not None:
        given = half_size_in_cells(points.mesh, *points.grid_functions)
        half[: len(given)] = given
    return half
