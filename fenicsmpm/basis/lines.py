# SPDX-License-Identifier: MIT
"""Functions on a line of nodes of distance one, from which those on lattices are products.

All come from one construction. The hat functions of the nodes are averaged around the point: over
its own length for the generalized interpolation (uGIMP), over the distance of two nodes for the
quadratic spline, which is uGIMP with points as large as cells, and over that twice for the cubic
one. So all have the sum one, and reproduce linear functions, since averages with a symmetric
weight do.

At a wall, grid functions are continued linearly beyond it: what would belong to a node -1 beyond
node 0 goes to the nodes with ``u_-1 = 2 u_0 - u_1``. Both properties then hold up to the wall, and
at the wall itself only its node counts, so Dirichlet conditions are as for finite elements. For the
cubic spline these are the boundary functions of M. Steffen, R. M. Kirby, M. Berzins (Int. J. Numer.
Meth. Engng 76, 2008); the quadratic one is linear within half a cell from the wall, as is uGIMP
where a part of a point sticks out.

Each function here returns values, first and second derivatives, each as a tuple of one number a
node. They are for one point in one direction and meant to be called from compiled loops.
"""

# mypy: disallow_untyped_defs=False

from fenicsmpm._njit import njit

# Kinds of functions, in an order in which compiled loops compare them
LINEAR, QUADRATIC, CUBIC, GIMP = range(4)

# Number of nodes that a point sees in each direction
WIDTH = {LINEAR: 2, QUADRATIC: 3, CUBIC: 4, GIMP: 3}


@njit
def linear(t):
    """Hat functions of the nodes 0 and 1 at 0 <= t <= 1."""
    return (1.0 - t, t), (-1.0, 1.0), (0.0, 0.0)


@njit
def quadratic_inside(s):
    """Quadratic splines of the nodes -1, 0, 1 at -1/2 <= s <= 1/2, away from walls.

    Args:
        s: position relative to the nearest node.
    """
    a, b = 0.5 - s, 0.5 + s
    return (0.5 * a * a, 0.75 - s * s, 0.5 * b * b), (-a, -2.0 * s, b)


@njit
def quadratic(s, lower, upper):
    """As ``quadratic_inside`` at any place.

    Args:
        s: position relative to the nearest node.
        lower: whether node -1 is beyond a wall.
        upper: whether node 1 is.
    """
    values, slopes = quadratic_inside(s)
    curvatures = (1.0, -2.0, 1.0)
    return (
        fold3(values, lower, upper),
        fold3(slopes, lower, upper),
        fold3(curvatures, lower, upper),
    )


@njit
def cubic_inside(t):
    """Cubic splines of the nodes -1, 0, 1, 2 at 0 <= t <= 1, away from walls."""
    r = 1.0 - t
    values = (
        r * r * r / 6.0,
        2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
        2.0 / 3.0 - r * r * (1.0 - 0.5 * r),
        t * t * t / 6.0,
    )
    slopes = (-0.5 * r * r, t * (1.5 * t - 2.0), -r * (1.5 * r - 2.0), 0.5 * t * t)
    return values, slopes


@njit
def cubic(t, lower, upper):
    """As ``cubic_inside`` at any place; ``lower`` if node -1 is beyond a wall, ``upper`` if 2."""
    values, slopes = cubic_inside(t)
    r = 1.0 - t
    curvatures = (r, 3.0 * t - 2.0, 3.0 * r - 2.0, t)
    return (
        fold4(values, lower, upper),
        fold4(slopes, lower, upper),
        fold4(curvatures, lower, upper),
    )


@njit
def gimp_inside(s, half):
    """UGIMP functions of the nodes -1, 0, 1 at -1/2 <= s <= 1/2, away from walls.

    S. G. Bardenhagen, E. M. Kober, CMES 5 (2004); the domain of a point keeps its initial size.

    Args:
        s: position relative to the nearest node.
        half: half of the point's size, above 0 and at most 1/2.
    """
    below, dbelow = _ramp(-s, half)
    above, dabove = _ramp(s, half)
    # the two ramps take from the node what they give to its neighbours
    return (below, 1.0 - below - above, above), (-dbelow, dbelow - dabove, dabove)


@njit
def gimp(s, half, lower, upper):
    """As ``gimp_inside`` at any place; the second derivative is the one between kinks of the first.

    Args:
        s: position relative to the nearest node.
        half: half of the point's size, above 0 and at most 1/2.
        lower: whether node -1 is beyond a wall.
        upper: whether node 1 is.
    """
    values, slopes = gimp_inside(s, half)
    c = 0.5 / half if abs(s) < half else 0.0
    return (
        fold3(values, lower, upper),
        fold3(slopes, lower, upper),
        fold3((c, -2.0 * c, c), lower, upper),
    )


@njit
def _ramp(s, half):
    """Average of max(s, 0) over (s - half, s + half), with its derivative."""
    reach = min(max(s, -half), half) + half
    return reach * reach / (4.0 * half) + max(s - half, 0.0), reach / (2.0 * half)


@njit
def fold3(f, lower, upper):
    """Give the parts of nodes beyond a wall to those at it: ``u_-1 = 2 u_0 - u_1``."""
    a, b, c = f
    if lower:
        return 0.0, b + 2.0 * a, c - a
    if upper:
        return a - c, b + 2.0 * c, 0.0
    return a, b, c


@njit
def fold4(f, lower, upper):
    """As ``fold3`` for four nodes."""
    a, b, c, d = f
    if lower:
        a, b, c = 0.0, b + 2.0 * a, c - a
    if upper:
        b, c, d = b - d, c + 2.0 * d, 0.0
    return a, b, c, d


@njit
def tabulate_line(kind, i, t, n, half, result):
    """Values and derivatives of a kind of functions into ``result (3, >= width)``.

    Args:
        kind: LINEAR, QUADRATIC, CUBIC or GIMP.
        i: number of the cell.
        t: position in it, 0 to 1.
        n: number of cells.
        half: half of the point's size in units of a cell (uGIMP).
        result: rows for values, first and second derivatives.

    Returns:
        Number of the first node, -1 if it is beyond the wall.
    """
    if kind == LINEAR:
        v2, g2, c2 = linear(t)
        for k in range(2):
            result[0, k], result[1, k], result[2, k] = v2[k], g2[k], c2[k]
        return i
    if kind == CUBIC:
        v4, g4, c4 = cubic(t, i == 0, i == n - 1)
        for k in range(4):
            result[0, k], result[1, k], result[2, k] = v4[k], g4[k], c4[k]
        return i - 1
    node = i if t < 0.5 else i + 1
    s = t - (node - i)
    if kind == QUADRATIC:
        v3, g3, c3 = quadratic(s, node == 0, node == n)
    else:
        v3, g3, c3 = gimp(s, half, node == 0, node == n)
    for k in range(3):
        result[0, k], result[1, k], result[2, k] = v3[k], g3[k], c3[k]
    return node - 1
