# SPDX-License-Identifier: MIT
"""The lattice's nodes in an explicit step: rows of numbers, momentum balance, conditions.

Nodes are numbered through, the last direction fastest, whatever dolfinx' numbers are. Each thread
adds its points to rows of its own; they are summed up in the order of threads. Bodies have rows of
their own, too, because volumes and J of different bodies do not mix.
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm._njit import njit
from fenicsmpm.basis.lattice import Lattice
from fenicsmpm.lanes import LANES, LINE_LANES, prefetch
from fenicsmpm.solvers.checks import check_bcs

# Rows that are fetched from memory ahead of the one that is worked on
_AHEAD = 64


class Nodes(NamedTuple):
    """Nodes of a lattice on all ranks, for compiled loops.

    In the plane, the third direction has one node.

    Attributes:
        origin: ``(3,)`` lowest node [m].
        per_metre: ``(3,)`` cells per metre.
        shape: ``(3,)`` number of nodes in each direction.
    """

    origin: npt.NDArray[np.float64]
    per_metre: npt.NDArray[np.float64]
    shape: npt.NDArray[np.int64]

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape))

    def numbers(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Numbers of the nodes at positions ``(n, 3)`` [m]."""
        index = np.rint((x - self.origin) * self.per_metre).astype(np.int64)
        numbers = np.ravel_multi_index(tuple(index.T), tuple(self.shape))
        return np.asarray(numbers, dtype=np.int64)

    def nearest(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """Numbers of the nodes next to positions ``(n, d)`` [m]."""
        return _nearest(self, np.ascontiguousarray(x))


def nodes_of(lattice: Lattice) -> Nodes:
    """Nodes of a lattice."""
    dim = len(lattice.spacing)
    origin, per_metre, shape = np.zeros(3), np.ones(3), np.ones(3, dtype=np.int64)
    origin[:dim] = lattice.origin
    per_metre[:dim] = 1.0 / lattice.spacing
    shape[:dim] = lattice.shape + 1
    return Nodes(origin, per_metre, shape)


@njit
def _nearest(nodes, x):
    numbers = np.empty(len(x), np.int64)
    for p in range(len(x)):
        number = np.int64(0)
        for k in range(x.shape[1]):
            t = (x[p, k] - nodes.origin[k]) * nodes.per_metre[k]
            number = number * nodes.shape[k] + int(t + 0.5)
        numbers[p] = number
    return numbers


class Constraints(NamedTuple):
    """Prescribed components of velocities.

    Attributes:
        nodes: ``(n,)`` numbers.
        components: ``(n,)`` 0, 1 or 2.
        values: ``(n,)`` [m/s].
    """

    nodes: npt.NDArray[np.int64]
    components: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]


