# SPDX-License-Identifier: MIT
"""Arrays by name with one row a point."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from fenicsmpm.points.checks import assign, check_weight
from fenicsmpm.points.pending_fields import FieldTable

# The arrays that every set of points has; all others are the user's fields.
BUILT_IN = ("x", "weight", "xi", "cell", "id", "tag")
# Changing these by hand would contradict the cells found for the points.
_READ_ONLY = ("x", "xi", "cell", "id")


class PointArrays:
    """What the points of this rank have: built-in arrays and the user's fields, by name."""

    _data: FieldTable
    _initial: dict[str, npt.NDArray[np.float64]]  # of fields that began with one value for all

    def __len__(self) -> int:
        """Number of points on this rank."""
        return self._data.shape("id")[0]

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """Positions in m, shape (n, d), read-only: see `move`."""
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
        """Shape of a field's value at one point.

        Raises:
            KeyError: If there is no such field.
        """
        self._check_name(name)
        return self._data.shape(name)[1:]

    @property
    def changed(self) -> frozenset[str]:
        """Deferred fields that may have other values than the loop's: see `pending_fields`."""
        return frozenset(self._data.changed)

    def present(self) -> dict[str, npt.NDArray]:
        """The arrays that are not pending, for loops that defer others: see `pending_fields`."""
        return self._data.present()

    def add_field(
        self, name: str, shape: tuple[int, ...] = (), value: npt.ArrayLike = 0.0
    ) -> npt.NDArray[np.float64]:
        """Add a field of float64 values.

        Args:
            name: Name of the field, the same on all ranks.
            shape: Shape of the value at one point.
            value: Initial value, of shape `shape` or (n, *shape). One value for all is also that of
                points which are added later without this field.

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
        """Whether there is a field or built-in array of this name."""
        return name in self._data

    def __getitem__(self, name: str) -> npt.NDArray:
        """The array of a field itself, shape (n, *value_shape); no copy.

        Hold no such array across `move`, `add`, `remove`, `sort` or a step: they may replace it.
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
        """Give fields new arrays, without copying them; the old arrays stay as they are.

        Args:
            fields: Arrays of shape (n, *value_shape) by name; also "weight".

        Raises:
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
        """All arrays on this rank, to be given to `restore`.

        Args:
            copy: False for the arrays themselves, if nobody changes them in place.
        """
        return {name: a.copy() if copy else a for name, a in self._data.items()}
