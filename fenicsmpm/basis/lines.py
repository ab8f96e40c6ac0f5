# SPDX-License-Identifier: MIT
"""Functions on a line of nodes of distance one, whose products are the functions on lattices.

All have the same construction: the hat functions of the nodes are averaged around the point. The
generalized interpolation (uGIMP) averages over the length of the point. The quadratic spline
averages over the distance of two nodes: it is uGIMP with points as large as cells. The cubic spline
averages over that distance twice. As averages with a symmetric weight keep linear functions, all
functions add up to one and reproduce linear functions.

At a wall, grid functions are continued linearly beyond it: the part of a node -1 beyond node 0 goes
to the nodes inside by ``u_-1 = 2 u_0 - u_1``. Both properties then hold up to the wall. At the wall
itself only its own node counts, so Dirichlet conditions work as for finite elements. For the cubic
spline these are the boundary functions of M. Steffen, R. M. Kirby, M. Berzins (Int. J. Numer. Meth.
Engng 76, 2008). The quadratic spline becomes linear within half a cell from the wall, as does uGIMP
where a part of a point extends beyond the wall.

Each function here returns values, first and second derivatives, each as a tuple of one number per
node. They are for one point in one direction and meant to be called from compiled loops.
"""

# mypy: disallow_untyped_defs=False

from fenicsmpm._njit import njit

# Kinds of functions, in the order in which compiled loops compare them
LINEAR, QUADRATIC, CUBIC, GIMP = range(4)

# Number of nodes that a point sees in each direction
WIDTH = {LINEAR: 2, QUADRATIC: 3, CUBIC: 4, GIMP: 3}


@njit
def linear(t):
    """Return hat functions of the nodes 0 and 1 at 0 <= t <= 1."""
    return (1.0 - t, t), (-1.0, 1.0), (0.0, 0.0)


@njit
def quadratic_inside(s):
    """Return quadratic splines of the nodes -1, 0, 1 at -1/2 <= s <= 1/2, away from walls.

    Args:
        s: Position relative to the nearest node.
    """
    a, b = 0.5 - s, 0.5 + s
    return (0.5 * a * a, 0.75 - s * s, 0.5 * b * b), (-a, -2.0 * s, b)


@njit
def quadratic(s, lower, upper):
    """Return quadratic splines anywhere, see ``quadratic_inside``.

    Args:
        s: Position relative to the nearest node.
        lower: Whether node -1 is beyond a wall.
        upper: Whether node 1 is beyond a wall.
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
    """Return cubic splines of the nodes -1, 0, 1, 2 at 0 <= t <= 1, away from walls."""
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
    """Return cubic splines anywhere: node -1 is beyond a wall if ``lower``, node 2 if ``upper``."""
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
    """Return uGIMP functions of the nodes -1, 0, 1 at -1/2 <= s <= 1/2, away from walls.

    S. G. Bardenhagen, E. M. Kober, CMES 5 (2004); the domain of a point keeps its initial size.

    Args:
        s: Position relative to the nearest node.
        half: Half of the point's size, above 0 and at most 1/2.
    """
    below, dbelow = _ramp(-s, half)
    above, dabove = _ramp(s, half)
    # the two ramps take from the node what they add to its neighbours
    return (below, 1.0 - below - above, above), (-dbelow, dbelow - dabove, dabove)


@njit
def gimp(s, half, lower, upper):
    """Return uGIMP functions anywhere, see ``gimp_inside``.

    The second derivative is that between the kinks of the first one.

    Args:
        s: Position relative to the nearest node.
        half: Half of the point's size, above 0 and at most 1/2.
        lower: Whether node -1 is beyond a wall.
        upper: Whether node 1 is beyond a wall.
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
    """Return the average of max(s, 0) over (s - half, s + half), with its derivative."""
    reach = min(max(s, -half), half) + half
    return reach * reach / (4.0 * half) + max(s - half, 0.0), reach / (2.0 * half)


@njit
def fold3(f, lower, upper):
    """Move the parts of nodes beyond a wall to nodes inside: ``u_-1 = 2 u_0 - u_1``."""
    a, b, c = f
    if lower:
        return 0.0, b + 2.0 * a, c - a
    if upper:
        return a - c, b + 2.0 * c, 0.0
    return a, b, c


@njit
def fold4(f, lower, upper):
    """Do as ``fold3`` for four nodes."""
    a, b, c, d = f
    if lower:
        a, b, c = 0.0, b + 2.0 * a, c - a
    if upper:
        b, c, d = b - d, c + 2.0 * d, 0.0
    return a, b, c, d


@njit
def tabulate_line(kind, i, t, n, half, result):
    """Write values and derivatives of a kind of functions into ``result (3, >= width)``.

    Args:
        kind: LINEAR, QUADRATIC, CUBIC or GIMP.
        i: Number of the cell.
        t: Position in it, 0 to 1.
        n: Number of cells.
        half: Half of the point's size in units of a cell (uGIMP).
        result: Rows for values, first and second derivatives.

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
