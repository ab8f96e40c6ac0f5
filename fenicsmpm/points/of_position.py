# SPDX-License-Identifier: MIT
"""Functions of positions that users pass: markers, predicates, velocities, densities, stresses.

They are those of dolfinx, in the plane too: a function gets positions in m of the shape (3, n), so
that x[0] are the first coordinates. A marker returns a mask (n,), others values whose last index is
that of the point: (n,), (d, n) of vectors, (3, 3, n) of tensors.
A function may fail on one rank only, so errors are returned: all ranks have to raise them together.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

OfPosition: TypeAlias = Callable[[npt.NDArray[np.float64]], npt.ArrayLike]

# What functions raise that take the wrong axis of their argument.
_OF_WRONG_SHAPES = (IndexError, TypeError, ValueError, np.exceptions.AxisError)


def mask_at(
    marker: OfPosition, x: npt.NDArray[np.float64]
) -> tuple[Exception | None, npt.NDArray[np.bool_]]:
    """Where a marker is true.

    Args:
        marker: Function of positions to a mask.
        x: Positions in m, shape (n, d).

    Returns:
        What is wrong, a ValueError for a wrong shape, else what the marker raised; and the mask
        (n,), false if anything is wrong.
    """
    error, given = _evaluate(marker, x, (), "b", "a mask")
    mask = np.zeros(len(x), dtype=bool) if given is None else np.ascontiguousarray(given)
    return error, mask


def vectors_at(
    function: OfPosition, x: npt.NDArray[np.float64]
) -> tuple[Exception | None, npt.NDArray[np.float64]]:
    """Values of a vector function, with as many components as positions have.

    Args:
        function: Function of positions to vectors.
        x: Positions in m, shape (n, d).

    Returns:
        What is wrong, as for `mask_at`; and the values (n, d), zero if anything is wrong.
    """
    return values_at(function, x, x.shape[1:])


def values_at(
    function: OfPosition, x: npt.NDArray[np.float64], shape: tuple[int, ...]
) -> tuple[Exception | None, npt.NDArray[np.float64]]:
    """Values of a function of some shape.

    Args:
        function: Function of positions to values (*shape, n).
        x: Positions in m, shape (n, d).
        shape: Of a value.

    Returns:
        What is wrong, as for `mask_at`; and the values (n, *shape), zero if anything is wrong.
    """
    error, given = _evaluate(function, x, shape, "biuf", "values")
    values = np.zeros((len(x), *shape))
    if given is not None:
        values[:] = np.moveaxis(given, -1, 0)
    return error, values


class CaughtMarker:
    """A marker for dolfinx' functions that raises nothing, as they are collective.

    Attributes:
        error: What was wrong, see `mask_at`; None if nothing was.
    """

    def __init__(self, marker: OfPosition):
        """Take a user's marker."""
        self._marker = marker
        self.error: Exception | None = None

    def __call__(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Mask (n,) at positions (3, n), false if the user's marker fails."""
        error, mask = mask_at(self._marker, x.T)
        self.error = self.error or error
        return mask


def name_of(function: OfPosition) -> str:
    """What to call a user's function in messages."""
    return getattr(function, "__name__", repr(function))


def _evaluate(
    function: OfPosition, x: npt.NDArray[np.float64], rows: tuple[int, ...], kinds: str, what: str
) -> tuple[Exception | None, npt.NDArray | None]:
    """What is wrong, and values (*rows, n) of numpy's `kinds` if nothing is and there are points.

    Without points the function is not called: taking the largest of none, for example, would fail.
    """
    n, d = x.shape
    if n == 0:
        return None, None
    # Three points would hide that a function takes rows for columns: there one comes twice.
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
    except Exception as caught:  # the user's own: other ranks must hear of it
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
