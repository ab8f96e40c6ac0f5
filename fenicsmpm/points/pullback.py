# SPDX-License-Identifier: MIT
"""Reference coordinates of a point in a given cell (numba).

Cells are given by the coefficients of their map in monomials of the reference coordinates, see
`fenicsmpm.points.geometry`. The functions write the reference coordinates into a scratch array and
return the margin: the smallest barycentric coordinate (simplices) or the smallest distance to a
face of the reference cell (quadrilaterals, hexahedra). The margin is negative outside the cell.
"""

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit

_MAX_ITERATIONS = 30


@njit
def reference_point(
    coefficients: npt.NDArray[np.float64],
    inverse: npt.NDArray[np.float64],
    c: int,
    x: npt.NDArray[np.float64],
    p: int,
    xi: npt.NDArray[np.float64],
) -> float:
    """Compute the reference coordinates of point `x[p]` in cell c.

    Args:
        coefficients: Coefficients of the cell maps, shape (cells, k, d).
        inverse: Inverse Jacobians of simplices, shape (cells, d, d); not used for other cells.
        c: Cell.
        x: Points, shape (n, d).
        p: Index of the point.
        xi: Result, shape (d,).

    Returns:
        The margin; minus infinity if the inverse map was not found.
    """
    d = x.shape[1]
    if coefficients.shape[1] == d + 1:
        return _simplex(coefficients, inverse, c, x, p, xi)
    if d == 2:
        return _quadrilateral(coefficients, c, x, p, xi)
    return _hexahedron(coefficients, c, x, p, xi)


@njit
def _simplex(coefficients, inverse, c, x, p, xi):  # type: ignore[no-untyped-def]
    d = x.shape[1]
    last = 1.0
    margin = np.inf
    for i in range(d):
        s = 0.0
        for j in range(d):
            s += inverse[c, i, j] * (x[p, j] - coefficients[c, 0, j])
        xi[i] = s
        last -= s
        margin = min(margin, s)
    return min(margin, last)


# Newton's method converges quadratically: after a step below 1e-9 the iterate is exact up to
# round-off. Iterates are kept near the reference cell. Points inside are found from its centre,
# so an iterate that leaves this range means that the point is outside.


@njit
def _quadrilateral(coefficients, c, x, p, xi):  # type: ignore[no-untyped-def]
    a = coefficients
    u = v = 0.5
    for _ in range(_MAX_ITERATIONS):
        r0 = a[c, 0, 0] - x[p, 0] + a[c, 1, 0] * u + a[c, 2, 0] * v + a[c, 3, 0] * u * v
        r1 = a[c, 0, 1] - x[p, 1] + a[c, 1, 1] * u + a[c, 2, 1] * v + a[c, 3, 1] * u * v
        j00 = a[c, 1, 0] + a[c, 3, 0] * v
        j01 = a[c, 2, 0] + a[c, 3, 0] * u
        j10 = a[c, 1, 1] + a[c, 3, 1] * v
        j11 = a[c, 2, 1] + a[c, 3, 1] * u
        det = j00 * j11 - j01 * j10
        if det == 0.0:
            return -np.inf
        du = (j11 * r0 - j01 * r1) / det
        dv = (j00 * r1 - j10 * r0) / det
        u = min(max(u - du, -1.0), 2.0)
        v = min(max(v - dv, -1.0), 2.0)
        if abs(du) < 1e-9 and abs(dv) < 1e-9:
            xi[0] = u
            xi[1] = v
            return min(u, v, 1.0 - u, 1.0 - v)
    return -np.inf


@njit
def _hexahedron(coefficients, c, x, p, xi):  # type: ignore[no-untyped-def]
    a = coefficients
    u = v = w = 0.5
    for _ in range(_MAX_ITERATIONS):
        r0, j00, j01, j02 = _trilinear(a, c, 0, u, v, w)
        r1, j10, j11, j12 = _trilinear(a, c, 1, u, v, w)
        r2, j20, j21, j22 = _trilinear(a, c, 2, u, v, w)
        r0 += a[c, 0, 0] - x[p, 0]
        r1 += a[c, 0, 1] - x[p, 1]
        r2 += a[c, 0, 2] - x[p, 2]
        c0 = j11 * j22 - j12 * j21
        c1 = j12 * j20 - j10 * j22
        c2 = j10 * j21 - j11 * j20
        det = j00 * c0 + j01 * c1 + j02 * c2
        if det == 0.0:
            return -np.inf
        du = (c0 * r0 + (j02 * j21 - j01 * j22) * r1 + (j01 * j12 - j02 * j11) * r2) / det
        dv = (c1 * r0 + (j00 * j22 - j02 * j20) * r1 + (j02 * j10 - j00 * j12) * r2) / det
        dw = (c2 * r0 + (j01 * j20 - j00 * j21) * r1 + (j00 * j11 - j01 * j10) * r2) / det
        u = min(max(u - du, -1.0), 2.0)
        v = min(max(v - dv, -1.0), 2.0)
        w = min(max(w - dw, -1.0), 2.0)
        if abs(du) < 1e-9 and abs(dv) < 1e-9 and abs(dw) < 1e-9:
            xi[0] = u
            xi[1] = v
            xi[2] = w
            return min(u, v, w, 1.0 - u, 1.0 - v, 1.0 - w)
    return -np.inf


@njit
def _trilinear(a, c, i, u, v, w):  # type: ignore[no-untyped-def]
    """Return component i of the map without its constant, and its derivatives by u, v, w."""
    value = (
        a[c, 1, i] * u
        + a[c, 2, i] * v
        + a[c, 3, i] * w
        + a[c, 4, i] * u * v
        + a[c, 5, i] * u * w
        + a[c, 6, i] * v * w
        + a[c, 7, i] * u * v * w
    )
    du = a[c, 1, i] + a[c, 4, i] * v + a[c, 5, i] * w + a[c, 7, i] * v * w
    dv = a[c, 2, i] + a[c, 4, i] * u + a[c, 6, i] * w + a[c, 7, i] * u * w
    dw = a[c, 3, i] + a[c, 5, i] * u + a[c, 6, i] * v + a[c, 7, i] * u * v
    return value, du, dv, dw
