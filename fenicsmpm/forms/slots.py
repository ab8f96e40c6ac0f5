# SPDX-License-Identifier: MIT
"""Slots: the scalars through which a grid function enters a pointwise form.

At a point, a function f of a finite element space is known to an integrand only by its
components' values, gradients and second gradients (and averages of these over the group of
points). Each such scalar is a *slot*. A slot is a linear combination of the degrees of freedom
that one component has in the point's group; the coefficients are one row of the stencil's table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt

from fenicsmpm.basis.stencil import PointStencil, derivative_rows
from fenicsmpm.forms.errors import UnsupportedFormError

SIMPLICES = ("interval", "triangle", "tetrahedron")


@dataclass(frozen=True)
class Leaf:
    """Components of a space that share one scalar element.

    Attributes:
        element: scalar basix element.
        size: number of components (block size); they alternate in the cell dofmap.
    """

    element: Any
    size: int


def leaves_of(element: Any) -> list[Leaf]:
    """Split a UFL element into leaves, in the order of value components and dofs.

    Args:
        element: element of a function space (scalar, blocked or mixed, nested at will).

    Raises:
        UnsupportedFormError: for elements that are not mapped by identity, such as H(div), H(curl),
            for symmetric tensor, quadrature and real elements.
    """
    leaves: list[Leaf] = []

    def visit(element: Any) -> None:
        subelements = element.sub_elements
        if isinstance(element, basix.ufl._MixedElement):
            for sub in subelements:
                visit(sub)
        elif isinstance(element, basix.ufl._BlockedElement):
            if element._has_symmetry:
                raise UnsupportedFormError(
                    f"symmetric tensor element over material points: {element}. "
                    "Use a full tensor space (symmetry=False)."
                )
            leaves.append(Leaf(_scalar_element(subelements[0]), element.block_size))
        else:
            leaves.append(Leaf(_scalar_element(element), 1))

    visit(element)
    return leaves


def _scalar_element(element: Any) -> Any:
    if not isinstance(element, basix.ufl._BasixElement):
        raise UnsupportedFormError(
            f"element without grid functions over material points: {element}. Use a Lagrange "
            "space, or a PointField for values that exist at points only."
        )
    scalar = element.basix_element
    identity = scalar.map_type == basix.MapType.identity and scalar.value_shape in ([], (), [1])
    if not (identity and scalar.dof_transformations_are_permutations):
        raise UnsupportedFormError(
            f"element that is not mapped by identity over material points: {element}. "
            "Only Lagrange-type spaces (scalar, blocked or mixed) are supported."
        )
    return scalar


class Layout:
    """Order of a space's slots and local degrees of freedom.

    Slot number ``(average * n_components + component) * n_rows + row`` with the rows of
    ``PointStencil.table`` (value, gradients, second gradients). Local degrees of freedom are
    reordered component by component, so that those of one slot are contiguous.

    Args:
        element: UFL element of the space.
        dim: space dimension d.
    """

    def __init__(self, element: Any, dim: int) -> None:
        """Lay out the slots of an element."""
        self.leaves = leaves_of(element)
        self.n_rows = derivative_rows(2, dim)
        self.dim = dim
        self.component_leaf = [leaf for leaf in self.leaves for _ in range(leaf.size)]

    @property
    def n_components(self) -> int:
        """Number of scalar value components."""
        return len(self.component_leaf)

    @property
    def is_linear(self) -> bool:
        """Whether all functions are linear within a cell."""
        elements = [leaf.element for leaf in self.leaves]
        return all(e.degree <= 1 and e.cell_type.name in SIMPLICES for e in elements)

    def value_slots(self, used: npt.NDArray[np.int64]) -> npt.NDArray[np.int64] | None:
        """Positions of the value slots within the used ones of linear functions.

        None if the functions are not linear, or if there are averages among the slots.
        """
        average = bool(np.any(used >= self.n_slots // 2))
        return np.flatnonzero(used % self.n_rows == 0) if self.is_linear and not average else None

    @property
    def n_slots(self) -> int:
        """Number of slots, averaged ones included."""
        return 2 * self.n_components * self.n_rows

    def slot(self, component: int, derivative: tuple[int, ...], average: bool) -> int:
        """Number of the slot of a component's derivative.

        Args:
            component: flattened value component.
            derivative: directions of derivation, at most two.
            average: average over the group's points instead of the value at the point.
        """
        row = sum(self.dim**k for k in range(len(derivative)))  # rows of lower derivatives
        index = 0
        for k in derivative:
            index = index * self.dim + k
        return (int(average) * self.n_components + component) * self.n_rows + row + index

    def component_starts(self, stencil: PointStencil) -> npt.NDArray[np.int64]:
        """``(n_components,)`` first local dof of each component, in the slots' order."""
        lengths = [stencil.n_functions(leaf.element) for leaf in self.component_leaf]
        return np.cumsum([0, *lengths[:-1]])

    def unrolled_dofs(self, space: Any, stencil: PointStencil) -> npt.NDArray[np.int32]:
        """``(n_groups, n_local)`` unrolled local dofs of a dolfinx space in the slots' order."""
        bs = space.dofmap.bs
        blocks = stencil.dofs(space)
        dofs = blocks[:, :, None] * bs + np.arange(bs, dtype=np.int32)
        dofs = dofs.reshape(len(blocks), blocks.shape[1] * bs)
        order = []
        first = 0
        for leaf in self.leaves:
            n = stencil.n_functions(leaf.element)
            order += [first + leaf.size * np.arange(n) + c for c in range(leaf.size)]
            first += leaf.size * n
        return np.ascontiguousarray(dofs[:, np.concatenate(order)], dtype=np.int32)


