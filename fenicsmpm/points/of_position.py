# SPDX-License-Identifier: MIT
"""Functions of position that users pass: markers, predicates, velocities, densities, stresses.

They follow dolfinx, in 2D as well: a function gets positions in m of shape (3, n), so that x[0]
holds the first coordinates. A marker returns a mask of shape (n,). Other functions return values
whose last index is the point: (n,) for scalars, (d, n) for vectors, (3, 3, n) for tensors.
A function may fail on one rank only. Errors are therefore returned, and the caller raises them on
all ranks together.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

OfPosition: TypeAlias = Callable[[npt.NDArray[np.float64]], npt.ArrayLike]

# Exceptions of functions that index the wrong axis of their argument.
_OF_WRONG_SHAPES = (IndexError, TypeError, ValueError, np.exceptions.AxisError)


def mask_at(
    marker: OfPosition, x: npt.NDArray[np.float64]
) -> tuple[Exception | None, npt.NDArray[np.bool_]]:
    """Evaluate a marker.

    Args:
        marker: Function from positions to a mask.
        x: Positions in m, shape (n, d).

    Returns:
        The error, or None, and the mask of shape (n,), all false after an error. The error is a
        ValueError for a wrong shape, otherwise what the marker raised.
    """
    error, given = _evaluate(marker, x, (), "b", "a mask")
    mask = np.zeros(len(x), dtype=bool) if given is None else np.ascontiguousarray(given)
    return error, mask


def vectors_at(
    function: OfPosition, x: npt.NDArray[np.float64]
) -> tuple[Exception | None, npt.NDArray[np.float64]]:
    """Evaluate a vector function with d components.

    Args:
        function: Function from positions to vectors.
        x: Positions in m, shape (n, d).

    Returns:
        The error, or None, as for `mask_at`; and the values of shape (n, d), zero after an error.
    """
    return values_at(function, x, x.shape[1:])


def values_at(
    function: OfPosition, x: npt.NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[Exception | None, npt.NDArray[np.float64]]:
    """Evaluate a function whose values have a given shape.

    Args:
        function: Function from positions to values of shape (*shape, n).
        x: Positions in m, shape (n, d).
        shape: Shape of one value.

    Returns:
        The error, or None, as for `mask_at`; and the values of shape (n, *shape), zero after an
        error.
    """
    error, given = _evaluate(function, x, shape, "biuf", "values")
    values = np.zeros((len(x), *shape))
    if given is not None:
        values[:] = np.moveaxis(given, -1, 0)
    return error, values


class CaughtMarker:
    """A marker that never raises, for dolfinx' collective functions.

    Attributes:
        error: Error of the user's marker, see `mask_at`; None if there was none.
    """

    def __init__(self, marker: OfPosition):
        """Wrap a user's marker."""
        self._marker = marker
        self.error: Exception | None = None

    def __call__(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Return the mask (n,) at positions (3, n), false if the user's marker fails."""
        error, mask = mask_at(self._marker, x.T)
        self.error = self.error or error
        return mask


def name_of(function: OfPosition) -> str:
    """Return the name of a user's function for messages."""
    return getattr(function, "__name__", repr(function))


def _evaluate(
    function: OfPosition, x: npt.NDArray[np.float64], rows: tuple[int, ...], kinds: str, what: str
) -> tuple[Exception | None, npt.NDArray | None]:
    """Return the error, or None, and values of shape (*rows, n) of one of numpy's `kinds`.

    There are no values after an error. Without points the function is not called, as it may fail
    on empty arrays: a maximum over no values does, for example.
    """
    n, d = x.shape
    if n == 0:
        return None, None
    # With three points a function that mixes up rows and columns would go unnoticed: repeat one.
    count = n + (n == 3)
    positions = np.zeros((3, count))
    positions[:d, :n] = x.T
    positions[:d, n:] = x[:1].T
    takes = (
        f"{name_of(function)} gets positions of the shape (3, n) as in dolfinx, so that x[0] are "
        "the first coordinates"
    )
    try:
        given = np.asarray(function(positions))
    except Exception as caught:  # from user code: other ranks must hear of it
        if type(caught) not in _OF_WRONG_SHAPES:
            return caught, None
        error = ValueError(f"{type(caught).__name__}: {caught} ({takes})")
        error.__cause__ = caught
        return error, None
    if given.shape == (*rows, count) and given.dtype.kind in kinds:
        return None, given[..., :n]
    return ValueError(
        f"{takes}, and must return {what} of the shape {(*rows, count)}, not {given.dtype} of the "
        f"shape {given.shape}"
    ), None
