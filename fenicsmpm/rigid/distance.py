# SPDX-License-Identifier: MIT
"""Signed distance of one point from a rigid shape, compiled by numba.

The distance from a box has a formula. All other shapes are sampled on their own lattice, and the
distance and its gradient are interpolated linearly in each direction between samples. Therefore a
contact law is the same function of one point for any shape, and its cost does not depend on the
number of edges or triangles.
"""

# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fenicsmpm._njit import njit
from fenicsmpm.basis.blocks import OPTIONS, inline

Array = npt.NDArray[np.float64]

_MOST = 20_000_000  # largest number of samples
_FEW = 5e-2  # norm of a gradient below which it has no meaningful direction


class Distance(NamedTuple):
    """Data of the compiled distance.

    Attributes:
        lower: First corner of a box, or of the lattice of samples ``(d,)`` [m].
        upper: Opposite corner ``(d,)`` [m].
        count: Number of samples in each direction ``(d,)``, 0 for a box.
        per_metre: Samples per length in each direction ``(d,)`` [1/m].
        samples: Distances and their gradients ``(n, 1 + d)``, with the last direction fastest.
    """

    lower: Any
    upper: Any
    count: Any
    per_metre: Any
    samples: Any


def of_box(lower: Array, upper: Array) -> Distance:
    """Return the distance from an axis-parallel box.

    Args:
        lower: Corner ``(d,)`` [m].
        upper: Opposite corner ``(d,)`` [m]. Both corners may have infinite components.
    """
    d = len(lower)
    none = np.zeros(d)
    return Distance(lower, upper, none.astype(np.int64), none, np.zeros((0, 1 + d)))


def sampled(shape: Any, spacing: float, margin: float) -> tuple[Distance, float]:
    """Sample the distance from a shape.

    Args:
        shape: Object with ``bounds()``, two corners ``(d,)`` of a box that contains it, and
            ``distance`` of positions ``(3, n)`` [m].
        spacing: Largest spacing of the samples [m].
        margin: Distance by which the samples extend beyond that box [m].

    Returns:
        The samples, and the largest error [m] of the interpolated distance within the margin of the
        surface. The error is measured at the centres between samples.

    Raises:
        ValueError: If there would be too many samples, a distance is not finite, or the slope of
            the function is not one near the surface.
    """
    first, last = shape.bounds()
    lower, upper = first - margin, last + margin
    count = np.ceil((upper - lower) / spacing).astype(np.int64) + 1
    if math.prod(map(float, count)) > _MOST:
        raise ValueError(
            f"{' x '.join(map(str, count))} samples of a distance are too many: give the rigid "
            f"body a larger spacing than {spacing:g} m"
        )
    steps = (upper - lower) / (count - 1)
    axes = [np.linspace(*ends) for ends in zip(lower, upper, count, strict=True)]
    values = _values(shape, axes).reshape(count)
    if not values.min() < 0 < values.max():
        raise ValueError(
            f"the signed distance lies between {values.min():g} and {values.max():g} m within "
            f"{lower} ... {upper}: it must be negative inside the body and positive outside"
        )
    slopes = np.gradient(values, *steps)
    near = np.abs(values) < margin
    steepness = float(np.median(np.sqrt(np.sum([g[near] ** 2 for g in slopes], axis=0))))
    if not 0.8 < steepness < 1.25:
        raise ValueError(
            f"the slope of a signed distance must be 1, but is about {steepness:.3g} near the "
            "surface: divide a level set by the norm of its gradient"
        )
    samples = np.stack([values, *slopes], axis=-1).reshape(-1, 1 + len(count))
    field = Distance(lower, upper, count, 1 / steps, np.ascontiguousarray(samples))
    middle = [(axis[1:] + axis[:-1]) / 2 for axis in axes]
    between, exact = values, _values(shape, middle)
    for k in range(len(count)):
        low, high = np.arange(count[k] - 1), np.arange(1, count[k])
        between = (between.take(low, axis=k) + between.take(high, axis=k)) / 2
    there = np.abs(exact) < margin
    return field, float(np.max(np.abs(between.ravel() - exact)[there], initial=0.0))


def _values(shape: Any, axes: list[Array]) -> Array:
    x = np.zeros((3, math.prod(map(len, axes))))
    for k, coordinates in enumerate(np.meshgrid(*axes, indexing="ij")):
        x[k] = coordinates.ravel()
    values = np.asarray(shape.distance(x), dtype=np.float64)
    if values.shape != x.shape[1:] or not np.isfinite(values).all():
        raise ValueError(
            "the signed distance of positions (3, n) must be n finite numbers, not an array of "
            f"shape {values.shape} with {np.count_nonzero(~np.isfinite(values))} values that are "
            "not finite"
        )
    return values


@inline
def distance_at(field, y, normal):
    """Return the distance of a point from a shape, and set the direction away from it.

    Args:
        field: The ``Distance``.
        y: Position ``(d,)`` in the frame in which the shape was given [m].
        normal: Direction ``(d,)``, overwritten. It is zero where there is no direction.

    Returns:
        The distance [m], negative inside, infinite outside the samples.
    """
    if len(field.samples) > 0:
        return _interpolate(field, y, normal)
    outside, nearest, side, sign = 0.0, -np.inf, 0, 1.0
    for k in range(len(y)):
        below, above = field.lower[k] - y[k], y[k] - field.upper[k]
        normal[k] = max(above, 0.0) - max(below, 0.0)
        outside += normal[k] * normal[k]
        if max(below, above) > nearest:
            nearest, side, sign = max(below, above), k, -1.0 if below > above else 1.0
    if outside > 0.0:
        distance = np.sqrt(outside)
        for k in range(len(y)):
            normal[k] /= distance
        return distance
    normal[:] = 0.0
    normal[side] = sign
    return nearest


@inline
def _interpolate(field, y, normal):
    d = len(y)
    first = 0
    for k in range(d):
        t = (y[k] - field.lower[k]) * field.per_metre[k]
        if not (0.0 <= t <= field.count[k] - 1):
            return np.inf
        first = first * field.count[k] + min(int(t), field.count[k] - 2)
    distance = 0.0
    normal[:] = 0.0
    for corner in range(1 << d):
        weight, place, stride = 1.0, first, 1
        for j in range(d):
            k = d - 1 - j
            t = (y[k] - field.lower[k]) * field.per_metre[k]
            t -= min(int(t), field.count[k] - 2)
            if corner >> j & 1:
                weight *= t
                place += stride
            else:
                weight *= 1.0 - t
            stride *= field.count[k]
        distance += weight * field.samples[place, 0]
        for k in range(d):
            normal[k] += weight * field.samples[place, 1 + k]
    norm = 0.0
    for k in range(d):
        norm += normal[k] * normal[k]
    norm = np.sqrt(norm)
    for k in range(d):
        normal[k] = normal[k] / norm if norm > _FEW else 0.0
    return distance


@njit(**OPTIONS)
def distances_at(field, y):
    """Return distances ``(n,)`` and normals ``(n, d)`` of points; see ``distance_at``.

    Args:
        field: The ``Distance``.
        y: Positions ``(n, d)`` in the frame in which the shape was given [m].
    """
    distances, normals = np.empty(len(y)), np.zeros(y.shape)
    for p in range(len(y)):
        distances[p] = distance_at(field, y[p], normals[p])
    return distances, normals
