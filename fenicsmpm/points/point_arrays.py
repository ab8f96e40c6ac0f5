# SPDX-License-Identifier: MIT
"""Named arrays with one row per point."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.checks import assign, check_weight
from fenicsmpm.points.pending_fields import FieldTable

# The arrays that every set of points has; all others are the user's fields.
BUILT_IN = ("x", "weight", "xi", "cell", "id", "tag")
# Changes by hand would contradict the cells found for the points.
_READ_ONLY = ("x", "xi", "cell", "id")


class PointArrays:
    """Arrays of the points of this rank by name: the built-in ones and the user's fields."""

    _data: FieldTable
    _initial: dict[str, npt.NDArray[np.float64]]  # of fields added with one value for all points

    def __len__(self) -> int:
        """Return the number of points on this rank."""
        return self._data.shape("id")[0]

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """Positions in m, shape (n, d), read-only; `move` changes them."""
        return self["x"]

    @property
    def xi(self) -> npt.NDArray[np.float64]:
        """Reference coordinates in the cell, shape (n, d), read-only."""
        return self["xi"]

    @property
    def cell(self) -> npt.NDArray[np.int32]:
        """Local cell (owned by this rank) of each point, shape (n,), int32, read-only."""
        return self["cell"]

    @property
    def id(self) -> npt.NDArray[np.int64]:
        """Permanent number of each point, unique over all ranks, shape (n,), int64, read-only."""
        return self["id"]

    @property
    def weight(self) -> npt.NDArray[np.float64]:
        """Volume, area or length of each point in m^d or m^(d-1), shape (n,)."""
        return self["weight"]

    @property
    def tag(self) -> npt.NDArray[np.int32]:
        """Group of each point, shape (n,), int32."""
        return self["tag"]

    @property
    def field_names(self) -> tuple[str, ...]:
        """Names of the user's fields, in the order in which they were added."""
        return tuple(name for name in self._data if name not in BUILT_IN)

    def field_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a field's value at one point.

        Args:
            name: Name of a field or built-in array.

        Raises:
            KeyError: If there is no such field.
        """
        self._check_name(name)
        return self._data.shape(name)[1:]

    @property
    def changed(self) -> frozenset[str]:
        """Deferred fields whose values may differ from those of the loop: see `pending_fields`."""
        return frozenset(self._data.changed)

    def present(self) -> dict[str, npt.NDArray]:
        """Return the arrays that are not pending, for loops that defer fields."""
        return self._data.present()

    def add_field(
        self, name: str, shape: tuple[int, ...] = (), value: npt.ArrayLike = 0.0
    ) -> npt.NDArray[np.float64]:
        """Add a field of float64 values.

        Args:
            name: Name of the field, the same on all ranks.
            shape: Shape of the value at one point.
            value: Initial value, of shape `shape` or (n, *shape). If one value is given for all
                points, points that are added later without this field get it, too.

        Returns:
            The new array, shape (n, *shape).

        Raises:
            ValueError: If the name is taken, or the value has another shape.
        """
        if name in self:
            raise ValueError(f"there is already a field '{name}': assign to points['{name}']")
        array = np.empty((len(self), *shape))
        assign(name, array, value)
        self._data[name] = array
        one = np.array(value, dtype=np.float64)
        if one.shape in ((), shape):
            self._initial[name] = one
        return array

    def __contains__(self, name: object) -> bool:
        """Return whether there is a field or built-in array of this name."""
        return name in self._data

    def __getitem__(self, name: str) -> npt.NDArray:
        """Return the array of a field, shape (n, *value_shape), not a copy.

        Do not keep it across `move`, `add`, `remove`, `sort` or a time step: they may replace it.
        """
        self._check_name(name)
        array = self._data[name]
        if name in _READ_ONLY:
            array = array.view()
            array.flags.writeable = False
        else:
            self._data.mark(name)
        return array

    def _check_name(self, name: str) -> None:
        if name not in self._data:
            raise KeyError(f"no field '{name}' at the points; there are {', '.join(self._data)}")

    def __setitem__(self, name: str, value: npt.ArrayLike) -> None:
        """Fill the array of an existing field with a value of shape (n, *shape) or (*shape)."""
        if name in _READ_ONLY:
            raise ValueError(f"'{name}' cannot be assigned: positions are changed by move()")
        if name == "weight":
            check_weight(np.atleast_1d(np.asarray(value, dtype=np.float64)))
        assign(name, self[name], value)

    def assign(self, fields: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Replace the arrays of fields without copying; the old arrays stay unchanged.

        Args:
            fields: Arrays of shape (n, *value_shape) by name; also "weight".

        Raises:
            KeyError: For names without a field.
            ValueError: For arrays of another shape, and weights that are not positive and finite.
        """
        for name, array in fields.items():
            self._check_name(name)
            if array.shape != self._data.shape(name) or name in _READ_ONLY:
                raise ValueError(f"an array of shape {array.shape} cannot become field '{name}'")
            if name == "weight":
                check_weight(array)
        self._data.update(fields)

    def snapshot(self, copy: bool = True) -> dict[str, npt.NDArray]:
        """Return all arrays on this rank, for `restore`.

        Args:
            copy: False returns the arrays themselves, for callers that never change them in place.
        """
        return {name: a.copy() if copy else a for name, a in self._data.items()}
