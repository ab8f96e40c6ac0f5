# SPDX-License-Identifier: MIT
"""PointIntegral: one lowered integral over (a subset of) a point set, ready to be evaluated."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm.basis import stencil_of
from fenicsmpm.forms import linear_loops, loops
from fenicsmpm.forms.geometry import cell_values, geometry_values
from fenicsmpm.forms.kernels import compile_pointwise
from fenicsmpm.forms.lowering import CELL_GEOMETRY, Source, lower
from fenicsmpm.forms.slots import SlotTable, slot_table
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import PointField

logger = logging.getLogger(__name__)

# Points of a batch and thread: its inputs and element tensors should stay in the cache
_BATCH = 4096


class PointIntegral:
    """Integral of a UFL expression over material points.

    Args:
        integrand: scalar UFL expression of rank 0, 1 or 2.
        points: the point set; its weights are the quadrature weights.
        tag: restrict the integral to points with this tag; None for all.
        jit_options: see ``form``.

    Raises:
        UnsupportedFormError: see ``lowering.lower``.
    """

    def __init__(
        self,
        integrand: Any,
        points: MaterialPoints,
        tag: int | None,
        jit_options: dict[str, Any],
    ) -> None:
        """Lower and compile (collective)."""
        self.points = points
        self.tag = tag
        if tag is not None:
            self._warn_of_unknown_tag(tag)
        self.stencil = stencil_of(points)
        self.lowered = lower(integrand, points.mesh)
        self.kernel = compile_pointwise(points.mesh.comm, self.lowered, jit_options)
        # the background mesh does not move as long as it has these points
        self._cell_values = {
            id(source): cell_values(source.item, points.mesh)
            for source in self.lowered.inputs
            if type(source.item).__name__ in CELL_GEOMETRY
        }
        self._version: Any = None
        self._tables: dict[int, SlotTable] = {}
        self._averages: dict[int, SlotTable] = {}
        self._active: dict[int, npt.NDArray[np.int32]] = {}
        self._dofs: dict[int, npt.NDArray[np.int32]] = {}

    def _warn_of_unknown_tag(self, tag: int) -> None:
        here = bool(np.any(self.points.tag == tag))
        if not self.points.mesh.comm.allreduce(here, MPI.LOR):
            logger.warning("no point has the tag %d of an integral: it is zero by now", tag)

    # --- the selected points -----------------------------------------------------------------

    def refresh(self) -> None:
        """Select points and groups anew if the points have moved or changed."""
        self._averages = {}  # they depend on the weights, which may change at any time
        tags = None if self.tag is None else self.points.tag
        key = (self.points.version, None if tags is None else tags.tobytes())
        if key == self._version:
            return
        self._version = key
        self._tables = {}
        self._active = {}
        order, offsets = self.stencil.order, self.stencil.offsets
        selected = slice(None) if tags is None else tags[order] == self.tag
        self.rows = np.arange(len(order))[selected]
        counts = np.searchsorted(self.rows, offsets)
        self.groups = np.flatnonzero(np.diff(counts)).astype(np.int32)
        self.offsets = np.append(counts[self.groups], len(self.rows)).astype(np.int64)
        self.order = order[self.rows]
        self._is_sorted = np.array_equal(self.order, np.arange(len(self.points)))

    def _in_group_order(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Rows of the selected points; no copy where points are stored in group order."""
        return values if self._is_sorted else values[self.order]

    @property
    def weights(self) -> npt.NDArray[np.float64]:
        """``(n,)`` weights of the selected points in group order."""
        return self._in_group_order(self.points.weight)

    def _average(self, table: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Average full table rows over the selected points of each group."""
        result = np.zeros_like(table)
        result[self.rows] = loops.average_groups(table[self.rows], self.weights, self.offsets)
        return result

    def table(self, source: Source) -> SlotTable:
        """Slot table of an argument or function, kept until the points move."""
        assert source.layout is not None
        has_average = np.any(source.used >= source.layout.n_slots // 2)
        tables = self._averages if has_average else self._tables
        if id(source) not in tables:
            tables[id(source)] = slot_table(source.layout, source.used, self.stencil, self._average)
        return tables[id(source)]

    def active(self, source: Source, space: Any) -> npt.NDArray[np.int32]:
        """Local dofs of an argument's space whose functions are not zero at all points."""
        if id(source) not in self._active:
            table = self.table(source)
            dofs = self.dofs(source, space)
            seen = np.zeros((len(self.groups), dofs.shape[1]), dtype=np.bool_)
            slots = (table.basis, table.column, table.length, table.start)
            loops.mark_seen(self.offsets, self.rows, *slots, seen)
            if self.kernel is None:  # a form that is zero is to show as zero
                seen[:] = True
            self._active[id(source)] = np.unique(dofs[self.groups][seen])
        return self._active[id(source)]

    def dofs(self, source: Source, space: Any) -> npt.NDArray[np.int32]:
        """``(n_groups, n_local)`` unrolled dofs of a source's space, in the slots' order."""
        key = id(source)
        if key not in self._dofs:
            assert source.layout is not None
            self._dofs[key] = source.layout.unrolled_dofs(space, self.stencil)
        return self._dofs[key]

    # --- kernel inputs -----------------------------------------------------------------------

    def batches(self) -> Iterator[tuple[slice, slice]]:
        """Ranges of groups and of points that are processed together."""
        size = _BATCH * numba.get_num_threads()
        first = 0
        while first < len(self.groups):
            last = int(np.searchsorted(self.offsets, self.offsets[first] + size, side="right")) - 1
            last = min(max(last, first + 1), len(self.groups))
            yield slice(first, last), slice(int(self.offsets[first]), int(self.offsets[last]))
            first = last

    def plain_inputs(self) -> list[npt.NDArray[np.float64] | None]:
        """Values of the inputs that are not grid functions, ``(n or 1, n_used)`` each."""
        return [
            None if source.layout is not None else self._plain_values(source)
            for source in self.lowered.inputs
        ]

    def _plain_values(self, source: Source) -> npt.NDArray[np.float64]:
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
        elif id(source) in self._cell_values:
            values = self._cell_values[id(source)][self.points.cell[self.order], None]
        else:
            values = geometry_values(item, self.stencil, self.points, self.rows, self.order)
        size = source.size // 2
        if source.used[-1] >= size:
            mean = loops.average_groups(values, self.weights, self.offsets)
            values = np.hstack([values, mean])
        return values if len(source.used) == values.shape[1] else values[:, source.used]

    def inputs(
        self,
        groups: slice,
        points: slice,
        plain: list[npt.NDArray[np.float64] | None],
    ) -> npt.NDArray[np.float64]:
        """``(n_points, n_inputs)`` input vectors of the kernel for a batch."""
        result = np.empty((points.stop - points.start, max(self.lowered.n_inputs, 1)))
        first = 0
        for source, values in zip(self.lowered.inputs, plain, strict=True):
            n = len(source.used)
            if values is not None:
                result[:, first : first + n] = values if len(values) == 1 else values[points]
            else:
                self._gather(source, groups, result, first)
            first += n
        return result

    def _gather(
        self, source: Source, groups: slice, result: npt.NDArray[np.float64], first: int
    ) -> None:
        """Put the used slots of a function at a batch of points into columns of the inputs."""
        assert source.layout is not None
        table = self.table(source)
        function = source.item
        where = (
            self.dofs(source, function.function_space),
            self.groups[groups],
            self.offsets[groups.start : groups.stop + 1],
            self.rows,
        )
        slots = (table.basis, table.column, table.length, table.start)
        values = source.layout.value_slots(source.used)
        if values is None:
            loops.gather_function(function.x.array, *where, *slots, result, first)
        else:
            is_value = np.zeros(len(source.used), dtype=np.bool_)
            is_value[values] = True
            linear_loops.gather_function(function.x.array, *where, is_value, *slots, result, first)

    # --- evaluation --------------------------------------------------------------------------

    def element_tensors(self) -> Iterator[tuple[slice, npt.NDArray[np.float64]]]:
        """Element tensors, a batch of groups at a time.

        Yields:
            The range of ``self.groups`` and the tensors, ``(n, [n_local0, [n_local1]])`` with
            the local dofs in the slots' order.
        """
        self.refresh()
        plain = self.plain_inputs()
        weights = self.weights
        arguments = self.lowered.arguments
        tables = [self.table(source) for source in arguments]
        values = [source.layout.value_slots(source.used) for source in arguments if source.layout]
        linear = all(v is not None for v in values)
        x = self._in_group_order(self.points.x)
        if linear:
            dim = x.shape[1]
            pairs = zip(tables, values, strict=True)
            slots = [a for t, v in pairs for a in linear_loops.with_moments(t, v, dim)]
        else:
            slots = [a for t in tables for a in (t.basis, t.column, t.length, t.start)]
        n_local = [len(source.layout.dof_order) for source in arguments if source.layout]
        kernel = self.kernel
        for groups, points in self.batches():
            result = np.empty((groups.stop - groups.start, *n_local))
            offsets = self.offsets[groups.start : groups.stop + 1]
            if kernel is None:
                result[:] = 0.0
                yield groups, result
                continue
            common = (kernel.address, offsets, weights)
            inputs = self.inputs(groups, points, plain)
            if len(arguments) == 0:
                loops.element_scalars(*common, inputs, result)
            elif linear:
                matrix = len(arguments) == 2
                element = linear_loops.element_matrices if matrix else linear_loops.element_vectors
                element(*common, self.rows, inputs, x, *values, *slots, result)
            else:
                element = loops.element_matrices if len(arguments) == 2 else loops.element_vectors
                element(*common, self.rows, inputs, *slots, result)
            yield groups, result

    def point_tensors(self) -> npt.NDArray[np.float64]:
        """Kernel's output at each selected point, ``(n, *kernel.shape)``, in group order."""
        self.refresh()
        if self.kernel is None:
            return np.zeros((len(self.rows), 0))
        plain = self.plain_inputs()
        size = int(np.prod(self.kernel.shape, dtype=int))
        result = np.zeros((len(self.rows), size))
        for groups, points in self.batches():
            inputs = self.inputs(groups, points, plain)
            loops.evaluate_points(self.kernel.address, inputs, result[points])
        return result.reshape(len(self.rows), *self.kernel.shape)


def selected_tags(integral: ufl.Integral) -> tuple[int | None, ...]:
    """Tags of an integral over points, each of which is an integral of its own; None for all.

    UFL splits ``dx((1, 2))`` by itself up to 2024.2.
    """
    ids = integral.subdomain_id()
    if isinstance(ids, str):  # "everywhere"
        return (None,)
    return tuple(int(i) for i in (ids if isinstance(ids, tuple) else (ids,)))
