# SPDX-License-Identifier: MIT
"""Weights of points with which a constant stress leaves the nodes inside a body in equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from fenicsmpm import forms
from fenicsmpm.basis.lattice import lattice_of
from fenicsmpm.cells.active_cells import ActiveCells
from fenicsmpm.cells.weight_correction import inner_cells
from fenicsmpm.points import MaterialPoints
from fenicsmpm.transfer.points_to_grid import p2g

# Reduction of the forces of a constant stress, and the largest number of iterations for it
_TOLERANCE, _MOST_ITERATIONS = 1e-8, 1000
# Factors of the weights, limited for cells with a hole or a pile of points
_LEAST, _MOST = 0.5, 1.5


class BalancedWeights:
    """Correction of weights for smooth functions on a lattice, as an observer of implicit steps.

    Where points have moved, the forces of a constant stress at the nodes inside of the body,
    ``sum_p w_p grad N_I(x_p)``, do not vanish. This correction makes them vanish by the smallest
    change of the weights, ``w_p = V_p (1 + div f(x_p))`` with a grid function f. Use it as
    ``ImplicitMPM(..., observers=[BalancedWeights(body, cells)])``. Masses do not change.

    A node is inside if all points that it sees are in interior cells: those of which no vertex
    belongs to a cell without points, and which are not shared with another body. The direction
    normal to a wall of the lattice is left out at the nodes of the wall. Weights change by half at
    most, which leaves holes as they are.

    Args:
        body: Material points with volumes in m^d as weights, which are changed.
        cells: Active cells of the body, of others that it touches, and of loads.

    Raises:
        ValueError: If the body is not one of the point sets of the cells, or the mesh is no
            lattice.
    """

    def __init__(self, body: MaterialPoints, cells: ActiveCells) -> None:
        """Compile the sums over the points. Collective."""
        self._body, self._cells = body, cells
        inner_cells(body, cells)  # or ValueError
        mesh = body.mesh
        lattice, dim = lattice_of(mesh), mesh.geometry.dim
        self._nodes = fem.functionspace(mesh, ("Lagrange", 1))
        space = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        self._f, test = fem.Function(space), ufl.TestFunction(space)
        self._forces = forms.form(ufl.div(test) * body.dx)
        self._product = forms.form(ufl.div(self._f) * ufl.div(test) * body.dx)
        self._change = forms.PointExpression(ufl.div(self._f), body)
        places = (space.tabulate_dof_coordinates()[:, :dim] - lattice.origin) / lattice.spacing
        numbers = np.rint(places)
        self._off_wall = (numbers > 0) & (numbers < lattice.shape)
        self._owned = space.dofmap.index_map.size_local

    def __call__(self, *_: Any) -> None:
        """Correct the weights, which are the volumes of the points. Collective."""
        body = self._body
        outside = ~inner_cells(body, self._cells)[body.cell]
        seen = p2g(body, np.where(outside, body.weight, 0.0), self._nodes).array
        inside = self._off_wall & (seen == 0.0)[:, None]
        self._f.x.array[:] = self._solution(inside).ravel()
        factor = np.clip(1.0 + self._change.evaluate(), _LEAST, _MOST)
        body["weight"] = body.weight * factor

    def _solution(self, inside: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """Return values of f, by conjugate gradients. Collective.

        Fields without divergence at the points make the system singular, but not contradictory.
        """
        residual = np.where(inside, -self._assembled(self._forces), 0.0)
        f, direction, size = np.zeros_like(residual), residual.copy(), self._dot(residual, residual)
        enough = _TOLERANCE**2 * size
        for _ in range(_MOST_ITERATIONS):
            if size <= enough:
                break
            self._f.x.array[:] = direction.ravel()
            product = np.where(inside, self._assembled(self._product), 0.0)
            length = size / self._dot(direction, product)
            f += length * direction
            residual -= length * product
            before, size = size, self._dot(residual, residual)
            direction = residual + size / before * direction
        return f

    def _assembled(self, form: forms.Form) -> npt.NDArray[np.float64]:
        """Return a sum at all nodes, ``(n_nodes, d)``. Collective."""
        vector = forms.assemble_vector(form)
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        return vector.array.reshape(self._off_wall.shape)

    def _dot(self, a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
        product = float(np.vdot(a[: self._owned], b[: self._owned]))
        return float(self._body.mesh.comm.allreduce(product))
