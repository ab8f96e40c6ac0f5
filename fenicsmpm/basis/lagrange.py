# SPDX-License-Identifier: MIT
"""Lagrange functions of any degree on triangles, tetrahedra, quadrilaterals and hexahedra."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

import basix
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.stencil import LEAST, derivative_rows, round_off

if TYPE_CHECKING:
    from fenicsmpm.points.material_points import MaterialPoints


def is_linear(element: Any) -> bool:
    """Return whether a scalar or blocked UFL element is continuous Lagrange of degree 1.

    Args:
        element: UFL element of a function space.

    Returns:
        True for P1 and Q1 elements, scalar or blocked.
    """
    scalar = getattr(element, "basix_element", None)
    if scalar is None or element.reference_value_size != element.block_size:
        return False
    is_lagrange = scalar.family == basix.ElementFamily.P and not scalar.discontinuous
    return is_lagrange and scalar.degree == 1


class LagrangeStencil:
    """Point stencil of the finite elements of the background mesh: a group is a cell.

    Tables are kept for each element and order of derivatives until the points move.

    Args:
        points: The point set, or another object with its mesh, geometry, cell, xi, order, version.
    """

    kind = "elements"
    groups_are_cells = True

    def __init__(self, points: Any) -> None:
        """Create an empty cache; nothing is tabulated yet."""
        # The points are the key of the stencil registry: a strong reference would keep them alive.
        self._points: weakref.ref[MaterialPoints] = weakref.ref(points)
        self._geometry = points.geometry
        self._version = -1
        self._tables: dict[tuple[int, int], npt.NDArray[np.float64]] = {}
        self._gradients: dict[int, npt.NDArray[np.float64]] = {}

    @property
    def points(self) -> MaterialPoints:
        """Return the point set."""
        points = self._points()
        assert points is not None
        return points

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Storage index of each point, in the order of cells, shape ``(n_points,)``."""
        return self.points.order

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Range of the points of each local cell within ``order``, shape ``(n_cells + 1,)``."""
        return self.points.cell_offsets

    @property
    def least(self) -> npt.NDArray[np.float64]:
        """Fraction of the largest function below which others may be round-off, ``(n_cells,)``."""
        return round_off(self._geometry)

    @property
    def n_owned_groups(self) -> int:
        """Number of cells owned by this rank."""
        topology = self.points.mesh.topology
        return topology.index_map(topology.dim).size_local

    def dofs(self, space: Any) -> npt.NDArray[np.int32]:
        """Return the cell dofmap of a function space (blocks), ``(n_cells, n_nodes)``."""
        return space.dofmap.list

    def n_functions(self, element: Any) -> int:
        """Return the number of functions of a scalar element in a cell."""
        return element.dim

    def seen_cells(self, which: npt.NDArray[np.bool_] | None = None) -> npt.NDArray[np.int32]:
        """Return the cells with points, ascending; see ``PointStencil.seen_cells``."""
        cells = self.points.cell
        return np.unique(cells if which is None else cells[which])

    def table(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        """Tabulate values and derivatives of a scalar element's functions at the points.

        Args:
            element: Scalar basix element with identity map.
            derivatives: Highest order of derivatives, 0 to 2.

        Returns:
            Table of shape ``(n_points, n_rows, n_nodes)``, see ``PointStencil.table``.
        """
        self._refresh()
        key = (hash(element), derivatives)
        if key not in self._tables:
            self._tables[key] = self._tabulate(element, derivatives)
        return self._tables[key]

    def positive_table(self, element: Any) -> npt.NDArray[np.float64]:
        """Tabulate values of the functions, such that those with a slope are not zero.

        Args:
            element: Scalar basix element of degree 1 with identity map.

        Returns:
            Table of shape ``(n_points, n_nodes)``, see ``PointStencil.positive_table``.
        """
        return np.maximum(self.table(element, 0)[:, 0], LEAST)

    def _refresh(self) -> None:
        if self._version != self.points.version:
            self._version = self.points.version
            self._tables = {}

    def _cells(self) -> npt.NDArray[np.int32]:
        return self.points.cell[self.points.order]

    def _tabulate_reference(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        """Return ``(n_derivatives, n_points, n_nodes)`` in basix' order of derivatives."""
        xi = self.points.xi[self.points.order]
        if len(xi) == 0:  # basix needs at least one point
            return element.tabulate(derivatives, np.zeros((1, xi.shape[1])))[:, :0, :, 0]
        return element.tabulate(derivatives, xi)[..., 0]

    def _tabulate(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        if derivatives == 1 and element.degree == 1 and self._geometry.is_simplex:
            values = self.table(element, 0)
            return np.concatenate([values, self._cell_gradients(element)[self._cells()]], axis=1)
        dim = self.points.mesh.geometry.dim
        reference = self._tabulate_reference(element, derivatives)
        n_points, n_nodes = reference.shape[1:]
        table = np.empty((n_points, derivative_rows(derivatives, dim), n_nodes))
        table[:, 0, :] = reference[0]
        if derivatives > 0:
            xi = self.points.xi[self.points.order]
            inverse = self._geometry.inverse_jacobian(self._cells(), xi)
            _push_forward_gradients(reference[1 : dim + 1], inverse, table)
            if derivatives > 1:
                second = reference[_second_derivatives(dim)]
                _push_forward_hessians(second, inverse, self._map_curvature(), table)
        return table

    def _cell_gradients(self, element: Any) -> npt.NDArray[np.float64]:
        """Return gradients of linear functions in simplices, ``(n_cells, d, n_nodes)``."""
        key = hash(element)
        if key not in self._gradients:
            dim = self._geometry.dim
            reference = element.tabulate(1, np.zeros((1, dim)))[1:, 0, :, 0]
            inverse = self._geometry.simplex_inverse
            self._gradients[key] = np.einsum("cki,ka->cia", inverse, reference)
        return self._gradients[key]

    def _map_curvature(self) -> npt.NDArray[np.float64]:
        """Return second derivatives x_m,kl of the cell map, ``(n_points, d, d, d)``."""
        mesh = self.points.mesh
        element = basix.create_element(basix.ElementFamily.P, mesh.basix_cell(), 1)
        directions = _second_derivatives(mesh.geometry.dim)
        second = self._tabulate_reference(element, 2)[directions]
        nodes = self._geometry.corners(self._cells())
        return np.einsum("klpa,pam->pmkl", second, nodes)


def _second_derivatives(dim: int) -> npt.NDArray[np.int64]:
    """Return the positions of the second derivatives in basix' tabulation, ``(d, d)``."""
    unit = np.eye(dim, dtype=int)
    return np.array([[basix.index(*(unit[k] + unit[m])) for m in range(dim)] for k in range(dim)])


@njit
def _push_forward_gradients(reference, inverse, table):  # type: ignore[no-untyped-def]
    """Write dN/dx_j = dN/dxi_k K_kj into rows 1 ... d of the table."""
    dim, n_points, n_nodes = reference.shape
    for p in range(n_points):
        for j in range(dim):
            for a in range(n_nodes):
                value = 0.0
                for k in range(dim):
                    value += reference[k, p, a] * inverse[p, k, j]
                table[p, 1 + j, a] = value


@njit
def _push_forward_hessians(second, inverse, curvature, table):  # type: ignore[no-untyped-def]
    """Write N_,ij = (N_,kl - N_,m x_m,kl) K_ki K_lj: chain rule with curvature of the cell map.

    The rows of the physical gradient N_,m must have been filled already.
    """
    dim, _, n_points, n_nodes = second.shape
    for p in range(n_points):
        for a in range(n_nodes):
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        for m in range(dim):
                            reference = second[k, m, p, a]
                            for r in range(dim):
                                reference -= table[p, 1 + r, a] * curvature[p, r, k, m]
                            value += reference * inverse[p, k, i] * inverse[p, m, j]
                    table[p, 1 + dim + i * dim + j, a] = value
