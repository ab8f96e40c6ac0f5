# SPDX-License-Identifier: MIT
"""Tree of boxes around facets: closest facet, winding number and signed distance of a point.

Facets are the oriented straight pieces of a closed boundary: segments in 2D, triangles in 3D. They
form an array (n, d, d): facet, vertex, coordinate. Their normals point out of the solid: it lies to
the left of a segment, and triangles are counter-clockwise as seen from outside.

All functions below `build` are compiled for use in other loops. They take one point (d,).
"""

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit

# Number of facets in a leaf
_LEAF = 4
# More levels than a balanced tree needs for as many facets as fit into memory
_DEPTH = 64


class Tree(NamedTuple):
    """Arrays of a balanced binary tree with node 0 as root.

    Attributes:
        lower: Lower corners of the nodes' boxes in m, shape (m, d).
        upper: Upper corners in m, shape (m, d).
        begin: First facet of each node, shape (m,).
        end: One past the last facet of each node, shape (m,).
        right: Second child of each node, 0 in leaves, shape (m,). The first child is the next node.
        facets: Vertices of the facets in m, in the order of the tree, shape (n, d, d).
        normals: Outer unit normals of the facets, shape (n, d).
        order: Number of each facet in the input, shape (n,).
    """

    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    begin: npt.NDArray[np.int64]
    end: npt.NDArray[np.int64]
    right: npt.NDArray[np.int64]
    facets: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]
    order: npt.NDArray[np.int64]


def build(facets: npt.NDArray[np.float64], normals: npt.NDArray[np.float64]) -> Tree:
    """Build the tree over facets (n, d, d) in m with outer unit normals (n, d)."""
    order, begin, end, right = _split(facets.sum(axis=1) / facets.shape[1])
    facets, normals = facets[order], normals[order]
    lower, upper = _bound(facets.min(axis=1), facets.max(axis=1), begin, end, right)
    return Tree(lower, upper, begin, end, right, facets, normals, order)


@njit
def _split(centre):  # type: ignore[no-untyped-def]
    """Halve sets of facets along the longest side of the box around their centres."""
    n, d = centre.shape
    order = np.arange(n)
    most = 4 * n // _LEAF + 3
    begin, end, right = np.zeros((3, most), dtype=np.int64)
    # sets to be split: first facet, one past the last, parent of which the set is the second child
    stack = np.zeros((_DEPTH, 3), dtype=np.int64)
    stack[0, 1], stack[0, 2] = n, -1
    height, node = 1, 0
    while height > 0:
        height -= 1
        a, b, parent = stack[height]
        if parent >= 0:
            right[parent] = node
        begin[node], end[node] = a, b
        if b - a > _LEAF:
            axis, longest = 0, -1.0
            for k in range(d):
                values = centre[order[a:b], k]
                extent = values.max() - values.min()
                if extent > longest:
                    axis, longest = k, extent
            order[a:b] = order[a:b][np.argsort(centre[order[a:b], axis], kind="mergesort")]
            middle = (a + b) // 2
            stack[height] = middle, b, node
            stack[height + 1] = a, middle, -1
            height += 2
        node += 1
    return order, begin[:node], end[:node], right[:node]


@njit
def _bound(lowest, highest, begin, end, right):  # type: ignore[no-untyped-def]
    """Compute boxes of nodes from those of facets; children have higher numbers than parents."""
    m, d = len(begin), lowest.shape[1]
    lower, upper = np.empty((m, d)), np.empty((m, d))
    for node in range(m - 1, -1, -1):
        for k in range(d):
            if right[node] == 0:
                lower[node, k] = lowest[begin[node] : end[node], k].min()
                upper[node, k] = highest[begin[node] : end[node], k].max()
            else:
                lower[node, k] = min(lower[node + 1, k], lower[right[node], k])
                upper[node, k] = max(upper[node + 1, k], upper[right[node], k])
    return lower, upper


