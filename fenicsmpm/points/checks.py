# SPDX-License-Identifier: MIT
"""Checks of user input. They return errors, which the caller raises on all ranks together."""

from collections.abc import Iterable, Mapping

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.location import Locator
from fenicsmpm.points.of_position import OfPosition, mask_at

Checked = tuple[ValueError | None, dict[str, npt.NDArray]]


def check_positions(
    x: npt.ArrayLike, dim: int, count: int | None = None
) -> tuple[ValueError | None, npt.NDArray[np.float64]]:
    """Copy positions to float64 and check their shape (n, dim), values, and `count` if given."""
    try:
        positions = np.array(x, dtype=np.float64, order="C")
    except (TypeError, ValueError) as e:
        return ValueError(f"positions of points must be numbers: {e}"), np.zeros((0, dim))
    if positions.ndim != 2 or positions.shape[1] != dim:
        return ValueError(f"positions need the shape (n, {dim}), not {positions.shape}"), positions
    if count is not None and len(positions) != count:
        return ValueError(f"{len(positions)} positions were given for {count} points"), positions
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(bad):
        return ValueError(
            f"positions must be finite: {len(bad)} of {len(positions)} are not, first point "
            f"{bad[0]} at {positions[bad[0]]}"
        ), positions
    return None, positions


def check_input(
    locator: Locator,
    x: npt.ArrayLike,
    weight: npt.ArrayLike,
    cells: npt.ArrayLike | None,
    xi: npt.ArrayLike | None,
    tag: npt.ArrayLike,
    number: npt.ArrayLike | None,
    fields: Mapping[str, npt.ArrayLike] | None,
    reserved: Iterable[str],
) -> Checked:
    """Check and copy the arguments of `MaterialPoints`."""
    error, positions = check_positions(x, locator.geometry.dim)
    data: dict[str, npt.NDArray] = {"x": positions}
    if error:
        return error, data
    n = len(positions)
    try:
        data["weight"] = _column("weight", weight, n, np.float64)
        data["tag"] = _column("tag", tag, n, np.int32)
        check_weight(data["weight"])
        if number is not None:
            data["id"] = _column("number", number, n, np.int64)
        if cells is not None:
            data["cell"] = _column("cells", cells, n, np.int32)
            _check_cells(data["cell"], locator.geometry.num_cells, -1 if xi is None else 0)
        if xi is not None:
            if cells is None:
                raise ValueError("xi needs cells, too: reference coordinates refer to a cell")
            data["xi"] = np.array(xi, dtype=np.float64, order="C")
            _check_reference(locator, data)
        for name, value in (fields or {}).items():
            if name in reserved:
                raise ValueError(f"'{name}' cannot be the name of a field: all points have it")
            data[name] = np.array(value, dtype=np.float64, order="C")
            if data[name].shape[:1] != (n,):
                raise ValueError(
                    f"field '{name}' of shape {data[name].shape} does not fit {n} points: the "
                    "first index must be the point"
                )
    except ValueError as e:
        return e, data
    return None, data


def check_fields(comm: MPI.Comm, data: Mapping[str, npt.NDArray]) -> ValueError | None:
    """Return an error unless all ranks have the same fields. Collective."""
    mine = {name: a.shape[1:] for name, a in data.items()}
    first = comm.bcast(mine)
    if mine != first or list(mine) != list(first):
        return ValueError(
            f"arrays and value shapes of points on rank {comm.rank} are {mine}, on rank 0 {first}: "
            "pass the same on all ranks (arrays with no rows where there are no points)"
        )
    return None


def check_same_fields(mine: Mapping[str, npt.NDArray], theirs: Mapping[str, npt.NDArray]) -> None:
    """Raise a ValueError unless two point sets have arrays of the same names and row shapes."""
    first, second = ({(name, a.shape[1:]) for name, a in data.items()} for data in (mine, theirs))
    if first != second:
        raise ValueError(
            f"points with {_listed(second - first)} cannot be added to points with "
            f"{_listed(first - second)}: add the missing fields first"
        )


def _listed(fields: set[tuple[str, tuple[int, ...]]]) -> str:
    names = ", ".join(f"'{name}' of shape {shape}" for name, shape in sorted(fields))
    return f"a field {names}" if names else "none of these"


def check_selection(
    which: npt.ArrayLike | OfPosition, x: npt.NDArray[np.float64]
) -> tuple[Exception | None, npt.NDArray[np.bool_]]:
    """Return an error, or None, and the mask selected by a mask, indices, or a marker.

    The points are at x, shape (n, d).
    """
    if callable(which):
        return mask_at(which, x)
    n = len(x)
    mask = np.zeros(n, dtype=bool)
    given = np.asarray(which)
    if given.dtype == bool and given.shape == (n,):
        return None, given
    if given.dtype == bool:
        return ValueError(
            f"a mask of points needs shape ({n},) and bool values, not shape {given.shape} and "
            f"type {given.dtype}"
        ), mask
    if given.size == 0:
        return None, mask
    if given.ndim != 1 or not np.issubdtype(given.dtype, np.integer):
        return ValueError(
            "points are selected by a mask or by indices of shape (m,), not by an array of type "
            f"{given.dtype} and shape {given.shape}"
        ), mask
    if given.min() < 0 or given.max() >= n:
        return ValueError(
            f"indices of points must be 0 to {n - 1}, not {given.min()} to {given.max()}"
        ), mask
    mask[given] = True
    return None, mask


def _column(name: str, value: npt.ArrayLike, n: int, dtype: type) -> npt.NDArray:
    given = np.asarray(value)
    if given.shape not in ((), (n,)):
        raise ValueError(f"{name} of shape {given.shape} does not fit {n} points: it needs ({n},)")
    column: npt.NDArray = np.empty(n, dtype=dtype)
    column[...] = given
    return column


def check_weight(weight: npt.NDArray[np.float64]) -> None:
    """Raise a ValueError unless all weights, shape (n,), are positive and finite."""
    bad = np.flatnonzero(~((weight > 0.0) & np.isfinite(weight)))
    if len(bad):
        raise ValueError(
            f"weights must be positive and finite: {len(bad)} of {len(weight)} are not, first "
            f"{weight[bad[0]]} at point {bad[0]}"
        )


def _check_cells(cell: npt.NDArray[np.int32], num_cells: int, lowest: int) -> None:
    bad = np.flatnonzero((cell < lowest) | (cell >= num_cells))
    if len(bad):
        raise ValueError(
            f"local cells must be {lowest} to {num_cells - 1}: {len(bad)} are not, first "
            f"{cell[bad[0]]} at point {bad[0]}"
        )


def _check_reference(locator: Locator, data: Mapping[str, npt.NDArray]) -> None:
    x, xi, cell = data["x"], data["xi"], data["cell"]
    if xi.shape != x.shape:
        raise ValueError(f"xi of shape {xi.shape} does not fit positions of shape {x.shape}")
    bad = np.flatnonzero(~locator.agrees(x, xi, cell))
    if len(bad):
        raise ValueError(
            f"xi and cells do not give the positions of {len(bad)} of {len(x)} points, first of "
            f"point {bad[0]} at {x[bad[0]]}; leave xi out to have the points located"
        )


def assign(name: str, array: npt.NDArray, value: npt.ArrayLike) -> None:
    """Fill the array of a field with one value for all points or one value per point."""
    given = np.asarray(value)
    if given.shape not in (array.shape, array.shape[1:], ()):
        raise ValueError(
            f"field '{name}' needs a value of shape {array.shape[1:]} or values of shape "
            f"{array.shape}, not {given.shape}"
        )
    array[...] = given
