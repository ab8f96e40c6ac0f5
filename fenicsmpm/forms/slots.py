# SPDX-License-Identifier: MIT
"""Slots: the scalars through which a grid function enters a pointwise form.

At a point, an integrand uses a function f of a finite element space only through the values,
gradients and second gradients of its components, and through averages of these over the points of a
group. Each such scalar is a *slot*. A slot is a linear combination of the degrees of freedom of one
component in the group of the point. Its coefficients are one row of the stencil's table.
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
        element: Scalar basix element.
        size: Number of components (block size); they alternate in the cell dofmap.
    """

    element: Any
    size: int


def leaves_of(element: Any) -> list[Leaf]:
    """Split a UFL element into leaves, in the order of value components and dofs.

    Args:
        element: Element of a function space (scalar, blocked or mixed, with any nesting).

    Raises:
        UnsupportedFormError: If an element is not mapped by identity, as for H(div) and H(curl), or
            is a symmetric tensor, quadrature or real element.
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
    """Order of the slots and local degrees of freedom of a space.

    The number of a slot is ``(average * n_components + component) * n_rows + row``, with the rows
    of ``PointStencil.table`` (value, gradients, second gradients). Local degrees of freedom are
    reordered component by component, so that those of one slot are contiguous.

    Args:
        element: UFL element of the space.
        dim: Space dimension d.
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

    @property
    def n_slots(self) -> int:
        """Number of slots, including those of averages."""
        return 2 * self.n_components * self.n_rows

    def slot(self, component: int, derivative: tuple[int, ...], average: bool) -> int:
        """Return the number of the slot of a derivative of a component.

        Args:
            component: Flattened value component.
            derivative: Directions of the derivative, at most two.
            average: Whether the slot is the average over the points of the group.
        """
        row = sum(self.dim**k for k in range(len(derivative)))  # number of lower derivatives
        index = 0
        for k in derivative:
            index = index * self.dim + k
        return (int(average) * self.n_components + component) * self.n_rows + row + index

    def component_starts(self, stencil: PointStencil) -> npt.NDArray[np.int64]:
        """Return the first local dof of each component ``(n_components,)``, in slot order.

        Args:
            stencil: Stencil of the points.
        """
        lengths = [stencil.n_functions(leaf.element) for leaf in self.component_leaf]
        return np.cumsum([0, *lengths[:-1]])

    def unrolled_dofs(self, space: Any, stencil: PointStencil) -> npt.NDArray[np.int32]:
        """Return unrolled local dofs ``(n_groups, n_local)`` of a dolfinx space, in slot order.

        Args:
            space: Dolfinx function space.
            stencil: Stencil of the points.
        """
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
        basis: Concatenated table rows in group order ``(n_points, n_columns)``.
        column: First column of each used slot ``(n_slots,)``.
        length: Number of grid functions of each used slot ``(n_slots,)``.
        start: First local dof of each used slot, in slot order ``(n_slots,)``.
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
        layout: Layout of the space.
        used: Slot numbers ``(n,)``.
        stencil: Stencil of the point set.
        average: Function that averages rows ``(n_points, ...)`` over the points of each group.
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
