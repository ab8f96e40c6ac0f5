# SPDX-License-Identifier: MIT
"""Forces at nodes with nearly no mass.

If points hardly reach a node, its mass is of the order of round-off, and forces would accelerate it
far too much. A node whose mass is below a fraction of the mean around it therefore takes less of
its force, or none. The rest goes to the nodes around it in proportion to their masses, so momentum
is conserved. The velocity of the node remains momentum divided by mass.

With linear functions, a point that has just entered a cell gives its far nodes hardly any mass, but
its full share of stress: an element whose node has the fraction s of its mass needs ``(c dt / h)^2
< 2 s``. In that case points are deformed by their new velocities, mapped back to the nodes
(D. Sulsky, S.-J. Zhou, H. L. Schreyer, Computer Physics Communications 87, 1995). A light node may
then have a large acceleration, but the points feel it only in proportion to its mass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from fenicsmpm._njit import njit

Array = npt.NDArray[np.float64]

# Fraction of the mean mass around a node below which it is light for the points' own forces. It
# only excludes divisions of round-off by round-off.
LIGHT = 1e-8
# The same fraction for loads, which act at surfaces, where functions end
LIGHT_FOR_LOADS = 0.01


class LightNodes:
    """Redistribution of forces at nodes with nearly no mass.

    Args:
        space: Lagrange space of degree 1, scalar or blocked, whose nodes are used. Collective.
    """

    def __init__(self, space: fem.FunctionSpace) -> None:
        """Count the nodes of the cells around each node."""
        self._space = space
        topology = space.mesh.topology
        self._cells = space.dofmap.list[: topology.index_map(topology.dim).size_local]
        nodes = space.dofmap.index_map
        self._counts = self._sum_over_cells(np.ones((nodes.size_local + nodes.num_ghosts, 1)))

    def relieve(self, mass: Array, force: Array, threshold: float, gradually: bool) -> None:
        """Move forces from light nodes to those around them. Collective.

        Args:
            mass: Masses in kg of all local nodes, ghosts up to date, ``(n_nodes,)``.
            force: Forces in N of these nodes, changed in place, ``(n_nodes, d)``.
            threshold: Fraction of the mean mass around a node, below which it is light.
            gradually: Whether a light node keeps a share that grows with its mass; else none.
        """
        total = self._sum_over_cells(mass[:, None])
        limit = threshold * (total / self._counts)[:, 0]
        light = mass < limit
        if not self._space.mesh.comm.allreduce(bool(force[light].any())):
            return
        given = np.zeros_like(force)
        given[light] = force[light]
        if gradually:
            given[light] *= (1 - mass[light] / limit[light])[:, None]
        force -= given
        given[light] /= total[light]
        force += mass[:, None] * self._sum_over_cells(given)

    def _sum_over_cells(self, values: Array) -> Array:
        """Sum nodal values ``(n_nodes, k)`` over all nodes of all cells at each node."""
        result = la.vector(self._space.dofmap.index_map, values.shape[1])
        result.array[:] = 0.0
        sums = result.array.reshape(values.shape)
        _add_cells(self._cells, values, sums)
        result.scatter_reverse(la.InsertMode.add)
        result.scatter_forward()
        return sums


@njit
def _add_cells(cells: Any, values: Any, sums: Any) -> None:
    total = np.empty(values.shape[1])
    for c in range(len(cells)):
        total[:] = 0.0
        for a in cells[c]:
            for k in range(len(total)):
                total[k] += values[a, k]
        for a in cells[c]:
            for k in range(len(total)):
                sums[a, k] += total[k]
