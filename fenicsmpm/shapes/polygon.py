# SPDX-License-Identifier: MIT
"""2D solids bounded by closed polygons."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.shapes.solid import Solid


def polygon(vertices: npt.ArrayLike, holes: Sequence[npt.ArrayLike] = ()) -> Solid:
    """Return the region inside a simple polygon, without its holes.

    The last vertex is joined to the first one, which may be repeated at the end. Either orientation
    is possible.

    Args:
        vertices: At least 3 vertices in m, shape (n, 2).
        holes: Polygons inside the first one, of the same form.

    Returns:
        The solid.

    Raises:
        ValueError: For wrong shapes, sides without length, sides that cross or touch each other,
            and holes that are not inside.
    """
    rings = [_ring(vertices, 1.0), *(_ring(hole, -1.0) for hole in holes)]
    facets = np.concatenate([np.stack([r, np.roll(r, -1, axis=0)], axis=1) for r in rings])
    first = np.repeat(np.cumsum([0, *map(len, rings)])[:-1], [len(r) for r in rings])
    length = np.repeat([len(r) for r in rings], [len(r) for r in rings])
    following = first + (np.arange(len(facets)) - first + 1) % length
    one, other = _first_crossing(facets, following)
    if one >= 0:
        raise ValueError(
            f"the polygon crosses itself: side {one} from {facets[one, 0]} to {facets[one, 1]} and "
            f"side {other} from {facets[other, 0]} to {facets[other, 1]}"
        )
    return Solid(facets)


def _ring(vertices: npt.ArrayLike, orientation: float) -> npt.NDArray[np.float64]:
    """Return distinct vertices, counter-clockwise for orientation 1 and clockwise for -1."""
    x = np.array(vertices, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != 2:
        raise ValueError(f"vertices of a polygon need the shape (n, 2), not {x.shape}")
    if not np.isfinite(x).all():
        raise ValueError("vertices of a polygon must be finite")
    if len(x) > 1 and np.array_equal(x[0], x[-1]):
        x = x[:-1]
    if len(x) < 3:
        raise ValueError(f"a polygon needs at least 3 vertices, not {len(x)}")
    side = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)
    bad = np.flatnonzero(side <= 1e-14 * np.abs(x).max())
    if len(bad):
        raise ValueError(
            f"side {bad[0]} of the polygon, at {x[bad[0]]}, has no length: remove repeated vertices"
        )
    y = x - x[0]
    turned = np.sum(y[:, 0] * np.roll(y[:, 1], -1) - y[:, 1] * np.roll(y[:, 0], -1))
    return x if turned * orientation >= 0.0 else x[::-1]


@njit
def _turn(a, b, c):  # type: ignore[no-untyped-def]
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@njit
def _first_crossing(facets, following):  # type: ignore[no-untyped-def]
    """Return the numbers of two sides that touch, other than neighbours at their end, or -1, -1."""
    for i in range(len(facets)):
        a, b = facets[i, 0], facets[i, 1]
        for j in range(i + 1, len(facets)):
            c, d = facets[j, 0], facets[j, 1]
            if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
                continue
            if max(a[1], b[1]) < min(c[1], d[1]) or max(c[1], d[1]) < min(a[1], b[1]):
                continue
            p, q = _turn(a, b, c), _turn(a, b, d)
            if following[i] == j or following[j] == i:
                # neighbours meet at one end, and must not overlap beyond it
                inner = (b[0] - a[0]) * (d[0] - c[0]) + (b[1] - a[1]) * (d[1] - c[1])
                if p == 0.0 and q == 0.0 and inner < 0.0:
                    return i, j
                continue
            r, s = _turn(c, d, a), _turn(c, d, b)
            apart = (p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0)
            apart |= (r > 0.0 and s > 0.0) or (r < 0.0 and s < 0.0)
            if not apart:
                return i, j
    return -1, -1
