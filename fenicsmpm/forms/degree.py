# SPDX-License-Identifier: MIT
"""Polynomial degree of a pointwise form with respect to the position of a point in its group."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ufl.classes import Conditional, Division, ListTensor, Product, Sum
from ufl.corealg.traversal import unique_post_traversal


def degree_of(expression: Any, leaves: Mapping[Any, float]) -> float:
    """Return the degree of an expression, given the degrees of its parts.

    Args:
        expression: UFL expression without free indices.
        leaves: Degrees of the parts that stand for functions. All other parts are constants.

    Returns:
        The degree, infinite if the expression is not a polynomial.
    """
    degrees: dict[Any, float] = {}
    for node in unique_post_traversal(expression):
        operands = [degrees[o] for o in node.ufl_operands]
        if node in leaves:
            degrees[node] = leaves[node]
        elif not any(operands):
            degrees[node] = 0
        elif isinstance(node, Sum | ListTensor):
            degrees[node] = max(operands)
        elif isinstance(node, Product):
            degrees[node] = sum(operands)
        elif isinstance(node, Division) and operands[1] == 0:
            degrees[node] = operands[0]
        elif isinstance(node, Conditional) and operands[0] == 0:
            degrees[node] = max(operands[1:])
        else:
            degrees[node] = math.inf
    return degrees[expression]
