# SPDX-License-Identifier: MIT
"""Dirichlet conditions at the nodes of a lattice's tiles, and their reaction forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm import _compat
from fenicsmpm.solvers.checks import check_bcs
from fenicsmpm.transfer.sharing import DofLink, NodeNumbers, Sharing
from fenicsmpm.transfer.tiles import Nodes

Array = npt.NDArray[np.float64]


class Supports:
    """Dirichlet conditions on velocities, at the nodes of all ranks that have them.

    Args:
        V: Space of velocities, linear, with a block of d components per node.
        bcs: Conditions on V or its components.
        numbers: Numbers of the nodes of V.

    Attributes:
        now: Rows of the nodes, components, and their values in m/s, each ``(n,)``.
        forces: Reaction forces in N of the last step, on the one rank that counts each, ``(n,)``.
    """

    forces: Array

    def __init__(
        self, V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC], numbers: NodeNumbers
    ) -> None:
        """Check the conditions. Collective."""
        check_bcs(bcs, V)
        self._bcs, self._dim, index_map = list(bcs), V.mesh.geometry.dim, V.dofmap.index_map
        dofs = _compat.fixed_dofs(bcs)
        # values at ghosts may differ from those of their owners by round-off
        self._dofs = dofs[dofs < index_map.size_local * self._dim]
        self._x = numbers.positions(self._dofs // self._dim)
        # conditions write to an array over the whole lattice: only the pages used take memory
        count = (index_map.size_local + index_map.num_ghosts) * self._dim
        self._values = np.zeros(count if bcs else 0)

    def find(self, sharing: Sharing, nodes: Nodes) -> None:
        """Find the rows of the nodes, and read the values. Collective."""
        self._link = DofLink(sharing, nodes, self._x)
        self._rows = len(sharing.layout.ids) * nodes.per_tile
        self._components = self._link.spread((self._dofs % self._dim).astype(np.int64))
        self.read()

    def read(self) -> None:
        """Read the current values. Collective."""
        for bc in self._bcs:
            _compat.bc_set(bc, self._values, None, 1.0)
        values = self._link.spread(self._values[self._dofs])
        self.now = self._link.places, self._components, values

    def forces_at_dofs(self) -> Callable[[], tuple[npt.NDArray[np.int32], Array]]:
        """Return a function for this rank's owned dofs and the present forces there. Collective."""
        link, dofs, dim = self._link, self._dofs, self._dim
        places, components, forces, rows = *self.now[:2], self.forces, self._rows

        def find() -> tuple[npt.NDArray[np.int32], Array]:
            values, nodal = np.zeros((rows, dim)), np.zeros((len(dofs), dim))
            values[places, components] = forces
            link.collect(values, np.arange(len(dofs), dtype=np.int32), nodal)
            return dofs, nodal[np.arange(len(dofs)), dofs % dim]

        return find
