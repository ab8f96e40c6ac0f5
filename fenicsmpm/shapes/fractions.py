# SPDX-License-Identifier: MIT
"""Fractions of boxes that lie in a solid."""

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.shapes.solid import Solid
from fenicsmpm.shapes.tree import closest, winding

# Points along each side of a box at which solid and half-space are compared.
_POINTS = 4
# Components of a normal below this fraction of the largest one count as zero.
_SMALL = 1e-4
# Points closer to the plane than this fraction of the box lie on it.
_ON = 1e-9


def fractions(
    solid: Solid, centre: npt.NDArray[np.float64], size: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the fraction of each of many equal boxes that lies in a solid.

    It is the sum of two parts. The first is the fraction of the box behind the plane through the
    closest point of the boundary, which is exact for a box cut by one facet. The second is the
    difference between solid and half-space at 4^d points of the box. It captures edges, curvature
    and thin parts.

    Args:
        solid: The solid.
        centre: Centres of the boxes in m, shape (n, d).
        size: Side lengths of the boxes in m, shape (d,).

    Returns:
        Fractions from 0 to 1, shape (n,).
    """
    result: npt.NDArray[np.float64] = _fractions(solid.tree, np.ascontiguousarray(centre), size)
    return result


@njit
def _behind_plane(normal, offset, size):  # type: ignore[no-untyped-def]
    """Return the fraction of a box where normal . (x - centre) <= offset.

    R. Scardovelli and S. Zaleski, J. Comput. Phys. 164 (2000) 228-237: inclusion and exclusion of
    corners, for a unit box in which the normal has no negative component.
    """
    d = len(size)
    slope, largest = np.empty(d), 0.0
    for k in range(d):
        slope[k] = abs(normal[k]) * size[k]
        largest = max(largest, slope[k])
    count, total = 0, 0.0
    for k in range(d):
        if slope[k] > _SMALL * largest:
            slope[count] = slope[k]
            total += slope[k]
            count += 1
    level = offset + 0.5 * total
    if level <= 0.0:
        return 0.0
    if level >= total:
        return 1.0
    # compute the smaller part, which has less cancellation
    level, turned = (total - level, True) if 2.0 * level > total else (level, False)
    part, below = 0.0, 1.0
    for corner in range(2**count):
        rest, sign = level, 1.0
        for k in range(count):
            if (corner >> k) & 1:
                rest -= slope[k]
                sign = -sign
        if rest > 0.0:
            part += sign * rest**count
    for k in range(count):
        below *= slope[k] * (k + 1)
    part = min(max(part / below, 0.0), 1.0)
    return 1.0 - part if turned else part


@njit
def _beside_plane(tree, centre, size, normal, offset, x):  # type: ignore[no-untyped-def]
    """Return the fraction in the solid less that behind the plane, at points of a fine lattice."""
    d = len(size)
    count, total = 0, _POINTS**d
    near = _ON * size.max()
    for number in range(total):
        rest, above = number, -offset
        for k in range(d):
            way = ((rest % _POINTS + 0.5) / _POINTS - 0.5) * size[k]
            x[k] = centre[k] + way
            above += normal[k] * way
            rest //= _POINTS
        if abs(above) > near:
            count += int(winding(tree, x) > 0) - int(above < 0.0)
    return count / total


@njit
def _fractions(tree, centre, size):  # type: ignore[no-untyped-def]
    n, d = centre.shape
    result, x, normal = np.empty(n), np.empty(d), np.empty(d)
    reach = 0.5 * np.sqrt(np.sum(size**2))
    for i in range(n):
        facet = closest(tree, centre[i], reach, x)
        inside = winding(tree, centre[i]) > 0
        if facet < 0:
            result[i] = 1.0 if inside else 0.0
            continue
        distance = 0.0
        for k in range(d):
            normal[k] = centre[i, k] - x[k]
            distance += normal[k] ** 2
        distance = np.sqrt(distance)
        sign = -1.0 if inside else 1.0
        if distance <= 1e-9 * reach:
            normal[:] = tree.normals[facet]
        else:
            normal *= sign / distance
        offset = -sign * distance
        part = _behind_plane(normal, offset, size)
        part += _beside_plane(tree, centre[i], size, normal, offset, x)
        result[i] = min(max(part, 0.0), 1.0)
    return result
