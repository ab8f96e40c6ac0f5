# SPDX-License-Identifier: MIT
"""Detection of folded quadrilaterals and hexahedra, whose Jacobian determinant changes sign.

In a quadrilateral the determinant is linear, so its values at the corners decide. In a hexahedron
it is quadratic in each direction and may be negative inside although it is positive at all corners.
It lies between the least and the greatest of its Bezier coefficients, which converge to it when the
cell is halved repeatedly (A. Johnen, J.-F. Remacle, C. Geuzaine, "Geometrical validity of
curvilinear finite elements", Journal of Computational Physics 233, 2013).
"""

import functools
import itertools

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Tolerance of determinants in units of the largest one in the cell. It allows corners at which two
# edges are in line, where the determinant is zero.
_ROUND_OFF = 1e-12

# Largest number of halvings of hexahedra that are still undecided. The determinant is then nowhere
# below about -4^-6 of the largest one.
_HALVINGS = 6

# Matrices from the values of a quadratic polynomial at 0, 1/2, 1 to its Bezier coefficients, and to
# its values at the same places of the lower and the upper half.
_BEZIER = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])
_LOWER = np.array([[1.0, 0.0, 0.0], [0.375, 0.75, -0.125], [0.0, 1.0, 0.0]])
_UPPER = _LOWER[::-1, ::-1]


@functools.cache
def grid(dim: int) -> Array:
    """Return the points where `folded` needs determinants, shape (3^d, d).

    They are the corners, the centres of edges and faces, and the centre of the cell.
    """
    return np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=dim)))


def folded(det: Array) -> npt.NDArray[np.bool_]:
    """Return which cells are folded.

    Args:
        det: Determinants of dx/dxi at the points of `grid`, shape (cells, 3^d).

    Returns:
        Mask of shape (cells,).
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
    # parts of cells that are still undecided, and the cells they belong to
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
