# SPDX-License-Identifier: MIT
"""Sites at which a pointwise form is evaluated, with its arguments and inputs there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from fenicsmpm.forms import linear_loops, loops
from fenicsmpm.forms.geometry import geometry_values
from fenicsmpm.forms.lowering import Source
from fenicsmpm.forms.slots import SlotTable, slot_table
from fenicsmpm.points.point_field import PointField

# Numbers of sites, and of entries in element tensors, per batch and thread, which should stay in
# the cache
_SITES, _NUMBERS = 4096, 1 << 18

Slices = tuple[slice, slice]
PlainInputs = list[npt.NDArray[np.float64] | None]


class Sites:
    """Selected points of a point set, ordered by group.

    The object is valid as long as the points do not move.

    Args:
        points: The point set, ``MaterialPoints`` or ``CondensedPoints``.
        stencil: Stencil of the points.
        rows: Selected rows of the stencil's tables ``(n,)``.
        groups: Groups with selected points ``(n_groups,)``.
        offsets: Range of each of these groups within ``rows`` ``(n_groups + 1,)``.

    Attributes:
        order: Storage index of each site ``(n,)``.
    """

    def __init__(
        self,
        points: Any,
        stencil: Any,
        rows: npt.NDArray[np.int64],
        groups: npt.NDArray[np.int32],
        offsets: npt.NDArray[np.int64],
    ) -> None:
        """Store the selection; nothing is tabulated yet."""
        self.points = points
        self.stencil = stencil
        self.rows = rows
        self.groups = groups
        self.offsets = offsets
        self.order = stencil.order[rows]
        self._is_sorted = np.array_equal(self.order, np.arange(len(points)))
        self._tables: dict[int, SlotTable] = {}
        self._averages: dict[int, SlotTable] = {}

    def forget_tables(self) -> None:
        """Free all tables after their last use, before the points move."""
        self._tables = {}
        self._averages = {}

    def forget_averages(self) -> None:
        """Discard averages before each use, because weights may change at any time."""
        self._averages = {}

    def _in_group_order(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the rows of the sites, without a copy if points are stored in group order."""
        if self._is_sorted:
            return values
        # numpy has the faster loop for lines in "take", for numbers in brackets
        return values[self.order] if values.ndim == 1 else values.take(self.order, axis=0)

    @property
    def weights(self) -> npt.NDArray[np.float64]:
        """Weights in group order ``(n,)`` [m^d]."""
        return self._in_group_order(self.points.weight)

    @property
    def x(self) -> npt.NDArray[np.float64]:
        """Positions in group order ``(n, d)`` [m]."""
        return self._in_group_order(self.points.x)

    # --- grid functions ----------------------------------------------------------------------

    def table(self, source: Source) -> SlotTable:
        """Return the slot table of an argument or function.

        Args:
            source: Argument or function.
        """
        assert source.layout is not None
        tables = self._averages if source.has_averages else self._tables
        if id(source) not in tables:
            tables[id(source)] = slot_table(source.layout, source.used, self.stencil, self._average)
        return tables[id(source)]

    def _average(self, table: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return full table rows averaged over the sites of each group."""
        result = np.zeros_like(table)
        result[self.rows] = loops.average_groups(table[self.rows], self.weights, self.offsets)
        return result

    # --- kernel inputs -----------------------------------------------------------------------

    def batches(self, numbers: int = 1) -> Iterator[Slices]:
        """Yield ranges of groups and of sites that are processed together.

        Args:
            numbers: Number of entries in the element tensor of a group.
        """
        threads = numba.get_num_threads()
        size, most = _SITES * threads, max(1, _NUMBERS // numbers) * threads
        first = 0
        while first < len(self.groups):
            last = int(np.searchsorted(self.offsets, self.offsets[first] + size, side="right")) - 1
            last = min(max(last, first + 1), first + most, len(self.groups))
            yield slice(first, last), slice(int(self.offsets[first]), int(self.offsets[last]))
            first = last

    def plain_inputs(self, sources: list[Source], cell_values: dict[int, Any]) -> PlainInputs:
        """Return the values of the inputs that are not grid functions, ``(n or 1, n_used)`` each.

        Args:
            sources: All inputs of the form.
            cell_values: Values ``(n_cells,)`` of the inputs that are constant in cells, by ``id``.
        """
        return [
            None if source.layout is not None else self._plain_values(source, cell_values)
            for source in sources
        ]

    def _plain_values(self, source: Source, cell_values: dict[int, Any]) -> npt.NDArray[np.float64]:
        item = source.item
        values: npt.NDArray[np.float64]
        if isinstance(item, fem.Constant):
            return item.value.reshape(1, -1)[:, source.used]
        if isinstance(item, PointField):
            if item.points is not self.points:
                raise ValueError(
                    f"field {item.name!r} of another point set in an integral over points: use a "
                    "field of the same points"
                )
            values = self._in_group_order(item.values).reshape(len(self.order), source.size // 2)
        elif id(source) in cell_values:
            values = cell_values[id(source)][self.points.cell[self.order], None]
        else:
            values = geometry_values(item, self.points, self.order)
        size = source.size // 2
        if source.used[-1] >= size:
            mean = loops.average_groups(values, self.weights, self.offsets)
            values = np.hstack([values, mean])
        return values if len(source.used) == values.shape[1] else values[:, source.used]

    def inputs(
        self, batch: Slices, sources: list[Source], plain: PlainInputs, dofs: Any
    ) -> npt.NDArray[np.float64]:
        """Return the input vectors of the kernel for a batch of groups and sites.

        Args:
            batch: Ranges of groups and sites; see ``batches``.
            sources: All inputs of the form.
            plain: Values of plain inputs; see ``plain_inputs``.
            dofs: Function from a source and its space to their dofs ``(n_all_groups, n_local)``.

        Returns:
            Input vectors ``(n_sites, n_inputs)``.
        """
        groups, sites = batch
        n_inputs = sum(len(source.used) for source in sources)
        result = np.empty((sites.stop - sites.start, max(n_inputs, 1)))
        first = 0
        for source, values in zip(sources, plain, strict=True):
            n = len(source.used)
            if values is not None:
                result[:, first : first + n] = values if len(values) == 1 else values[sites]
            else:
                space = source.item.function_space
                self._gather(source, dofs(source, space), groups, result, first)
            first += n
        return result

    def _gather(
        self,
        source: Source,
        dofs: npt.NDArray[np.int32],
        groups: slice,
        result: npt.NDArray[np.float64],
        first: int,
    ) -> None:
        """Write the used slots of a function at a batch of sites to columns of the inputs."""
        assert source.layout is not None
        table = self.table(source)
        function = source.item.x.array
        where = (
            dofs,
            self.groups[groups],
            self.offsets[groups.start : groups.stop + 1],
            self.rows,
        )
        slots = (table.basis, table.column, table.length, table.start)
        values = source.value_slots
        if values is None:
            loops.gather_function(function, *where, *slots, result, first)
        else:
            is_value = np.zeros(len(source.used), dtype=np.bool_)
            is_value[values] = True
            linear_loops.gather_function(function, *where, is_value, *slots, result, first)
