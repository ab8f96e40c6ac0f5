# SPDX-License-Identifier: MIT
"""Expansion of tensor expressions into components: UFL's ``expand_indices`` with memoization.

UFL visits shared parts of an expression again for each of their uses, and so on recursively. For
tangents of stresses with inverses and products of tensors this takes minutes.
"""

from __future__ import annotations

from typing import Any

from ufl.classes import (
    ComponentTensor,
    Conditional,
    FixedIndex,
    Indexed,
    IndexSum,
    ListTensor,
    MultiIndex,
    ScalarValue,
    Sum,
    Zero,
)


def expand_components(expression: Any) -> Any:
    """Expand a scalar expression so that it has no free indices, index sums or tensors.

    Args:
        expression: Scalar UFL expression, with derivatives already expanded and compound tensor
            operators already lowered, for example by ``expand_derivatives``.

    Returns:
        The expression in terms of components of its terminals. Equal parts are the same object.
    """
    return _Expander().visit(expression, (), {})


class _Expander:
    """Components found so far, by expression, component and values of the free indices."""

    def __init__(self) -> None:
        self._memo: dict[Any, Any] = {}

    def visit(self, node: Any, component: tuple[int, ...], values: dict[int, int]) -> Any:
        """Return a component of a node, given the values of its free indices by count."""
        key = (node, component, tuple(values[i] for i in node.ufl_free_indices))
        if key not in self._memo:
            self._memo[key] = self._expand(node, component, values)
        return self._memo[key]

    def _expand(self, node: Any, component: tuple[int, ...], values: dict[int, int]) -> Any:
        if isinstance(node, Zero):
            return Zero()
        if isinstance(node, ScalarValue) or (node._ufl_is_terminal_ and node.ufl_shape == ()):
            return node
        if node._ufl_is_terminal_:
            return node[component]
        if isinstance(node, Indexed):
            tensor, index = node.ufl_operands
            return self.visit(tensor, _numbers(index, values), values)
        if isinstance(node, ComponentTensor):
            scalar, index = node.ufl_operands
            counts = [i.count() for i in index.indices()]
            return self.visit(scalar, (), values | dict(zip(counts, component, strict=True)))
        if isinstance(node, ListTensor):
            return self.visit(node.ufl_operands[component[0]], component[1:], values)
        if isinstance(node, IndexSum):
            summand, index = node.ufl_operands
            count = index[0].count()
            choices = (values | {count: k} for k in range(node.dimension()))
            return sum(self.visit(summand, component, choice) for choice in choices)
        if isinstance(node, Sum):
            a, b = (self.visit(o, component, values) for o in node.ufl_operands)
            return a + b
        if isinstance(node, Conditional):
            condition, *cases = node.ufl_operands
            new = [self.visit(condition, (), values)]
            new += [self.visit(o, component, values) for o in cases]
            return node._ufl_expr_reconstruct_(*new)
        operands = [
            o if isinstance(o, MultiIndex) else self.visit(o, (), values) for o in node.ufl_operands
        ]
        return node._ufl_expr_reconstruct_(*operands)


def _numbers(index: MultiIndex, values: dict[int, int]) -> tuple[int, ...]:
    return tuple(
        int(i) if isinstance(i, FixedIndex) else values[i.count()] for i in index.indices()
    )
