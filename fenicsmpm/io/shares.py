# SPDX-License-Identifier: MIT
"""What a rank has of points or grid functions, in the form in which VTK shows it."""

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

VERTEX = 1  # VTK's number of the type


class PointShare:
    """This rank's points of one set or several.

    Args:
        bodies: the sets; of several one after the other, with the fields that all have.

    Attributes:
        comm: communicator of the ranks.
        names: of what is there beside positions, "id" first.
        grid: what decides whether cells are those of another time.
        moves: whether positions change.
    """

    moves = True

    def __init__(self, bodies: Sequence[MaterialPoints]) -> None:
        """Take them as they are."""
        self._bodies = bodies
        self.comm: MPI.Intracomm = bodies[0].mesh.comm
        self.names = names_of_points(bodies)
        self.grid: Mesh | int = sum(body.size_global for body in bodies)

    def x(self) -> npt.NDArray[np.float64]:
        """Positions, shape (n, 3) [m]."""
        return self.values("x")

    def cells(self) -> Cells:
        """A vertex for each point (collective)."""
        n = sum(len(body) for body in self._bodies)
        begin = sum(self.comm.allgather(n)[: self.comm.rank])
        return Cells(np.arange(begin, begin + n, dtype=np.int64).reshape(-1, 1), VERTEX)

    def values(self, name: str) -> npt.NDArray:
        """Values of a field, shape (n,) or (n, width)."""
        parts = [in_space(np.asarray(body[name])) for body in self._bodies]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


class FunctionShare:
    """Values of functions at the nodes of the mesh that this rank owns.

    Args:
        functions: Lagrange functions of degree 1 (or Q1) on one mesh of straight cells.

    Attributes:
        comm: communicator of the ranks.
        names: of the functions.
        grid: what decides whether cells are those of another time.
        moves: whether positions change.

    Raises:
        ValueError: see ``gather_functions``.
    """

    moves = False

    def __init__(self, functions: Sequence[fem.Function]) -> None:
        """Take them as they are."""
        self.grid: Mesh | int = check_functions(functions)
        self._mesh = functions[0].function_space.mesh
        self._functions = {f.name: f for f in functions}
        self.comm: MPI.Intracomm = self._mesh.comm
        self.names = list(self._functions)
        self._n = self._mesh.geometry.index_map().size_local

    def x(self) -> npt.NDArray[np.float64]:
        """Positions, shape (n, 3) [m]."""
        return self._mesh.geometry.x[: self._n]

    def cells(self) -> Cells:
        """The mesh's cells."""
        cells, types, _ = plot.vtk_mesh(self._mesh)
        n_nodes = _compat.geometry_dofmap(self._mesh).shape[1]
        nodes = cells.reshape(-1, n_nodes + 1)[:, 1:].astype(np.int32)
        numbers = self._mesh.geometry.index_map().local_to_global(nodes.ravel())
        kind = int(types[0]) if len(types) else 0
        return Cells(np.asarray(numbers, np.int64).reshape(-1, n_nodes), kind)

    def values(self, name: str) -> npt.NDArray:
        """Values of a function, shape (n,) or (n, width)."""
        return in_space(at_nodes(self._functions[name])[: self._n])
