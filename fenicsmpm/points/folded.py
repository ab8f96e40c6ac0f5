# SPDX-License-Identifier: MIT
"""Quadrilaterals and hexahedra that are folded: the determinant of their Jacobian changes its sign.

In a quadrilateral it is linear, so that its values at the corners say all. In a hexahedron it is
quadratic in each direction and may be negative inside though it is positive at all corners. It lies
between the least and the greatest of its Bezier coefficients, which come as near to it as one likes
when the cell is halved (A. Johnen, J.-F. Remacle, C. Geuzaine, "Geometrical validity of curvilinear
finite elements", Journal of Computational Physics 233, 2013).
"""

import functools
import itertools

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# What determinants may be off by, in units of the largest one in the cell. Corners at which two
# edges are in line, where it is zero, are allowed.
_ROUND_OFF = 1e-12

# How often hexahedra are halved that are not decided before. Then the determinant is nowhere below
# about -4^-6 of the largest one.
_HALVINGS = 6

# Values at 0, 1/2, 1 of a quadratic polynomial to its Bezier coefficients, and to its values at the
# same places of the lower and the upper half.
_BEZIER = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])
_LOWER = np.array([[1.0, 0.0, 0.0], [0.375, 0.75, -0.125], [0.0, 1.0, 0.0]])
_UPPER = _LOWER[::-1, ::-1]


@functools.cache
def grid(dim: int) -> Array:
    """Where `folded` wants determinants: corners, centres of edges and faces, centre; (3^d, d)."""
    return np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=dim)))


def folded(det: Array) -> npt.NDArray[np.bool_]:
    """Which cells are folded.

    Args:
        det: Determinants of dx/dxi at the points of `grid`, shape (cells, 3^d).

    Returns:
        Shape (cells,).
    """
    dim = 2 if det.shape[1] == 9 else 3
    corners = (grid(dim) != 0.5).all(axis=1)
    to_bezier = functools.reduce(np.kron, [_BEZIER] * dim)
    to_parts = np.array(
        [
            functools.reduce(np.kron, part)
            for part in itertools.product((_LOWER, _UPPER), repeat=dim)
        ]
    )
    largest = np.take_along_axis(det, np.abs(det).argmax(axis=1)[:, None], axis=1)
    result = np.zeros(len(det), dtype=bool)
    # parts of cells that are not known to be good, and the cells that they are of
    cell = np.flatnonzero(largest)
    part = det[cell] / largest[cell]
    for _ in range(1 + _HALVINGS):
        result[cell[part[:, corners].min(axis=1, initial=0.0) < -_ROUND_OFF]] = True
        open_ = ((part @ to_bezier.T).min(axis=1, initial=0.0) < -_ROUND_OFF) & ~result[cell]
        if not open_.any():
            break
        cell = np.repeat(cell[open_], len(to_parts))
        part = np.einsum("hij,cj->chi", to_parts, part[open_]).reshape(len(cell), -1)
    return result
