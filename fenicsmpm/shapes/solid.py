# SPDX-License-Identifier: MIT
"""Solids given by their closed boundary."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fenicsmpm.shapes.tree import Tree, all_distances, all_windings, build

# Distance, as a fraction of the size of a solid, at which both sides of its facets are tested.
_BESIDE = 1e-7


class Solid:
    """Region with a closed boundary of straight facets, in 2D or 3D.

    It is a predicate of positions like dolfinx' markers, so it can be passed wherever ``inside=``
    is expected. Nothing here is collective: each rank has all facets.

    Attributes:
        dim: Dimension d, 2 or 3.
        facets: Vertices in m, shape (n, d, d): facet, vertex, coordinate. Facets are segments in
            2D, triangles in 3D.
        normals: Outer unit normals of the facets, shape (n, d).
        areas: Areas of the facets in m^2, in 2D lengths in m, shape (n,).
        volume: Volume in m^d.
        centroid: Centroid in m, shape (d,).
        second_moment: Integral of (x - centroid) (x - centroid)^T over the solid in m^(d + 2),
            shape (d, d).
        tree: Search tree for compiled loops, see `fenicsmpm.shapes.tree`.
    """

    def __init__(self, facets: npt.ArrayLike):
        """Create a solid from its closed boundary.

        Args:
            facets: Vertices in m, shape (n, d, d), all oriented alike. A boundary whose normals
                point inwards is reversed.

        Raises:
            ValueError: For wrong shapes, positions that are not finite, facets without area, and a
                boundary that is not closed, or crosses or covers itself.
        """
        self.facets = np.array(facets, dtype=np.float64, order="C")
        shape = self.facets.shape
        if len(shape) != 3 or shape[1:] not in ((2, 2), (3, 3)) or not len(self.facets):
            raise ValueError(f"facets need the shape (n, 2, 2) or (n, 3, 3), not {shape}")
        if not np.isfinite(self.facets).all():
            bad = np.flatnonzero(~np.isfinite(self.facets).all(axis=(1, 2)))
            raise ValueError(f"vertices must be finite: {len(bad)} facets are not, first {bad[0]}")
        self.dim = shape[2]
        vectors = self._area_vectors()
        self.areas = np.linalg.norm(vectors, axis=1)
        self._check_areas()
        open_by = float(np.linalg.norm(vectors.sum(axis=0)) / self.areas.sum())
        if open_by > 1e-9:
            raise ValueError(
                f"the boundary is not closed: its area vectors add up to {open_by:.3g} of its area"
            )
        self.volume, self.centroid, self.second_moment = self._moments()
        if self.volume < 0.0:  # normals point inwards
            self.facets = np.ascontiguousarray(self.facets[:, ::-1])
            vectors, self.volume, self.second_moment = -vectors, -self.volume, -self.second_moment
        self.normals = vectors / self.areas[:, None]
        self.tree: Tree = build(self.facets, self.normals)
        self._check_sides()

    def _area_vectors(self) -> npt.NDArray[np.float64]:
        """Return outer normals times areas, (n, d)."""
        edges = self.facets[:, 1:] - self.facets[:, :1]
        if self.dim == 2:
            return np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
        return 0.5 * np.cross(edges[:, 0], edges[:, 1])

    def _check_areas(self) -> None:
        """Raise an error for facets without a normal."""
        edges = self.facets - np.roll(self.facets, 1, axis=1)
        longest = np.linalg.norm(edges, axis=2).max(axis=1)
        size = np.abs(self.facets).max()
        flat = self.areas <= np.maximum(1e-12 * longest, 1e-15 * size) * longest ** (self.dim - 2)
        bad = np.flatnonzero(flat)
        if len(bad):
            what = "sides without length" if self.dim == 2 else "triangles without area"
            raise ValueError(
                f"{len(bad)} of {len(flat)} facets are {what}, first number {bad[0]} at "
                f"{self.facets[bad[0], 0]}: remove them"
            )

    def _moments(self) -> tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return volume, centroid and second moment, by simplices from the facets to one point."""
        d = self.dim
        lower, upper = self.bounds()
        start = 0.5 * (lower + upper)
        v = self.facets - start
        parts = np.linalg.det(v) / (2.0 if d == 2 else 6.0)
        volume = float(parts.sum())
        if not abs(volume) > 1e-12 * np.prod(upper - lower):
            raise ValueError(f"the boundary must enclose a volume, but its volume is {volume:.3g}")
        s = v.sum(axis=1)
        centroid = np.einsum("n,ni->i", parts, s) / ((d + 1) * volume)
        square = np.einsum("n,nai,naj->ij", parts, v, v) + np.einsum("n,ni,nj->ij", parts, s, s)
        second = square / ((d + 1) * (d + 2)) - volume * np.outer(centroid, centroid)
        return volume, start + centroid, second

    def _check_sides(self) -> None:
        """Raise an error unless each facet has the solid behind it and nothing in front of it."""
        lower, upper = self.bounds()
        step = _BESIDE * float(np.linalg.norm(upper - lower))
        edges = np.linalg.norm(self.facets - np.roll(self.facets, 1, axis=1), axis=2)
        # Beside a sliver, such a point may lie on the other side of a neighbouring facet.
        which = np.flatnonzero(self.areas > 10.0 * step * edges.max(axis=1) ** (self.dim - 2))
        centre, offset = self.facets[which].mean(axis=1), step * self.normals[which]
        behind, before = (all_windings(self.tree, centre + s * offset) for s in (-1, 1))
        bad = np.flatnonzero((behind != 1) | (before != 0))
        if len(bad):
            raise ValueError(
                f"the boundary crosses or covers itself: {len(bad)} of {len(which)} facets do not "
                f"have the solid on one side, first number {which[bad[0]]} at {centre[bad[0]]}; "
                "unite bodies that overlap, and orient all parts alike"
            )

    @property
    def area(self) -> float:
        """Area of the whole boundary in m^(d-1)."""
        return float(self.areas.sum())

    def bounds(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the lowest and highest coordinates in m, each of shape (d,)."""
        return self.facets.min(axis=(0, 1)), self.facets.max(axis=(0, 1))

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which positions are inside.

        Args:
            x: Positions in m, shape (3, n) as in dolfinx; in 2D also (2, n).

        Returns:
            Mask, shape (n,).
        """
        inside: npt.NDArray[np.bool_] = all_windings(self.tree, self._positions(x)) > 0
        return inside

    def distance(self, x: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the signed distance from the boundary in m, negative inside, shape (n,).

        Args:
            x: Positions as in `__call__`.
        """
        return self.distance_and_gradient(x)[0]

    def distance_and_gradient(
        self, x: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the signed distance in m, shape (n,), and its gradient, shape (d, n).

        The gradient is a unit vector. If several points of the boundary are closest, it belongs to
        one of them. On the boundary it is the outer normal of a facet.

        Args:
            x: Positions as in `__call__`.
        """
        distance, gradient = all_distances(self.tree, self._positions(x))
        return distance, np.ascontiguousarray(gradient.T)

    def _positions(self, x: npt.ArrayLike) -> npt.NDArray[np.float64]:
        given = np.asarray(x, dtype=np.float64)
        if given.ndim != 2 or given.shape[0] not in (self.dim, 3):
            raise ValueError(
                f"positions need the shape (3, n) as in dolfinx, so that x[0] are the first "
                f"coordinates, not {given.shape}"
            )
        return np.ascontiguousarray(given[: self.dim].T)

    def transformed(
        self,
        scale: float = 1.0,
        translation: npt.ArrayLike = 0.0,
        rotation: npt.ArrayLike | None = None,
    ) -> Solid:
        """Return the solid scaled, then rotated, then translated: R (scale x) + translation.

        Args:
            scale: Positive factor, such as 1e-3 for a file in mm.
            translation: Translation in m, one number or shape (d,).
            rotation: Rotation matrix R, shape (d, d); None for no rotation.

        Raises:
            ValueError: For a scale that is not positive, or a matrix that is no rotation.
        """
        if not 0.0 < scale < np.inf:
            raise ValueError(f"a scale must be positive, not {scale}")
        R = np.eye(self.dim) if rotation is None else np.asarray(rotation, dtype=np.float64)
        if R.shape != (self.dim, self.dim) or not (
            np.allclose(R @ R.T, np.eye(self.dim), atol=1e-9) and np.linalg.det(R) > 0
        ):
            raise ValueError(
                f"a rotation of {self.dim} dimensions needs an orthogonal matrix, not {R.tolist()}"
            )
        shift = np.asarray(translation, dtype=np.float64)
        if shift.shape not in ((), (self.dim,)):
            raise ValueError(f"a translation needs {self.dim} components, not {shift}")
        return Solid(scale * self.facets @ R.T + shift)

    def __repr__(self) -> str:
        """Return size and bounds as text."""
        lower, upper = self.bounds()
        what = "sides" if self.dim == 2 else "triangles"
        return (
            f"Solid of {len(self.facets)} {what}: volume {self.volume:.6g}, area {self.area:.6g}, "
            f"bounds {lower} to {upper}"
        )
