# SPDX-License-Identifier: MIT
"""Arrays by name that are brought up to date only when somebody reads them.

A time loop that keeps points in arrays of its own need not write them back after each step. It
declares which fields of the points are *pending* and how to get them. The contract of the loop:

1. At the end of one or more steps, when each point is on the rank that owns its cell, the loop
   calls ``points.defer(names, provide)``. The arrays of these names are dropped, and
   ``points.version`` grows if positions are among them. If points have changed ranks or places in
   the arrays since, the arrays that are not pending have to follow: the loop reads them from
   ``points.present()`` and returns them by ``points.defer(names, provide, others)``.
2. The first access to a pending field calls ``provide(name)``. It returns a new array for this
   field, and for others of the same call if they cost little. It must not communicate, as one rank
   may read fields that others do not. It may read other fields of the points. Until the next
   ``defer`` it must return the state of the last one. If it raises, the points stay as they were.
3. Before its next step, the loop compares ``points.version`` with the value after ``defer``. If it
   differs, points were moved, sorted, added, removed or restored, and the loop reads all fields
   again. Otherwise it reads the fields in ``points.changed``; its own arrays are right for all
   others. A field is in ``changed`` if it was written, or handed out as an array that can be
   written. Copies (``snapshot``, ``select``), read-only arrays (``x``, ``xi``, ``cell``) and shapes
   of values do not count. Ranks may differ in ``changed``, so no communication of the loop may
   depend on it.

Cells and reference coordinates are pending together with the positions, and each rank finds them
alone. If points are where they belong, these are the cells that a search on all ranks would find:
among the cells of the owner that touch the point, the one of lowest number. Ids, tags, and the
numbers of points on the rank and on all ranks are never pending.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

# Function from a name to its array and, possibly, arrays of other names; shapes (n, *shape).
Provider: TypeAlias = Callable[[str], Mapping[str, npt.NDArray]]


class FieldTable(Mapping[str, npt.NDArray]):
    """Arrays by name with one row per point; reading a pending one brings it up to date.

    Attributes:
        changed: Deferred names that were set or marked since they were deferred.
    """

    def __init__(self, arrays: Mapping[str, npt.NDArray]):
        """Start with nothing pending. Arrays are not copied."""
        self._arrays = dict(arrays)  # placeholders where they are pending
        self._pending: dict[str, Provider] = {}
        self._deferred: set[str] = set()
        self.changed: set[str] = set()

    def __getitem__(self, name: str) -> npt.NDArray:
        """Return the array of a name, up to date.

        Raises:
            KeyError: If there is no such name.
            ValueError: If the provider returns wrong arrays.
        """
        if name in self._pending:
            self._bring(name)
        return self._arrays[name]

    def __setitem__(self, name: str, array: npt.NDArray) -> None:
        """Replace or add an array; a pending one of this name is forgotten."""
        self._arrays[name] = array
        self._pending.pop(name, None)
        self.mark(name)

    def update(self, arrays: Mapping[str, npt.NDArray]) -> None:
        """Replace some arrays."""
        for name, array in arrays.items():
            self[name] = array

    def __iter__(self) -> Iterator[str]:
        """Iterate over names in the order in which they were added."""
        return iter(self._arrays)

    def __len__(self) -> int:
        """Return the number of names."""
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        """Return whether there is an array of this name, pending or not."""
        return name in self._arrays

    def mark(self, name: str) -> None:
        """Mark an array as possibly changed by others."""
        if name in self._deferred:
            self.changed.add(name)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array, without bringing it up to date."""
        return self._arrays[name].shape

    def present(self) -> dict[str, npt.NDArray]:
        """Return the arrays that are not pending."""
        return {name: a for name, a in self._arrays.items() if name not in self._pending}

    def settle(self, but: Collection[str] = ()) -> None:
        """Bring all arrays up to date, except those in `but`, which are about to be replaced."""
        for name in list(self._pending):
            if name in self._pending and name not in but:  # it may have come with another one
                self._bring(name)

    def defer(
        self,
        providers: Mapping[str, Provider],
        others: Mapping[str, npt.NDArray] | None = None,
    ) -> None:
        """Drop arrays, which are pending from now on.

        Args:
            providers: Provider of each name to be deferred.
            others: New arrays, possibly with another number of rows, for exactly those names that
                are not pending.

        Raises:
            KeyError: For names without arrays.
            ValueError: If `others` has other names, or arrays of different numbers of rows.
        """
        unknown = [name for name in providers if name not in self._arrays]
        if unknown:
            raise KeyError(f"there is no field '{unknown[0]}' to be deferred")
        pending = {**self._pending, **providers}
        arrays = dict(self._arrays)
        if others is not None:
            wanted = [name for name in self if name not in pending]
            if set(others) != set(wanted) or len({len(a) for a in others.values()}) > 1:
                shapes = {name: a.shape for name, a in others.items()}
                raise ValueError(
                    f"others must have arrays of one number of points for {wanted}, not {shapes}"
                )
            arrays.update(others)
        count = len(next(arrays[name] for name in arrays if name not in pending))
        for name in pending:
            arrays[name] = _placeholder(count, arrays[name])
        self._arrays, self._pending = arrays, pending
        self._deferred |= set(providers)
        self.changed -= set(providers)

    def _bring(self, name: str) -> None:
        """Get a pending array from its provider."""
        provide = self._pending[name]
        brought = {key: a for key, a in provide(name).items() if self._pending.get(key) is provide}
        for key, array in brought.items():
            blank = self._arrays[key]
            if (array.shape, array.dtype) != (blank.shape, blank.dtype):
                raise ValueError(
                    f"the provider of pending field '{key}' must return shape {blank.shape} and "
                    f"type {blank.dtype}, not {array.shape} and {array.dtype}"
                )
        if name not in brought:
            raise ValueError(
                f"the provider of pending field '{name}' returned {sorted(brought)} without it"
            )
        self._arrays.update(brought)
        for key in brought:
            del self._pending[key]


def _placeholder(count: int, array: npt.NDArray) -> npt.NDArray:
    """Return an array of the type and row shape of another one that takes no memory."""
    return np.broadcast_to(np.zeros((), dtype=array.dtype), (count, *array.shape[1:]))
