# SPDX-License-Identifier: MIT
"""3D solids bounded by closed triangulated surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fenicsmpm.shapes.solid import Solid


class OpenSurfaceError(ValueError):
    """Error for a surface with holes, which encloses nothing.

    Attributes:
        free_edges: Number of edges with a triangle on one side only.
        length: Total length of these edges in m.
        solid_angle: Fraction of all directions, 0 to 0.5, that is missing as seen from the centroid
            of the surface: the distance of its winding number there from the closest integer.
        position: Midpoint of the first free edge in m, shape (3,).
    """

    def __init__(
        self, free_edges: int, length: float, solid_angle: float, position: npt.NDArray[np.float64]
    ):
        """Compose the message from the attributes."""
        self.free_edges, self.length = free_edges, length
        self.solid_angle, self.position = solid_angle, position
        super().__init__(
            f"the surface is open: {free_edges} free edges with a total length of {length:.6g}, "
            f"the first one at {position}; {100.0 * solid_angle:.3g} % of all directions are "
            "missing as seen from its centroid. Close the holes, or merge vertices that should be "
            "one"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle needs to recreate the error on another rank."""
        return type(self), (self.free_edges, self.length, self.solid_angle, self.position)


def surface(vertices: npt.ArrayLike, triangles: npt.ArrayLike) -> Solid:
    """Return the region inside a closed surface of triangles.

    The surface may have several parts and cavities. All triangles must be oriented alike, either
    outwards or inwards.

    Args:
        vertices: Vertices in m, shape (m, 3).
        triangles: Numbers of their vertices, shape (n, 3). Neighbouring triangles must share
            vertex numbers, not only positions.

    Returns:
        The solid.

    Raises:
        OpenSurfaceError: If some edges have a triangle on one side only.
        ValueError: For wrong shapes or numbers, triangles without area, neighbours of different
            orientation, and a surface that crosses or covers itself.
    """
    x, t = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if x.ndim != 2 or x.shape[1] != 3:
        raise ValueError(f"vertices of a surface need the shape (m, 3), not {x.shape}")
    if t.ndim != 2 or t.shape[1] != 3 or not np.issubdtype(t.dtype, np.integer):
        raise ValueError(f"triangles need integers of shape (n, 3), not {t.dtype} of {t.shape}")
    if not len(t):
        raise ValueError("a surface needs triangles, but none were given")
    if t.min() < 0 or t.max() >= len(x):
        raise ValueError(
            f"numbers of vertices must be 0 to {len(x) - 1}, not {t.min()} to {t.max()}"
        )
    _check_edges(x, t.astype(np.int64))
    return Solid(x[t])


def _check_edges(x: npt.NDArray[np.float64], t: npt.NDArray[np.int64]) -> None:
    """Raise an error unless each edge is traversed equally often in both directions."""
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    direction = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    pairs, which = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    balance = np.bincount(which, weights=direction, minlength=len(pairs)).astype(np.int64)
    ends = x[pairs]
    free = np.flatnonzero(np.bincount(which, minlength=len(pairs)) % 2)
    if len(free):
        lengths = np.linalg.norm(ends[free, 1] - ends[free, 0], axis=1)
        turns = _solid_angle(x[t]) / (4.0 * np.pi)
        raise OpenSurfaceError(
            len(free), float(lengths.sum()), abs(turns - round(turns)), ends[free[0]].mean(axis=0)
        )
    bad = np.flatnonzero(balance)
    if len(bad):
        raise ValueError(
            f"triangles are not oriented alike: neighbours traverse {len(bad)} of {len(pairs)} "
            f"edges in the same direction, first at {ends[bad[0]].mean(axis=0)}; orient them, for "
            "example with pyvista's compute_normals(consistent_normals=True, "
            "auto_orient_normals=True)"
        )


def _solid_angle(facets: npt.NDArray[np.float64]) -> float:
    """Return the solid angle of triangles (n, 3, 3), seen from the centroid of their surface.

    A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126, eq. 8.
    """
    area = np.linalg.norm(
        np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1
    )
    v = facets - np.average(facets.mean(axis=1), axis=0, weights=area)
    a, b, c = v[:, 0], v[:, 1], v[:, 2]
    la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    ab, bc, ca = (np.sum(p * q, axis=1) for p, q in ((a, b), (b, c), (c, a)))
    below = la * lb * lc + ab * lc + bc * la + ca * lb
    return float(2.0 * np.arctan2(np.linalg.det(v), below).sum())