@dataclass
class SlotTable:
    """Rows of grid functions for the used slots of one argument or coefficient.

    Attributes:
        basis: ``(n_points, n_columns)`` concatenated table rows, in group order.
        column: ``(n_slots,)`` first column of each used slot.
        length: ``(n_slots,)`` number of grid functions of each used slot.
        start: ``(n_slots,)`` first local dof (slots' order) of each used slot.
    """

    basis: npt.NDArray[np.float64]
    column: npt.NDArray[np.int64]
    length: npt.NDArray[np.int64]
    start: npt.NDArray[np.int64]


def slot_table(
    layout: Layout,
    used: npt.NDArray[np.int64],
    stencil: PointStencil,
    average: Any,
) -> SlotTable:
    """Tabulate the used slots of a space.

    Args:
        layout: of the space.
        used: ``(n,)`` slot numbers.
        stencil: of the point set.
        average: function that averages ``(n_points, ...)`` rows over the points of each group.
    """
    rows = used % layout.n_rows
    components = (used // layout.n_rows) % layout.n_components
    averaged = used // (layout.n_rows * layout.n_components) > 0
    first_rows = [derivative_rows(k, layout.dim) for k in range(3)]
    blocks: list[npt.NDArray[np.float64]] = []
    block_column: dict[tuple[int, bool], int] = {}
    column = np.empty(len(used), dtype=np.int64)
    length = np.empty(len(used), dtype=np.int64)
    start = np.empty(len(used), dtype=np.int64)
    width = 0
    starts = layout.component_starts(stencil)
    for i, (row, component) in enumerate(zip(rows, components, strict=True)):
        element = layout.component_leaf[component].element
        key = (hash(element), bool(averaged[i]))
        if key not in block_column:
            same = [
                int(rows[j])
                for j in range(len(used))
                if layout.component_leaf[components[j]].element == element
                and bool(averaged[j]) == key[1]
            ]
            derivatives = next(k for k in range(3) if max(same) < first_rows[k])
            if layout.is_linear:
                derivatives = 1  # see linear_loops
            table = stencil.table(element, derivatives)
            block = table.reshape(len(table), table.shape[1] * table.shape[2])
            blocks.append(average(block) if key[1] else block)
            block_column[key] = width
            width += block.shape[1]
        length[i] = stencil.n_functions(element)
        column[i] = block_column[key] + row * length[i]
        start[i] = starts[component]
    if len(blocks) == 1:
        basis = blocks[0]
    else:
        basis = np.hstack([np.zeros((len(stencil.order), 0)), *blocks])
    return SlotTable(basis, column, length, start)
