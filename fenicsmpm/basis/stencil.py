# SPDX-License-Identifier: MIT
"""PointStencil: the grid functions that are not zero at each material point.

Points are handled in *groups* that see the same grid functions: the points of a cell for
Lagrange elements, the points between the same knots for splines on lattices. All arrays here
have one row a point **in group order**; ``order`` leads back to the storage order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

# Least value of a function that may have a slope, for explicit steps: without mass, the far node of
# a point on a wall or a grid line would have no velocity
LEAST = 1e-14

if TYPE_CHECKING:
    from fenicsmpm.points.geometry import CellGeometry


class PointStencil(Protocol):
    """What the assembly and the mapping need to know of a basis on a point set."""

    @property
    def order(self) -> npt.NDArray[np.int64]:
        """``(n_points,)`` storage index of each point, in group order."""

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """``(n_groups + 1,)`` range of the points of each group within ``order``."""

    @property
    def n_owned_groups(self) -> int:
        """Number of groups that can hold points of this rank; they come first."""

    @property
    def kind(self) -> str:
        """Stencils of the same kind on the same mesh have the same groups and nodes."""

    @property
    def groups_are_cells(self) -> bool:
        """Whether each group is the points of a cell."""

    def n_functions(self, element: Any) -> int:
        """Number of functions of a scalar element that a group sees."""

    @property
    def least(self) -> npt.NDArray[np.float64]:
        """``(n_groups,)`` share of the largest function up to which others may be round-off."""

    def dofs(self, space: Any) -> npt.NDArray[np.int32]:
        """``(n_groups, n)`` local blocks of a function space seen by each group.

        Those of a mixed space come in the order of its cell dofmap: subspace by subspace, and
        node by node within each.

        Raises:
            ValueError: if the functions do not stand for those of the space.
        """

    def seen_cells(self, which: npt.NDArray[np.bool_] | None = None) -> npt.NDArray[np.int32]:
        """Local cells, ghosts included, of which some point sees all nodes; ascending.

        Args:
            which: ``(n_points,)`` mask of the points that count; None for all.
        """

    def table(self, element: Any, derivatives: int) -> npt.NDArray[np.float64]:
        """Grid functions and their derivatives at the points.

        Args:
            element: scalar basix element.
            derivatives: 0 for values, 1 also for gradients, 2 also for second derivatives.

        Returns:
            ``(n_points, n_rows, n_nodes)``; rows are the value, then d gradients in 1/m, then
            d*d second derivatives in 1/m^2 (row-major).
        """

    def positive_table(self, element: Any) -> npt.NDArray[np.float64]:
        """Values of functions that are nowhere negative, at least ``LEAST`` if they have a slope.

        Args:
            element: scalar basix element of degree 1.

        Returns:
            ``(n_points, n_nodes)``, in group order.
        """


def round_off(geometry: CellGeometry) -> npt.NDArray[np.float64]:
    """``(n_cells,)`` what grid functions that are zero may be at points in each cell.

    Their slopes on the reference cell are less than 10.
    """
    return 10 * geometry.tolerance


def derivative_rows(derivatives: int, dim: int) -> int:
    """Number of table rows for values and derivatives up to the given order."""
    return sum(dim**k for k in range(derivatives + 1))
