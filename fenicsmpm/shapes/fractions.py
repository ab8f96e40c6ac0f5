# SPDX-License-Identifier: MIT
"""Which part of boxes is in a solid."""

import numba
import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.shapes.solid import Solid
from fenicsmpm.shapes.tree import closest, winding

# Parts along each side of boxes that the boundary does not cut like a plane.
_PARTS = 4
# Components of a normal below this part of the largest one count as zero.
_SMALL = 1e-4
# Cosine of the angle between the facet and the plane up to which it is no edge that is closest.
_ALIKE = 0.95


def fractions(
    solid: Solid, centre: npt.NDArray[np.float64], size: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Part of each of many equal boxes that is in a solid.

    Where the corners of a box are in or out as the plane says through the closest point of the
    boundary, it is the part behind that plane (exact for a box that one facet cuts). In other
    boxes, such as those at edges and around thin parts, it is the part of 4^d points.

    Args:
        solid: The solid.
        centre: Centres of the boxes in m, shape (n, d).
        size: Their sides in m, shape (d,).

    Returns:
        Numbers from 0 to 1, shape (n,).
    """
    result: npt.NDArray[np.float64] = _fractions(solid.tree, np.ascontiguousarray(centre), size)
    return result


@numba.njit
def _behind_plane(normal, offset, size):  # type: ignore[no-untyped-def]
    """Part of a box where normal . (x - centre) <= offset.

    R. Scardovelli and S. Zaleski, J. Comput. Phys. 164 (2000) 228-237, for a unit box in which the
    normal has no negative component: inclusion and exclusion of corners.
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
    # the smaller part has less cancellation
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


@numba.njit
def _is_plane(tree, centre, size, normal, offset, x):  # type: ignore[no-untyped-def]
    """Whether the corners of a box are in or out as a plane says, as far as they are not on it."""
    d = len(size)
    largest = size.max()
    for corner in range(2**d):
        above = -offset
        for k in range(d):
            side = size[k] if (corner >> k) & 1 else -size[k]
            x[k] = centre[k] + 0.5 * side
            above += 0.5 * normal[k] * side
        if abs(above) > 0.02 * largest and (winding(tree, x) > 0) != (above < 0.0):
            return False
    return True


@numba.njit
def _sampled(tree, centre, size, x):  # type: ignore[no-untyped-def]
    """Part of the points of a fine lattice in a box that are inside."""
    d = len(size)
    count, total = 0, _PARTS**d
    for number in range(total):
        rest = number
        for k in range(d):
            x[k] = centre[k] + ((rest % _PARTS + 0.5) / _PARTS - 0.5) * size[k]
            rest //= _PARTS
        count += winding(tree, x) > 0
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
        along = 0.0
        for k in range(d):
            along += normal[k] * tree.normals[facet, k]
        if along > _ALIKE and _is_plane(tree, centre[i], size, normal, offset, x):
            result[i] = _behind_plane(normal, offset, size)
        else:
            result[i] = _sampled(tree, centre[i], size, x)
    return result
