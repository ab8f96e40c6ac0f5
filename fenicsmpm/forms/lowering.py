# SPDX-License-Identifier: MIT
"""Lowering of an integrand over material points to a pointwise form over slots.

Some parts of a UFL integrand depend on the point: arguments, coefficients, their gradients and
averages, and geometry. These parts are replaced by components of three vectors, the slots of the
test function, the slots of the trial function and the inputs. The rest is algebra, which FFCx
compiles as a form with one quadrature point on an interval of length one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives
from ufl.classes import (
    CellAvg,
    Coefficient,
    ComplexValue,
    ComponentTensor,
    Conj,
    Division,
    FacetAvg,
    FixedIndex,
    GeometricQuantity,
    Grad,
    Imag,
    Indexed,
    IndexSum,
    ListTensor,
    MultiIndex,
    Product,
    Real,
    Restricted,
    Sum,
    Variable,
    Zero,
)
from ufl.core.base_form_operator import BaseFormOperator
from ufl.corealg.traversal import unique_post_traversal

from fenicsmpm.forms.components import expand_components
from fenicsmpm.forms.degree import degree_of
from fenicsmpm.forms.errors import UnsupportedFormError
from fenicsmpm.forms.slots import SIMPLICES, Layout
from fenicsmpm.points.point_field import PointField

# FFCx needs a mesh to compile the pointwise form. This interval serves the purpose: with the
# coordinates 0 and 1 its Jacobian is one.
INTERVAL = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))
ONE_POINT = {
    "quadrature_rule": "custom",
    "quadrature_points": ((0.5,),),
    "quadrature_weights": (1.0,),
}

# Geometry that varies within cells
POINT_GEOMETRY = ("SpatialCoordinate", "Jacobian", "JacobianInverse", "JacobianDeterminant")
# Geometry that is constant in each cell
CELL_GEOMETRY = (
    "CellVolume",
    "Circumradius",
    "CellDiameter",
    "MinCellEdgeLength",
    "MaxCellEdgeLength",
)


@dataclass
class Source:
    """Argument, coefficient, constant or geometric quantity, and the slots of it that are used.

    Attributes:
        item: The UFL object.
        placeholder: Vector that stands for all its slots during lowering.
        layout: Layout of its space. None if the slots are plain components.
        size: Number of its slots.
        used: Numbers of the slots that the form needs, set at the end of lowering.
    """

    item: Any
    placeholder: Any
    layout: Layout | None
    size: int
    used: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @cached_property
    def has_averages(self) -> bool:
        """Whether slots of averages over a group are used. Ask after lowering only."""
        return self.layout is not None and bool(np.any(self.used >= self.layout.n_slots // 2))

    @cached_property
    def value_slots(self) -> npt.NDArray[np.int64] | None:
        """Positions of values within the used slots of linear functions. Ask after lowering only.

        None if the functions are not linear, or if there are averages among the slots.
        """
        if self.layout is None or not self.layout.is_linear or self.has_averages:
            return None
        return np.flatnonzero(self.used % self.layout.n_rows == 0)


@dataclass
class PointwiseForm:
    """Lowered integrand.

    Attributes:
        form: UFL form for FFCx, with the arguments (trial slots, test slots) in this order. None if
            the integrand is zero, for example due to second gradients of linear functions.
        arguments: Test and trial sources, in the order of argument numbers.
        inputs: All other sources. Their used slots, one source after the other, form the input
            vector.
        degree: Polynomial degree of the integrand in the position of the point within its group.
            Infinite if it is not a polynomial, or has inputs other than linear functions and
            constants.
    """

    form: ufl.Form | None
    arguments: list[Source]
    inputs: list[Source]
    degree: float


def lower(integrand: Any, mesh: Any) -> PointwiseForm:
    """Lower the integrand of an integral over material points.

    Args:
        integrand: Scalar UFL expression.
        mesh: Dolfinx mesh of the points.

    Returns:
        The pointwise form.

    Raises:
        UnsupportedFormError: If a part of the integrand has no meaning over points. The message
            names it.
    """
    lowering = _Lowering(mesh)
    # expand_derivatives works on forms, whatever the measure
    form = expand_derivatives(integrand * ufl.Measure("dx", domain=mesh.ufl_domain()))
    integrals = form.integrals()
    expression = ufl.as_ufl(sum(lowering.rewrite(i.integrand()) for i in integrals))
    return lowering.finish(expand_components(expression))


class _Lowering:
    """State of a lowering: the sources found so far, and the memo of rewritten nodes."""

    def __init__(self, mesh: Any) -> None:
        self.mesh = mesh
        self.dim = mesh.geometry.dim
        self.sources: dict[Any, Source] = {}
        self.memo: dict[Any, Any] = {}

    # --- rewriting ---------------------------------------------------------------------------

    def rewrite(self, expression: Any) -> Any:
        """Replace all point-dependent parts of an expression with slots."""
        for node in unique_post_traversal(expression):
            if node not in self.memo:
                self.memo[node] = self._rewrite_node(node)
        return self.memo[expression]

    def _rewrite_node(self, node: Any) -> Any:
        if isinstance(node, Restricted):
            raise UnsupportedFormError(
                f"restriction to a facet's side over material points: {node}. "
                "Use dS for integrals over facets."
            )
        if isinstance(node, ComplexValue | Imag):
            raise UnsupportedFormError(f"complex number over material points: {node}")
        if isinstance(node, FacetAvg):
            raise UnsupportedFormError(f"facet average over material points: {node}")
        if isinstance(node, BaseFormOperator):
            raise UnsupportedFormError(
                f"operator without a lowering over material points: {node}. "
                "Evaluate it first and put the values into a PointField."
            )
        if isinstance(node, Grad):
            return self._differentiated(node, average=False)
        if isinstance(node, CellAvg):
            return self._average(node.ufl_operands[0])
        if isinstance(node, Conj | Real | Variable):
            return self.memo[node.ufl_operands[0]]
        if node._ufl_is_terminal_:
            return self._terminal(node, (), average=False)
        operands = [self.memo.get(o, o) for o in node.ufl_operands]
        if all(a is b for a, b in zip(operands, node.ufl_operands, strict=True)):
            return node
        return node._ufl_expr_reconstruct_(*operands)

    def _differentiated(self, node: Any, average: bool) -> Any:
        """Return the slots of grad(grad(...f)) for a terminal f."""
        depth = 0
        terminal = node
        while isinstance(terminal, Grad):
            terminal = terminal.ufl_operands[0]
            depth += 1
        if isinstance(terminal, PointField):
            raise UnsupportedFormError(
                f"gradient of a field that exists at points only: {node}. "
                "Project it onto a function space first."
            )
        if not isinstance(terminal, ufl.Argument | Coefficient):
            raise UnsupportedFormError(f"gradient over material points: {node}")
        if depth > 2:
            raise UnsupportedFormError(
                f"derivative of order {depth} over material points: {node}. "
                "Values, gradients and second gradients are supported."
            )
        return self._terminal(terminal, (self.dim,) * depth, average)

    def _average(self, node: Any) -> Any:
        """Return the average of an expression over the points of a group, by linearity."""
        if isinstance(node, Grad):
            return self._differentiated(node, average=True)
        if isinstance(node, Variable | Conj | Real | CellAvg):
            # For CellAvg: the average of an average is the average.
            return self._average(node.ufl_operands[0])
        if node._ufl_is_terminal_:
            return self._terminal(node, (), average=True)
        operands = node.ufl_operands
        if isinstance(node, Sum | ListTensor):
            return node._ufl_expr_reconstruct_(*[self._average(o) for o in operands])
        if isinstance(node, Indexed | ComponentTensor | IndexSum):
            return node._ufl_expr_reconstruct_(self._average(operands[0]), operands[1])
        if isinstance(node, Product):
            # The operator * would sum over an index that both factors have.
            a, b = operands
            if _is_uniform(a):
                return node._ufl_expr_reconstruct_(self.memo[a], self._average(b))
            if _is_uniform(b):
                return node._ufl_expr_reconstruct_(self._average(a), self.memo[b])
        if isinstance(node, Division) and _is_uniform(operands[1]):
            return self._average(operands[0]) / self.memo[operands[1]]
        raise UnsupportedFormError(
            f"cell_avg of a nonlinear expression over material points: {node}. Average its "
            "linear parts, or evaluate the expression into a PointField first."
        )

    # --- terminals ---------------------------------------------------------------------------

    def _terminal(self, item: Any, derivative: tuple[int, ...], average: bool) -> Any:
        name = type(item).__name__
        if isinstance(item, ufl.Argument | Coefficient) and not isinstance(item, PointField):
            return self._grid_function(item, derivative, average)
        if isinstance(item, PointField):
            if item.points.mesh.ufl_domain() is not self.mesh.ufl_domain():
                raise UnsupportedFormError(
                    f"point field of points on another mesh: {item}. Use points on the mesh of "
                    "the integral."
                )
            return self._plain(item, item.ufl_shape, average)
        if isinstance(item, ufl.Constant):
            if not isinstance(item, fem.Constant):
                raise UnsupportedFormError(f"constant without a value: {item}. Use fem.Constant.")
            _require_float64(item, item.dtype)
            return self._plain(item, item.ufl_shape, average=False)
        if isinstance(item, GeometricQuantity):
            if name in POINT_GEOMETRY:
                return self._plain(item, item.ufl_shape, average)
            if name in CELL_GEOMETRY:
                return self._plain(item, item.ufl_shape, average=False)
            if name == "FacetNormal":
                raise UnsupportedFormError(
                    f"FacetNormal over material points: {item}. A point lies on no facet: use the "
                    'normals that boundary points carry, points.field("normal"). Those of '
                    "points.on_facets, on_curve and on_surface have them, and "
                    "formulations.set_normals(points, normals) gives them to others."
                )
            raise UnsupportedFormError(
                f"{name} over material points: {item}. Available are "
                f"{', '.join(POINT_GEOMETRY + CELL_GEOMETRY)}."
            )
        return item  # literals, multi-indices, labels

    def _grid_function(self, item: Any, derivative: tuple[int, ...], average: bool) -> Any:
        space = item.ufl_function_space()
        if isinstance(item, ufl.Argument) and item.part() is not None:
            raise UnsupportedFormError(f"argument of a MixedFunctionSpace: {item}")
        if space.ufl_domain() is not self.mesh.ufl_domain():
            raise UnsupportedFormError(
                f"function on another mesh than that of the points: {item} in {space}. "
                "Define the space on the points' background mesh."
            )
        if isinstance(item, Coefficient) and not isinstance(item, fem.Function):
            raise UnsupportedFormError(f"coefficient without values: {item}. Use fem.Function.")
        if isinstance(item, fem.Function):
            _require_float64(item, item.dtype)
        if item not in self.sources:
            new = Layout(space.ufl_element(), self.dim)
            self._add(item, new, new.n_slots)
        source = self.sources[item]
        layout = source.layout
        assert layout is not None
        order = len(derivative)
        components = np.empty((layout.n_components, *derivative), dtype=object)
        for index in np.ndindex(components.shape):
            leaf = layout.component_leaf[index[0]]
            if order > leaf.element.degree and _is_simplex(leaf.element):
                components[index] = ufl.as_ufl(0.0)
            else:
                slot = layout.slot(index[0], index[1:], average)
                components[index] = source.placeholder[slot]
        shape = item.ufl_shape + derivative
        return _as_tensor(components.reshape(shape))

    def _plain(self, item: Any, shape: tuple[int, ...], average: bool) -> Any:
        """Return slots without grid functions: the components, followed by their averages."""
        size = int(np.prod(shape, dtype=int))
        source = self.sources.get(item) or self._add(item, None, 2 * size)
        components = np.array(
            [source.placeholder[int(average) * size + k] for k in range(size)] + [None],
            dtype=object,
        )[:-1]
        return _as_tensor(components.reshape(shape))

    def _add(self, item: Any, layout: Layout | None, size: int) -> Source:
        if isinstance(item, ufl.Argument):
            placeholder: Any = _slot_argument(size, item.number())
        else:
            placeholder = ufl.Constant(INTERVAL, shape=(size,))
        self.sources[item] = Source(item, placeholder, layout, size)
        return self.sources[item]

    # --- compression -------------------------------------------------------------------------

    def finish(self, expression: Any) -> PointwiseForm:
        """Drop unused slots, and build the form for FFCx."""
        by_placeholder = {source.placeholder: source for source in self.sources.values()}
        found: dict[Any, set[int]] = {p: set() for p in by_placeholder}
        nodes = list(unique_post_traversal(expression))
        for node in nodes:
            if isinstance(node, Indexed) and node.ufl_operands[0] in found:
                found[node.ufl_operands[0]].add(int(node.ufl_operands[1][0]))
        for placeholder, source in by_placeholder.items():
            source.used = np.array(sorted(found[placeholder]), dtype=np.int64)
        arguments = sorted(
            (s for s in self.sources.values() if isinstance(s.item, ufl.Argument)),
            key=lambda s: s.item.number(),
        )
        inputs = [
            s
            for s in self.sources.values()
            if not isinstance(s.item, ufl.Argument) and len(s.used) > 0
        ]
        replacement: dict[Any, tuple[Any, dict[int, int]]] = {}
        for source in arguments:
            # Rows in FFCx belong to argument 0. With the trial slots as argument 0 the result is D
            # transposed, which the assembly contracts with unit stride.
            number = len(arguments) - 1 - source.item.number()
            vector = _slot_argument(len(source.used), number)
            replacement[source.placeholder] = (vector, _positions(source.used, 0))
        n_inputs = sum(len(s.used) for s in inputs)
        vector = ufl.Constant(INTERVAL, shape=(max(n_inputs, 1),))
        offset = 0
        for source in inputs:
            replacement[source.placeholder] = (vector, _positions(source.used, offset))
            offset += len(source.used)
        memo: dict[Any, Any] = {}
        for node in nodes:
            if isinstance(node, Indexed) and node.ufl_operands[0] in replacement:
                target, position = replacement[node.ufl_operands[0]]
                k = FixedIndex(position[int(node.ufl_operands[1][0])])
                memo[node] = Indexed(target, MultiIndex((k,)))
            elif node._ufl_is_terminal_:
                memo[node] = node
            else:
                memo[node] = node._ufl_expr_reconstruct_(*[memo[o] for o in node.ufl_operands])
        if isinstance(memo[expression], Zero):
            return PointwiseForm(None, arguments, inputs, 0)
        measure = ufl.Measure("dx", domain=INTERVAL, metadata=ONE_POINT)
        leaves = {
            node: _degree_of_slot(by_placeholder[node.ufl_operands[0]], node)
            for node in nodes
            if isinstance(node, Indexed) and node.ufl_operands[0] in by_placeholder
        }
        degree = degree_of(expression, leaves)
        return PointwiseForm(memo[expression] * measure, arguments, inputs, degree)


def _require_float64(item: Any, dtype: Any) -> None:
    if dtype != np.float64:
        raise UnsupportedFormError(f"values of type {dtype} over material points: {item}")


def _degree_of_slot(source: Source, node: Any) -> float:
    """Return the degree of a placeholder component in the point's position within its group."""
    layout = source.layout
    if layout is None:
        is_uniform = type(source.item).__name__ in CELL_GEOMETRY
        return 0 if is_uniform or isinstance(source.item, fem.Constant) else math.inf
    slot = int(node.ufl_operands[1][0])
    is_average = slot >= layout.n_slots // 2
    if not layout.is_linear:
        return math.inf
    return 0 if is_average else int(slot % layout.n_rows == 0)


def _positions(used: npt.NDArray[np.int64], offset: int) -> dict[int, int]:
    return {int(slot): offset + k for k, slot in enumerate(used)}


def _slot_argument(size: int, number: int) -> ufl.Argument:
    element = basix.ufl.element("DG", "interval", 0, shape=(max(size, 1),))
    return ufl.Argument(ufl.FunctionSpace(INTERVAL, element), number)


def _as_tensor(components: npt.NDArray[np.object_]) -> Any:
    if components.shape == ():
        return components.item()
    return ufl.as_tensor(components.tolist())


def _is_simplex(element: Any) -> bool:
    return element.cell_type.name in SIMPLICES


def _is_uniform(expression: Any) -> bool:
    """Return whether an expression has the same value at all points of a group."""
    return all(
        isinstance(t, ufl.Constant | ufl.classes.ConstantValue | MultiIndex)
        or type(t).__name__ in CELL_GEOMETRY
        for t in unique_post_traversal(expression)
        if t._ufl_is_terminal_
    )