class Supports:
    """Dirichlet conditions on velocities, known to all ranks.

    Args:
        nodes: of V's mesh.
        V: space of velocities, linear, with a block of d components a node.
        bcs: conditions on V or its components.
    """

    def __init__(self, nodes: Nodes, V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> None:
        """Find the nodes (collective)."""
        check_bcs(bcs, V)
        self._V, self._bcs, self._value = V, list(bcs), fem.Function(V)
        dim, owned = V.mesh.geometry.dim, V.dofmap.index_map.size_local
        dofs = _compat.fixed_dofs(bcs)
        # values at ghosts may differ from their owners' by round-off
        self._dofs = dofs[dofs < owned * dim]
        mine = nodes.numbers(V.tabulate_dof_coordinates()[self._dofs // dim])
        self._nodes = np.concatenate(V.mesh.comm.allgather(mine))
        self._components = np.concatenate(V.mesh.comm.allgather(self._dofs % dim)).astype(np.int64)

    def now(self) -> Constraints:
        """Nodes, components and their values now (collective)."""
        for bc in self._bcs:
            _compat.bc_set(bc, self._value.x.array, None, 1.0)
        mine = self._value.x.array[self._dofs]
        values = np.concatenate(self._V.mesh.comm.allgather(mine))
        return Constraints(self._nodes, self._components, values)


def empty_rows(threads: int, nodes: int, lanes: int) -> npt.NDArray[np.float64]:
    """``(threads, nodes, lanes)`` zeros, each row or line within a cache line."""
    size = threads * nodes * lanes
    memory = np.zeros(size + LANES)
    skip = (-memory.ctypes.data // memory.itemsize) % LANES
    return memory[skip : skip + size].reshape(threads, nodes, lanes)


@njit(parallel=True)
def clear(rows):
    """Zeros for all threads and nodes."""
    for n in numba.prange(rows.shape[1]):
        for t in range(rows.shape[0]):
            for i in range(rows.shape[2]):
                rows[t, n, i] = 0.0


@njit(parallel=True)
def sum_threads(rows):
    """Add the rows of all threads to those of the first."""
    for n in numba.prange(rows.shape[1]):
        for t in range(1, rows.shape[0]):
            for i in range(rows.shape[2]):
                rows[0, n, i] += rows[t, n, i]


@njit(parallel=True)
def add_body(rows, total):
    """Add the rows ``(nodes, 8)`` of another body to those of the first, but for the volume."""
    for n in numba.prange(len(rows)):
        for i in range(LANES):
            if i != 4:
                total[n, i] += rows[n, i]


@njit(parallel=True)
def sum_averages(lines, sums):
    """Add up the lines ``(threads, nodes, 4)`` of averages to ``(nodes,)``."""
    head = LINE_LANES - 1
    for n in numba.prange(len(sums)):
        total = 0.0
        for t in range(lines.shape[0]):
            prefetch(lines[t], n // 2 + _AHEAD)  # two lines are as long as a row
            if n >= head:  # without an inner loop it is four times faster
                total += lines[t, n, 0] + lines[t, n - 1, 1] + lines[t, n - 2, 2]
                total += lines[t, n - 3, 3]
            else:
                for c in range(n + 1):
                    total += lines[t, n - c, c]
        sums[n] = total


@njit(parallel=True)
def update_nodes(rows, dt, gravity, damping, least_mass):
    """New velocities of the nodes, eq. 9 (F-bar), with local damping.

    The damping force is that share of the unbalanced force, against the motion (Al-Kafaji,
    *Formulation of a dynamic material point method for geomechanical problems*, 2013).
    """
    for n in numba.prange(len(rows)):
        prefetch(rows, n + _AHEAD)
        m = rows[n, 0]
        if m > least_mass:
            per_mass = 1.0 / m
            for k in range(3):
                v = rows[n, 1 + k] * per_mass
                f = rows[n, 5 + k] + m * gravity[k]
                dv = dt * (f - damping * abs(f) * np.sign(v)) * per_mass
                rows[n, 1 + k] = v + dv
                rows[n, 5 + k] = dv
        else:
            for k in range(3):
                rows[n, 1 + k] = 0.0
                rows[n, 5 + k] = 0.0


@njit
def reactions(rows, dt, gravity, nodes, components, values):
    """Sum of the forces that prescribed velocities will need, ``(3,)`` [N], before the update.

    Supported nodes are not damped: the reaction to a body at rest is its weight.
    """
    total = np.zeros(3)
    for i in range(len(nodes)):
        n, k = nodes[i], components[i]
        m = rows[n, 0]
        total[k] += (m * values[i] - rows[n, 1 + k]) / dt - rows[n, 5 + k] - m * gravity[k]
    return total


@njit
def constrain(rows, nodes, components, values):
    """Prescribe velocities of updated nodes."""
    for i in range(len(nodes)):
        n, k = nodes[i], components[i]
        rows[n, 5 + k] += values[i] - rows[n, 1 + k]
        rows[n, 1 + k] = values[i]


@njit(parallel=True)
def average_nodes(rows, sums, lines):
    """Volume-averaged J at the nodes (F-bar, eq. 19) from its sums, in lines ``(nodes, 4)``.

    The rows ``(threads, nodes, 8)`` are cleared for the next step.
    """
    for n in numba.prange(len(sums)):
        prefetch(rows[0], n + _AHEAD)
        volume = rows[0, n, 4]
        # nodes at the edge of a point's support may have neither volume nor J
        sums[n] = sums[n] / volume if volume > 0.0 else 0.0
        for t in range(rows.shape[0]):
            for i in range(LANES):
                rows[t, n, i] = 0.0
    last = len(sums) - 1
    for n in numba.prange(len(sums)):
        for c in range(LINE_LANES):
            lines[n, c] = sums[min(n + c, last)]
