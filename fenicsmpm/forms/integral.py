# SPDX-License-Identifier: MIT
"""Integrals over (a subset of) a point set, lowered and ready for evaluation."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from fenicsmpm.basis import LagrangeStencil, stencil_of
from fenicsmpm.forms import linear_loops, loops, matrix_loops
from fenicsmpm.forms.condensation import Condensation, sites_per_cell
from fenicsmpm.forms.errors import UnsupportedFormError
from fenicsmpm.forms.geometry import cell_values
from fenicsmpm.forms.kernels import compile_pointwise
from fenicsmpm.forms.lowering import CELL_GEOMETRY, Source, lower
from fenicsmpm.forms.sites import Sites, Slices
from fenicsmpm.points import MaterialPoints
from fenicsmpm.points.point_field import ComputedField

logger = logging.getLogger(__name__)


class PointIntegral:
    """Integral of a UFL expression over material points.

    Args:
        integrand: Scalar UFL expression of rank 0, 1 or 2.
        points: The point set, whose weights are the quadrature weights.
        tag: Tag of the points to which the integral is restricted. None for all points.
        jit_options: Options of the compiler; see ``form``.

    Raises:
        UnsupportedFormError: For the reasons of ``lowering.lower``, or for averages over cells if
            the grid functions of the points are not those of a cell.
        ValueError: If the grid functions of the points cannot represent a function space.
    """

    def __init__(
        self,
        integrand: Any,
        points: MaterialPoints,
        tag: int | None,
        jit_options: dict[str, Any],
    ) -> None:
        """Lower and compile. Collective."""
        self.points = points
        self.tag = tag
        if tag is not None:
            self._warn_of_unknown_tag(tag)
        self.lowered = lower(integrand, points.mesh)
        # Without functions on the grid, points are grouped by cells, which needs no ghost cells.
        by_cells = points.grid_functions is not None and not self._has_functions()
        self.stencil = LagrangeStencil(points) if by_cells else stencil_of(points)
        self.kernel = compile_pointwise(points.mesh.comm, self.lowered, jit_options)
        # The background mesh does not move as long as it has these points.
        self._cell_values = {
            id(source): cell_values(source.item, points.mesh)
            for source in self.lowered.inputs
            if type(source.item).__name__ in CELL_GEOMETRY
        }
        # Fields that are computed together are updated only once.
        items = (source.item for source in self.lowered.inputs)
        self._updates = dict.fromkeys(i.update for i in items if isinstance(i, ComputedField))
        self._version: Any = None
        self._active: dict[int, npt.NDArray[np.int32]] = {}
        self._dofs: dict[int, npt.NDArray[np.int32]] = {}
        for source in (*self.lowered.arguments, *self.lowered.inputs):
            self._check(source)

    def _has_functions(self) -> bool:
        sources = (*self.lowered.arguments, *self.lowered.inputs)
        spaces = (source.item.ufl_function_space() for source in sources if source.layout)
        return any(isinstance(space, fem.FunctionSpace) for space in spaces)

    def _check(self, source: Source) -> None:
        """Raise an error if the points' grid functions cannot represent those of a source."""
        has_average = np.any(source.used >= source.size // 2)
        if has_average and not self.stencil.groups_are_cells:
            raise UnsupportedFormError(
                f"cell_avg of {source.item} over points whose grid functions are not those of a "
                "cell: project it onto a function space instead"
            )
        space = source.item.ufl_function_space() if source.layout else None
        if isinstance(space, fem.FunctionSpace):
            self.dofs(source, space)

    def _warn_of_unknown_tag(self, tag: int) -> None:
        here = bool(np.any(self.points.tag == tag))
        if not self.points.mesh.comm.allreduce(here, MPI.LOR):
            logger.warning("no point has the tag %d of an integral: its value is zero for now", tag)

    # --- the selected points -----------------------------------------------------------------

    def refresh(self) -> None:
        """Update the selection of points and groups if the points have moved or changed."""
        tags = None if self.tag is None else self.points.tag
        key = (self.points.version, None if tags is None else tags.tobytes())
        if key != self._version:
            self._version = key
            self._active = {}
            self._select(tags)
        self.sites.forget_averages()

    def _select(self, tags: npt.NDArray[np.int32] | None) -> None:
        order, all_offsets = self.stencil.order, self.stencil.offsets
        rows, counts = np.arange(len(order)), all_offsets
        if tags is not None:
            selected = tags[order] == self.tag
            rows, counts = rows[selected], np.append(0, np.cumsum(selected))[all_offsets]
        groups = np.flatnonzero(np.diff(counts)).astype(np.int32)
        offsets = np.append(counts[groups], len(rows)).astype(np.int64)
        self.sites = Sites(self.points, self.stencil, rows, groups, offsets)
        self._condensation: Condensation | None = None
        n_few = len(groups) * sites_per_cell(self.points.mesh, self.lowered.degree)
        if isinstance(self.stencil, LagrangeStencil) and n_few < len(rows):
            self._condensation = Condensation(self.lowered.degree, self.sites)

    @property
    def groups(self) -> npt.NDArray[np.int32]:
        """Groups with selected points ``(n_groups,)``."""
        return self.sites.groups

    def active(self, source: Source, space: Any) -> npt.NDArray[np.int32]:
        """Return local dofs of an argument's space whose functions are not zero at all points.

        Args:
            source: Test or trial source.
            space: Its function space.
        """
        if id(source) not in self._active:
            table = self.sites.table(source)
            dofs = self.dofs(source, space)
            least = self.stencil.least[self.groups]
            seen = np.zeros((len(self.groups), dofs.shape[1]), dtype=np.bool_)
            slots = (table.basis, table.column, table.length, table.start)
            loops.mark_seen(self.sites.offsets, self.sites.rows, *slots, least, seen)
            if self.kernel is None:  # rows of a form that is zero are zero, not of the identity
                seen[:] = True
            self._active[id(source)] = np.unique(dofs[self.groups][seen])
        return self._active[id(source)]

    def dofs(self, source: Source, space: Any) -> npt.NDArray[np.int32]:
        """Return the unrolled dofs ``(n_groups, n_local)`` of a source's space, in slot order.

        Args:
            source: Argument or function.
            space: Its function space.
        """
        key = id(source)
        if key not in self._dofs:
            assert source.layout is not None
            self._dofs[key] = source.layout.unrolled_dofs(space, self.stencil)
        return self._dofs[key]

    # --- evaluation --------------------------------------------------------------------------

    def element_tensors(self) -> Iterator[tuple[slice, npt.NDArray[np.float64]]]:
        """Yield element tensors in batches of groups.

        Yields:
            The range of ``self.groups``, and the tensors ``(n, [n_local0, [n_local1]])`` with local
            dofs in slot order.
        """
        n_local = self._local_sizes()
        for groups, element, arguments in self._batches(math.prod(n_local)):
            result = np.empty((groups.stop - groups.start, *n_local))
            element(*arguments, result)
            yield groups, result

    def add_matrices(
        self,
        places: npt.NDArray[np.unsignedinteger],
        indptr: npt.NDArray[np.int64],
        fixed: list[npt.NDArray[np.uint8]],
        data: npt.NDArray[np.float64],
    ) -> None:
        """Add the element matrices of an integral of rank 2 to a matrix.

        Args:
            places: Places of the entries for all of ``self.groups``; see ``loops.add_matrices``.
            indptr: Start of each row of the matrix.
            fixed: Marks of constrained rows and columns.
            data: Values of the matrix.
        """
        n_local = self._local_sizes()
        dofs = [self._dofs[id(source)] for source in self.lowered.arguments]
        numbers = math.prod(n_local) if self._sums_first else 1
        for groups, element, arguments in self._batches(numbers):
            where = (*dofs, self.groups[groups], places[groups], indptr, *fixed, data)
            if element is matrix_loops.element_matrices:
                matrix_loops.add_element_matrices(*arguments, *where, numba.get_num_threads())
            else:
                matrices = np.empty((groups.stop - groups.start, *n_local))
                element(*arguments, matrices)
                loops.add_matrices(matrices, *where)

    def _local_sizes(self) -> list[int]:
        return [self._dofs[id(source)].shape[1] for source in self.lowered.arguments]

    @property
    def _integration_sites(self) -> Sites:
        return self.sites if self._condensation is None else self._condensation.sites()

    @property
    def _sums_first(self) -> bool:
        """Whether sums over a cell come before the contraction with linear functions."""
        arguments = self.lowered.arguments
        values = [source.value_slots for source in arguments]
        sites = self._integration_sites
        # only useful if a group has several sites
        return all(v is not None for v in values) and len(sites.rows) > len(sites.groups)

    def _batches(
        self, numbers: int
    ) -> Iterator[tuple[slice, Callable[..., None], tuple[Any, ...]]]:
        """Yield batches of groups with a function of their element tensors and its arguments.

        The last argument of the function, the result, is missing.

        Args:
            numbers: See ``Sites.batches``.
        """
        self.refresh()
        sites, arguments = self._integration_sites, self.lowered.arguments
        inputs_at = self._inputs(sites)
        weights, x = sites.weights, sites.x
        tables = [sites.table(source) for source in arguments]
        slots = [a for t in tables for a in (t.basis, t.column, t.length, t.start)]
        sums_first = self._sums_first
        values: list[Any] = []
        if sums_first:
            values = [source.value_slots for source in arguments]
            pairs = zip(tables, values, strict=True)
            slots = [a for t, v in pairs for a in linear_loops.with_moments(t, v, x.shape[1])]
        for groups, batch in sites.batches(numbers):
            if self.kernel is None:
                yield groups, lambda result: result.fill(0.0), ()
                continue
            offsets = sites.offsets[groups.start : groups.stop + 1]
            common = (self.kernel.address, offsets, weights)
            inputs = inputs_at((groups, batch))
            if len(arguments) == 0:
                yield groups, loops.element_scalars, (*common, inputs)
            elif sums_first:
                matrix = len(arguments) == 2
                element = linear_loops.element_matrices if matrix else linear_loops.element_vectors
                yield groups, element, (*common, sites.rows, inputs, x, *values, *slots)
            elif len(arguments) == 1:
                yield groups, loops.element_vectors, (*common, sites.rows, inputs, *slots)
            else:
                where = (sites.rows, inputs, self._is_square, *slots)
                yield groups, matrix_loops.element_matrices, (*common, *where)

    @property
    def _is_square(self) -> bool:
        """Whether test and trial functions are the same, with the same slots."""
        test, trial = self.lowered.arguments
        spaces = [source.item.ufl_function_space() for source in (test, trial)]
        return spaces[0] == spaces[1] and np.array_equal(test.used, trial.used)

    def point_tensors(self) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]:
        """Yield the output of the kernel at the selected points, in batches.

        Yields:
            Storage indices ``(n,)`` of the points and tensors ``(n, *kernel.shape)``.
        """
        self.refresh()
        if self.kernel is None:
            return
        inputs_at = self._inputs(self.sites)
        size = int(np.prod(self.kernel.shape, dtype=int))
        for batch in self.sites.batches():
            rows = self.sites.order[batch[1]]
            result = np.zeros((len(rows), size))
            loops.evaluate_points(self.kernel.address, inputs_at(batch), result)
            yield rows, result.reshape(len(rows), *self.kernel.shape)
        self.sites.forget_tables()  # points usually move after an evaluation

    def _inputs(self, sites: Sites) -> Callable[[Slices], npt.NDArray[np.float64]]:
        """Return a function that gives the inputs of the kernel for a batch."""
        for update in self._updates:
            update()
        sources = self.lowered.inputs
        plain = sites.plain_inputs(sources, self._cell_values)
        return lambda batch: sites.inputs(batch, sources, plain, self.dofs)


def selected_tags(integral: ufl.Integral) -> tuple[int | None, ...]:
    """Return the tags of an integral over points, each for a separate integral; None means all.

    UFL up to 2024.2 splits ``dx((1, 2))`` by itself.

    Args:
        integral: UFL integral over points.
    """
    ids = integral.subdomain_id()
    if isinstance(ids, str):  # "everywhere"
        return (None,)
    return tuple(int(i) for i in (ids if isinstance(ids, tuple) else (ids,)))
