# SPDX-License-Identifier: MIT
"""One rank's part of points or grid functions, in the form of VTK."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem, plot
from dolfinx.mesh import Mesh

from fenicsmpm import _compat
from fenicsmpm.io.results import at_nodes, check_functions, in_space, names_of_points
from fenicsmpm.io.vtkhdf import Cells
from fenicsmpm.points import MaterialPoints

VERTEX = 1  # VTK's number of this cell type


class PointShare:
    """This rank's points of one set or several.

    Args:
        bodies: The sets, one after the other, with the fields that all have.

    Attributes:
        comm: Communicator of the ranks.
        names: Names of the arrays except positions, "id" first.
        grid: Value that differs if cells differ from those of another time.
        moves: Whether positions change.
    """

    moves = True

    def __init__(self, bodies: Sequence[MaterialPoints]) -> None:
        """Take the points as they are."""
        self._bodies = bodies
        self.comm: MPI.Intracomm = bodies[0].mesh.comm
        self.names = names_of_points(bodies)
        self.grid: Mesh | int = sum(body.size_global for body in bodies)

    def x(self) -> npt.NDArray[np.float64]:
        """Return positions in m, shape (n, 3)."""
        return self.values("x")

    def cells(self) -> Cells:
        """Return a vertex for each point. Collective."""
        n = sum(len(body) for body in self._bodies)
        begin = sum(self.comm.allgather(n)[: self.comm.rank])
        return Cells(np.arange(begin, begin + n, dtype=np.int64).reshape(-1, 1), VERTEX)

    def values(self, name: str) -> npt.NDArray:
        """Return values of a field, shape (n,) or (n, width)."""
        parts = [in_space(np.asarray(body[name])) for body in self._bodies]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


class FunctionShare:
    """Values of functions at the nodes of the mesh that this rank owns.

    Args:
        functions: Lagrange functions of degree 1 (or Q1) on one mesh of straight cells.

    Attributes:
        comm: Communicator of the ranks.
        names: Names of the functions.
        grid: Value that differs if cells differ from those of another time.
        moves: Whether positions change.

    Raises:
        ValueError: As for ``gather_functions``.
    """

    moves = False

    def __init__(self, functions: Sequence[fem.Function]) -> None:
        """Take the functions as they are."""
        self.grid: Mesh | int = check_functions(functions)
        self._mesh = functions[0].function_space.mesh
        self._functions = {f.name: f for f in functions}
        self.comm: MPI.Intracomm = self._mesh.comm
        self.names = list(self._functions)
        self._n = self._mesh.geometry.index_map().size_local

    def x(self) -> npt.NDArray[np.float64]:
        """Return positions in m, shape (n, 3)."""
        return self._mesh.geometry.x[: self._n]

    def cells(self) -> Cells:
        """Return the cells of the mesh."""
        cells, types, _ = plot.vtk_mesh(self._mesh)
        n_nodes = _compat.geometry_dofmap(self._mesh).shape[1]
        nodes = cells.reshape(-1, n_nodes + 1)[:, 1:].astype(np.int32)
        numbers = self._mesh.geometry.index_map().local_to_global(nodes.ravel())
        kind = int(types[0]) if len(types) else 0
        return Cells(np.asarray(numbers, np.int64).reshape(-1, n_nodes), kind)

    def values(self, name: str) -> npt.NDArray:
        """Return values of a function, shape (n,) or (n, width)."""
        return in_space(at_nodes(self._functions[name])[: self._n])
