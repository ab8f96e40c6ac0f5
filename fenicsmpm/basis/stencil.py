# SPDX-License-Identifier: MIT
"""Interface of grid functions at material points.

Points are handled in *groups* that see the same grid functions: the points of a cell for
Lagrange elements, the points between the same knots for splines on lattices. All arrays here
have one row per point **in group order**; ``order`` leads back to the storage order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

# Least value of a function that may have a slope, for explicit steps. Without any mass, the far
# node of a point on a wall or a grid line would have no velocity.
LEAST = 1e-14

if TYPE_CHECKING:
    from fenicsmpm.points.geometry import CellGeometry


class PointStencil(Protocol):
    """Grid functions that are not zero at the points, as assembly and mapping need them."""

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """Storage index of each point, in group order, shape ``(n_points,)``."""

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Range of the points of each group within ``order``, shape ``(n_groups + 1,)``."""

    @property
    def n_owned_groups(self) -> int:
        """Number of groups that can hold points of this rank; they come first."""

    @property
    def kind(self) -> str:
        """Kind of the stencil; on a mesh, stencils of one kind have the same groups and nodes."""

    @property
    def groups_are_cells(self) -> bool:
        """Whether a group consists of the points of a cell."""

    def n_functions(self, element: Any) -> int:
        """Return the number of functions of a scalar element that a group sees."""

    @property
    def least(self) -> npt.NDArray[np.float64]:
        """Fraction of the largest function below which others may be round-off, ``(n_groups,)``."""

    def dofs(self, space: Any) -> npt.NDArray[np.int32]:
        """Return local blocks of a function space that each group sees, ``(n_groups, n)``.

        For a mixed space they are in the order of its cell dofmap: subspace by subspace, and node
        by node within each.

        Raises:
            ValueError: If the functions cannot replace those of the space.
        """

    def seen_cells(self, which: npt.NDArray[np.bool_] | None = None) -> npt.NDArray[np.int32]:
        """Return local cells, ghosts included, all of whose nodes some point sees; ascending.

        Args:
            which: Mask of the points that count, ``(n_points,)``; None for all.
        """

    def table(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        """Tabulate grid functions and their derivatives at the points.

        Args:
            element: Scalar basix element.
            derivatives: 0 for values, 1 also for gradients, 2 also for second derivatives.

        Returns:
            Table of shape ``(n_points, n_rows, n_nodes)``. Rows are the value, then d gradients in
            1/m, then d*d second derivatives in 1/m^2 (row-major).
        """

    def positive_table(self, element: Any) -> npt.NDArray[np.float64]:
        """Tabulate functions that are nowhere negative, at least ``LEAST`` if they have a slope.

        Args:
            element: Scalar basix element of degree 1.

        Returns:
            Table of shape ``(n_points, n_nodes)``, in group order.
        """


def round_off(geometry: CellGeometry) -> npt.NDArray[np.float64]:
    """Return the round-off of grid functions that are zero at points in each cell, ``(n_cells,)``.

    Their slopes on the reference cell are less than 10.
    """
    return 10 * geometry.tolerance


def derivative_rows(derivatives: int, dim: int) -> int:
    """Return the number of table rows for values and derivatives up to the given order."""
    return sum(dim**k for k in range(derivatives + 1))
