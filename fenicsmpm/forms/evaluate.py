# SPDX-License-Identifier: MIT
"""Evaluation of UFL expressions at material points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr

from fenicsmpm.forms import loops
from fenicsmpm.forms.errors import UnsupportedFormError
from fenicsmpm.forms.form import Form
from fenicsmpm.forms.integral import PointIntegral
from fenicsmpm.points import MaterialPoints


class PointExpression:
    """Compiled UFL expression over material points.

    Args:
        expression: UFL expression of any shape, without arguments. As in forms over points, it may
            contain functions and their gradients, point fields, constants and geometry.
        points: The point set.
        jit_options: Options of the compiler; see ``form``.

    Attributes:
        shape: Shape of the expression.

    Raises:
        UnsupportedFormError: If the expression has arguments, or parts without meaning at points.
    """

    def __init__(
        self,
        expression: Any,
        points: MaterialPoints,
        jit_options: dict[str, Any] | None = None,
    ) -> None:
        """Compile. Collective."""
        expression = ufl.as_ufl(expression)
        if extract_arguments(expression):
            raise UnsupportedFormError(
                f"expression with arguments at points: {expression}. Replace test and trial "
                "functions by functions."
            )
        self.shape = expression.ufl_shape
        size = int(np.prod(self.shape, dtype=int))
        # With one constant test function per component, the rows of the kernel are the components.
        element = basix.ufl.element("DG", points.mesh.basix_cell(), 0, shape=(size,))
        test = ufl.TestFunction(ufl.FunctionSpace(points.mesh.ufl_domain(), element))
        components = (
            [expression[index] for index in np.ndindex(self.shape)] if self.shape else [expression]
        )
        integrand = sum(c * test[k] for k, c in enumerate(components))
        self._integral = PointIntegral(integrand, points, None, jit_options or {})

    def batches(self) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]:
        """Yield current values in batches of points, which limits the memory in use.

        Yields:
            Storage indices ``(n,)`` and values ``(n, size)``, flattened components. Nothing is
            yielded for an expression that is zero.
        """
        if self._integral.kernel is None:  # zero
            return
        layout = self._integral.lowered.arguments[0].layout
        assert layout is not None
        # Components that are zero have no slot.
        columns = self._integral.lowered.arguments[0].used // layout.n_rows
        size = int(np.prod(self.shape, dtype=int))
        for rows, tensors in self._integral.point_tensors():
            if len(columns) == size:
                yield rows, tensors
            else:
                values = np.zeros((len(rows), size))
                values[:, columns] = tensors
                yield rows, values

    def evaluate(self) -> npt.NDArray[np.float64]:
        """Return the current values, ``(n_points, *shape)``, in the storage order of the points."""
        n = len(self._integral.points)
        result = np.zeros((n, int(np.prod(self.shape, dtype=int))))
        for rows, values in self.batches():
            loops.put_rows(result, rows, values, 0)
        return result.reshape(n, *self.shape)


class FieldUpdates:
    """New values of several fields of a point set, whose expressions are compiled together.

    Args:
        points: The point set.
        fields: New values by field name, as UFL over the points, or as functions that return
            ``(n_points, *shape)``.
    """

    def __init__(self, points: MaterialPoints, fields: Mapping[str, Any]) -> None:
        """Compile. Collective."""
        self._points = points
        self._functions = {name: f for name, f in fields.items() if not isinstance(f, Expr)}
        expressions = {name: f for name, f in fields.items() if isinstance(f, Expr)}
        self._shapes = {name: value.ufl_shape for name, value in expressions.items()}
        components = [
            value[index] if index else value
            for value in expressions.values()
            for index in np.ndindex(value.ufl_shape)
        ]
        self._expression = PointExpression(ufl.as_vector(components), points)

    def evaluate(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return new arrays by field name, in storage order; the fields do not change."""
        n = len(self._points)
        # An expression that is zero has no batches.
        result = {name: np.zeros((n, *shape)) for name, shape in self._shapes.items()}
        for rows, values in self._expression.batches():
            first = 0
            for array in result.values():
                columns = array.reshape(n, -1)
                loops.put_rows(columns, rows, values, first)
                first += columns.shape[1]
        return result | {name: function() for name, function in self._functions.items()}


def evaluate(expression: Any, points: MaterialPoints) -> npt.NDArray[np.float64]:
    """Return the values of a UFL expression at material points.

    To evaluate the same expression many times, keep a ``PointExpression``.

    Args:
        expression: UFL expression without arguments.
        points: The point set.

    Returns:
        Values ``(n_points, *shape)`` in storage order, which can be assigned to a field of the
        points.

    Raises:
        UnsupportedFormError: If the expression has arguments, or parts without meaning at points.
    """
    return PointExpression(expression, points).evaluate()


def describe_not_finite(compiled: Form) -> str:
    """Describe at which material point an integrand of a form is not finite. Collective.

    Args:
        compiled: Compiled form.

    Returns:
        One sentence with position, cell and rank of the first such point.
    """
    found = None
    for integral in compiled.point_integrals:
        bad = np.concatenate([np.empty(0, dtype=np.int64), *_not_finite(integral)])
        if len(bad) > 0 and found is None:
            points, k = integral.points, bad[0]
            found = (
                f"the integrand is not finite at {len(bad)} points, first at point "
                f"{points.id[k]} in cell {points.cell[k]} on rank {points.mesh.comm.rank}, "
                f"position {np.array2string(points.x[k], precision=6)}: a deformation gradient "
                "with a determinant <= 0 or NaN in a field are the usual reasons"
            )
    messages = [m for m in compiled.mesh.comm.allgather(found) if m is not None]
    return messages[0] if messages else "the integrands over material points are finite"


def _not_finite(integral: PointIntegral) -> Iterator[npt.NDArray[np.int64]]:
    """Yield the storage indices of points at which an integrand is not finite."""
    for rows, tensors in integral.point_tensors():
        yield rows[~np.isfinite(tensors).all(axis=tuple(range(1, tensors.ndim)))]