@numba.njit
def _squared_to_box(lower, upper, x):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(x)):
        gap = max(lower[k] - x[k], x[k] - upper[k], 0.0)
        total += gap * gap
    return total


@numba.njit
def _on_segment(facet, x, result):  # type: ignore[no-untyped-def]
    """Find the closest point of a segment, and return the squared distance."""
    dx, dy = facet[1, 0] - facet[0, 0], facet[1, 1] - facet[0, 1]
    t = (x[0] - facet[0, 0]) * dx + (x[1] - facet[0, 1]) * dy
    t = min(max(t / (dx * dx + dy * dy), 0.0), 1.0)
    result[0] = facet[0, 0] + t * dx
    result[1] = facet[0, 1] + t * dy
    return (x[0] - result[0]) ** 2 + (x[1] - result[1]) ** 2


@numba.njit
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit
def _difference(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit
def _weights_in_triangle(facet, x):  # type: ignore[no-untyped-def]
    """Return the weights of the second and third vertex in the closest point of a triangle.

    C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    ab, ac = _difference(facet[1], facet[0]), _difference(facet[2], facet[0])
    ap = _difference(x, facet[0])
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bp = _difference(x, facet[1])
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    cp = _difference(x, facet[2])
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w
    total = va + vb + vc
    return vb / total, vc / total


@numba.njit
def _on_triangle(facet, x, result):  # type: ignore[no-untyped-def]
    """Find the closest point of a triangle, and return the squared distance."""
    v, w = _weights_in_triangle(facet, x)
    total = 0.0
    for k in range(3):
        result[k] = facet[0, k] + v * (facet[1, k] - facet[0, k]) + w * (facet[2, k] - facet[0, k])
        total += (x[k] - result[k]) ** 2
    return total


@numba.njit
def closest(tree, x, radius, result):  # type: ignore[no-untyped-def]
    """Find the point of the boundary that is closest to x.

    Args:
        tree: The `Tree`.
        x: Position in m, shape (d,).
        radius: Largest distance in m, may be infinite. A small radius makes the search faster.
        result: Output: the closest point in m, shape (d,).

    Returns:
        Number of the facet in the tree, -1 if none is closer than the radius.
    """
    d = len(x)
    stack = np.empty(_DEPTH, dtype=np.int64)
    bound = np.empty(_DEPTH)
    candidate = np.empty(d)
    stack[0], bound[0] = 0, _squared_to_box(tree.lower[0], tree.upper[0], x)
    height, best, facet = 1, radius * radius, -1
    while height > 0:
        height -= 1
        node = stack[height]
        if bound[height] >= best:
            continue
        if tree.right[node] == 0:
            for i in range(tree.begin[node], tree.end[node]):
                if d == 2:
                    squared = _on_segment(tree.facets[i], x, candidate)
                else:
                    squared = _on_triangle(tree.facets[i], x, candidate)
                if squared < best:
                    best, facet = squared, i
                    for k in range(d):
                        result[k] = candidate[k]
            continue
        near, far = node + 1, tree.right[node]
        to_near = _squared_to_box(tree.lower[near], tree.upper[near], x)
        to_far = _squared_to_box(tree.lower[far], tree.upper[far], x)
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        stack[height], bound[height] = far, to_far
        stack[height + 1], bound[height + 1] = near, to_near
        height += 2
    return facet


@numba.njit
def _crosses(a, b, x):  # type: ignore[no-untyped-def]
    """Return how the line from a to b crosses the ray from x in the first direction, in a plane.

    The result is 1 for upwards, -1 for downwards, 0 for no crossing. The reversed line has the
    opposite sign in spite of round-off. If a line ends on the ray, either this line or the next one
    crosses it. The lines of a closed polygon therefore add up to its winding number.
    """
    if (a[1] <= x[1]) == (b[1] <= x[1]):
        return 0
    # use the same numbers for both directions of the line
    low, high = (a, b) if a[1] <= b[1] else (b, a)
    left = (high[0] - low[0]) * (x[1] - low[1]) - (x[0] - low[0]) * (high[1] - low[1])
    if left <= 0.0:
        return 0
    return 1 if a[1] < b[1] else -1


@numba.njit
def _above(facet, x):  # type: ignore[no-untyped-def]
    """Return how a triangle crosses the ray from x in the third direction: 1 outwards, -1, or 0."""
    a, b, c = facet[0], facet[1], facet[2]
    turns = _crosses(a, b, x) + _crosses(b, c, x) + _crosses(c, a, x)
    if turns == 0:
        return 0
    u, v, p = _difference(b, a), _difference(c, a), _difference(x, a)
    normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    return turns if turns * _dot(normal, p) < 0.0 else 0


@numba.njit
def winding(tree, x):  # type: ignore[no-untyped-def]
    """Return how often the boundary winds around x: 1 in the solid, 0 outside.

    The function counts crossings of a ray. A point on the boundary is either in or out, such that
    of two solids with a common facet never both contain it.
    """
    d = len(x)
    ray = 0 if d == 2 else 2
    stack = np.empty(_DEPTH, dtype=np.int64)
    stack[0] = 0
    height, count = 1, 0
    while height > 0:
        height -= 1
        node = stack[height]
        misses = tree.upper[node, ray] < x[ray]
        for k in range(d):
            if k != ray:
                misses |= tree.lower[node, k] > x[k] or tree.upper[node, k] < x[k]
        if misses:
            continue
        if tree.right[node] == 0:
            for i in range(tree.begin[node], tree.end[node]):
                if d == 2:
                    count += _crosses(tree.facets[i, 0], tree.facets[i, 1], x)
                else:
                    count += _above(tree.facets[i], x)
            continue
        stack[height], stack[height + 1] = tree.right[node], node + 1
        height += 2
    return count


@numba.njit
def signed_distance(tree, x, gradient):  # type: ignore[no-untyped-def]
    """Return the signed distance of x from the boundary in m, negative in the solid.

    Args:
        tree: The `Tree`.
        x: Position in m, shape (d,).
        gradient: Output: the gradient of the distance, shape (d,). It is a unit vector that points
            outwards, and the normal of a facet on the boundary.
    """
    d = len(x)
    facet = closest(tree, x, np.inf, gradient)
    sign = -1.0 if winding(tree, x) > 0 else 1.0
    squared, size = 0.0, 0.0
    for k in range(d):
        gradient[k] = x[k] - gradient[k]
        squared += gradient[k] ** 2
        size = max(size, abs(tree.facets[facet, 0, k]))
    distance = np.sqrt(squared)
    on_it = distance <= 1e-14 * size
    for k in range(d):
        gradient[k] = tree.normals[facet, k] if on_it else sign * gradient[k] / distance
    return sign * distance


@njit
def all_windings(tree, x):  # type: ignore[no-untyped-def]
    """Return `winding` at points x (n, d), shape (n,)."""
    result = np.empty(len(x), dtype=np.int64)
    for i in range(len(x)):
        result[i] = winding(tree, x[i])
    return result


@njit
def all_near(tree, x, radius):  # type: ignore[no-untyped-def]
    """Return whether the boundary is closer than a radius to points x (n, d), shape (n,)."""
    result, found = np.empty(len(x), dtype=np.bool_), np.empty(x.shape[1])
    for i in range(len(x)):
        result[i] = closest(tree, x[i], radius, found) >= 0
    return result


@njit
def all_distances(tree, x):  # type: ignore[no-untyped-def]
    """Return `signed_distance` and gradients at points x (n, d), shapes (n,) and (n, d)."""
    result, gradients = np.empty(len(x)), np.empty(x.shape)
    for i in range(len(x)):
        result[i] = signed_distance(tree, x[i], gradients[i])
    return result, gradients
