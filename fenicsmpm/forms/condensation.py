# SPDX-License-Identifier: MIT
"""Exact replacement of many material points in a cell by few sites.

If the functions are linear in a cell and no data vary from point to point, integrands are often
polynomials of a low degree q in the cell. For q <= 1 the centroid of the points represents all of
them. For higher degrees, f is the sum of its nodal values times the Lagrange functions L_a of
degree q, and

    sum_p V_p f(x_p) = sum_a W_a f(x_a)    with    W_a = sum_p V_p L_a(x_p).
"""

# mypy: disallow_untyped_defs=False

from __future__ import annotations

import math
from typing import Any

import basix
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis import LagrangeStencil
from fenicsmpm.forms.sites import Sites
from fenicsmpm.forms.slots import SIMPLICES
from fenicsmpm.points import MaterialPoints

# Highest useful degree: the product of an input, a test and a trial function, all linear
MAX_DEGREE = 3


def sites_per_cell(mesh: Any, degree: float) -> float:
    """Return the number of sites per cell for integrands of a degree, infinite if impossible.

    Args:
        mesh: Background mesh.
        degree: Polynomial degree of the integrand.
    """
    if degree > MAX_DEGREE or mesh.basix_cell().name not in SIMPLICES:
        return math.inf
    return 1 if degree <= 1 else _lagrange(mesh, int(degree)).dim


def _lagrange(mesh: Any, degree: int) -> Any:
    variant = basix.LagrangeVariant.equispaced
    return basix.create_element(basix.ElementFamily.P, mesh.basix_cell(), degree, variant)


class CondensedPoints:
    """Sites in cells with their own weights.

    The class has those attributes of ``MaterialPoints`` that a ``LagrangeStencil`` and integrals of
    grid functions need.

    Args:
        points: Points that the sites represent.
        cell: Cells of the sites ``(n,)``, in ascending order.
        xi: Reference positions ``(n, d)`` [-].
        weight: Weights ``(n,)`` [m^d], of any sign.
    """

    version = 0  # read by stencils; these sites do not move

    def __init__(
        self,
        points: MaterialPoints,
        cell: npt.NDArray[np.int32],
        xi: npt.NDArray[np.float64],
        weight: npt.NDArray[np.float64],
    ) -> None:
        """Compute the positions."""
        self.mesh, self.geometry = points.mesh, points.geometry
        self.cell, self.xi, self.weight = cell, xi, weight
        self.order = np.arange(len(cell))
        self.x = self.geometry.push_forward(cell, xi)

    def __len__(self) -> int:
        """Return the number of sites on this rank."""
        return len(self.cell)


class Condensation:
    """Replacement of many sites by few, for integrands of one degree.

    Args:
        degree: Degree of the integrands, for which ``sites_per_cell`` must be finite.
        sites: All selected points, by cell.
    """

    def __init__(self, degree: float, sites: Sites) -> None:
        """Tabulate the functions whose weighted sums are the new weights."""
        self._all = sites
        self._weights: npt.NDArray[np.float64] | None = None
        self._element = None
        xi = sites.points.xi[sites.order]
        if degree <= 1:
            self._table = np.column_stack([np.ones(len(xi)), xi])
        else:
            self._element = _lagrange(sites.points.mesh, int(degree))
            self._table = self._element.tabulate(0, xi)[0, ..., 0]

    def sites(self) -> Sites:
        """Return the sites that represent all points with their current weights."""
        weights = self._all.weights
        if self._weights is None or not np.array_equal(weights, self._weights):
            self._weights = weights.copy()
            self._few = self._condense(weights)
        return self._few

    def _condense(self, weights: npt.NDArray[np.float64]) -> Sites:
        if not weights.min(initial=1.0) > 0.0:  # the centroid may not exist
            return self._all
        groups = self._all.groups
        moments = np.empty((len(groups), self._table.shape[1]))
        _sum_moments(weights, self._table, self._all.offsets, moments)
        if self._element is None:
            per_cell, xi, weight = 1, moments[:, 1:] / moments[:, :1], moments[:, 0].copy()
        else:
            per_cell, weight = self._element.dim, moments.ravel()
            xi = np.tile(self._element.points, (len(groups), 1))
        few = CondensedPoints(self._all.points, np.repeat(groups, per_cell), xi, weight)
        offsets = per_cell * np.arange(len(groups) + 1)
        return Sites(few, LagrangeStencil(few), few.order, groups, offsets)


@njit
def _sum_moments(weights, table, offsets, result):
    """Set ``result (n_cells, n_columns)`` to W_a = sum_p V_p L_a(x_p)."""
    for i in range(len(offsets) - 1):
        result[i] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            for a in range(table.shape[1]):
                result[i, a] += weights[k] * table[k, a]
