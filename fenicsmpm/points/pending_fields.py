# SPDX-License-Identifier: MIT
"""Arrays by name that are brought up to date when somebody looks at them.

A time loop that keeps points in arrays of its own need not write them back after each step. It says
which fields of the points are *pending* and how to get them. Its side of the contract:

1. At the end of a step (or of several), when each point is on the rank that owns its cell, it calls
   ``points.defer(names, provide)``. The arrays of these names are dropped, and ``points.version``
   grows if positions are among them. If points have changed ranks or places in the arrays since,
   the arrays that are not pending have to follow: it takes them by ``points.present()`` and gives
   them back as ``points.defer(names, provide, others)``.
2. The first look at a pending field calls ``provide(name)``, which returns a new array for it, and
   for others of the same call, if they come at little cost. It must not communicate: one rank may
   look at what others do not. It may read other fields of the points. It answers for the state at
   the last ``defer`` until the next one. If it raises, the points are as before.
3. Before it begins the next step, it takes all fields from the points if ``points.version`` is not
   what it was after ``defer``: then points were moved, sorted, added, removed or restored. Else it
   takes those named by ``points.changed``, and its own arrays are right for all others. A field is
   in ``changed`` if it was written, or handed out in an array that can be written. Copies
   (``snapshot``, ``select``), read-only arrays (``x``, ``xi``, ``cell``) and the shapes of values
   do not count. Different ranks may name different fields, so that no step of the loop that
   communicates may depend on them.

Cells and reference coordinates are pending with the positions; they are found from them by this
rank alone. It is the same cell that all ranks together would have found, if points are where they
belong: the lowest of those that touch the point, among the cells of its owner. Ids and tags, the
number of points on the rank and on all ranks are never pending.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

# From a name to an array of that name and, if they come with it, of others; shapes (n, *shape).
Provider: TypeAlias = Callable[[str], Mapping[str, npt.NDArray]]


class FieldTable(Mapping[str, npt.NDArray]):
    """Arrays by name with one row a point. Reading a pending one brings it up to date.

    Attributes:
        changed: Those of the deferred names that were set or marked since they were deferred.
    """

    def __init__(self, arrays: Mapping[str, npt.NDArray]):
        """Nothing is pending. Arrays are not copied."""
        self._arrays = dict(arrays)  # placeholders where they are pending
        self._pending: dict[str, Provider] = {}
        self._deferred: set[str] = set()
        self.changed: set[str] = set()

    def __getitem__(self, name: str) -> npt.NDArray:
        """The array of a name, up to date.

        Raises:
            KeyError: If there is no such name.
            ValueError: For wrong arrays from the provider.
        """
        if name in self._pending:
            self._bring(name)
        return self._arrays[name]

    def __setitem__(self, name: str, array: npt.NDArray) -> None:
        """Replace an array or add one; what was pending for it is forgotten."""
        self._arrays[name] = array
        self._pending.pop(name, None)
        self.mark(name)

    def update(self, arrays: Mapping[str, npt.NDArray]) -> None:
        """Replace some arrays."""
        for name, array in arrays.items():
            self[name] = array

    def __iter__(self) -> Iterator[str]:
        """Names in the order in which they were added."""
        return iter(self._arrays)

    def __len__(self) -> int:
        """Number of names."""
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        """Whether there is an array of this name, pending or not."""
        return name in self._arrays

    def mark(self, name: str) -> None:
        """Say that others may change the array of a name."""
        if name in self._deferred:
            self.changed.add(name)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array; what is pending stays so."""
        return self._arrays[name].shape

    def present(self) -> dict[str, npt.NDArray]:
        """The arrays that are not pending."""
        return {name: a for name, a in self._arrays.items() if name not in self._pending}

    def settle(self, but: Collection[str] = ()) -> None:
        """Bring all arrays up to date, but for some that are to be replaced."""
        for name in list(self._pending):
            if name in self._pending and name not in but:  # it did not come with another one
                self._bring(name)

    def defer(
        self,
        providers: Mapping[str, Provider],
        others: Mapping[str, npt.NDArray] | None = None,
    ) -> None:
        """Drop arrays, which are pending from now on.

        Args:
            providers: For each name to be deferred.
            others: New arrays of all other names that are not pending, with a new number of rows.

        Raises:
            KeyError: For names without arrays.
            ValueError: For others that are not those names, and differ in their numbers of rows.
        """
        unknown = [name for name in providers if name not in self._arrays]
        if unknown:
            raise KeyError(f"no field '{unknown[0]}' to be deferred")
        pending = {**self._pending, **providers}
        arrays = dict(self._arrays)
        if others is not None:
            wanted = [name for name in self if name not in pending]
            if set(others) != set(wanted) or len({len(a) for a in others.values()}) > 1:
                shapes = {name: a.shape for name, a in others.items()}
                raise ValueError(
                    f"arrays of the same number of points are needed for {wanted}, not {shapes}"
                )
            arrays.update(others)
        count = len(next(arrays[name] for name in arrays if name not in pending))
        for name in pending:
            arrays[name] = _placeholder(count, arrays[name])
        self._arrays, self._pending = arrays, pending
        self._deferred |= set(providers)
        self.changed -= set(providers)

    def _bring(self, name: str) -> None:
        """Ask the provider of a pending array."""
        provide = self._pending[name]
        brought = {key: a for key, a in provide(name).items() if self._pending.get(key) is provide}
        for key, array in brought.items():
            blank = self._arrays[key]
            if (array.shape, array.dtype) != (blank.shape, blank.dtype):
                raise ValueError(
                    f"pending field '{key}' of shape {blank.shape} and type {blank.dtype} came "
                    f"with {array.shape} and {array.dtype}"
                )
        if name not in brought:
            raise ValueError(f"pending field '{name}' did not come, but {sorted(brought)}")
        self._arrays.update(brought)
        for key in brought:
            del self._pending[key]


def _placeholder(count: int, array: npt.NDArray) -> npt.NDArray:
    """An array of the type and row shape of another one, which takes no memory."""
    return np.broadcast_to(np.zeros((), dtype=array.dtype), (count, *array.shape[1:]))
