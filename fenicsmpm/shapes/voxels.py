# SPDX-License-Identifier: MIT
"""Solids from images: masks of pixels and voxels, and level sets of gray values.

Arrays have the first coordinate first: values[i, j] or values[i, j, k] belong to the pixel or voxel
whose lower corner is origin + (i, j, k) * spacing.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from fenicsmpm.shapes.solid import Solid
from fenicsmpm.shapes.surface import surface

# Values this close to the level, as a fraction of their range, are moved away to avoid slivers.
_FROM_LEVEL = 1e-3


def mask(
    values: npt.ArrayLike, spacing: float | npt.ArrayLike = 1.0, origin: npt.ArrayLike = 0.0
) -> Solid:
    """Return the union of pixels or voxels. Its boundary follows their sides.

    The volume is exact. The area is that of a staircase; `contour` makes a smooth boundary.

    Args:
        values: True in the solid, shape (nx, ny) or (nx, ny, nz).
        spacing: Size of a voxel in m, one number or shape (d,).
        origin: Lower corner of the first voxel in m, one number or shape (d,).

    Returns:
        The solid.

    Raises:
        ValueError: For other shapes, values that are not bool, a mask that is false everywhere, and
            a spacing that is not positive.
    """
    given = np.asarray(values)
    if given.ndim not in (2, 3) or given.dtype != bool:
        raise ValueError(
            f"a mask needs bool values of shape (nx, ny) or (nx, ny, nz), not {given.dtype} of "
            f"shape {given.shape}: compare an image with a level, as in image > 0.5"
        )
    size, start = _checked(given.ndim, spacing, origin)
    if not given.any():
        raise ValueError(f"a mask must be true somewhere, but all {given.shape} values are false")
    d = given.ndim
    padded = np.pad(given, 1).astype(np.int8)
    # corners of a side whose normal is direction 0, counter-clockwise as seen from outside
    corners = np.array([[0], [1]] if d == 2 else [[0, 0], [1, 0], [1, 1], [0, 1]])
    pieces = [[0, 1]] if d == 2 else [[0, 1, 2], [0, 2, 3]]
    facets = []
    for axis, sign in itertools.product(range(d), (1, -1)):
        # voxel i of the image has the index i + 1 here, so a step from i to i + 1 is at position i
        steps = np.diff(padded, axis=axis) == -sign
        place = np.stack(np.nonzero(steps), axis=1) - 1
        place[:, axis] += 1
        others = [(axis + 1 + k) % d for k in range(d - 1)]
        side = np.repeat(place[:, None], len(corners), axis=1)
        side[:, :, others] += corners
        # in 2D the turn from the other direction to the second one is clockwise
        turn = -1 if (sign < 0) != (d == 2 and axis == 1) else 1
        facets += [side[:, piece[::turn]] for piece in pieces]
    return Solid(start + np.concatenate(facets) * size)


def contour(
    values: npt.ArrayLike,
    level: float,
    spacing: float | npt.ArrayLike = 1.0,
    origin: npt.ArrayLike = 0.0,
) -> Solid:
    """Return the region where gray values are above a level, with an interpolated boundary.

    Values belong to the centres of voxels and vary linearly between them. The boundary comes from
    marching squares in 2D (contourpy) and marching cubes in 3D (VTK by pyvista). Outside of the
    image the lowest value is assumed. Normals and area converge for smooth images. A mask should be
    blurred first, for example with scipy.ndimage.gaussian_filter.

    Args:
        values: Gray values, shape (nx, ny) or (nx, ny, nz).
        level: Level between the lowest and the highest value. Values closer to it than a
            thousandth of their range are moved away from it.
        spacing: Size of a voxel in m, one number or shape (d,).
        origin: Lower corner of the first voxel in m, one number or shape (d,).

    Returns:
        The solid.

    Raises:
        ValueError: For other shapes, values that are not finite, a level out of their range, and a
            spacing that is not positive.
        ImportError: In 3D, if pyvista is not installed.
    """
    given = np.asarray(values, dtype=np.float64)
    if given.ndim not in (2, 3):
        raise ValueError(f"an image needs the shape (nx, ny) or (nx, ny, nz), not {given.shape}")
    size, start = _checked(given.ndim, spacing, origin)
    lowest, highest = given.min(initial=np.inf), given.max(initial=-np.inf)
    if not np.isfinite(given).all() or not lowest < level < highest:
        raise ValueError(
            f"the level {level} must lie between the finite values of the image, from {lowest} to "
            f"{highest}"
        )
    padded = np.pad(given, 1, constant_values=lowest) - level
    least = _FROM_LEVEL * (highest - lowest)
    padded = np.where(np.abs(padded) < least, np.where(padded < 0.0, -least, least), padded)
    first = start - 0.5 * size  # centre of the first added voxel
    return Solid(_lines(padded) * size + first) if given.ndim == 2 else _level(padded, size, first)


def _checked(
    d: int, spacing: float | npt.ArrayLike, origin: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return spacing and origin as arrays (d,)."""
    size, start = (np.asarray(each, dtype=np.float64) for each in (spacing, origin))
    if size.shape not in ((), (d,)) or start.shape not in ((), (d,)):
        raise ValueError(
            f"spacing and origin of an image need 1 or {d} numbers, not {spacing!r} and {origin!r}"
        )
    if not np.all((size > 0.0) & (size < np.inf)):
        raise ValueError(f"the spacing of an image must be positive, not {spacing!r}")
    return np.broadcast_to(size, d), np.broadcast_to(start, d)


def _lines(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the segments (n, 2, 2) of level 0, in units of pixels."""
    from contourpy import LineType, contour_generator

    # contourpy has the second coordinate first
    generator = contour_generator(z=values.T, line_type=LineType.Separate)
    lines = [np.asarray(line, dtype=np.float64) for line in generator.lines(0.0)]
    return np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])


def _level(
    values: npt.NDArray[np.float64], size: npt.NDArray[np.float64], first: npt.NDArray[np.float64]
) -> Solid:
    """Return the solid bounded by level 0 in 3D."""
    import pyvista

    grid = pyvista.ImageData(dimensions=values.shape)
    grid.point_data["values"] = values.ravel(order="F")
    found = grid.contour([0.0], scalars="values", method="flying_edges", compute_normals=False)
    triangles = found.faces.reshape(-1, 4)[:, 1:]
    return surface(np.asarray(found.points, dtype=np.float64) * size + first, triangles)
